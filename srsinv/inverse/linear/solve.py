"""The solution of a linear problem, and its three paths.

- *direct*: exact; the modes of the whitened operator under the prior (`modes.py`); up to a few
  thousand unknowns. Where jax traces the problem, Cholesky factors take their place.
- *spectral*: exact; the modes of a circulant operator are waves.
- *iterative*: conjugate gradients, which take products of the operator alone; any size. A rule goes
  by a bidiagonalisation (`krylov.py`).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import refuse
from ...grid import as_real
from ...known import Numbers, array_module, as_number, in_jax, is_traced, outside_traces
from ...status import Status
from .. import diagnostics
from ..estimate import Stats
from ..line import direct
from ..line.pure import TRUSTED
from ..line.rule import Rule, choose
from ..line.scorer import Scores
from . import iterative
from .estimate import LinearEstimate, standard_error
from .krylov import KrylovChoice, choose_weight
from .modes import (
    Decomposition,
    FactorScores,
    Modes,
    ModeScorer,
    ModeScores,
    box,
    circulant_modes,
    decompose,
    is_circulant,
    modes,
    stationary,
)
from .operator import MatrixMap, matrix_of
from .prior import Differences, PriorFactors, prior_factors
from .problem import LinearProblem
from .standard import standard_form

DIRECT_LIMIT, AUTO_LIMIT = 4096, 2048  # unknowns: more are refused, and not chosen
CHOLESKY_DECADES = 11.6  # of a weight below the most information: normal equations lose the others


class Regularisation(NamedTuple):
    """How a method weighs the prior.

    - `weight`: of its precision; None: `rule` chooses it.
    - `order`: of the differences that are penalised where a problem has no prior.
    - `path`, `tolerance`: how it is solved. `stats`: of the method.
    """

    weight: Any
    rule: Rule
    order: int
    path: str
    tolerance: float
    stats: Mapping[str, Any]


class WhitenedProblem(NamedTuple):
    """The operator (s, m) and the data (s,) over the valid samples in units of the noise, the data
    less those of the prior's mean."""

    model: Float[Numbers, "s m"]
    data: Float[Numbers, " s"]


class LinearSolution(NamedTuple):
    """A solution: the flat `value` (m,), a root `spread` (m, k) of its covariance, what it makes of
    whitened data, `gain` (m, s), the `condition` number and the degrees of freedom `resolved`."""

    value: Float[Numbers, " m"]
    spread: Float[Numbers, "m k"]
    gain: Float[Numbers, "m s"] | None
    condition: Any
    resolved: Any


def solve(problem: LinearProblem, how: Regularisation) -> LinearEstimate:
    """The posterior of the unknown under its prior, or under a penalty on its differences.

    Raises `BadInput` for a path that does not serve the problem, and on the iterative path for a
    weight that a rule is to choose where jax traces the problem.
    """
    _, m = problem.operator.sizes
    is_auto = how.path == "auto"
    if how.path == "iterative" or (is_auto and m > AUTO_LIMIT):
        return _by_iterations(problem, how)
    refuse(
        how.path == "direct" and m > DIRECT_LIMIT,
        f"path=direct would factor {m} unknowns, more than {DIRECT_LIMIT}: give path=iterative.",
    )
    matrix = matrix_of(problem.operator)
    is_known = not is_traced(problem, matrix, how.weight)
    wraps = not is_traced(matrix) and is_circulant(matrix)
    factors = factors_of(problem, how.order, wraps)
    is_even = is_known and wraps and _has_one_level(problem)
    gains = stationary(factors) if is_even else None
    refuse(
        how.path == "spectral" and is_known and gains is None,
        "path=spectral needs a circulant matrix, one noise level, no sample missing and a prior "
        "that is the same everywhere: give path=auto.",
    )
    model = problem.whiten(matrix)
    white = WhitenedProblem(model, problem.whiten(problem.data.reshape(-1)) - model @ factors.mean)
    if not is_known:
        return _traced(problem, how, factors, white)
    refuse(not np.any(model), "operator is zero: give one that maps unknowns to data.")
    if gains is None or how.path == "direct":
        path = "direct"
        spread_out = factors.transpose_spread(model.T).T
        found = decompose(spread_out, factors.root_matrix(), factors.rank)
        own = modes(found, factors, white.data)
    else:
        path = "spectral"
        own, found = circulant_modes(model[:, 0], gains, white.data)
    weight, status = _weight(how, ModeScores(1, own), found, white.data)
    condition = own.condition(weight)
    ended = Status.CONVERGED if condition < TRUSTED["float64"] else Status.ILL_CONDITIONED
    solved = _of_modes(own, weight, factors, condition)
    chosen = {"weight": weight, "rule_status": status, "path": path}
    return _estimate(problem, how, in_jax((solved, white)), chosen, ended)


def factors_of(problem: LinearProblem, order: int, wraps: bool) -> PriorFactors:
    """The factors of the problem's prior, or of the penalty on differences of this order.

    Raises `BadInput` where there are too few unknowns for a difference.
    """
    shape, (_, m) = problem.operator.unknown_shape, problem.operator.sizes
    if problem.prior is not None:
        return prior_factors(problem.prior, shape)
    root = Differences(shape, order, wraps) if order else None
    refuse(
        root is not None and not root.is_defined,
        f"order={order} needs more than {order} unknowns along an axis, and the unknown has the "
        f"shape {shape}: give order=0.",
    )
    return PriorFactors(np.zeros(m), None, root, m)


def _has_one_level(problem: LinearProblem) -> bool:
    """Whether the noise of all samples is alike and none is missing."""
    noise = problem.noise
    is_white = problem.noise_root is None and bool(np.all(noise == noise.ravel()[0]))
    return not problem.missing and is_white


def _weight(
    how: Regularisation, scores: Scores, found: Decomposition, data: Float[Numbers, " s"]
) -> tuple[Any, Status]:
    """The weight that is given or that the rule chooses, and how the choice ended; `data`:
    whitened."""
    if how.weight is not None:
        return how.weight, Status.GIVEN
    ends = box(found, data, array_module(found))
    if is_traced(scores):
        ends = jnp.maximum(ends, ends[1] - CHOLESKY_DECADES)
    else:
        ends = np.asarray(as_real(ends))
    made = choose(how.rule, ModeScorer(scores, len(data)), ends)
    weight = 10.0 ** made.log_weights[0]
    return (weight if is_traced(weight) else float(weight)), made.status


def _of_modes(own: Modes, weight: Any, factors: PriorFactors, condition: float) -> LinearSolution:
    _, total = own.power(float(weight))
    response = own.model / total
    spread = own.basis / np.sqrt(total)
    value = factors.mean + own.basis @ (response * own.data)
    count = own.left.shape[1]
    gain = (own.basis[:, :count] * response[:count]) @ own.left.T
    return LinearSolution(value, spread, gain, condition, float(np.sum(own.model * response)))


def _traced(
    problem: LinearProblem, how: Regularisation, factors: PriorFactors, white: WhitenedProblem
) -> LinearEstimate:
    """The estimate of a problem that jax traces, by Cholesky factors, which have derivatives; NaN
    where the system is too ill-conditioned for its precision."""
    model, data = map(jnp.asarray, white)
    spread_out = factors.transpose_spread(model.T).T
    root = factors.root_matrix()
    k = factors.coordinates
    penalty = jnp.eye(k) if root is None else jnp.asarray(root).T @ jnp.asarray(root)
    basis = jnp.asarray(factors.apply_spread(jnp.eye(k)))
    information = spread_out.T @ spread_out
    if how.weight is None:
        of = direct.Scored(
            direct.Whitened(spread_out, data[None]), information, penalty,
            jnp.array([float(factors.rank)]), jnp.zeros(()), jnp.zeros(1, bool), basis,
        )  # fmt: skip
        known = spread_out, None if root is None else jnp.asarray(root), data
        frozen = jax.lax.stop_gradient(known)
        found = decompose(*frozen[:2], factors.rank, jnp)
        weight, status = _weight(how, FactorScores(1, of), found, frozen[2])
    else:
        weight, status = how.weight, Status.GIVEN
    precision = information + weight * penalty
    factor = jnp.linalg.cholesky(precision)
    spread = jax.scipy.linalg.solve_triangular(factor, basis.T, lower=True).T
    gain = spread @ jax.scipy.linalg.solve_triangular(factor, spread_out.T, lower=True)
    inverse = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(k))
    norms = [jnp.max(jnp.sum(jnp.abs(each), axis=0)) for each in (precision, inverse)]
    condition = norms[0] * norms[1]
    trusted = jnp.where(condition < TRUSTED[data.dtype.name], 1.0, jnp.nan)
    value = trusted * (factors.mean + gain @ data)
    resolved = jnp.sum(inverse * information)
    solved = LinearSolution(value, trusted * spread, gain, condition, resolved)
    chosen = {"weight": weight, "rule_status": status, "path": "direct"}
    return _estimate(problem, how, (solved, WhitenedProblem(model, data)), chosen, Status.CONVERGED)


def _by_iterations(problem: LinearProblem, how: Regularisation) -> LinearEstimate:
    own = problem.operator
    wraps = isinstance(own, MatrixMap) and not is_traced(own.values) and is_circulant(own.values)
    factors = factors_of(problem, how.order, wraps)
    warnings = diagnostics.drawn_bands(iterative.DRAWS)
    chosen: dict[str, Any] = {"path": "iterative", "tolerance": how.tolerance}
    condition = np.nan
    if how.weight is not None:
        chosen |= {"weight": how.weight, "rule_status": Status.GIVEN}
        found = iterative.solve(problem, factors, how.weight, how.tolerance)
    else:
        refuse(
            is_traced(problem),
            "A rule cannot choose the weight under jit, vmap or grad on path=iterative: give "
            "weight_p=..., or path=direct.",
        )
        with outside_traces():
            found, made = _chosen(problem, factors, how)
        condition = made.condition
        chosen |= {"weight": made.weight, "rule_status": made.status, "probes": made.probes}
        chosen |= {"weight_error": made.weight_error}
        warnings = (*warnings, *diagnostics.probed_weight(made.probes, made.weight_error))
    solved = LinearSolution(found.value, found.spread, None, condition, found.resolved)
    ended = Status.CONVERGED if is_traced(found) or found.is_converged else Status.STEP_LIMIT
    ended = Status.ILL_CONDITIONED if condition >= TRUSTED["float64"] else ended
    return _estimate(problem, how, (solved, None), chosen, ended, warnings)


def _chosen(
    problem: LinearProblem, factors: PriorFactors, how: Regularisation
) -> tuple[iterative.Iterated, KrylovChoice]:
    """The solution under the rule's weight, and the choice of that."""
    form = standard_form(problem, factors)
    made = choose_weight(form, how.rule)
    if made.triplets is not None:
        return iterative.by_triplets(form, made.triplets, made.weight, made.mean), made
    start = form.coordinates(made.mean)
    return iterative.solve(problem, factors, made.weight, how.tolerance, start), made


def _estimate(
    problem: LinearProblem,
    how: Regularisation,
    made: tuple[LinearSolution, WhitenedProblem | None],
    chosen: dict[str, Any],
    status: Status,
    warnings: Sequence[str] = (),
) -> LinearEstimate:
    """The estimate of a solution; `chosen`: its weight and path."""
    solved, white = made
    shape = problem.operator.unknown_shape
    value = solved.value.reshape(shape)
    fitted = problem.operator.forward(value if problem.operator.by_jax else np.asarray(value))
    left = problem.whiten((problem.data - fitted).reshape(-1))
    xp = array_module(left, solved)
    squares = xp.sum(xp.square(left))
    freedom = problem.sample_count - solved.resolved
    is_known = not is_traced(left, solved)
    if is_known:
        chi2 = float(squares / freedom) if freedom >= 1 else None
        if not np.all(np.isfinite(np.asarray(value))):
            status = Status.NOT_FINITE
        warnings = (
            *(how.rule.band_warnings if how.weight is None else ()),
            *diagnostics.undetermined_weights(chosen["rule_status"]),
            *diagnostics.nothing_resolved(float(solved.resolved), problem.operator.sizes[1]),
            *_pulled(solved, white),
            *diagnostics.unchecked_residual(chi2),
            *diagnostics.residual_over_noise(chi2, float(freedom)),
            *warnings,
        )
    else:
        chi2 = jnp.where(freedom >= 1, squares / jnp.maximum(freedom, 1.0), jnp.nan)
        warnings = (*warnings, *diagnostics.unchecked())
    rule = "given" if how.weight is not None else how.rule.name
    numbers = {
        "weight": as_number(chosen["weight"]), "condition": as_number(solved.condition),
        "resolved_dof": as_number(solved.resolved), "chi2_per_freedom": chi2,
        "degrees_of_freedom": as_number(freedom),
    }  # fmt: skip
    return LinearEstimate(
        value=value,
        stderr=standard_error(solved.spread).reshape(shape),
        data=problem.at_samples(problem.valid_data),
        fitted=fitted,
        whitened=problem.at_samples(left),
        spread=solved.spread,
        status=status,
        warnings=warnings,
        stats=Stats({**how.stats, "rule": rule, **chosen, **numbers}),
        name=problem.name,
        gain=solved.gain,
        model=None if white is None else white.model,
    )


def _pulled(solved: LinearSolution, white: WhitenedProblem | None) -> Sequence[str]:
    """Warning on a prior that pulls the estimate by more than its band allows."""
    if white is None or solved.gain is None:
        return ()
    # C P x = x - C A^T A x, as the posterior covariance C is the inverse of A^T A + P.
    moved = solved.gain @ white.data
    pull = moved - solved.gain @ (white.model @ moved)
    variance = float(np.sum(np.asarray(solved.spread) ** 2))
    if not variance > 0:
        return ()
    ratio = float(np.sum(np.asarray(pull) ** 2)) / variance
    return diagnostics.pulled_by_prior("the unknown", ratio, float(solved.resolved))
