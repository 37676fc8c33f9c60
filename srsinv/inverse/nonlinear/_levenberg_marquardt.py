"""Levenberg and Marquardt's method inside a box, as an optimistix solver.

A step p solves the damped linear problem min |f + J p|^2 + lambda |D p|^2 over the variables that
are not held by their bounds, is bent by the residual's second derivative along it, and is cut at
the box. Four choices make it robust:

- D holds the column norms of J, remembered for some steps: the path does not depend on the
  variables' units, and a column that has become small is not damped by its past (More 1978 keeps
  the largest for ever, which crawls in MGH10).
- Where steps show the residual's own curvature to be the larger part of the cost's, a secant
  estimate of it joins J^T J (see `_quadratic_model`).
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
from ._quadratic_model import (
    Point,
    QuadraticModel,
    at_least,
    linearised,
    no_point,
    positive,
    quadratic_model,
    uses_secant,
)

FIRST_DAMPING = 1e-3
LEAST_DAMPING, MOST_DAMPING = 1e-18, 1e18
ACCEPTED = 1e-4  # fraction of the predicted fall that a step has to achieve
BENT = 0.75  # the bend's second derivative, beside p, up to which a step is tried
ROUNDING_FACTOR = 10  # roundings of a residual, or of a cost, within which two are equal
REMEMBERED = 0.5  # of D from one accepted point to the next


class _DampedState(eqx.Module):
    trial: Float[Array, " m"]
    predicted: Float[Array, ""]
    point: Point
    uses_secant: Bool[Array, ""]
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
    column of the Jacobian is below it, or when its square bounds the fall of the cost; the last
    step is still taken where it does no harm.
    """

    lower: Float[Array, " m"]
    upper: Float[Array, " m"]
    rtol: float
    bends: bool = True
    atol: float = 0.0
    norm: Callable[[Any], Array] = optx.two_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _DampedState:
        zero = jnp.zeros((), y.dtype)
        return _DampedState(
            trial=jnp.clip(y, self.lower, self.upper),
            predicted=zero,
            point=no_point(f_struct.size, y.size, y.dtype),
            uses_secant=jnp.array(False),
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
        # Whether the next model has the residual's own curvature.
        uses = uses_secant(state.point, moved, gain)
        uses = jnp.where(accept & ~state.first, uses, state.uses_secant)
        point = _reached(state, accept, residual, cost, push, moved)
        damping, growth = _damping(state, gain, accept)
        begun = jnp.where(state.first, cost, state.begun)
        held = self._held(y, point)
        model = quadratic_model(point, uses)
        c = model.lift @ point.c
        step = _step(model, c, held, damping)
        straight = self._cut(y, step)
        predicted = model.fall(c, straight)
        # By the whole step: one that the box cuts short is no sign of a minimum.
        ready = self._converged(y, point, model, held, damping, step, model.fall(c, step))
        bend, tight = jnp.zeros_like(straight), jnp.array(True)
        if self.bends:
            bend, tight = _bend(residual_at, y, straight, point, model, held, damping, begun)
        state = _DampedState(
            trial=y + self._cut(y, straight + bend),
            predicted=jnp.where(tight, predicted, jnp.inf),  # else it will not be accepted
            point=point,
            uses_secant=uses,
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
    def _ftol(self) -> float:
        return max(self.rtol**2, 4 * float(jnp.finfo(self.lower.dtype).eps))

    def _held(self, y, point: Point) -> Bool[Array, " m"]:
        """Mask of variables on a bound beyond which the cost would fall."""
        gradient = point.root.T @ point.c
        return ((y <= self.lower) & (gradient >= 0)) | ((y >= self.upper) & (gradient <= 0))

    def _cut(self, y, p) -> Float[Array, " m"]:
        return jnp.clip(y + p, self.lower, self.upper) - y

    def _converged(
        self, y, point: Point, model: QuadraticModel, held, damping, p, predicted
    ) -> Bool[Array, ""]:
        unit = point.root / positive(lengths(point.root))
        left = jnp.sqrt(2 * point.cost)
        cosines = jnp.abs(unit.T @ point.c) / jnp.where(left > 0, left, 1.0)
        cosine = jnp.max(jnp.where(held, 0.0, cosines), initial=0.0)
        scale = jnp.where(held, 0.0, model.scale)
        length, size = self.norm(scale * p), self.norm(scale * y)
        # A strongly damped step is the undamped one over about the damping: it indicates
        # convergence only below the variables' rounding.
        undamped = 1 + damping
        small = (undamped * length <= self.rtol * size) | (length <= jnp.finfo(y.dtype).eps * size)
        flat = undamped * predicted <= self._ftol * point.cost
        return (cosine <= self.rtol) | small | flat


def _reached(state: _DampedState, accept, residual, cost, push, moved) -> Point:
    """The trial, linearised, where it is accepted; else the point before."""
    return jax.lax.cond(
        accept,
        lambda: linearised(
            residual, cost, _jacobian(push, state.trial), moved, state.point, REMEMBERED,
            state.first,
        ),
        lambda: state.point,
    )  # fmt: skip


def _jacobian(push, y) -> Float[Array, "r m"]:
    return jax.vmap(push, out_axes=1)(jnp.eye(y.size, dtype=y.dtype))


def _step(model: QuadraticModel, c, held, damping) -> Float[Array, " m"]:
    """The minimiser of |c + A p|^2 + damping |D p|^2 over the variables that are not held."""
    scale = model.scale
    # In units of D, so that the small factorisation meets columns of length one.
    root = jnp.where(held, 0.0, model.root / scale)
    stacked = jnp.concatenate([root, jnp.sqrt(damping) * jnp.eye(scale.size, dtype=root.dtype)])
    q, r = jnp.linalg.qr(stacked)
    right = q.T @ jnp.concatenate([c, jnp.zeros_like(c)])
    return -jax.scipy.linalg.solve_triangular(r, right) / scale


def _bend(residual_at, y, p, point: Point, model: QuadraticModel, held, damping, begun):
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
    acceleration = _step(model, model.lift @ second, held, damping)
    acceleration = jnp.where(jnp.isfinite(acceleration), acceleration, 0.0)
    tight = jnp.linalg.norm(model.scale * acceleration) <= BENT * jnp.linalg.norm(model.scale * p)
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
