"""The set of contact under a rigid profile on an elastic skin, found as a whole.

Primal-dual active sets (Hintermueller, Ito and Kunisch 2003): on a set that is given, the pressure
closes the gap; cells in tension then leave the set, and cells that overlap come to it. For a half
space the sets shrink onto the contact from the one of full contact, some ten of them however rough
the profile, as 1/compliance is an M-matrix. For a layer that bends nothing is sure: the caller
goes on from elsewhere where the sets do not settle.

On a set the pressure is found by conjugate gradients, preconditioned by E^T S E, S = 1/compliance
and E the extension of values on the set over the gaps along straight lines. Extended by zero
instead, a smooth displacement of many small contacts would jump at each of their edges, which S
amplifies. E keeps constants, so that E^T S E makes no net force.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .contact_conditions import cut, forceless_stiffness, least_error, rounding, times, touches

MOST_SET_STEPS = 200  # on all sets; those of hard cases settle within some 60
SET_ERROR = 0.05  # of a set's first error: what is left when cells come or go


class Extension(NamedTuple):
    """From cells of a set to all: the nearest of them on the `left` and on the `right`, and the
    `weight` of the right one."""

    left: Int[Array, " n"]
    right: Int[Array, " n"]
    weight: Float[Array, " n"]

    def __call__(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        """Values on the set, continued linearly over its gaps."""
        left, right = values[self.left], values[self.right]
        return left + self.weight * (right - left)

    def adjoint(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        """All values, those beside the set distributed to its edges."""
        on_right = self.weight * values
        total = jnp.zeros_like(values).at[self.left].add(values - on_right)
        return total.at[self.right].add(on_right)


def extension(touching: Bool[Array, " n"], dtype) -> Extension:
    """The extension from the cells `touching`, round the window."""
    n = touching.size
    cell = jnp.arange(n, dtype=jnp.int32)  # half the memory of the default
    since = _last_before(jnp.where(touching, cell, -2 * n))
    left = since % n
    # A cell of the set follows the one that the cell before it has on its left.
    follows = jnp.where(touching, jnp.roll(left, 1), n)
    right = jnp.zeros(n, cell.dtype).at[follows].set(cell, mode="drop")[left]
    span = (right - left) % n
    weight = (cell - since).astype(dtype) / jnp.where(span == 0, n, span).astype(dtype)
    return Extension(left, right, weight)


def _last_before(cells: Int[Array, " n"]) -> Int[Array, " n"]:
    """The largest of `cells` from each one backwards round the window, where they are n less.

    By doubling, in one loop: `jax.lax.cummax` takes as long, and a second longer to compile.
    """
    n = cells.size

    def further(doubling, largest):
        both = jnp.concatenate([largest - n, largest])
        return jnp.maximum(largest, jax.lax.dynamic_slice(both, (n - 2**doubling,), (n,)))

    return jax.lax.fori_loop(0, max(n - 1, 1).bit_length(), further, cells)


def edges(touching: Bool[Array, " n"]) -> Int[Array, ""]:
    """Number of the set's edges, round the window."""
    return jnp.sum(touching != jnp.roll(touching, 1))


class SetState(NamedTuple):
    """The deviation, the set to be taken next, whether it is the last one, and steps until now."""

    deviation: Float[Array, " n"]
    active: Bool[Array, " n"]
    settled: Bool[Array, ""]
    steps: Float[Array, ""]


def by_sets(height, nominal, compliance, start, settled) -> SetState:
    """The last set and its pressure, begun with the set of `start`, unless that is `settled`."""

    def going(at: SetState):
        return ~at.settled & (at.steps < MOST_SET_STEPS)

    def step(at: SetState) -> SetState:
        return _on_set(at, height, nominal, compliance)

    zero = jnp.zeros((), height.dtype)
    first = SetState(start, touches(nominal, start), settled, zero)
    end = jax.lax.while_loop(going, step, first)
    return end._replace(deviation=cut(end.deviation, end.active, nominal))


class _WithinSet(NamedTuple):
    """The deviation on a set, the gap under it, its error and the bound of that, the last direction
    of conjugate gradients and the squared norm of what it began with, the set that follows."""

    deviation: Float[Array, " n"]
    gap: Float[Array, " n"]
    off: Float[Array, ""]
    goal: Float[Array, ""]
    direction: Float[Array, " n"]
    norm: Float[Array, ""]
    following: Bool[Array, " n"]
    steps: Float[Array, ""]


def _on_set(at: SetState, height, nominal, compliance) -> SetState:
    """The pressure that closes the gap on the set, until that suggests another one or is exact."""
    active, inverse = at.active, forceless_stiffness(compliance)
    extend = extension(active, height.dtype)

    def going(now: _WithinSet):
        is_other = jnp.any(now.following != active)
        enough = jnp.where(is_other, jnp.maximum(now.goal, SET_ERROR * first.off), now.goal)
        return (now.off > enough) & (now.steps < MOST_SET_STEPS)

    def step(now: _WithinSet) -> _WithinSet:
        rest = jnp.where(active, now.gap, 0.0)
        z = jnp.where(active, extend.adjoint(times(inverse, extend(rest))), 0.0)
        norm = rest @ z
        direction = _ratio(norm, now.norm) * now.direction - z
        answer = times(compliance, direction)
        length = _ratio(norm, direction @ answer)
        deviation = now.deviation + length * direction
        gap = _gap_on(active, now.gap + length * answer)
        off, goal = _set_error(active, deviation, gap, height, nominal)
        following = jnp.where(active, touches(nominal, deviation), gap < 0)
        return _WithinSet(deviation, gap, off, goal, direction, norm, following, now.steps + 1)

    deviation = cut(at.deviation, active, nominal)
    gap = _gap_on(active, times(compliance, deviation) - height)
    off = jnp.max(jnp.where(active, jnp.abs(gap), 0.0))
    zero, none = jnp.zeros_like(at.steps), jnp.zeros_like(gap)
    first = _WithinSet(deviation, gap, off, -jnp.ones_like(off), none, zero, active, at.steps)
    end = jax.lax.while_loop(going, step, first)
    settled = jnp.all(end.following == active) & (end.off <= end.goal)
    return SetState(end.deviation, end.following, settled, end.steps)


def _ratio(one, other):
    """Their ratio; nothing where the other is nothing, as under a single cell."""
    return one / jnp.where(other > 0, other, jnp.inf)


def _gap_on(active, gap):
    """The gap, zero on average on the set."""
    return gap - jnp.sum(jnp.where(active, gap, 0.0)) / jnp.maximum(jnp.sum(active), 1)


def _set_error(active, deviation, gap, height, nominal):
    """The error of the gap on the set, and its bound, as in `gap_and_error`."""
    tolerance, reach, span = least_error(height.dtype), jnp.ptp(gap + height), jnp.ptp(height)
    most, rounding_ratio = 1 + jnp.max(deviation) / nominal, rounding(height.dtype) / tolerance
    bound = tolerance * jnp.minimum(reach, jnp.maximum(span / most, rounding_ratio * reach))
    return jnp.max(jnp.where(active, jnp.abs(gap), 0.0)), bound
