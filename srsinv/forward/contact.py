"""Contact: the pressure under a rigid profile pressed into the skin, without friction or adhesion.

Heights are positive into the finger. The skin's surface is displaced by w, everything repeats with
the window, and the mean pressure is given; the skin as a whole moves freely. Then

    gap = w + const - h >= 0,  p >= 0,  p gap = 0,  mean p = nominal.

At nu = 1/2 shear does not move the surface normally (no Dundurs coupling), so that friction leaves
p alone (docs/physics.md, section 10).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ..errors import number, refuse
from ..grid import Line, as_real, sinc
from .skin import Skin

COARSER = 16  # the start comes from cells so many times wider
COARSEST = 2048  # cells: below, a coarse start gains nothing, and costs compilation
COARSE_STEPS = 60  # of the start on coarser cells, which need not converge
MOST_STEPS = 1000
DERIVATIVE_STEPS = 500


class Contact(eqx.Module):
    """The solution: over cells (n,), pressure [Pa] as cell averages and gap [m] at their centres.

    - `residual`: how far the gap is from zero in contact, or below it elsewhere, at most, over the
      profile's height; `tolerance`: what it has to reach. `iterations`: on the finest cells.
    """

    pressure_Pa: Float[Array, " n"]
    gap_m: Float[Array, " n"]
    residual: Float[Array, ""]
    iterations: Float[Array, ""]
    tolerance: float = eqx.field(static=True)

    @property
    def touching(self) -> Bool[Array, " n"]:
        """Where the skin touches."""
        return self.pressure_Pa > 0

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether the residual is as small as it has to be."""
        return self.residual <= self.tolerance

    @property
    def result(self) -> str:
        """ "converged", or what went wrong."""
        if bool(self.converged):
            return "converged"
        return (
            f"not converged: after {int(self.iterations)} iterations the gap is off by "
            f"{float(self.residual):.2g} of the profile's height"
        )


def press(line: Line, skin: Skin, height_m: Float[Array, " n"], nominal_pressure_Pa) -> Contact:
    """The profile `height_m` (n,) at the cell centres, pressed into `skin` with a mean pressure.

    Projected conjugate gradients after Polonsky and Keer (1999), preconditioned on the contact set
    by 1/compliance (|k| for a half space), started from wider cells; full contact by its formula.
    Differentiable in all that is given, forward and reverse, by the implicit function theorem:
    where a cell is about to touch or to part, the derivative is that of one side.

    Raises `BadInput` for a pressure that is not positive and heights that are not finite, unless
    they are traced. Traced, a pressure of zero or less gives no contact at all.
    """
    wanted = "a positive pressure in Pa, the mean over the contact window"
    number("nominal_pressure_Pa", nominal_pressure_Pa, wanted, above=0)
    if not isinstance(height_m, Tracer):
        refuse(
            not bool(np.isfinite(height_m).all()),
            "The surface's height is not finite everywhere: check its numbers, in metres.",
        )
    compliance = cell_compliance(line, skin)
    nominal = as_real(nominal_pressure_Pa)
    pressure, gap, residual, iterations = _solved(height_m, nominal, compliance)
    return Contact(pressure, gap, residual, iterations, _tolerance(height_m.dtype))


# Compiled as a whole: step by step, called eagerly, every loop would be compiled anew.
@jax.jit
def _solved(height_m, nominal, compliance):
    """Pressure, gap, residual and iterations."""
    height = height_m - jnp.mean(height_m)
    deviation, iterations = _pressed(height, nominal, compliance)
    gap, residual = _gap(height, nominal, _times(compliance, deviation), deviation)
    # Cells out of contact hold -nominal: their pressure is zero to the last digit.
    return jnp.maximum(nominal, 0.0) + deviation, gap, residual, iterations


@eqx.filter_jit
def cell_compliance(line: Line, skin: Skin) -> Float[Array, " k"]:
    """Displacement at the cell centres under cell averages of pressure [m/Pa], at line.k.

    The pressure is the band-limited function with these averages, as on a periodic line. Nothing
    at k = 0: the mean displacement is free.
    """
    k = line.k
    there = k > 0
    safe = jnp.where(there, k, 1.0)
    return jnp.where(there, skin.compliance(safe) / sinc(safe * line.cell_m / 2), 0.0)


def _tolerance(dtype) -> float:
    return max(1e-10, 40 * float(jnp.finfo(dtype).eps))


def _times(spectrum: Float[Array, " k"], values: Float[Array, " n"]) -> Float[Array, " n"]:
    return jnp.fft.irfft(spectrum * jnp.fft.rfft(values), values.size)


def _stiffness(compliance: Float[Array, " k"]) -> Float[Array, " k"]:
    """1/compliance, with something of the size of the longest wave's at k = 0."""
    inverse = 1 / jnp.where(compliance > 0, compliance, 1.0)
    return jnp.where(compliance > 0, inverse, inverse[1] / 2)


def _gap(height, nominal, moved, deviation):
    """The gap, zero on average where the skin touches, and its error over the profile's height."""
    touching = _touching(nominal, deviation)
    gap = moved - height
    gap = gap - jnp.sum(jnp.where(touching, gap, 0.0)) / jnp.maximum(jnp.sum(touching), 1)
    # Weighed by the pressure, so that p gap is small beside the load too.
    weight = jnp.maximum(1.0, 1.0 + deviation / jnp.where(nominal > 0, nominal, 1.0))
    wrong = jnp.max(jnp.where(touching, weight * jnp.abs(gap), jnp.maximum(-gap, 0.0)))
    span = jnp.ptp(height)
    return gap, jax.lax.stop_gradient(
        jnp.where(span > 0, wrong / jnp.where(span > 0, span, 1), 0.0)
    )


def _touching(nominal, deviation):
    return deviation > -nominal


@jax.custom_jvp
def _pressed(height, nominal, compliance):
    """The pressure's deviation from its mean, and the number of iterations.

    As a deviation, so that features far smaller than the load keep their digits.
    """
    full = _times(_stiffness(compliance).at[0].set(0.0), height)
    is_full = jnp.all(full > -nominal)
    return jax.lax.cond(
        is_full,
        lambda: (full, jnp.zeros((), height.dtype)),
        lambda: _partial(height, nominal, compliance, MOST_STEPS),
    )


def _partial(height, nominal, compliance, most: int):
    """Partial contact, from the solution on wider cells."""
    n = height.size
    if n % COARSER == 0 and n // COARSER >= COARSEST:
        coarse = jnp.mean(height.reshape(-1, COARSER), axis=1)
        lower = compliance[: coarse.size // 2 + 1]
        start = jnp.repeat(_partial(coarse, nominal, lower, COARSE_STEPS)[0], COARSER)
    else:
        start = jnp.zeros_like(height)
    return _iterate(height, nominal, compliance, start, most)


class _State(NamedTuple):
    deviation: Float[Array, " n"]
    moved: Float[Array, " n"]
    gap: Float[Array, " n"]
    residual: Float[Array, ""]
    active: Bool[Array, " n"]
    evenly: Float[Array, " n"]
    direction: Float[Array, " n"]
    norm: Float[Array, ""]
    conjugate: Bool[Array, ""]
    steps: Float[Array, ""]


def _iterate(height, nominal, compliance, start, most: int):
    """From `start`: each step is one of conjugate gradients on the cells that touch or overlap.

    A state holds the deviation, the displacement `moved` under it, the gap and its error; `evenly`
    is the preconditioned unit load on the `active` cells. What costs Fourier transforms is only
    done again where cells came or went.
    """
    stiffness, tolerance = _stiffness(compliance), _tolerance(height.dtype)

    def on(active, values):
        return jnp.where(active, _times(stiffness, values), 0.0)

    def going(at: _State):
        return (at.residual > tolerance) & (at.steps < most)

    def step(at: _State) -> _State:
        touching = _touching(nominal, at.deviation)
        entering = ~touching & (at.gap < 0)
        active = touching | entering
        evenly = jax.lax.cond(
            jnp.all(active == at.active),
            lambda: at.evenly,
            lambda: on(active, active.astype(height.dtype)),
        )
        rest = jnp.where(active, at.gap, 0.0)
        z = _balanced(on(active, rest), evenly)
        norm = rest @ z
        keep = at.conjugate & ~jnp.any(entering)
        beta = jnp.where(keep, norm / jnp.where(at.norm > 0, at.norm, 1.0), 0.0)
        direction = jnp.where(active, z + beta * at.direction, 0.0)
        answer = _times(compliance, direction)
        bent = direction @ answer
        length = (rest @ direction) / jnp.where(bent > 0, bent, 1.0)
        free = at.deviation - length * direction
        lifted = active & (free <= -nominal)
        whole = ~jnp.any(lifted)
        deviation = jnp.where(whole, free, _cut(free, active, nominal))
        moved = jax.lax.cond(
            whole,
            lambda: at.moved - length * answer,
            lambda: _times(compliance, deviation),
        )
        gap, residual = _gap(height, nominal, moved, deviation)
        # A direction that lost cells would carry a net force.
        return _State(
            deviation, moved, gap, residual, active, evenly, direction, norm, whole, at.steps + 1
        )

    zero, none = jnp.zeros((), height.dtype), jnp.zeros_like(height)
    moved = _times(compliance, start)
    gap, residual = _gap(height, nominal, moved, start)
    active = jnp.zeros(height.shape, bool)
    first = _State(start, moved, gap, residual, active, none, none, zero, jnp.array(False), zero)
    end = jax.lax.while_loop(going, step, first)
    return end.deviation, end.steps


def _cut(deviation, active, nominal):
    """Without the cells that pull, which are let go, and with the same load on the rest."""
    pressure = jnp.where(active, jnp.maximum(nominal + deviation, 0.0), 0.0)
    mean = jnp.mean(pressure)
    return nominal / jnp.where(mean > 0, mean, 1.0) * pressure - nominal


def _balanced(values, evenly):
    """`values` with no net force, what is missing spread as `evenly`."""
    total = jnp.sum(evenly)
    return values - jnp.sum(values) / jnp.where(total != 0, total, 1.0) * evenly


@_pressed.defjvp
def _pressed_jvp(primals, tangents):
    """The implicit function theorem on the contact set, which to first order does not move: the
    pressure vanishes at its edge. There gap = 0 gives C dp + const = dh - dC p."""
    _, nominal, compliance = primals
    d_height, d_nominal, d_compliance = tangents
    deviation, iterations = _pressed(*primals)
    touching = _touching(nominal, deviation)
    share = jnp.where(touching, 1.0, 0.0) / jnp.maximum(jnp.mean(touching), 1 / touching.size)
    # The load changes evenly over the contact, and what balances has no net force.
    even = d_nominal * (share - 1)
    wanted = d_height - _times(d_compliance, deviation) - _times(compliance, even)
    free = _solve_on(touching, compliance, wanted)
    return (deviation, iterations), (even + free, jnp.zeros_like(iterations))


def _solve_on(touching, compliance, wanted):
    """What has no net force on the contact set and gives `wanted` there, up to a constant."""
    count = jnp.maximum(jnp.sum(touching), 1)

    def project(values):
        inside = jnp.where(touching, values, 0.0)
        return jnp.where(touching, inside - jnp.sum(inside) / count, 0.0)

    def response(values):
        # What is not in the range answers too, faintly and in the same unit, so that the system is
        # regular and its rounding no larger than the rest's.
        inside = project(values)
        return project(_times(compliance, inside)) + compliance[-1] * (values - inside)

    def on(values):
        return jnp.where(touching, _times(_stiffness(compliance), values), 0.0)

    evenly = on(touching.astype(wanted.dtype))

    def solve(_, right):
        return _gradients(response, lambda values: _balanced(on(values), evenly), right)

    return project(jax.lax.custom_linear_solve(response, project(wanted), solve, symmetric=True))


def _gradients(response, precondition, right):
    """Preconditioned conjugate gradients, in the range of the preconditioner."""
    eps = jnp.finfo(right.dtype).eps

    def going(at):
        return (at[3] > target) & (at[4] < DERIVATIVE_STEPS)

    def step(at):
        found, rest, direction, norm, steps = at
        pushed = response(direction)
        bent = direction @ pushed
        length = norm / jnp.where(bent > 0, bent, 1.0)
        found, rest = found + length * direction, rest - length * pushed
        z = precondition(rest)
        new = rest @ z
        return found, rest, z + new / jnp.where(norm > 0, norm, 1.0) * direction, new, steps + 1

    z = precondition(right)
    first = right @ z
    target = (8 * eps) ** 2 * first
    start = (jnp.zeros_like(right), right, z, first, 0)
    return jax.lax.while_loop(going, step, start)[0]
