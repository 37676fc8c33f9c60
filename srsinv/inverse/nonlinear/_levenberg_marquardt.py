"""Levenberg and Marquardt's method inside a box, as an optimistix solver.

A step p solves the damped linear problem min |f + J p|^2 + lambda |D p|^2 over the variables that
are not held by their bounds, is bent by the residual's second derivative along it, and is cut at
the box. Four choices make it robust:

- D holds the column norms of J, remembered for some steps: the path does not depend on the
  variables' units, and a column that has become small is not damped by its past (More 1978 keeps
  the largest for ever, which crawls in MGH10).
- D also holds what the residual's own curvature adds along each variable, from a secant estimate S
  of it (see `_secant`): where the residual is large, or J nearly loses rank in the minimum, column
  norms alone let steps go far too long.
- The bend, geodesic acceleration, is also a test: where it is not small beside p, the linear model
  does not reach that far, and the damping grows (Transtrum and Sethna 2012).
- The damping follows the ratio of the cost's fall to the predicted one (Nielsen 1999).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ._lengths import lengths

FIRST_DAMPING = 1e-3
LEAST_DAMPING, MOST_DAMPING = 1e-18, 1e18
ACCEPTED = 1e-4  # fraction of the predicted fall that a step has to achieve
BENT = 0.75  # the bend's second derivative, beside p, up to which a step is tried
ROUNDING_FACTOR = 10  # roundings of a residual, or of a cost, within which two are equal
REMEMBERED = 0.5  # of D from one accepted point to the next
# Of the diagonal of S, in the square of D: a column of J that vanishes where S does not sets no
# bound on the variable's step. Without it those on penalty I never end.
CURVATURE_FRACTION = 0.25


class Point(eqx.Module):
    """An accepted point: cost |f|^2/2, J = Q R, c = Q^T f, the remembered column norms `scale` of
    J, and `secant`, the estimate S of the residual's curvature."""

    cost: Float[Array, ""]
    q: Float[Array, "r m"]
    root: Float[Array, "m m"]
    c: Float[Array, " m"]
    scale: Float[Array, " m"]
    secant: Float[Array, "m m"]

    @property
    def metric(self) -> Float[Array, " m"]:
        """D, with 1 for a variable that has had no effect yet."""
        curvature = CURVATURE_FRACTION * jnp.abs(jnp.diagonal(self.secant))
        # Not the root of the squares' sum: they can overflow.
        return positive(jnp.hypot(self.scale, jnp.sqrt(curvature)))

    def fall(self, p: Float[Array, " m"]) -> Float[Array, ""]:
        """Fall of the linearised problem's cost by the step p."""
        change = self.root @ p
        return -(jnp.vdot(self.c, change) + 0.5 * jnp.vdot(change, change))


class _DampedState(eqx.Module):
    trial: Float[Array, " m"]
    predicted: Float[Array, ""]
    point: Point
    begun: Float[Array, ""]
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    first: Bool[Array, ""]
    ready: Bool[Array, ""]
    done: Bool[Array, ""]


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Least squares over lower <= y <= upper, for `optimistix.least_squares` on vectors y (m,).

    Where the residual's derivative is discontinuous it has no second one: `bends` is then False. It
    ends when a step is below `rtol` of y, when the cosine between the residual and every free
    column of the Jacobian is below it, when its square bounds the fall of the cost, or at `near`
    standard errors from the linear problem's minimum, by the residual's own size; the last step is
    still taken where it does no harm.
    """

    lower: Float[Array, " m"]
    upper: Float[Array, " m"]
    rtol: Any
    bends: bool = True
    near: Any = 0.0
    atol: float = 0.0
    norm: Callable[[Any], Array] = optx.two_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _DampedState:
        zero = jnp.zeros((), y.dtype)
        return _DampedState(
            trial=jnp.clip(y, self.lower, self.upper),
            predicted=zero,
            point=_no_point(f_struct.size, y),
            begun=zero,
            damping=zero + FIRST_DAMPING,
            growth=zero + 2,
            first=jnp.array(True),
            ready=jnp.array(False),
            done=jnp.array(False),
        )

    def step(self, fn, y, args, options, state: _DampedState, tags):
        def residual_at(y):
            return fn(y, args)[0]

        residual, push = jax.linearize(residual_at, state.trial)
        cost = 0.5 * jnp.vdot(residual, residual)
        gain = state.point.cost - cost
        # The last step may fall by less than the cost's own rounding.
        harmless = gain >= -ROUNDING_FACTOR * jnp.finfo(cost.dtype).eps * state.point.cost
        accept = state.first | (gain > ACCEPTED * state.predicted) | (state.ready & harmless)
        moved = state.trial - y
        y = jnp.where(accept, state.trial, y)
        point = _reached(state, accept, residual, cost, push, moved)
        damping, growth = _damping(state, gain, accept)
        begun = jnp.where(state.first, cost, state.begun)
        held = self._held(y, point)
        step = _step(point, point.c, held, damping)
        straight = self._cut(y, step)
        predicted = point.fall(straight)
        # By the whole step: one that the box cuts short is no sign of a minimum.
        ready = self._converged(y, point, held, damping, step, point.fall(step))
        bend, tight = jnp.zeros_like(straight), jnp.array(True)
        if self.bends:
            bend, tight = _bend(residual_at, y, straight, point, held, damping, begun)
        state = _DampedState(
            trial=y + self._cut(y, straight + bend),
            predicted=jnp.where(tight, predicted, jnp.inf),  # else it will not be accepted
            point=point,
            begun=begun,
            damping=damping,
            growth=growth,
            first=jnp.array(False),
            ready=ready,
            done=state.ready | ~jnp.isfinite(point.cost) | (damping >= MOST_DAMPING),
        )
        return y, state, None

    def terminate(self, fn, y, args, options, state: _DampedState, tags):
        failed = ~jnp.isfinite(state.point.cost) & ~state.first
        result = optx.RESULTS.where(failed, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return state.done, result

    def postprocess(self, fn, y, aux, args, options, state: _DampedState, tags, result):
        return y, aux, {}

    @property
    def _ftol(self) -> Any:
        return jnp.maximum(self.rtol**2, 4 * float(jnp.finfo(self.lower.dtype).eps))

    def _held(self, y, point: Point) -> Bool[Array, " m"]:
        """Mask of variables on a bound beyond which the cost would fall."""
        gradient = point.root.T @ point.c
        return ((y <= self.lower) & (gradient >= 0)) | ((y >= self.upper) & (gradient <= 0))

    def _cut(self, y, p) -> Float[Array, " m"]:
        return jnp.clip(y + p, self.lower, self.upper) - y

    def _converged(self, y, point: Point, held, damping, p, predicted) -> Bool[Array, ""]:
        unit = point.root / positive(lengths(point.root))
        left = jnp.sqrt(2 * point.cost)
        cosines = jnp.abs(unit.T @ point.c) / jnp.where(left > 0, left, 1.0)
        cosine = jnp.max(jnp.where(held, 0.0, cosines), initial=0.0)
        scale = jnp.where(held, 0.0, point.metric)
        length, size = self.norm(scale * p), self.norm(scale * y)
        # A strongly damped step is the undamped one over about the damping: it indicates
        # convergence only below the variables' rounding.
        undamped = 1 + damping
        small = (undamped * length <= self.rtol * size) | (length <= jnp.finfo(y.dtype).eps * size)
        # At `near` standard errors from its minimum the cost, n s^2 / 2, is near^2 s^2 / 2 higher.
        fall = jnp.maximum(self._ftol, self.near**2 / point.q.shape[0])
        flat = undamped * predicted <= fall * point.cost
        return (cosine <= self.rtol) | small | flat


def _no_point(size: int, y: Float[Array, " m"]) -> Point:
    """Placeholder for the point before the first one, of `size` data."""
    square, row = jnp.zeros((y.size, y.size), y.dtype), jnp.zeros_like(y)
    q = jnp.zeros((max(size, y.size), y.size), y.dtype)
    return Point(jnp.array(jnp.inf, y.dtype), q, square, row, row, square)


def _reached(state: _DampedState, accept, residual, cost, push, moved) -> Point:
    """The trial, linearised, where it is accepted; else the point before."""
    m = state.trial.size

    def linearised() -> Point:
        jacobian = jax.vmap(push, out_axes=1)(jnp.eye(m, dtype=residual.dtype))
        columns = lengths(jacobian)
        unit = positive(columns)
        q, root = jnp.linalg.qr(at_least(m, jacobian / unit))
        before, padded = state.point, at_least(m, residual)
        scale = jnp.maximum(REMEMBERED * before.scale, columns)
        point = Point(cost, q, root * unit, q.T @ padded, scale, before.secant)
        secant = _secant(before, point, padded, moved)
        # The first point has none before it.
        secant = jnp.where(state.first, before.secant, secant)
        return eqx.tree_at(lambda at: at.secant, point, secant)

    return jax.lax.cond(accept, linearised, lambda: state.point)


def _secant(before: Point, point: Point, residual, s) -> Float[Array, "m m"]:
    """The estimate of S, the sum of f_i times the second derivative of f_i, after the step s.

    By the Jacobians at two points alone (Dennis, Gay and Welsch, ACM TOMS 7, 1981, section 3): with
    g the gradient, y = g_new - g_old and y# = g_new - J_old^T f_new,

        S_new = t S + (w v^T + v w^T) - (s^T w) v v^T,   w = y# - t S s,   v = y / y^T s,

    sized by t = min(1, |s^T y#| / |s^T S s|).
    """
    gradient = point.root.T @ point.c
    y_sharp = gradient - before.root.T @ (before.q.T @ residual)
    y = gradient - before.root.T @ before.c
    along, wanted = jnp.abs(s @ before.secant @ s), jnp.abs(jnp.vdot(s, y_sharp))
    size = jnp.where(along > wanted, wanted / jnp.where(along > 0, along, 1.0), 1.0)
    sized = size * before.secant
    rise = jnp.vdot(y, s)
    v = y / jnp.where(rise > 0, rise, 1.0)
    w = y_sharp - sized @ s
    across = jnp.outer(w, v)
    update = across + across.T - jnp.vdot(s, w) * jnp.outer(v, v)
    # In single precision the square of 1e20 is infinite.
    usable = (rise > 0) & jnp.all(jnp.isfinite(update))
    return sized + jnp.where(usable, update, 0.0)


def _step(point: Point, c, held, damping) -> Float[Array, " m"]:
    """The minimiser of |c + R p|^2 + damping |D p|^2 over the variables that are not held."""
    scale = point.metric
    # In units of D, so that the small factorisation meets columns of length one.
    root = jnp.where(held, 0.0, point.root / scale)
    stacked = jnp.concatenate([root, jnp.sqrt(damping) * jnp.eye(scale.size, dtype=root.dtype)])
    q, r = jnp.linalg.qr(stacked)
    right = q.T @ jnp.concatenate([c, jnp.zeros_like(c)])
    return -jax.scipy.linalg.solve_triangular(r, right) / scale


def _bend(residual_at, y, p, point: Point, held, damping, begun):
    """Half the acceleration along p, and whether it is small beside p.

    From one more residual at a fraction of the step, which is cheaper to run and to compile than
    the exact second derivative. Changes within the rounding of the initial residual, `begun` half
    its square, or within the effect of rounding of y, count as no bend.
    """
    eps = float(jnp.finfo(y.dtype).eps)
    part = eps ** (1 / 6)  # balances the errors of rounding and of the third derivative
    trial = at_least(y.size, residual_at(y + part * p))
    off = point.q.T @ trial - point.c - part * (point.root @ p)
    rounding = eps * (jnp.sqrt(2 * begun) + jnp.linalg.norm(lengths(point.root) * y))
    is_rounding = jnp.linalg.norm(off) <= ROUNDING_FACTOR * rounding
    second = jnp.where(is_rounding, 0.0, 2 / part**2 * off)
    acceleration = _step(point, second, held, damping)
    acceleration = jnp.where(jnp.isfinite(acceleration), acceleration, 0.0)
    scale = point.metric
    tight = jnp.linalg.norm(scale * acceleration) <= BENT * jnp.linalg.norm(scale * p)
    return 0.5 * acceleration, tight


def _damping(state: _DampedState, gain, accept):
    """The next damping: less after a step as good as predicted, ever more after failures."""
    gain_ratio = gain / jnp.where(state.predicted != 0, state.predicted, 1.0)
    ease = jnp.clip(1 - (2 * gain_ratio - 1) ** 3, 1 / 3, 2.0)
    damping = jnp.where(accept, state.damping * ease, state.damping * state.growth)
    growth = jnp.where(accept, 2.0, 2 * state.growth)
    damping = jnp.where(state.first, state.damping, damping)
    growth = jnp.where(state.first, state.growth, growth)
    return jnp.clip(damping, LEAST_DAMPING, MOST_DAMPING), growth


def at_least(m: int, rows):
    """`rows`, padded with zeros where there are fewer data than variables."""
    return jnp.pad(rows, [(0, max(m - rows.shape[0], 0))] + [(0, 0)] * (rows.ndim - 1))


def positive(scale):
    """The scale, with 1 for a variable that has had no effect yet."""
    return jnp.where(scale > 0, scale, 1.0)
