"""The pressure under a rigid profile pressed into an elastic skin: compliance real and positive.

Pressure is held as its deviation from the nominal one, so that features far smaller than the load
keep their digits. Heights [m] are measured from the highest crest, so that a slight contact keeps
its own; `compliance` [m/Pa] is that of cells, zero at k = 0.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .contact_conditions import (
    cut,
    forceless_stiffness,
    gap_and_error,
    least_error,
    stiffness,
    times,
    touches,
)
from .contact_sets import by_sets, edges, extension

COARSER = 16  # ratio of the widths of the cells that the sets are begun on
COARSEST = 256  # cells: of fewer, descent is done in no time, and sets cost compilation
FEW_EDGES = 8  # of contacts on wider cells: of so few, descent ends in some ten steps
MOST_STEPS = 1000
DERIVATIVE_STEPS = 500
# Steps in which the energy may rise where cells are let go: the shortest way of most contacts,
# which end within them. Some, of a stiff layer that bends over many cells, would go on in a circle.
FREE_STEPS = 20


@jax.custom_jvp
def pressure_deviation(height, nominal, compliance):
    """The pressure's deviation from its mean, and the number of iterations.

    As a deviation, so that features far smaller than the load keep their digits.
    """
    full = times(forceless_stiffness(compliance), height)
    is_full = jnp.all(full > -nominal)
    return jax.lax.cond(
        is_full,
        lambda: (full, jnp.zeros((), height.dtype)),
        lambda: _partial(height, nominal, compliance, full),
    )


def _partial(height, nominal, compliance, full):
    """Partial contact, by descent: of many cells begun where sets settle, these where they settle
    on wider cells."""
    steps, start, n = jnp.zeros((), height.dtype), jnp.zeros_like(height), height.size
    if n // COARSER >= COARSEST:
        start, few = full, jnp.array(False)
        if n % COARSER == 0:
            wide, from_wide = (jnp.mean(v.reshape(-1, COARSER), axis=1) for v in (height, full))
            lower = compliance[: wide.size // 2 + 1]
            wider = by_sets(wide, nominal, lower, from_wide, few).deviation
            start, few = jnp.repeat(wider, COARSER), edges(touches(nominal, wider)) <= FEW_EDGES
        end = by_sets(height, nominal, compliance, start, few)
        start, steps = jnp.where(end.settled, end.deviation, 0.0), end.steps
    tolerance = least_error(height.dtype)
    deviation, more = iterate(height, nominal, compliance, start, MOST_STEPS, tolerance)
    return deviation, steps + more


class _DescentState(NamedTuple):
    """The deviation, the `displacement` under it, the gap and its error; `evenly` is the
    preconditioned unit load on the `active` cells, the next step goes on as `conjugate` to this
    one's `direction`."""

    deviation: Float[Array, " n"]
    displacement: Float[Array, " n"]
    gap: Float[Array, " n"]
    residual: Float[Array, ""]
    active: Bool[Array, " n"]
    evenly: Float[Array, " n"]
    direction: Float[Array, " n"]
    norm: Float[Array, ""]
    conjugate: Bool[Array, ""]
    steps: Float[Array, ""]


def iterate(height, nominal, compliance, start, most: int, tolerance):
    """The deviation and the number of steps, from the deviation `start`: each step is one of
    conjugate gradients on the cells that touch or overlap."""
    inverse = stiffness(compliance)

    def going(at: _DescentState):
        return (at.residual > tolerance) & (at.steps < most)

    def step(at: _DescentState) -> _DescentState:
        return _descended(at, height, nominal, compliance, inverse)

    zero, none = jnp.zeros((), height.dtype), jnp.zeros_like(height)
    displacement = times(compliance, start)
    gap, residual = gap_and_error(height, nominal, displacement, start)
    active = jnp.zeros(height.shape, bool)
    first = _DescentState(
        start, displacement, gap, residual, active, none, none, zero, jnp.array(False), zero
    )
    end = jax.lax.while_loop(going, step, first)
    return end.deviation, end.steps


def _descended(at: _DescentState, height, nominal, compliance, inverse) -> _DescentState:
    """The state after one step. What costs Fourier transforms is only done again where cells came
    or went."""

    def on(active, values):
        return jnp.where(active, times(inverse, values), 0.0)

    touching = touches(nominal, at.deviation)
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
    beta = jnp.where(keep, norm / at.norm, 0.0)
    direction = jnp.where(active, z + beta * at.direction, 0.0)
    answer = times(compliance, direction)
    length = (rest @ direction) / (direction @ answer)
    free = at.deviation - length * direction
    lifted = active & (free <= -nominal)
    whole = ~jnp.any(lifted)
    deviation, displacement = jax.lax.cond(
        whole,
        lambda: (free, at.displacement - length * answer),
        lambda: _falling(at, cut(free, active, nominal), height, compliance),
    )
    gap, residual = gap_and_error(height, nominal, displacement, deviation)
    # A direction that lost cells would carry a net force.
    return _DescentState(
        deviation, displacement, gap, residual, active, evenly, direction, norm, whole, at.steps + 1
    )


def _falling(at: _DescentState, cut, height, compliance):
    """The step from the state to `cut`, after some steps shortened to where the energy falls: else
    cells can come and go in a circle. Returns the deviation, and the displacement under it."""
    displacement = times(compliance, cut)
    change, response = cut - at.deviation, displacement - at.displacement
    slope, curvature = change @ (at.displacement - height), change @ response
    rises = (at.steps >= FREE_STEPS) & (slope < 0) & (slope + curvature / 2 > 0)
    part = -slope / curvature
    # A mean of pressures that are not negative, but for rounding.
    falling = jnp.maximum(at.deviation + part * change, jnp.minimum(at.deviation, cut))
    return jnp.where(rises, falling, cut), jnp.where(
        rises, at.displacement + part * response, displacement
    )


def _balanced(values, evenly):
    """`values` with no net force, the balance spread as `evenly`."""
    total = jnp.sum(evenly)
    return values - jnp.sum(values) / jnp.where(total != 0, total, 1.0) * evenly


@pressure_deviation.defjvp
def _pressure_deviation_jvp(primals, tangents):
    deviation, iterations = pressure_deviation(*primals)
    change = derivative(primals, tangents, deviation, _solve_on)
    return (deviation, iterations), (change, jnp.zeros_like(iterations))


def derivative(primals, tangents, deviation, solve_on):
    """The implicit function theorem on the contact set, which to first order does not move: the
    pressure vanishes at its edge. There gap = 0 gives C dp + const = dh - dC p.

    `solve_on(touching, compliance, wanted)` is the pressure without net force on the contact set
    that displaces it by `wanted`, up to a constant.
    """
    _, nominal, compliance = primals
    d_height, d_nominal, d_compliance = tangents
    touching = touches(nominal, deviation)
    # In the pressure's own precision: the mean of truths is single in either.
    inside = touching.astype(deviation.dtype)
    uniform = inside / jnp.maximum(jnp.mean(inside), 1 / touching.size)
    # The load changes evenly over the contact, and what balances has no net force.
    even = d_nominal * (uniform - 1)
    wanted = d_height - times(d_compliance, deviation) - times(compliance, even)
    return even + solve_on(touching, compliance, wanted)


def _solve_on(touching, compliance, wanted):
    project, response, precondition = on_contact(touching, compliance)

    def solve(_, right):
        return gradients(response, precondition, right)

    return project(jax.lax.custom_linear_solve(response, project(wanted), solve, symmetric=True))


def on_contact(touching, compliance):
    """Three maps of values (n,): onto what has no net force on the contact set, the displacement
    under that as far as it is no constant there, and nearly the inverse of that displacement
    (contact_sets.py)."""
    count = jnp.maximum(jnp.sum(touching), 1)

    def project(values):
        inside = jnp.where(touching, values, 0.0)
        return jnp.where(touching, inside - jnp.sum(inside) / count, 0.0)

    def response(values):
        return project(times(compliance, project(values)))

    extend, inverse = extension(touching, compliance.dtype), forceless_stiffness(compliance)

    def precondition(values):
        return project(extend.adjoint(times(inverse, extend(project(values)))))

    return project, response, precondition


def gradients(response, precondition, right, tolerance=None):
    """Preconditioned conjugate gradients, in the range of the preconditioner, until the error is
    `tolerance` of the first, by default a few round-offs."""
    tolerance = 8 * jnp.finfo(right.dtype).eps if tolerance is None else tolerance

    def going(at):
        return (at[3] > target) & (at[4] < DERIVATIVE_STEPS)

    def step(at):
        solution, rest, direction, norm, steps = at
        pushed = response(direction)
        length = norm / (direction @ pushed)
        solution, rest = solution + length * direction, rest - length * pushed
        z = precondition(rest)
        new = rest @ z
        return solution, rest, z + new / norm * direction, new, steps + 1

    z = precondition(right)
    first = right @ z
    target = tolerance**2 * first
    start = (jnp.zeros_like(right), right, z, first, 0)
    return jax.lax.while_loop(going, step, start)[0]
