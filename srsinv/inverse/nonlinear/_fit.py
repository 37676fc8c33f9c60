"""The general nonlinear fit: any differentiable model to data, with the directions that are not
identifiable."""

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any, cast

import jax
import numpy as np
from jaxtyping import Array

from ...errors import refuse
from ...known import is_traced, outside_traces
from ..diagnostics import false_minimum
from ._answer import Fit
from ._differences import checked_steps, with_differences
from ._loss import Loss
from ._parameters import Tree, on_host, parameters
from ._request import (
    UNTRACED,
    check_linear,
    checked_data,
    checked_solver,
    data_unit,
    filled,
    objective_of,
)
from ._saddle import escape_saddle
from ._search import Objective, Search, SearchEnd
from ._solvers import Solver
from ._starts import starting_points, starting_rows
from ._summary import Summary
from ._traced import TracedFit, hoisted, traced_fit

if TYPE_CHECKING:  # of known numbers, as nearly all are
    AnyFit = Fit
else:
    AnyFit = Fit | TracedFit

AT_ONCE = 8  # data whose model is one call: more of them no longer share a processor's cache
MAX_SEARCHES = 8  # number of best starts to search from
SCALES = 8  # rounds of estimating an unknown noise level where the minimum depends on it
NORMAL_MAD = 1.4826022185056018  # a normal's standard deviation over its median deviation


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
    max_searches: int = MAX_SEARCHES,
    steps: Mapping[str, float] | None = None,
) -> AnyFit:
    """Fit the parameters of `model` to the data `y`, with their uncertainty.

    - `model(params)`: an array like `y`, by differentiable jax operations. A model that is the same
      object compiles once for data of the same shape.
    - `initial`: the parameters to start from, any tree of numbers and arrays (a mapping by name, a
      vector, ...). Names below are keys joined by dots, `"b[1]"` for a number of an array.
    - `noise`: standard deviation, one or one for each of `y` (infinite leaves a sample out), a
      [`Spectrum`][] or [`Correlated`][] of `srsinv.inverse.nonlinear`; None: white, its level taken
      from the residual.
    - `bounds`: `{name: (lower, upper)}`, None for no bound, or two trees (lower, upper).
    - `free`: names of the fitted parameters, or a tree of truth values; None: all.
    - `priors`: `{name: (mean, standard deviation)}`, Gaussian.
    - `starts`: further points to start from: `{name: values}` along a leading axis, or a number of
      points spread over the bounds. The `max_searches` best of all are searched from.
    - `linear`: names of parameters that enter the model linearly: they need no start and are solved
      out (variable projection). Linearity is tested, unless they are those of the model's own
      attribute `linear`.
    - `loss`: "squares", "huber", "soft_l1", "cauchy", or a [`Loss`][] with its threshold.
    - `solver`: [`Optimistix`][] (default), [`OptaxLBFGS`][], [`JaxoptLBFGSB`][].
    - `steps`: `{name: step}` for parameters whose derivative jumps with their position between
      cells: the standard errors, and a traced fit's derivatives, then use the central difference
      over this step.

    Standard errors are those of the linearised problem: (J^T N^-1 J)^-1, with a robust loss Huber's
    M-estimator form. Raises `BadInput` for values that disagree or are out of range.

    Under `jax.jit`, `vmap`, `grad` and `jvp`, jax may trace the data, the noise, the priors, the
    values of `initial` and what the model closes over. The fit is then a [`TracedFit`][] of
    `srsinv.inverse.nonlinear`: its values, standard errors and residual, with their derivatives.
    """
    unknowns, steps = parameters(initial, bounds, free, linear), checked_steps(steps)
    model = hoisted(model, unknowns)
    objective, level_known = objective_of(model, unknowns, checked_data(y), noise, priors, loss)
    points = starting_points(starts, unknowns)
    check_linear(objective, points, linear)
    solver = checked_solver(solver, max_searches=max_searches)
    box = on_host(unknowns.lower), on_host(unknowns.upper)
    if is_traced(objective, points):
        made = traced_fit(objective, level_known, solver, points, box, max_searches, steps)
        return cast(Fit, made)  # as far as jax can trace it
    summary = Summary(objective, unknowns, level_known, solver)
    with outside_traces():
        return _known_fit(objective, summary, Search(solver, points, *box, max_searches), steps)


def _known_fit(
    objective: Objective, summary: Summary, search: Search, steps: Mapping[str, float]
) -> Fit:
    """The fit of known numbers."""
    ends = search(objective)
    if not summary.level_known and (objective.prior_mean is not None or objective.is_robust):
        for _ in range(SCALES):
            scale = _level(objective, ends)
            settled = abs(scale / float(objective.scale) - 1) < 1e-3
            objective = dataclasses.replace(objective, scale=on_host(scale))
            ends = search(objective)
            if settled:
                break
    ends = escape_saddle(objective, ends, search)
    if steps:
        return with_differences(summary, objective, ends, search, steps)
    return summary(objective, jax.device_get(ends), search)


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
    each: Mapping[str, Any] | None = None,
    linear: Collection[str] = (),
    solver: Solver | None = None,
    max_searches: int = MAX_SEARCHES,
    at_once: int = AT_ONCE,
) -> list[Fit]:
    """Fit the same model to many data, `ys` (batch, ...): a [`Fit`][srsinv.Fit] of each.

    - `each`: values to start each of the data from, by name along the batch, in place of the
      initial ones.
    - `at_once`: how many of the data one call of the compiled model takes.
    - `model`, `initial`, `noise`, `bounds`, `free`, `priors`, `starts`, `linear`, `solver`,
      `max_searches`: as of [`fit`][srsinv.fit]. Robust losses and `steps` are those of `fit` alone.

    The minima reached for some of the data are starts for the others. Where one of them explains
    data better than the minimum that their own start led to, they are searched again from there. A
    fit whose residual still exceeds the known noise has a warning that its minimum may be a false
    one; by chance alone one good fit in a thousand has it. Solvers other than [`Optimistix`][]
    fit one after the other. Raises `BadInput` as `fit` does, and for priors where the noise is not
    known.
    """
    refuse(is_traced(initial, ys, noise, priors, starts, each), UNTRACED)
    unknowns = parameters(initial, bounds, free, linear)
    ys = checked_data(ys)
    refuse(ys.ndim < 2 or not len(ys), "fit_many takes data with a leading axis: (batch, ...).")
    refuse(
        noise is None and bool(priors),
        "fit_many needs a known noise to weigh the priors: give noise, or use fit.",
    )
    objective, level_known = objective_of(model, unknowns, ys[0], noise, priors, "squares")
    observed = objective.whiten.observed(ys.shape[1:])
    ys = filled(ys, observed).astype(objective.y.dtype)
    if not level_known:
        objective = dataclasses.replace(objective, scale=on_host(data_unit(ys, observed)))
    refuse(
        starts is not None and each is not None,
        "Both starts and each are given: give starts for all of the data, or one for each.",
    )
    points, own = starting_points(starts, unknowns), starting_rows(each, unknowns, len(ys))
    check_linear(objective, points, linear)
    solver = checked_solver(solver, max_searches=max_searches, at_once=at_once)
    box = on_host(unknowns.lower), on_host(unknowns.upper)
    summary = Summary(objective, unknowns, level_known, solver)
    from ._many import ends_of_many  # and optimistix

    ends = ends_of_many(
        objective, ys, (unknowns.lower, unknowns.upper), points, own, solver, max_searches,
        at_once, summary.is_noise,
    )  # fmt: skip
    fits = []
    for i, (y, end) in enumerate(zip(ys, ends, strict=True)):
        mine = dataclasses.replace(objective, y=y)
        begun = points if own is None else on_host(own[i : i + 1])
        search = Search(solver, begun, *box, max_searches)
        end = jax.device_get(search(mine)) if end is None else end
        fitted = summary(mine, jax.device_get(escape_saddle(mine, end, search)), search)
        notes = false_minimum(fitted.known_chi2, fitted.stats["degrees_of_freedom"])
        # Their search's program is another, so that a profile would compile one.
        fits.append(dataclasses.replace(fitted, notes=notes, _may_profile=False))
    return fits


def _level(objective: Objective, ends: SearchEnd) -> float:
    """The noise's level from a residual: its rms, or for a robust loss an estimate robust to
    outliers."""
    white = np.asarray(ends.white, float) * float(objective.scale)
    nonzero = white[white != 0] if np.any(white) else white
    if objective.is_robust:
        level = NORMAL_MAD * np.median(np.abs(nonzero))
    else:
        level = np.sqrt(nonzero @ nonzero / max(len(nonzero) - ends.z.size, 1))
    # Not below the rounding of the data.
    data = np.asarray(objective.y)
    rounding = float(np.finfo(data.dtype).eps) * data_unit(
        data, objective.whiten.observed(data.shape)
    )
    return float(max(level, rounding))
