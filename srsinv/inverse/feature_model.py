"""The signal of features of traction: parameters to voltage along a motion."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..forward.feature import Feature, ScanExtent
from ..forward.scan import Motion
from ..forward.scanned import Scanned
from ..forward.sensor import Sensor
from ..grid import Line, Open, as_real

CELLS_PER_DEPTH = 32  # the signal of an edge is then right to 1e-6 of its peak, of a line to 1e-5
MARGIN_DEPTHS = 16  # beyond the scan, in which what repeats fades out
FAR_M = 1e3  # how far a step goes on

Features = Mapping[str, Feature]


class SampledOperator(eqx.Module):
    """A sensor along a motion, on the open line that features' traction lies on.

    `scanned` maps traction on `line` to the signal; `tail` (e, c, sample) is the signal, ahead of
    the filters, of unit traction on everything beyond the line's end, for what continues; `fade`
    (n,) takes out what repeats towards the line's ends. With `free_offset` each element has an
    unknown constant.
    """

    scanned: Scanned
    tail: Float[Array, "e c sample"]
    fade: Float[Array, " n"]
    line: Line
    direction: Float[Array, " sample"]
    reverses: bool = eqx.field(static=True)
    free_offset: bool = eqx.field(static=True)

    def __init__(self, sensor: Sensor, motion: Motion, cells_per_depth: int = CELLS_PER_DEPTH):
        self.line = line_under(sensor, motion, cells_per_depth)
        self.scanned, self.tail, self.fade = _responding(sensor, motion, self.line)
        self.direction = motion.direction
        self.reverses = bool(motion.reverses)
        self.free_offset = sensor.amplifier.offset is None


@eqx.filter_jit
def _responding(sensor: Sensor, motion: Motion, line: Line):
    return (
        sensor.scanned(line, motion),
        sensor.signal_of_continuation(line, motion, FAR_M),
        _fade(line, motion),
    )


class FeatureModel(eqx.Module):
    """The signal of features as `sampled`: parameters by feature to (element, sample).

    Where they are looked for is no part of it: one program serves every range.
    """

    sampled: SampledOperator
    features: dict[str, Feature]

    def __init__(self, sampled: SampledOperator, features: Features):
        self.sampled = sampled
        self.features = {name: feature.anywhere for name, feature in features.items()}

    @property
    def line(self) -> Line:
        """Where the traction lies."""
        return self.sampled.line

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        named = [f"{n}.{part}" for n, f in self.features.items() for part in f.linear]
        return (*named, "offset") if self.sampled.free_offset else tuple(named)

    def traction(self, params: Any) -> Float[Array, "2 n"]:
        """p and q [Pa] on the line while sliding towards +x."""
        total = jnp.zeros((2, self.line.n))
        for name, feature in self.features.items():
            shape = feature.profile(params[name]).cell_values(self.line)
            shape = shape * self.sampled.fade if feature.is_periodic else shape
            total = total + jnp.stack(amplitudes(feature, params[name]))[:, None] * shape[None]
        return total

    def __call__(self, params: Any) -> Float[Array, "e sample"]:
        return self._signal(jax.tree.map(as_real, params))  # Python's numbers would be compiled in

    @eqx.filter_jit
    def _signal(self, params: Any) -> Float[Array, "e sample"]:
        sampled, forward = self.sampled, self.traction(params)
        turn, backward = jnp.array([[1.0], [-1.0]]), None
        if sampled.reverses:
            backward = turn * forward
        else:
            forward = jnp.where(sampled.direction[0] < 0, turn, 1.0) * forward
        signal = sampled.scanned(forward, backward, self._continuation(params))
        return signal + params["offset"][:, None] if sampled.free_offset else signal

    def _continuation(self, params: Any) -> Float[Array, "e sample"] | None:
        """Of what continues beyond the line's end."""
        tail, total = self.sampled.tail, None
        for name, feature in self.features.items():
            if feature.is_semi_infinite:
                p, q = amplitudes(feature, params[name])
                own = p * tail[:, 0] + q * self.sampled.direction[None] * tail[:, 1]
                total = own if total is None else total + own
        return total


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


def _fade(line: Line, motion: Motion) -> Float[Array, " n"]:
    """One over the scan and half its margins, falling to zero at the line's ends as a cosine."""
    x, low, high = line.x, jnp.min(motion.position_m), jnp.max(motion.position_m)
    outside = jnp.maximum(low - x, x - high) / jnp.maximum(low - line.x[0], line.cell_m)
    return 0.5 * (1 + jnp.cos(jnp.pi * jnp.clip(2 * outside - 1, 0.0, 1.0)))


def scan_extent(sensor: Sensor, motion: Motion) -> ScanExtent:
    """Where the motion has been."""
    x = np.asarray(motion.position_m)
    return ScanExtent(float(x.min()), float(x.max()), float(sensor.depth_m))
