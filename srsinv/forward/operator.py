"""The operator along a measured motion x(t).

The stress pattern is fixed to the surface, so that the film's charge is Q(x(t)) and its current
dQ/dt = u(t) Q'(x(t)). The line gives Q' by its exact transfer or kernel; what is left is to
interpolate it to x(t) and to multiply by u(t). Nothing is divided by the speed: at a standstill the
rate signal is zero.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from ..errors import refuse
from ..grid import Convolution, Line, Operator, Periodic, as_real
from .filter import Filter, filtered, filtered_adjoint

POINTS = 8
AT_THE_END = 1e-3  # of a cell: a position this far beyond an end is there but for round-off


class PositionInterpolation(eqx.Module):
    """Interpolation from the samples of a line to the positions x(t), linear in the samples.

    Each position takes the polynomial through its 8 nearest samples (all, where a line has fewer):
    the error is of eighth order in the cell, and nothing at a sample itself. A periodic line wraps
    around. An open one ends at its first and last sample, and near them the polynomial is that of
    the 8 at the end. Differentiable in the positions.

    Raises `BadInput` for a position beyond the ends of an open line, unless it is traced.
    """

    index: Int[Array, "sample point"]
    weights: Float[Array, "sample point"]
    n: int = eqx.field(static=True)

    def __init__(self, line: Line, position_m):
        wraps = isinstance(line, Periodic)
        points = min(POINTS, line.n)
        at = (as_real(position_m) - line.start_m) / line.cell_m
        first = jnp.floor(at) - (points - 1) // 2
        if not wraps:
            _refuse_outside(line, at)
            first = jnp.clip(first, 0, line.n - points)
        index = first.astype(int)[:, None] + np.arange(points)[None]
        self.index = index % line.n if wraps else index
        self.weights = lagrange(at - first, points)
        self.n = line.n

    def __call__(self, signal: Float[Array, "e n"]) -> Float[Array, "e sample"]:
        """The signal at the positions."""
        return jnp.sum(self.weights[None] * signal[:, self.index], axis=-1)

    def adjoint(self, y: Float[Array, "e sample"]) -> Float[Array, "e n"]:
        """The transpose: <y, self(s)> = <self.adjoint(y), s>."""
        zero = jnp.zeros((y.shape[0], self.n), y.dtype)
        return zero.at[:, self.index].add(self.weights[None] * y[..., None])


class MotionOperator(Operator):
    """The operator along a measured motion: a sample wherever the sensor is at its times.

    - `line`: of the traction; `interpolation`: from its cells to where the sensor is.
    - `field`: the `order`-th derivative of charge along x on the line, order 1 for a rate signal.
    - `gain`, `direction` (sample,): the amplifier's factor, R_f u(t) for a rate signal, and
      sign(u), kept through a standstill.
    - `filters`: what the electronics then do in time, the samples being `interval_s` apart; before
      the first sample the signal was what it is there.
    - `end` (e, c, sample): the signal, ahead of the filters, of unit traction on everything beyond
      the line's last cell; None where nothing goes on there.
    - `directions` of motion: True where the sensor slides towards +x, False towards -x, in this
      order.

    Coulomb friction turns with the motion, q = sign(u) mu p. In this idealisation the shear jumps
    at the instant of reversal and sends an impulse of current; no sample stands at that instant,
    and the impulse is not in the signal.
    """

    line: Line
    field: Convolution
    interpolation: PositionInterpolation
    gain: Float[Array, " sample"]
    direction: Float[Array, " sample"]
    filters: tuple[Filter, ...] = ()
    interval_s: Float[Array, ""] | None = None
    end: Float[Array, "e c sample"] | None = None
    directions: tuple[bool, ...] = eqx.field(static=True, default=(True, False))

    def __call__(
        self,
        traction: Float[Array, "*way c n"],
        end: Float[Array, "*way c"] | None = None,
    ) -> Float[Array, "e sample"]:
        """The signal under one `traction` [Pa] all along, as without friction or where the motion
        does not turn, or under one for each way; with `end`, the traction that goes on beyond the
        last cell.

        One traction is one convolution in the program, both ways are two.
        """
        return filtered(self.filters, self._before_filters(traction, end), self.interval_s)

    def _before_filters(self, traction, end) -> Float[Array, "e sample"]:
        if traction.ndim == 3:
            ahead, back = (
                self._before_filters(own, None if end is None else end[direction])
                for direction, own in enumerate(traction)
            )
            return jnp.where(self.direction[None] < 0, back, ahead)
        signal = self.gain[None] * self.interpolation(self.field(traction))
        return signal if end is None else signal + jnp.einsum("ecs,c->es", self.end, end)

    def adjoint(
        self, signal: Float[Array, "e sample"], each_way: bool = False
    ) -> Float[Array, "*way c n"]:
        """The transpose for one traction all along, or for one for each way."""
        y = filtered_adjoint(self.filters, signal, self.interval_s)
        if not each_way:
            return self._adjoint(y)
        turned = self.direction[None] < 0
        directions = jnp.where(turned, 0.0, y), jnp.where(turned, y, 0.0)
        return jnp.stack([self._adjoint(own) for own in directions])

    def _adjoint(self, y: Float[Array, "e sample"]) -> Float[Array, "c n"]:
        return self.field.adjoint(self.interpolation.adjoint(self.gain[None] * y))


def lagrange(t: Float[Array, " sample"], points: int) -> Float[Array, "sample point"]:
    """Weights at t of samples at 0, 1, ..., points - 1.

    As products, which have neither 0/0 nor an infinite gradient at a sample.
    """
    node = np.arange(points)[None]
    weights = jnp.ones((t.size, points), t.dtype)
    for other in range(points):
        itself = node == other
        distance = np.where(itself, 1, node - other)
        weights = weights * jnp.where(itself, 1.0, (t[:, None] - other) / distance)
    return weights


def _refuse_outside(line: Line, at: Float[Array, " sample"]) -> None:
    if isinstance(at, Tracer):
        return
    cells = np.asarray(at)
    before, after = -cells.min(), cells.max() - (line.n - 1)
    excess = max(before, after)
    end = line.start_m if before > after else line.x[-1]
    refuse(
        bool(excess > AT_THE_END),
        f"The motion goes {excess * float(line.cell_m):.4g} m beyond the end of the line at "
        f"{float(end):.6g} m: make the line longer by that much, or cut the motion there.",
    )
