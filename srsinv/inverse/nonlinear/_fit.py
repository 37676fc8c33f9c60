"""The general nonlinear fit: any differentiable model to data, with what the data do not tell."""

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...errors import refuse
from ...grid import as_real
from ._loss import Loss, Squares
from ._parameters import Layout, Parameters, Tree, parameters, starting_points
from ._request import check_linear, checked_data, checked_solver, filled, misfit_of
from ._search import Found, Misfit, search, search_many
from ._solvers import Solver
from ._uncertainty import Spread, log_evidence, nothing_known, offset, spread

POLISHED = 8  # of many starts, so many of the best are searched from
SCALES = 8  # rounds in which an unknown noise level is sought where the minimum depends on it
AT_BOUND = 1e-6  # standard errors from a bound up to which a parameter stands on it
SAME = 1e-8  # relative difference of two costs up to which they are one minimum
NORMAL_MAD = 1.4826022185056018  # a normal's standard deviation over its median deviation


@dataclasses.dataclass(frozen=True)
class Fit:
    """What a fit found.

    - `value`, `stderr`: trees like the parameters; the standard error is 0 for what was not free
      and infinite for what the data do not determine.
    - `names` (m,): the free parameters in a row; `covariance`, `correlation` (m, m) in that order,
      nan beside what is not determined.
    - `residual`: data - model, like the data, nan where they are left out; `whitened`: the same in
      units of the noise, in a row, 0 there. `jacobian` (n, m): the derivative of `whitened`.
    - `noise_rms`: the noise's level where it was not given, else None.
    - `result`: "converged", or what went wrong; `at_bound`: who stands on a bound. Standard errors
      there are those without the bound.
    - `undetermined`: directions along which the data do not notice a move, each a mapping of names
      to moves.
    - `log_evidence`: the log marginal likelihood (Laplace), where the noise and proper priors for
      all free parameters are given, else None.
    - `stats`: cost (half the sum of squares), chi2 per degree of freedom, iterations, starts.
    """

    value: Tree
    stderr: Tree
    names: tuple[str, ...]
    covariance: np.ndarray
    correlation: np.ndarray
    residual: np.ndarray
    whitened: np.ndarray
    jacobian: np.ndarray
    noise_rms: float | None
    result: str
    at_bound: tuple[str, ...]
    undetermined: tuple[dict[str, float], ...]
    log_evidence: float | None
    stats: dict[str, Any]
    _misfit: Misfit
    _z: np.ndarray
    _spread: Spread

    @property
    def converged(self) -> bool:
        """Whether the result is an answer."""
        return self.result == "converged"

    def derive(
        self, function: Callable[[Tree], Any], steps: Mapping[str, float] | None = None
    ) -> tuple[Any, Any]:
        """A function of the parameters, and its standard error to first order (the delta method).

        `function` maps the tree of parameters to a number or an array (k,). With `steps` its
        gradient is taken by central differences: over these steps where a parameter is named, else
        over its standard error. Infinite standard errors where the data do not determine it. It is
        compiled at each call, once for all where it is an equinox module.
        """

        def of(z):
            return jnp.asarray(function(self._misfit.tree(z)))

        # Compiled whole: operation by operation takes seconds where a traction is derived.
        if steps is None:
            slope = _shared_slope if isinstance(function, eqx.Module) else eqx.filter_jit(_slope)
            misfit = self._misfit
            value, gradient = slope(function, misfit.layout, misfit.row, as_real(self._z))
        else:
            value, gradient = self._differences(jax.jit(of), steps)
        along = np.atleast_2d(np.asarray(gradient))
        stderr = self._spread.along(along)
        return (value[()], stderr[0]) if np.ndim(value) == 0 else (np.asarray(value), stderr)

    def _differences(self, of: Callable[[Any], Any], steps: Mapping[str, float]):
        """The function's value, and its gradient (k, m)."""
        own = self._spread.stderr()
        columns = []
        for i, name in enumerate(self.names):
            fallback = own[i] if 0 < own[i] < np.inf else 1e-3 * max(abs(self._z[i]), 1e-9)
            off = np.zeros(self._z.size)
            off[i] = step = steps.get(name, fallback)
            above, below = (np.asarray(of(as_real(self._z + sign * off))) for sign in (1, -1))
            columns.append((above - below) / (2 * step))
        return of(as_real(self._z)), np.stack(columns, axis=-1)


def fit(
    model: Callable[[Tree], Array],
    initial: Tree,
    y,
    *,
    noise: Any = None,
    bounds: Any = None,
    free: Any = None,
    priors: Mapping[str, tuple[Any, Any]] | None = None,
    starts: Any = None,
    linear: Collection[str] = (),
    loss: Loss | str = "squares",
    solver: Solver | None = None,
    polished: int = POLISHED,
    steps: Mapping[str, float] | None = None,
) -> Fit:
    """The parameters under which `model` explains the data `y` best, and how well they are known.

    - `model(params)`: an array like `y`, by differentiable jax operations. A model that is the same
      object compiles once for data of the same shape.
    - `initial`: the parameters to start from, any tree of numbers and arrays (a mapping by name, a
      vector, ...). Names below are keys joined by dots, `"b[1]"` for a number of an array.
    - `noise`: standard deviation, one or one for each of `y` (infinite leaves a sample out), a
      [`Spectrum`][], a [`Correlated`][]; None: white, its level taken from the residual.
    - `bounds`: `{name: (lower, upper)}`, None for no bound, or two trees (lower, upper).
    - `free`: names of what is fitted, or a tree of truth values; None: everything.
    - `priors`: `{name: (mean, standard deviation)}`, Gaussian.
    - `starts`: further points to start from: `{name: values}` along a leading axis, or a number of
      points spread over the bounds. The `polished` best of all are searched from.
    - `linear`: names of parameters that enter the model linearly: they need no start and are solved
      out (variable projection). Whether they do is tried, unless they are those that the model
      itself names, as its attribute `linear`.
    - `loss`: "squares", "huber", "soft_l1", "cauchy", or a [`Loss`][] with its threshold.
    - `solver`: [`Optimistix`][] (default), [`OptaxLBFGS`][], [`JaxoptLBFGSB`][].
    - `steps`: `{name: step}` for parameters whose derivative jumps with their place between cells:
      for the standard errors it is then the central difference over this step.

    Standard errors are those of the linearised problem: (J^T N^-1 J)^-1, with a robust loss Huber's
    M-estimator form. Raises `BadInput` for what disagrees or is out of range.
    """
    found = parameters(initial, bounds, free, linear)
    misfit, level_known = misfit_of(model, found, checked_data(y), noise, priors, loss)
    points = starting_points(starts, found)
    check_linear(misfit, points, linear)
    solver = checked_solver(solver, polished=polished)
    settings = solver, points, as_real(found.lower), as_real(found.upper), polished
    ends = search(misfit, *settings)
    if not level_known and (misfit.prior_mean is not None or _is_robust(misfit)):
        for _ in range(SCALES):
            scale = _level(misfit, ends)
            settled = abs(scale / float(misfit.scale) - 1) < 1e-3
            misfit = dataclasses.replace(misfit, scale=as_real(scale))
            ends = search(misfit, *settings)
            if settled:
                break
    if steps:
        ends = _differenced(misfit, ends, steps)
    return _described(misfit, found, ends, level_known, solver)


def fit_many(
    model: Callable[[Tree], Array],
    initial: Tree,
    ys,
    *,
    noise: Any = None,
    bounds: Any = None,
    free: Any = None,
    priors: Mapping[str, tuple[Any, Any]] | None = None,
    starts: Any = None,
    linear: Collection[str] = (),
    solver: Solver | None = None,
    polished: int = POLISHED,
    at_once: int = 1,
) -> list[Fit]:
    """[`fit`][] of the same model to many data, `ys` (batch, ...), in one compiled program.

    `at_once` of them go side by side, which pays on an accelerator only: each waits for the
    slowest, and on a CPU jaxlib's batched LAPACK can lock up (seen with 0.10.2). Least squares
    only, and without priors where the noise is not known.
    """
    found = parameters(initial, bounds, free, linear)
    ys = checked_data(ys)
    refuse(ys.ndim < 2 or not len(ys), "fit_many takes data with a leading axis: (batch, ...).")
    refuse(
        noise is None and bool(priors),
        "fit_many cannot weigh priors against noise that is not known: give noise, or use fit.",
    )
    misfit, level_known = misfit_of(model, found, ys[0], noise, priors, "squares")
    ys = as_real(filled(ys, misfit.whiten.seen(ys.shape[1:])))
    points = starting_points(starts, found)
    check_linear(misfit, points, linear)
    solver = checked_solver(solver, polished=polished, at_once=at_once)
    box = as_real(found.lower), as_real(found.upper)
    at_once = min(at_once, len(ys))
    # Filled up to whole rounds: what is left over would be compiled a second time.
    rows = np.minimum(np.arange(-(-len(ys) // at_once) * at_once), len(ys) - 1)
    batch = search_many(misfit, ys[rows], solver, points, *box, polished, at_once)
    batch = jax.device_get(batch)
    fits = []
    for i, y in enumerate(ys):
        ends = jax.tree.map(lambda leaf, i=i: leaf[i], batch)
        mine = dataclasses.replace(misfit, y=y)
        fits.append(_described(mine, found, ends, level_known, solver))
    return fits


def _is_robust(misfit: Misfit) -> bool:
    return not isinstance(misfit.loss, Squares)


def _level(misfit: Misfit, ends: Found) -> float:
    """The noise's level from a residual: its rms, or what outliers do not move."""
    white = np.asarray(ends.white) * float(misfit.scale)
    seen = white[white != 0] if np.any(white) else white
    if _is_robust(misfit):
        level = NORMAL_MAD * np.median(np.abs(seen))
    else:
        level = np.sqrt(seen @ seen / max(len(seen) - ends.z.size, 1))
    return float(max(level, np.finfo(float).tiny ** 0.5))


def _differenced(misfit: Misfit, ends: Found, steps: Mapping[str, float]) -> Found:
    """What was found, with central differences in the Jacobian's columns of these parameters."""
    names, jacobian = misfit.layout.free_names, np.array(ends.jacobian)
    for name, step in steps.items():
        refuse(not step > 0, f"The step of {name} is {step!r}: give a number above 0.")
        if name not in names:
            continue
        at = names.index(name)
        off = np.zeros(ends.z.size)
        off[at] = step
        above, below = (_white_at(misfit, ends.z, as_real(sign * off)) for sign in (1, -1))
        jacobian[:, at] = (np.asarray(above) - np.asarray(below)) / (2 * step)
    return dataclasses.replace(ends, jacobian=jnp.asarray(jacobian))


@eqx.filter_jit
def _white_at(misfit: Misfit, z, off):
    return misfit.white(z + off)[0]


def _slope(function, layout: Layout, row, z):
    """A function of the parameters, and its derivative by the free ones."""

    def of(z):
        return jnp.asarray(function(layout.tree(row.at[np.asarray(layout.free)].set(z))))

    return of(z), jax.jacfwd(of)(z)


_shared_slope = eqx.filter_jit(_slope)


# --- saying what was found -------------------------------------------------------------------


def _described(
    misfit: Misfit, found: Parameters, ends: Found, level_known: bool, solver: Solver
) -> Fit:
    layout, z = misfit.layout, np.asarray(ends.z, float)
    eps = max(float(np.finfo(np.asarray(ends.z).dtype).eps), solver.lost)
    terms, jacobian = _terms(misfit, ends)
    free = np.asarray(layout.free)
    with np.errstate(all="ignore"):
        gradient, squares = jacobian.T @ terms, np.sum(jacobian**2, axis=0)
        cost = 0.5 * float(terms @ terms)
    finite = bool(np.isfinite([*gradient, *squares, cost]).all())
    known = spread(_rows(misfit, ends), eps) if finite else nothing_known(z.size)
    count = misfit.whiten.count(misfit.y.shape)
    freedom = count - known.factor.shape[1]
    known = known.times(_inflation(misfit, ends, level_known, freedom) if finite else 1.0)
    # A solver that works in other variables reaches a bound up to rounding only.
    near = AT_BOUND * np.sqrt(np.sum(known.factor**2, axis=1)) + 8 * eps * np.abs(z)
    low, high = z - found.lower <= near, found.upper - z <= near
    held = (low & (gradient >= 0)) | (high & (gradient <= 0))
    least = 1.0 if level_known else 0.0  # of a noise that is known
    distance = offset(jacobian, terms, held, eps, least) if finite else np.inf
    covariance, errors = known.covariance(), known.stderr()
    row, stderr = np.asarray(misfit.row, float).copy(), np.zeros(len(layout.names))
    row[free], stderr[free] = z, errors
    costs = np.asarray(ends.costs)
    weight = misfit.prior_weight
    weight = np.zeros(z.size) if weight is None else np.asarray(weight, float)
    sigma = np.where(weight > 0, 1 / np.where(weight > 0, weight, 1.0), np.inf)
    evidence = None
    if level_known and finite and not _is_robust(misfit):
        volume = misfit.whiten.log_volume(misfit.y.shape) + count / 2 * np.log(2 * np.pi)
        evidence = log_evidence(
            terms, jacobian, volume, np.where(low, found.lower, np.where(high, found.upper, z)),
            found.lower, found.upper, sigma,
        )  # fmt: skip
    return Fit(
        value=layout.host_tree(row),
        stderr=layout.host_tree(stderr),
        names=layout.free_names,
        covariance=covariance,
        correlation=_correlation(covariance),
        residual=np.where(misfit.whiten.seen(misfit.y.shape), ends.residual, np.nan),
        whitened=np.asarray(ends.white),
        jacobian=np.asarray(ends.jacobian),
        noise_rms=None if level_known else _rms(misfit, ends, freedom),
        result=_result(finite, distance, terms, misfit, ends, solver, eps),
        at_bound=tuple(layout.free_names[i] for i in np.flatnonzero(low | high)),
        undetermined=known.directions(layout.free_names, z),
        log_evidence=evidence,
        stats={
            "solver": solver.name,
            "cost": cost,
            "data": count,
            "degrees_of_freedom": freedom,
            "chi2_per_freedom": 2 * cost / freedom if freedom > 0 else None,
            "iterations": int(ends.iterations),
            "starts": int(ends.start_costs.size),
            "searches": int(costs.size),
            "searches_at_best": int(np.sum(costs <= costs.min() * (1 + SAME) + SAME**2)),
            "distance_to_minimum": distance,
        },
        _misfit=misfit,
        _z=z,
        _spread=known,
    )


def _rms(misfit: Misfit, ends: Found, freedom: int) -> float:
    """The level of the noise, where it is estimated."""
    if _is_robust(misfit):
        return float(misfit.scale)
    with np.errstate(over="ignore"):
        return float(misfit.scale * np.linalg.norm(ends.white) / np.sqrt(max(freedom, 1)))


def _terms(misfit: Misfit, ends: Found) -> tuple[np.ndarray, np.ndarray]:
    """What is squared, and its derivative."""
    root, slope = _rooted(misfit.loss, ends.white)
    jacobian = np.asarray(slope)[:, None] * np.asarray(ends.jacobian)
    return _with_priors(misfit, ends, np.asarray(root), jacobian)


@eqx.filter_jit
def _rooted(loss: Loss, white):
    """The loss's root, and its slope."""
    return jax.jvp(loss.root, (white,), (jnp.ones_like(white),))


def _rows(misfit: Misfit, ends: Found) -> np.ndarray:
    """The derivative of the whitened residual and of the priors' terms."""
    return _with_priors(misfit, ends, np.asarray(ends.white), np.asarray(ends.jacobian))[1]


def _with_priors(misfit: Misfit, ends: Found, terms, jacobian) -> tuple[np.ndarray, np.ndarray]:
    if misfit.prior_mean is None or misfit.prior_weight is None:
        return terms.astype(float), jacobian.astype(float)
    weight = np.asarray(misfit.prior_weight, float)
    more = (np.asarray(ends.z) - np.asarray(misfit.prior_mean)) * weight
    return np.concatenate([terms, more]), np.vstack([jacobian, np.diag(weight)])


def _inflation(misfit: Misfit, ends: Found, level_known: bool, freedom: int) -> float:
    """What the standard errors under unit noise are multiplied by.

    One for least squares with known noise; the residual's rms where its level is not known; Huber's
    ratio (1981, section 7.6) for a robust loss. Infinite where no datum is left over to tell it.
    """
    white = np.asarray(ends.white, float)
    if _is_robust(misfit):
        seen = misfit.whiten.seen(misfit.y.shape).ravel()
        influence, slope = (np.asarray(v)[seen] for v in misfit.loss.influence(ends.white))
        mean = max(float(slope.mean()), 1e-12)
        correction = 1 + ends.z.size / slope.size * float(slope.var()) / mean**2
        return float(correction * np.sqrt(influence @ influence / max(freedom, 1)) / mean)
    if level_known or misfit.prior_mean is not None:
        return 1.0
    return float(np.sqrt(white @ white / freedom)) if freedom > 0 else np.inf


def _correlation(covariance: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", divide="ignore"):
        stderr = np.sqrt(np.diagonal(covariance))
        correlation = covariance / np.outer(stderr, stderr)
    correlation[np.diag_indices(len(stderr))] = 1.0
    return correlation


def _result(finite, distance, terms, misfit: Misfit, ends: Found, solver: Solver, eps) -> str:
    if not finite:
        return "not finite: the model or its derivative is nan or infinite where the search stopped"
    if distance <= solver.near_enough or _nothing_left(terms, misfit, ends, eps):
        return "converged"
    if not bool(ends.done):
        return f"not converged: {solver.name} reached its {solver.max_steps} steps"
    return (
        f"not converged: {solver.name} stopped {distance:.2g} standard errors from the minimum of "
        "the linearised problem"
    )


def _nothing_left(terms, misfit: Misfit, ends: Found, eps: float) -> bool:
    """Whether the residual is rounding beside the data, or beside where the search began."""
    data = np.linalg.norm(misfit.whiten(misfit.y)) / float(misfit.scale)
    begun = np.asarray(ends.start_costs)
    begun = np.sqrt(2 * np.max(begun, where=np.isfinite(begun), initial=0.0))
    return bool(np.linalg.norm(terms) <= eps ** (2 / 3) * max(data, begun))
