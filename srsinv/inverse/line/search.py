"""The weights of least criterion: a scan along the box's diagonal, grids about the best point, each
half as wide, and Newton's steps to where the criterion's slope is zero.

It needs no start, stays within the box and gives the same answer every time. As it ends where the
slope is zero, the weights have derivatives by the implicit function theorem.
"""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...known import array_module

SCANNED = 19  # weights along the diagonal
SHAPES = 5  # shapes of each weight that is scanned, a decade from each other over four
REPEATED = 3  # grids of each width beside a shape, whose valley may be narrow and oblique
SCANNED_JOINTLY = 97  # where they are all that are searched, and a corner may be narrow
HALVES = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)  # decades, half the widths of the grids
NEWTON_STEPS = 3  # from the finest grid to rounding
REACH = 2.0  # half widths of the finest grid, beyond which a step leads to another minimum

Logs = Float[Any, " c"]
Value = Callable[[Float[Array, " c"]], Any]


def _plan(is_joint: bool, has_shape: bool) -> tuple[int, tuple[float, ...]]:
    """How many weights along the diagonal are scanned, and half the widths of the grids."""
    if is_joint:
        return SCANNED_JOINTLY, HALVES[-2:]
    return SCANNED, tuple(half for half in HALVES for _ in range(REPEATED if has_shape else 1))


def _ends(is_joint: bool, box: Any) -> tuple[Any, Any]:
    """The ends of what is searched for: of the weights, or of the decades along the diagonal."""
    xp = array_module(box)
    low, high = xp.asarray(box)
    return (xp.zeros(1), xp.max(high - low)[None]) if is_joint else (low, high)


def _worth(values: Any, is_joint: bool) -> Any:
    """Scanned values, infinite where they are not finite, and, where the weights are chosen
    jointly, but at a minimum within the box: many criteria have their least value at an end."""
    xp = array_module(values)
    values = xp.where(xp.isfinite(values), values, xp.inf)
    if not is_joint:
        return values
    before, at, after = values[:-2], values[1:-1], values[2:]
    is_least = (at <= before) & (at <= after) & xp.isfinite(before) & xp.isfinite(after)
    within = xp.pad(xp.where(is_least, at, xp.inf), 1, constant_values=xp.inf)
    return xp.where(xp.any(xp.isfinite(within)), within, values)


def weights_at(is_joint: bool, box: Any, searched: Any) -> Any:
    """The weights of what is searched for."""
    if not is_joint:
        return searched
    low, high = array_module(box, searched).asarray(box)
    return low + searched * (high - low) / (high - low).max()


def _scan(low: Logs, high: Logs, count: int, has_shape: bool) -> Float[Any, "row c"]:
    """Weights along the diagonal, from strong to weak: ties go to the smoother. Where the last
    number is a shape, the diagonal of the others for each of some shapes."""
    along = np.linspace(1, 0, count)[:, None]
    if not has_shape:
        return low + along * (high - low)
    shapes = np.repeat(np.linspace(1, 0, SHAPES), count)[:, None]
    parts = [np.tile(along, (SHAPES, 1))] * (len(low) - 1)
    return low + np.concatenate([*parts, shapes], axis=1) * (high - low)


def _offsets(size: int) -> Float[np.ndarray, "row c"]:
    """The points of a grid about zero, 0 in the middle, large weights first."""
    return np.array(list(product((1.0, 0.0, -1.0), repeat=size)))


def on_grids(
    values: Callable[[np.ndarray], np.ndarray],
    is_joint: bool,
    box: Float[np.ndarray, "2 c"],
    has_shape: bool,
) -> np.ndarray:
    """The best of what is scanned and on grids; `values`: of rows of what is searched for."""
    known: dict[tuple[float, ...], float] = {}  # the grids share points
    (count, halves), (low, high) = _plan(is_joint, has_shape), _ends(is_joint, box)

    def best(points: np.ndarray, is_scan: bool = False) -> np.ndarray:
        rows = [tuple(row) for row in points.tolist()]
        new = [row for row in dict.fromkeys(rows) if row not in known]
        if new:
            known.update(zip(new, np.asarray(values(np.array(new))).tolist(), strict=True))
        every = np.array([known[row] for row in rows])
        return points[np.argmin(_worth(every, is_joint and is_scan))]

    centre = best(_scan(low, high, count, has_shape), is_scan=True)
    for half in halves:
        centre = best(np.clip(centre + half * _offsets(len(low)), low, high))
    return centre


def each_row(value: Callable, rows: Float[Array, "row c"], count: Any, together: int) -> Any:
    """The value of each of the first `count` rows, so many of them at once; zeros of the others.
    One alone is not batched, as LAPACK on a CPU may wait for itself."""
    every = partial(jax.lax.map, value) if together == 1 else jax.vmap(value)
    padded = jnp.pad(rows, ((0, -len(rows) % together), (0, 0)), mode="edge")

    def add(i, values):
        some = jax.lax.dynamic_slice_in_dim(padded, i * together, together)
        put = partial(jax.lax.dynamic_update_slice_in_dim, start_index=i * together, axis=0)
        return jax.tree.map(put, values, every(some))

    like = jax.eval_shape(value, rows[0])
    empty = jax.tree.map(lambda each: jnp.zeros((len(padded), *each.shape), each.dtype), like)
    values = jax.lax.fori_loop(0, (count + together - 1) // together, add, empty)
    return jax.tree.map(lambda each: each[: len(rows)], values)


class WeightSearch(eqx.Module):
    """A search from `low` (c,) to `high` (c,), of which `together` points are computed at once.

    `scanned`: weights of the first scan, where a criterion costs little; None: see `_plan`.
    `has_shape`: whether the last number is a shape of the prior.
    """

    low: Float[Array, " c"]
    high: Float[Array, " c"]
    is_joint: bool = eqx.field(static=True)
    together: int = eqx.field(static=True)
    scanned: int | None = eqx.field(static=True, default=None)
    has_shape: bool = eqx.field(static=True, default=False)

    @classmethod
    def of(
        cls,
        is_joint: bool,
        box: Float[Array, "2 c"],
        together: int,
        scanned: int | None = None,
        has_shape: bool = False,
    ) -> "WeightSearch":
        """The search of all weights in the box, or along its diagonal."""
        return cls(*_ends(is_joint, box), is_joint, together, scanned, has_shape)

    def least(self, value: Value) -> Float[Array, " c"]:
        """Where the value is least: `on_grids`, then Newton's steps."""
        low, high, size = self.low, self.high, self.low.size
        scanned, widths = _plan(self.is_joint or self.scanned is not None, self.has_shape)
        offsets = np.delete(_offsets(size), len(_offsets(size)) // 2, axis=0)
        first = _scan(low, high, self.scanned or scanned, self.has_shape)
        scanned = len(first)
        around = jnp.zeros((scanned, size)).at[: len(offsets)].set(offsets)
        halves = jnp.array([0.0, *widths])

        def closer(i, state):
            centre, at_centre = state
            grid = jnp.clip(centre + halves[i] * around, low, high)
            rows = jnp.where(i == 0, first, grid)
            count = jnp.where(i == 0, scanned, len(offsets))
            values = each_row(value, rows, count, self.together)
            values = jnp.where(jnp.arange(scanned) < count, values, jnp.inf)
            values = jnp.where(i == 0, _worth(values, self.is_joint), _worth(values, False))
            # The centre in the middle of its grid, so that ties go to the smoother here, too.
            middle = len(offsets) // 2
            rows = jnp.insert(rows, middle, centre, axis=0)
            values = jnp.insert(values, middle, at_centre)
            best = jnp.argmin(values)
            return rows[best], values[best]

        start = high, jnp.asarray(jnp.inf, low.dtype)
        centre, _ = jax.lax.fori_loop(0, len(halves), closer, start)
        return self._newton(value, centre)

    def _newton(self, value: Value, centre: Float[Array, " c"]) -> Float[Array, " c"]:
        """The zero of the slope near the best point of the finest grid; that point where there is
        none."""

        def closer(i, logs):
            slope, inverse = self._slope_and_inverse(value, logs)
            step = -inverse @ slope
            moved = jnp.clip(logs + step, self.low, self.high)
            is_near = jnp.abs(moved - centre) <= REACH * HALVES[-1]
            return jnp.where(jnp.all(jnp.isfinite(step) & is_near), moved, logs)

        return jax.lax.fori_loop(0, NEWTON_STEPS, closer, centre)

    def _slope_and_inverse(
        self, value: Value, logs: Float[Array, " c"]
    ) -> tuple[Float[Array, " c"], Float[Array, "c c"]]:
        """The slope of the value, and the inverse of its second derivatives, by differences of
        slopes; zero for weights that are fixed or at an end of the box."""
        step = float(jnp.finfo(logs.dtype).eps) ** 0.3
        aside = step * jnp.eye(logs.size)
        rows = jnp.concatenate([logs[None], logs + aside, logs - aside])
        slopes = each_row(jax.grad(value), rows, len(rows), self.together)
        ahead, behind = jnp.split(slopes[1:], 2)
        second = (ahead - behind) / (2 * step)
        is_free = (logs > self.low) & (logs < self.high)
        both = is_free[:, None] & is_free[None]
        second = jnp.where(both, (second + second.T) / 2, jnp.eye(logs.size))
        is_minimum, inverse = _inverse_of_positive(second)
        return slopes[0], jnp.where(both & is_minimum, inverse, 0.0)

    def with_slopes(
        self, value: Callable[[Any, Float[Array, " c"]], Any], known: Any, logs: Array
    ) -> Float[Array, " c"]:
        """The weights of least value(known, logs) with their first derivatives by `known`: one more
        step of Newton's, of zero length, by the implicit function theorem."""
        frozen = partial(value, jax.lax.stop_gradient(known))
        _, inverse = self._slope_and_inverse(frozen, jax.lax.stop_gradient(logs))
        inverse = jax.lax.stop_gradient(inverse)
        return logs - inverse @ jax.grad(value, argnums=1)(known, logs)


def _inverse_of_positive(matrix: Float[Array, "c c"]) -> tuple[Any, Float[Array, "c c"]]:
    """Whether a symmetric matrix of up to three rows is positive definite, and its inverse where it
    is: by minors, as batched factors of LAPACK's may wait for themselves on a CPU."""
    size = len(matrix)
    if size == 1:
        return matrix[0, 0] > 0, 1 / matrix
    (a, b), (_, d) = matrix[:2, :2]
    minor = a * d - b * b
    is_positive = (a > 0) & (minor > 0)
    if size == 2:
        return is_positive, jnp.array([[d, -b], [-b, a]]) / minor
    first, second, third = matrix
    adjugate = jnp.stack(
        [jnp.cross(second, third), jnp.cross(third, first), jnp.cross(first, second)]
    )
    determinant = first @ adjugate[0]
    return is_positive & (determinant > 0), adjugate / determinant
