"""The signal along a measured motion x(t): the stage after the line, in time.

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
from ..grid import Convolution, Line, Periodic, as_real
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


class Scanned(eqx.Module):
    """The signal of every sample of a motion: traction (2, n) on a line to (element, sample).

    - `field`: the `order`-th derivative of charge along x on the line, order 1 for a rate signal.
    - `gain`, `direction` (sample,): the amplifier's factor, R_f u(t) for a rate signal, and
      sign(u), kept through a standstill.
    - `filters`: what the electronics then do in time, the samples being `interval_s` apart; before
      the first sample the signal was what it is there.

    Coulomb friction turns with the motion, q = sign(u) mu p. In this idealisation the shear jumps
    at the instant of reversal and sends an impulse of current; no sample stands at that instant,
    and the impulse is not in the signal.
    """

    field: Convolution
    sampling: PositionInterpolation
    gain: Float[Array, " sample"]
    direction: Float[Array, " sample"]
    filters: tuple[Filter, ...] = ()
    interval_s: Float[Array, ""] | None = None

    def __call__(
        self,
        forward: Float[Array, "c n"],
        backward: Float[Array, "c n"] | None = None,
        continuation: Float[Array, "e sample"] | None = None,
    ) -> Float[Array, "e sample"]:
        """The signal under `forward`, the traction [Pa] while sliding towards +x, and `backward`,
        the one while sliding towards -x; with `continuation`, what the amplifier reads of traction
        off the line.

        Without `backward` the traction is the same all along: without friction, or where the
        motion does not reverse. Only one convolution is then in the program.
        """
        signal = self.sampling(self.field(forward))
        if backward is not None:
            turned = self.sampling(self.field(backward))
            signal = jnp.where(self.direction[None] < 0, turned, signal)
        signal = self.gain[None] * signal
        signal = signal if continuation is None else signal + continuation
        return filtered(self.filters, signal, self.interval_s)

    def adjoint(self, y: Float[Array, "e sample"]) -> Float[Array, "c n"]:
        """The transpose for one traction all along: <y, self(r)> = <self.adjoint(y), r>."""
        y = filtered_adjoint(self.filters, y, self.interval_s)
        return self._before_filters(y)

    def adjoint_each_way(
        self, y: Float[Array, "e sample"]
    ) -> tuple[Float[Array, "c n"], Float[Array, "c n"]]:
        """The transpose for two tractions: <y, self(f, b)> = <a, f> + <c, b> with (a, c) this."""
        y = filtered_adjoint(self.filters, y, self.interval_s)
        turned = self.direction[None] < 0
        ahead = self._before_filters(jnp.where(turned, 0.0, y))
        return ahead, self._before_filters(jnp.where(turned, y, 0.0))

    def _before_filters(self, y: Float[Array, "e sample"]) -> Float[Array, "c n"]:
        return self.field.adjoint(self.sampling.adjoint(self.gain[None] * y))


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
