"""Start values of a fit of a surface's features: contact solved once per shape, shifted to every
place.

A periodic surface gives the same traction wherever its feature lies, so that contact is solved for
one place only, and its signal is shifted.
"""

import itertools
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from ..forward.feature import ScanExtent
from ..forward.surface_feature import SurfaceFeature
from ..grid import as_real
from .cells import Window
from .feature_search import Blocks, apart
from .surface_model import SurfaceModel

CELLS_PER_DEPTH = 12
SAMPLES_PER_DEPTH = 4
AT_ONCE = 64  # shapes whose signals are held at the same time
PLACE = "position_m"


class SurfaceSearch:
    """The best shapes and places of a feature, by a coarse model."""

    def __init__(self, model: SurfaceModel, window: Window, stretch: ScanExtent):
        depth = float(model.sensor.depth_m)
        self._blocks = Blocks(model.motion, depth / SAMPLES_PER_DEPTH)
        self._coarse = SurfaceModel.on_window(
            model.sensor, self._blocks.motion, window, depth / CELLS_PER_DEPTH
        )
        self._stretch = stretch

    def signal(self, features: Mapping[str, SurfaceFeature], params: Any) -> np.ndarray:
        """The coarse signal of features already found."""
        return np.asarray(self._coarse.with_features(features)(params))

    def starts(
        self,
        y: Float[np.ndarray, "e sample"],
        white: Float[np.ndarray, " e"],
        previous: tuple[Mapping[str, SurfaceFeature], Any],
        feature: SurfaceFeature,
        known: Mapping[str, float],
        start: Mapping[str, float],
    ) -> list[dict[str, float]]:
        """Parameters to start from, the best first.

        - `y`, `white`: the data and their white noise; `previous`: features found before, and all
          of their parameters; `known`: `nominal_pressure_Pa` and the feature's `edge_length_m`;
        - `start`: user's values of the feature's `axes`: some of them are fixed, and the rest
          searched; all of them are one more start.
        """
        whole = feature.axes.keys() <= start.keys()
        tried = {
            name: np.array([start[name]])
            if name in start and not whole
            else axis.tried(within, self._stretch)
            for (name, axis), within in zip(
                feature.axes.items(), feature.ranges(self._stretch).values(), strict=True
            )
        }
        rest = self._blocks.means(np.nan_to_num(y))
        if previous[0]:
            rest = rest - self.signal(*previous)
        places = tried.pop(PLACE)
        shapes = np.array(list(itertools.product(*tried.values()))).reshape(-1, len(tried))
        if whole:
            shapes = np.vstack([shapes, [start[name] for name in tried]])
            places = np.append(places, start[PLACE])
        # Filled up to whole rounds: an incomplete round would be compiled a second time.
        rounds = -(-len(shapes) // AT_ONCE)
        size = -(-len(shapes) // rounds)
        filled = shapes[np.minimum(np.arange(rounds * size), len(shapes) - 1)]
        misfit = np.concatenate(
            [
                self._misfits(rest / white[:, None], white, feature, names_to(tried, some), places,
                              known)
                for some in np.split(filled, rounds)
            ]
        )[: len(shapes)]  # fmt: skip
        rows = [np.repeat(column, places.size) for column in shapes.T]
        rows.append(np.tile(places, len(shapes)))
        names = [*tried, PLACE]
        chosen = apart(rows, -misfit.ravel())
        return [
            {name: float(row[at]) for name, row in zip(names, rows, strict=True)} for at in chosen
        ]

    def _misfits(self, white_y, white, feature, shapes, places, known) -> np.ndarray:
        """Half the residual sum of squares under the best frictions, (shape, place)."""
        line, motion = self._coarse.line, self._coarse.motion
        middle = float(line.x[line.n // 2])
        model = self._coarse.with_features({"one": feature})
        # Edges sharper than a cell would be sampled or missed as a whole.
        edge = max(known["edge_length_m"], float(line.cell_m))
        rest = {
            "nominal_pressure_Pa": as_real(known["nominal_pressure_Pa"]),
            "edge_length_m": as_real(edge),
            PLACE: as_real(middle),
        }
        fields = np.asarray(_fields(model, {k: as_real(v) for k, v in shapes.items()}, rest))
        fields = fields / white[:, None]
        gain, way = np.asarray(self._coarse.operator.gain), self._ways()
        position, start, cell = np.asarray(motion.position_m), float(line.x[0]), float(line.cell_m)
        white_y = self._without_mean(white_y).ravel()
        misfit = np.empty((len(fields), places.size))
        for i, place in enumerate(places):
            at = (position - place + middle - start) / cell
            first = np.floor(at).astype(int)
            fraction = (at - first)[:, None, None, None]
            # Advanced indices come first: (sample, shape, part, e).
            low = fields[:, :, way, :, first % line.n]
            high = fields[:, :, way, :, (first + 1) % line.n]
            signal = gain[:, None, None, None] * (low + fraction * (high - low))
            parts = signal.transpose(1, 2, 3, 0)
            if self._coarse.free_offset:
                parts = parts - parts.mean(axis=-1, keepdims=True)
            parts = parts.reshape(*parts.shape[:2], -1)
            left = white_y - parts[:, 0]
            basis = parts[:, 1:]
            gram = basis @ basis.swapaxes(1, 2)
            size = np.trace(gram, axis1=1, axis2=2)[:, None, None]
            gram = gram + (1e-9 * size + 1e-300) * np.eye(gram.shape[-1])
            projections = (basis @ left[:, :, None])[..., 0]
            solved = np.linalg.solve(gram, projections[..., None])[..., 0]
            misfit[:, i] = np.sum(left**2, axis=1) - np.sum(projections * solved, axis=1)
        return misfit / 2

    def _ways(self) -> np.ndarray:
        """Index into the model's `ways` (directions of sliding) of each sample."""
        onwards = np.asarray(self._coarse.motion.direction) >= 0
        return np.array([self._coarse.operator.ways.index(bool(each)) for each in onwards])

    def _without_mean(self, y: np.ndarray) -> np.ndarray:
        return y - self._coarse.free_offset * y.mean(axis=-1, keepdims=True)


def names_to(tried: Mapping[str, Any], rows: np.ndarray) -> dict[str, np.ndarray]:
    """Rows (start, name) by their names."""
    return dict(zip(tried, rows.T, strict=True))


@eqx.filter_jit
def _fields(model: SurfaceModel, shapes, rest) -> Float[Array, "start part way e n"]:
    """The amplifier's input along the line, of the model's only feature."""
    ((name, feature),) = model.features.items()
    pressure = {"nominal_pressure_Pa": rest["nominal_pressure_Pa"]}
    own = {k: v for k, v in rest.items() if k not in pressure}
    own |= {f: as_real(0.0) for f in feature.frictions}
    return jax.lax.map(lambda shape: model.fields(pressure | {name: shape | own}), shapes)
