"""Forward model of traction features: parameters to voltage along a motion."""

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..forward.feature import Feature, ScanExtent
from ..forward.operator import MotionOperator
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..grid import Line, Open, as_real

CELLS_PER_DEPTH = 32  # the signal of an edge is then right to 1e-6 of its peak, of a line to 1e-5
MARGIN_DEPTHS = 16  # beyond the scan, in which what repeats fades out
FAR_M = 1e3  # how far a step goes on

Features = Mapping[str, Feature]


class FeatureModel(eqx.Module):
    """Parameters of traction features to the signal (element, sample) along a motion.

    The traction lies on an open line with fine cells and a margin beyond the scan; a semi-infinite
    feature goes on beyond the line's end, and a periodic one fades out towards both ends by `fade`
    (n,). With `free_offset` each element has an unknown constant. Where features are searched is no
    part of the model: one program serves every range.
    """

    PROFILES: ClassVar[tuple[str, ...]] = ("p", "q")
    operator: MotionOperator
    fade: Float[Array, " n"]
    features: dict[str, Feature]
    free_offset: bool = eqx.field(static=True)

    @classmethod
    def along(
        cls, sensor: Sensor, motion: Motion, cells_per_depth: int = CELLS_PER_DEPTH
    ) -> "FeatureModel":
        """The model of a sensor along a motion, without any feature."""
        line = line_under(sensor, motion, cells_per_depth)
        operator = operator_along(sensor, line, motion, FAR_M, motion.ways)
        return cls(operator, _fade(line, motion), {}, sensor.amplifier.offset is None)

    def with_features(self, features: Features) -> "FeatureModel":
        """The same sensor and motion with these features in place of its own."""
        anywhere = {name: feature.anywhere for name, feature in features.items()}
        return dataclasses.replace(self, features=anywhere)

    @property
    def line(self) -> Line:
        """The cells of the traction."""
        return self.operator.line

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        named = [f"{n}.{part}" for n, f in self.features.items() for part in f.linear]
        return (*named, "offset") if self.free_offset else tuple(named)

    def traction(self, params: Any) -> Float[Array, "2 n"]:
        """p and q [Pa] on the line while sliding towards +x."""
        total = jnp.zeros((2, self.line.n))
        for name, feature in self.features.items():
            shape = feature.profile(params[name]).cell_values(self.line)
            shape = shape * self.fade if feature.is_periodic else shape
            total = total + jnp.stack(amplitudes(feature, params[name]))[:, None] * shape[None]
        return total

    def profiles(self, params: Any) -> Float[Array, "2 n"]:
        """What acts along the line while sliding towards +x: p and q [Pa]."""
        return self.traction(params)

    def cell_traction(self, params: Any, line: Line) -> Float[Array, "2 m"]:
        """Averages of p and q [Pa] over the cells of any line, while sliding towards +x."""
        total = jnp.zeros((2, line.n))
        for name, feature in self.features.items():
            shape = feature.profile(params[name]).cell_average(line)
            if feature.is_periodic:
                shape = shape * jnp.interp(line.x, self.line.x, self.fade)
            total = total + jnp.stack(amplitudes(feature, params[name]))[:, None] * shape
        return total

    @property
    def steps(self) -> dict[str, float]:
        """Steps for central differences, by parameter: its derivatives need none."""
        return {}

    def __call__(self, params: Any) -> Float[Array, "e sample"]:
        return self._signal(jax.tree.map(as_real, params))  # Python's numbers would be compiled in

    @eqx.filter_jit
    def _signal(self, params: Any) -> Float[Array, "e sample"]:
        end = self._end(params)
        signal = self.operator(
            self._each_way(self.traction(params)), None if end is None else self._each_way(end)
        )
        return signal + params["offset"][:, None] if self.free_offset else signal

    def _each_way(self, traction: Float[Array, "2 *n"]) -> Float[Array, "..."]:
        """p and q for each way of the motion from those while sliding towards +x."""
        back = traction * jnp.array([1.0, -1.0]).reshape(2, *[1] * (traction.ndim - 1))
        ways = [traction if way else back for way in self.operator.ways]
        return jnp.stack(ways) if len(ways) > 1 else ways[0]

    def _end(self, params: Any) -> Float[Array, " 2"] | None:
        """p and q of semi-infinite features, which go on beyond the line's end."""
        ends = [
            jnp.stack(amplitudes(feature, params[name]))
            for name, feature in self.features.items()
            if feature.is_semi_infinite
        ]
        return sum(ends[1:], ends[0]) if ends else None


@eqx.filter_jit
def operator_along(
    sensor: Sensor, line: Line, motion: Motion, reach_m: float | None, ways: tuple[bool, ...]
) -> MotionOperator:
    """[`Sensor.operator_along`][] as one program."""
    return sensor.operator_along(line, motion, reach_m, ways)


def amplitudes(feature: Feature, own: Mapping[str, Any]) -> tuple[Array, Array]:
    """Of p and of q."""
    p = jnp.asarray(own[feature.amplitude])
    q = own[feature.shear] if feature.friction is None else feature.friction * p
    return p, jnp.asarray(q)


def line_under(sensor: Sensor, motion: Motion, cells_per_depth: int) -> Open:
    """The open line that the features' traction lies on: fine cells, and a margin at both ends."""
    depth = float(sensor.depth_m)
    x = np.asarray(motion.position_m)
    cell = depth / cells_per_depth
    start = float(x.min()) - MARGIN_DEPTHS * depth
    n = int(np.ceil((float(x.max()) + MARGIN_DEPTHS * depth - start) / cell)) + 1
    return Open(n, cell, start)


@eqx.filter_jit
def _fade(line: Line, motion: Motion) -> Float[Array, " n"]:
    """One over the scan and half its margins, falling to zero at the line's ends as a cosine."""
    x, low, high = line.x, jnp.min(motion.position_m), jnp.max(motion.position_m)
    outside = jnp.maximum(low - x, x - high) / jnp.maximum(low - x[0], line.cell_m)
    return 0.5 * (1 + jnp.cos(jnp.pi * jnp.clip(2 * outside - 1, 0.0, 1.0)))


def scan_extent(sensor: Sensor, motion: Motion) -> ScanExtent:
    """Where the motion has been."""
    x = np.asarray(motion.position_m)
    return ScanExtent(float(x.min()), float(x.max()), float(sensor.depth_m))
