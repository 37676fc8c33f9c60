"""Where a known feature lies in the signals of a rig that is known roughly."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..forward.operator import PositionInterpolation
from ..grid import as_real
from .features.search import Blocks
from .features.sliding_noise import first_levels
from .rig_model import RigModel

TRIED_DEPTHS = (0.7, 1.0, 1.4)  # of the stated depth, in the search for the feature's place
SEARCHED = 4_000  # means of samples at most, in that search


@eqx.filter_jit
def _unit_signals(model: RigModel, first: Any, depths: Float[Array, " a"], places):
    """The signals (a, b, part, e, sample) at gains of one, at depths and places (b,) tried: of
    pressure, and of the shear of a friction of one. What the electronics do in time is left out."""
    motion, pressure = model.motion, model.pressure_Pa
    nothing = jnp.zeros_like(pressure)
    turn = jnp.where(motion.direction < 0, -1.0, 1.0)

    def at_depth(depth):
        sensor = model.sensor_of(first | {"depth_m": depth})
        operator = sensor.operator_along(model.line, motion, ways=model.ways)
        fields = [
            operator.field(jnp.stack(pair)) for pair in ((pressure, nothing), (nothing, pressure))
        ]

        def at_place(place):
            at = PositionInterpolation(model.line, motion.position_m + model.place_m - place)
            alone, shear = (operator.gain * at(field) for field in fields)
            return jnp.stack([alone, turn * shear])

        return jax.lax.map(at_place, places)

    return jax.lax.map(at_depth, depths)


def feature_start(
    model: RigModel, y: Float[np.ndarray, "e sample"], first: Mapping[str, Any], free: list[str]
) -> dict[str, float]:
    """Where the feature is, and a first depth and gains: those whose signals, of pressure and of
    shear in any ratio in each channel, leave least of the data."""
    depth, x = float(first["depth_m"]), np.asarray(model.motion.position_m)
    blocks = Blocks(model.motion, max(depth / 4, float(np.sum(np.abs(np.diff(x)))) / SEARCHED))
    coarse = eqx.tree_at(lambda m: m.motion, model, blocks.motion)
    places = np.arange(x.min() - depth, x.max() + depth, depth / 3)
    places = places if "position_m" in free else np.array([first["position_m"]])
    depths = depth * np.array(TRIED_DEPTHS if "depth_m" in free else (1.0,))
    own = {name: as_real(value) for name, value in first.items()}
    signals = np.asarray(_unit_signals(coarse, own, as_real(depths), as_real(places)))
    tried = np.stack(np.meshgrid(depths, places, indexing="ij"), axis=-1)
    means = blocks.means(np.nan_to_num(y))
    observed = blocks.means(np.isfinite(y).astype(float)) > 0.5
    white = first_levels(y, depth).white
    best, most = None, -np.inf
    rows = zip(tried.reshape(-1, 2), signals.reshape(-1, *signals.shape[2:]), strict=True)
    for row, unit in rows:
        gains, ratios, explained = [], [], 0.0
        for e in range(len(y)):
            columns, data = unit[:, e, observed[e]].T, means[e, observed[e]]
            if model.free_offset:
                columns, data = columns - columns.mean(axis=0), data - data.mean()
            parts, *_ = np.linalg.lstsq(columns, data, rcond=1e-9)
            explained += float(data @ columns @ parts) / white[e] ** 2
            gains.append(float(parts[0]))
            ratios.append(parts[1] / parts[0] if parts[0] else 0.0)
        if explained > most:
            mu = float(np.clip(np.median(ratios), -1, 1))
            best, most = (row, gains, mu), explained
    assert best is not None
    (depth, place), gains, mu = best
    start = {"depth_m": float(depth), "position_m": float(place), "base_friction": mu}
    start |= {f"gain_{e}": gain for e, gain in enumerate(gains, 1)}
    return {name: value for name, value in start.items() if name in free}
