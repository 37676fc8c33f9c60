"""The pressure under a rigid profile pressed into a skin that lags: complex compliance, Re C > 0.

The displacement is real, and still falls uniquely from the pressure, but C(-k) is the conjugate of
C(k): the operator is not symmetric, and conjugate gradients do not hold. It is an elastic skin of
compliance |C|, pressed on a height that its own lag has changed:

    |C| p + const - t >= 0 in contact with p,  t = h + (|C| - C) p.

Taken as it stands, this recursion for t fails where the lag is large. Reflected (Peaceman and
Rachford 1955), t' = h + r (h + 2 |C| p - t) with r = (|C| - C)/(|C| + C), it has the same end and
comes closer by |r| = tan(lag/2) < 1 each time in the elastic energy's norm, whatever the cells:
reflections of monotone operators expand nothing (Lions and Mercier 1979). The same holds for the
linear system behind a derivative.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from .contact_conditions import gap_and_error, least_error, times
from .contact_elastic import derivative, gradients, iterate, on_contact

MOST_ROUNDS = 1000
ROUND_STEPS = 40  # of one elastic contact, which need not converge before the last
ERROR_FRACTION = 0.2  # of a round's reduction of the error: an elastic contact's own error


def _turned(compliance: Complex[Array, " k"]) -> Complex[Array, " k"]:
    """(|C| - C)/(|C| + C), imaginary: minus the tangent of half the phase. Nothing at k = 0."""
    total = jnp.abs(compliance) + compliance.real
    return -1j * compliance.imag / jnp.where(total > 0, total, 1.0)


def _error_fraction(turned: Complex[Array, " k"]) -> Float[Array, ""]:
    """The fraction of the error that an elastic solution may leave, so that rounds still
    converge."""
    return ERROR_FRACTION * (1 - jnp.max(jnp.abs(turned)))


@jax.custom_jvp
def pressure_deviation(height, nominal, compliance):
    """The pressure's deviation from its mean, and the number of steps of all elastic contacts."""
    stiffness = jnp.where(compliance == 0, 0.0, 1 / compliance)
    full = times(stiffness, height)
    return jax.lax.cond(
        jnp.all(full > -nominal),
        lambda: (full, jnp.zeros((), height.dtype)),
        lambda: _rounds(height, nominal, compliance),
    )


class _RoundState(NamedTuple):
    lag: Float[Array, " n"]
    deviation: Float[Array, " n"]
    residual: Float[Array, ""]
    enough: Float[Array, ""]
    steps: Float[Array, ""]
    rounds: Float[Array, ""]


def _rounds(height, nominal, compliance):
    """Partial contact: elastic ones on the target h + `lag`, each started from the one before."""
    size, turned = jnp.abs(compliance), _turned(compliance)
    # Half the tolerance, so that rounding elsewhere does not exceed it.
    goal = least_error(height.dtype) / 2
    error_fraction = _error_fraction(turned)

    def going(at: _RoundState):
        return (at.residual > goal) & (at.rounds < MOST_ROUNDS) & (nominal > 0)

    def step(at: _RoundState) -> _RoundState:
        target = height + at.lag
        deviation, steps = iterate(target, nominal, size, at.deviation, ROUND_STEPS, at.enough)
        moved, elastic = times(compliance, deviation), times(size, deviation)
        _, residual = gap_and_error(height, nominal, moved, deviation)
        # The elastic contact's own error is over its own displacement.
        reach, wide = jnp.ptp(moved), jnp.ptp(elastic)
        per_elastic = reach / jnp.where(wide > 0, wide, 1.0)
        enough = error_fraction * per_elastic * jnp.maximum(residual, goal)
        # h + 2 |C| p - t without the height: what a slight contact adds to it is far smaller.
        lag = times(turned, 2 * elastic - at.lag)
        return _RoundState(lag, deviation, residual, enough, at.steps + steps, at.rounds + 1)

    zero, none = jnp.zeros((), height.dtype), jnp.zeros_like(height)
    first = _RoundState(none, none, jnp.full_like(zero, jnp.inf), error_fraction, zero, zero)
    end = jax.lax.while_loop(going, step, first)
    return end.deviation, end.steps


@pressure_deviation.defjvp
def _pressure_deviation_jvp(primals, tangents):
    deviation, iterations = pressure_deviation(*primals)
    change = derivative(primals, tangents, deviation, _solve_on)
    return (deviation, iterations), (change, jnp.zeros_like(iterations))


def _solve_on(touching, compliance, wanted):
    elastic = on_contact(touching, jnp.abs(compliance))
    project, response, _ = elastic

    def lagging(values):
        late = compliance - jnp.abs(compliance)
        return response(values) + project(times(late, project(values)))

    # The transpose of a convolution is that with the mirrored kernel: the conjugate spectrum.
    solve, solve_transpose = (
        partial(_solve, elastic=elastic, compliance=c) for c in (compliance, compliance.conj())
    )
    return project(jax.lax.custom_linear_solve(lagging, project(wanted), solve, solve_transpose))


def _solve(lagging, right, elastic, compliance):
    """The pressure (n,) on the contact set with `lagging`(pressure) = `right`, in rounds too."""
    project, response, precondition = elastic
    size, turned = jnp.abs(compliance), _turned(compliance)
    error_fraction, eps = _error_fraction(turned), jnp.finfo(right.dtype).eps

    def norm(values):
        return values @ precondition(values)

    def going(at):
        return (at[2] > enough) & (at[3] < MOST_ROUNDS)

    def step(at):
        target, solution, _, rounds = at
        missing = project(target) - response(solution)
        solution = solution + gradients(response, precondition, missing, error_fraction)
        target = right + times(turned, right + 2 * times(size, solution) - target)
        return target, solution, norm(right - lagging(solution)), rounds + 1

    first = norm(right)
    # The rounding of n random displacements, in the norm of the pressures that make them.
    enough = (8 * eps) ** 2 * right.size * first
    start = (right, jnp.zeros_like(right), first, 0)
    return jax.lax.while_loop(going, step, start)[1]
