"""The iterative path of a linear problem: conjugate gradients on the normal equations of the
prior's coordinates, without any matrix.

Bands are the scatter of draws from the posterior: a solution with noise of variance one in the
whitened data and in the prior's rows is such a draw (Papandreou and Yuille 2010). Where a rule has
found all singular vectors, the solution is a sum over them, and draws have what they leave.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.sparse.linalg
import numpy as np
import scipy.sparse.linalg
from jaxtyping import Float

from ...known import Numbers, in_jax
from .bidiagonal import Triplets, each_unknown
from .prior import PriorFactors
from .problem import LinearProblem
from .standard import StandardForm, centred_data, whitened_adjoint, whitened_forward

DRAWN_TOLERANCE = 1e-6  # of a draw, whose scatter is far larger
DRAWS = 64  # from the posterior: a standard deviation is right to 1/sqrt(128), 9 %
MOST_STEPS = 20  # of conjugate gradients for each unknown, beyond which they are stopped
SLACK = 10.0  # of the residual that is found over the tolerance: rounding in the recursion


class Iterated(NamedTuple):
    """The flat `value` (m,), a root `spread` (m, draw) of its covariance by draws, the degrees of
    freedom `resolved`, and whether conjugate gradients ended within the tolerance."""

    value: Float[Numbers, " m"]
    spread: Float[Numbers, "m draw"]
    resolved: Any
    is_converged: Any


def solve(
    problem: LinearProblem,
    factors: PriorFactors,
    weight: Any,
    tolerance: float,
    start: Float[Numbers, " k"] | None = None,
) -> Iterated:
    """The posterior mean and draws of its error, to a relative tolerance, from `start` or zero."""
    if problem.operator.by_jax:
        problem, factors = in_jax((problem, factors))
    xp = jnp if problem.operator.by_jax else np
    root_weight = xp.sqrt(xp.asarray(weight))

    forward = partial(whitened_forward, problem, factors)
    adjoint = partial(whitened_adjoint, problem, factors)

    def normal(z: Any) -> Any:
        pulled = factors.transpose_root(factors.apply_root(z))
        return adjoint(forward(z)) + root_weight**2 * pulled

    rows = jax.eval_shape(factors.apply_root, jax.ShapeDtypeStruct((factors.coordinates,), float))
    rng = np.random.default_rng(0)
    of_data = xp.asarray(rng.standard_normal((DRAWS, problem.sample_count)))
    of_prior = xp.asarray(rng.standard_normal((DRAWS, *rows.shape)))

    def right(ours: Any, theirs: Any) -> Any:
        return adjoint(ours) + root_weight * factors.transpose_root(theirs)

    invert, each = _solver(normal, factors.coordinates, problem.operator.by_jax)
    best, zero = adjoint(centred_data(problem, factors)), xp.zeros(factors.coordinates)
    z = invert(best, zero if start is None else xp.asarray(start), tolerance)
    enough = max(tolerance, DRAWN_TOLERANCE)
    draws = each(lambda pair: invert(right(*pair), zero, enough), (of_data, of_prior))
    resolved = xp.mean(xp.sum(each(forward, draws) ** 2, axis=1))
    wrong = xp.linalg.norm(best - normal(z))
    spread = factors.apply_spread(draws.T) / np.sqrt(DRAWS)
    is_converged = wrong <= SLACK * tolerance * xp.linalg.norm(best)
    return Iterated(factors.mean + factors.apply_spread(z), spread, resolved, is_converged)


def by_triplets(
    form: StandardForm, triplets: Triplets, weight: float, mean: Float[np.ndarray, " r"]
) -> Iterated:
    """The posterior of this `mean` in standard form, where all singular vectors are known: exact
    along these, and draws from the prior for the rest."""
    total = triplets.values**2 + weight
    draws = np.random.default_rng(0).standard_normal((DRAWS, form.size)) / np.sqrt(DRAWS * weight)
    rest = draws - (draws @ triplets.right.T) @ triplets.right
    rows = np.concatenate([triplets.right / np.sqrt(total)[:, None], rest])
    free = form.factors.apply_spread(np.asarray(form.free))
    spread = np.concatenate([each_unknown(form, rows).T, free], axis=1)
    value = form.factors.mean + form.factors.apply_spread(form.coordinates(mean))
    resolved = form.free_count + np.sum(triplets.values**2 / total)
    return Iterated(np.asarray(value), spread, resolved, True)


def _solver(
    normal: Callable[[Any], Any], size: int, by_jax: bool
) -> tuple[Callable[[Any, Any, float], Any], Callable[..., Any]]:
    """Conjugate gradients from a start to a tolerance, and the map of a function over rows, by jax
    or by scipy."""
    most = max(MOST_STEPS * size, 1000)
    if by_jax:

        def invert(right: Any, start: Any, tolerance: float) -> Any:
            solved = jax.scipy.sparse.linalg.cg(normal, right, start, tol=tolerance, maxiter=most)
            return solved[0]

        return invert, jax.lax.map

    make: Any = scipy.sparse.linalg.LinearOperator
    operator = make((size, size), matvec=normal, dtype=float)

    def by_scipy(right: Any, start: Any, tolerance: float) -> Any:
        return scipy.sparse.linalg.cg(operator, right, start, rtol=tolerance, maxiter=most)[0]

    def each(function: Callable[[Any], Any], rows: Any) -> Any:
        pairs = zip(*rows, strict=True) if isinstance(rows, tuple) else rows
        return np.array([function(own) for own in pairs])

    return by_scipy, each
