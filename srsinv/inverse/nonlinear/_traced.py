"""Fits under jit, vmap, grad and jvp: the search is a part of the traced program, and its minimum
has derivatives by the implicit function theorem.

In the minimum z of C(z; c) = |t(z; c)|^2 / 2 the slope g = J^T t is zero, so that with the whole
second derivative H = J^T J + S, and S = t . d^2 t / dz^2, what c changes moves it by

    dz = -H^-1 (dg/dc) dc.

With J = Q R this is -R^-1 (1 + R^-T S R^-1)^-1 R^-T (dg/dc) dc: H itself, of J's condition squared,
is not formed. What stays on a bound does not move. All of it can be differentiated again.

A derivative that jumps between cells has no slope. By parameters with `steps` J and S are then
central differences over these, as in the standard errors of a known fit.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import sequential_vmap
from jaxtyping import Array, Bool, Float

from ...compiled import compiled
from ...errors import refuse
from ...known import in_jax, is_outside_traces, is_traced
from ..diagnostics import unchecked
from ..quality import Quality
from ._differences import ByDifferences
from ._lengths import lengths
from ._parameters import Layout, Parameters, Tree
from ._search import Objective, Search
from ._solvers import Solver
from ._summary import AT_BOUND
from ._uncertainty import ROUNDING_FACTOR, TOUCHED

Steps = tuple[tuple[str, float], ...]  # by parameter


class TracedFit(eqx.Module):
    """A fit as jax traces it: the arrays of a [`Fit`][srsinv.Fit], as far as they follow without
    its checks.

    - `value`, `stderr`: trees like the parameters; NaN where the search did not converge.
    - `names` (m,): the free parameters in a row, `row` (m,) their values, `covariance` (m, m) in
      that order.
    - `residual` (of the data's shape), `whitened` (n,), `noise_rms`, `stats` (cost, chi-square per
      degree of freedom, degrees of freedom): as a `Fit` has them.
    - `is_at_bound` (m,): which parameters are on a bound. They do not move with what is traced.
    - `converged`: whether the search ended in a minimum.
    - `warnings`: that the fit was not checked; its `quality` is doubtful.
    """

    value: Tree
    stderr: Tree
    names: tuple[str, ...] = eqx.field(static=True)
    row: Float[Array, " m"]
    covariance: Float[Array, "m m"]
    residual: Float[Array, "..."]
    whitened: Float[Array, " n"]
    noise_rms: Float[Array, ""] | None
    is_at_bound: Bool[Array, " m"]
    converged: Bool[Array, ""]
    stats: dict[str, Float[Array, ""]]
    _layout: Layout = eqx.field(static=True)
    _all: Float[Array, " all"]
    _spread: "_Spread"
    _steps: "Steps" = eqx.field(static=True)

    @property
    def warnings(self) -> tuple[str, ...]:
        """That JAX traced the fit."""
        return tuple(unchecked("fit"))

    @property
    def quality(self) -> Quality:
        """Doubtful, as nothing was checked."""
        return Quality.DOUBTFUL

    def derive(self, function: Callable[[Tree], Any]) -> tuple[Any, Any]:
        """A function of the parameters, a number or an array (k,), and its standard error to first
        order."""
        stepped = ByDifferences.around(function, self._layout, self.row, self._steps)

        def of(z):
            return jnp.asarray(stepped(self._layout.filled(self._all, z)))

        gradient = jax.jacfwd(of)(self.row)
        return of(self.row), self._spread.along(gradient)


def hoisted(model: Any, unknowns: Parameters) -> Any:
    """The model, what it closes over and jax traces among its arrays; the model itself where there
    is no such thing."""
    if is_outside_traces() or isinstance(model, eqx.Module) or not callable(model):
        return model
    layout, like = unknowns.layout, jax.dtypes.canonicalize_dtype(np.float64)
    leaves = [jax.ShapeDtypeStruct(shape, like) for shape in layout.shapes]
    converted = eqx.filter_closure_convert(model, jax.tree.unflatten(layout.structure, leaves))
    return converted if is_traced(converted) else model


def traced_fit(
    objective: Objective,
    level_known: bool,
    solver: Solver,
    points: Any,
    box: tuple[Any, Any],
    max_searches: int,
    steps: Mapping[str, float],
) -> TracedFit:
    """The fit of an objective, or from points, that jax traces."""
    is_weighed = objective.is_robust or objective.prior_mean is not None
    refuse(
        not level_known and is_weighed,
        "The noise's level is not known, and the minimum depends on it: under jit, vmap and grad "
        "give noise, or neither priors nor a robust loss.",
    )
    objective, points, box = in_jax((objective, points, box))
    pairs = tuple(steps.items())
    how = solver, points, *box, max_searches, level_known, float(solver.near_enough)
    end = _minimum(objective, how, pairs)
    is_answer, layout = end.is_answer > 0, objective.layout
    z = jnp.where(is_answer, end.z, jnp.nan)
    at = _local(_stepped(objective, z, pairs), z, level_known)
    everything = jnp.asarray(objective.row).at[np.asarray(layout.free)].set(z)
    spread = jnp.zeros_like(everything).at[np.asarray(layout.free)].set(at.stderr)
    # Back from the unit in place of an unknown noise level.
    unit = jnp.asarray(1.0 if level_known else objective.scale)
    observed = objective.whiten.observed(objective.y.shape)
    cost = unit**2 * at.cost
    chi2 = jnp.where(at.freedom > 0, 2 * cost / jnp.maximum(at.freedom, 1), jnp.nan)
    return TracedFit(
        value=layout.filled(everything, z),
        stderr=layout.filled(spread, at.stderr),
        names=layout.free_names,
        row=z,
        covariance=at.spread.covariance(),
        residual=jnp.where(observed, at.residual, jnp.nan),
        whitened=unit * at.white,
        noise_rms=None if level_known else unit * at.level,
        is_at_bound=end.held > 0,
        converged=is_answer,
        stats={"cost": cost, "chi2_per_freedom": chi2, "degrees_of_freedom": at.freedom},
        _layout=layout,
        _all=everything,
        _spread=at.spread,
        _steps=pairs,
    )


class _End(NamedTuple):
    """Where a search ended: z (m,), which of them a bound holds, and whether it is a minimum (as
    numbers, 0 or 1)."""

    z: Float[Array, " m"]
    held: Float[Array, " m"]
    is_answer: Float[Array, ""]


def _stepped(objective: Objective, z: Float[Array, " m"], steps: Steps) -> Objective:
    """The objective with differences for derivatives in z by parameters that have steps."""
    model = ByDifferences.around(objective.model, objective.layout, z, steps)
    return dataclasses.replace(objective, model=model)


@eqx.filter_custom_jvp
def _minimum(objective: Objective, how: Any, steps: Steps) -> _End:
    """The end of a search; `how`: solver, starts (s, m), bounds (m,), the number of searches,
    whether the noise's level is known, and how near a minimum a search has converged."""
    del steps
    return _ended(objective, how)


@_minimum.def_jvp
def _with_slopes(primals: Any, tangents: Any) -> tuple[_End, _End]:
    (objective, how, steps), (change, *_) = primals, tangents
    end = _minimum(objective, how, steps)

    def gradient(objective):
        return _gradient(_stepped(objective, end.z, steps), end.z)

    _, moved = eqx.filter_jvp(gradient, (objective,), (change,))
    near = _stepped(objective, end.z, steps)
    slope = -_times_inverse(near, end.z, end.held > 0, moved)
    return end, _End(slope, jnp.zeros_like(end.held), jnp.zeros_like(end.is_answer))


@compiled
def _ended(objective: Objective, how: Any) -> _End:
    arrays, rest = eqx.partition((objective, how), eqx.is_array)

    # One after the other: batched LAPACK on a CPU may wait for itself, and each would wait for the
    # slowest.
    @sequential_vmap
    def of(arrays):
        objective, (solver, points, lower, upper, most, level_known, near_enough) = eqx.combine(
            arrays, rest
        )
        end = Search(solver, points, lower, upper, most).traced(objective)
        z = jnp.asarray(end.z)
        at = _local(objective, z, level_known)
        # A solver that works in other variables reaches a bound up to rounding only.
        near = AT_BOUND * jnp.where(jnp.isfinite(at.stderr), at.stderr, 0.0)
        near = near + 8 * jnp.finfo(z.dtype).eps * jnp.abs(z)
        held = (z - lower <= near) | (upper - z <= near)
        is_near = _distance(objective, z, held, level_known) <= near_enough
        is_answer = (jnp.asarray(end.done) | is_near) & jnp.isfinite(at.cost)
        return _End(z, held.astype(z.dtype), is_answer.astype(z.dtype))

    return of(arrays)


class _Root(NamedTuple):
    """The triangular root (m, m) of rows' squares, columns scaled to length one by `columns` (m,);
    `missing` (m, m): unit vectors of what the rows leave open, which are rows of it, too; zeros
    else."""

    root: Float[Array, "m m"]
    missing: Float[Array, "m m"]
    columns: Float[Array, " m"]

    @classmethod
    def of(cls, rows: Float[Array, "n m"]) -> "_Root":
        """That of these rows."""
        columns, m = jax.lax.stop_gradient(lengths(rows)), rows.shape[1]
        columns = jnp.where(columns > 0, columns, 1.0)
        scaled = rows / columns
        padded = jnp.concatenate([jax.lax.stop_gradient(scaled), jnp.zeros((m, m), rows.dtype)])
        _, sizes, axes = jnp.linalg.svd(jnp.linalg.qr(padded, mode="r"))
        eps = jnp.finfo(rows.dtype).eps
        is_missing = sizes <= ROUNDING_FACTOR * eps * jnp.maximum(sizes[0], eps)
        missing = jnp.where(is_missing[:, None], axes, 0.0)
        root = jnp.linalg.qr(jnp.concatenate([scaled, missing]), mode="r")
        return cls(root, missing, columns)

    @property
    def factor(self) -> Float[Array, "m m"]:
        """F, where F F^T is the inverse of the rows' squares."""
        eye = jnp.eye(len(self.root), dtype=self.root.dtype)
        return jax.scipy.linalg.solve_triangular(self.root, eye) / self.columns[:, None]

    @property
    def determined(self) -> Any:
        """How many directions the rows determine."""
        return len(self.missing) - jnp.sum(jnp.any(self.missing != 0, axis=1))


class _Spread(NamedTuple):
    """The parameters' covariance, `factor` (m, m) times its transpose, along what is not `missing`
    (m, m); `is_scaled`: whether the noise's level is known."""

    factor: Float[Array, "m m"]
    missing: Float[Array, "m m"]
    columns: Float[Array, " m"]
    is_scaled: Bool[Array, ""]

    def along(self, gradient: Float[Array, "*k m"]) -> Float[Array, "*k"]:
        """Standard errors of quantities with these gradients: see `Spread`."""
        variance = jnp.sum((gradient @ self.factor) ** 2, axis=-1)
        # The slope of the root is infinite at zero.
        stderr = jnp.sqrt(jnp.where(variance > 0, variance, 1.0)) * (variance > 0)
        scaled = gradient / self.columns
        size = TOUCHED * jnp.linalg.norm(jax.lax.stop_gradient(scaled), axis=-1)
        is_open = jnp.any(jnp.abs(scaled @ self.missing.T) > size[..., None], axis=-1)
        return jnp.where(is_open | (~self.is_scaled & (variance > 0)), jnp.inf, stderr)

    def covariance(self) -> Float[Array, "m m"]:
        """(m, m): infinite variances and nan beside them where the data do not determine."""
        eye = jnp.eye(len(self.factor))
        stderr = self.along(eye)
        is_open = jnp.isinf(stderr)
        covariance = jnp.where(is_open[:, None] | is_open, jnp.nan, self.factor @ self.factor.T)
        return jnp.where((eye > 0) & is_open, jnp.inf, covariance)


class _Local(NamedTuple):
    """The problem linearised at a point: its cost, the whitened residual, the noise's level in
    units of what the objective takes for it, and the parameters' spread."""

    cost: Float[Array, ""]
    white: Float[Array, " n"]
    residual: Float[Array, "..."]
    freedom: Any
    level: Float[Array, ""]
    spread: _Spread

    @property
    def stderr(self) -> Float[Array, " m"]:
        """Standard errors of the parameters."""
        return self.spread.along(jnp.eye(len(self.spread.factor)))


@compiled
def _local(objective: Objective, z: Float[Array, " m"], level_known: bool) -> _Local:
    """As `Summary` has it of a known fit."""
    white, push, residual = jax.linearize(objective.white, z, has_aux=True)
    rows = jax.vmap(push, out_axes=1)(jnp.eye(z.size, dtype=z.dtype))
    if objective.prior_weight is not None:
        rows = jnp.concatenate([rows, jnp.diag(jnp.asarray(objective.prior_weight))])
    terms = objective.with_priors(objective.loss.root(white), z)
    root = _Root.of(rows)
    freedom = objective.whiten.count(objective.y.shape) - root.determined
    level = _level(objective, white, level_known, freedom)
    is_scaled = jnp.asarray(level_known | (freedom > 0))
    spread = _Spread(level * root.factor, root.missing, root.columns, is_scaled)
    return _Local(0.5 * jnp.vdot(terms, terms), white, residual, freedom, level, spread)


def _level(objective: Objective, white: Float[Array, " n"], level_known: bool, freedom: Any) -> Any:
    """Factor on the standard errors under unit noise: see `_summary`."""
    left = jnp.maximum(freedom, 1)
    if not objective.is_robust:
        return jnp.ones(()) if level_known else jnp.linalg.norm(white) / jnp.sqrt(left)
    observed = jnp.ravel(objective.whiten.observed(objective.y.shape))
    influence, slope = objective.loss.influence(white)
    count = jnp.sum(observed)
    mean = jnp.maximum(jnp.sum(observed * slope) / count, 1e-12)
    variance = jnp.sum(observed * (slope - mean) ** 2) / count
    correction = 1 + len(objective.layout.free) / count * variance / mean**2
    return correction * jnp.sqrt(jnp.sum(observed * influence**2) / left) / mean


def _rows(objective: Objective, z: Float[Array, " m"]) -> tuple[Array, Array]:
    """The terms and their derivative (terms, m): forward, as not every model has another."""
    terms, push = jax.linearize(objective.terms, z)
    return terms, jax.vmap(push, out_axes=1)(jnp.eye(z.size, dtype=z.dtype))


@compiled
def _gradient(objective: Objective, z: Float[Array, " m"]) -> Float[Array, " m"]:
    terms, rows = _rows(objective, z)
    return rows.T @ terms


def _distance(
    objective: Objective, z: Float[Array, " m"], held: Bool[Array, " m"], level_known: bool
) -> Float[Array, ""]:
    """The distance to the minimum of the linearised problem: see `offset`."""
    terms, rows = _rows(objective, z)
    rows = jnp.where(held, 0.0, rows)
    spread = _Root.of(rows)
    along = spread.factor.T @ (rows.T @ terms)
    across = jnp.maximum(jnp.vdot(terms, terms) - jnp.vdot(along, along), 0.0)
    freedom = terms.size - spread.determined
    rms = jnp.sqrt(across / jnp.maximum(freedom, 1)) * (freedom > 0)
    distance = jnp.linalg.norm(along) / jnp.sqrt(jnp.maximum(spread.determined, 1))
    rms = jnp.maximum(rms, 1.0) if level_known else rms
    return jnp.where(distance > 0, distance / rms, 0.0)


@compiled
def _times_inverse(
    objective: Objective,
    z: Float[Array, " m"],
    held: Bool[Array, " m"],
    moved: Float[Array, " m"],
) -> Float[Array, " m"]:
    """The inverse of the cost's second derivative times a change of its slope, over what no bound
    holds; nothing in directions that the data leave open."""
    terms, rows = _rows(objective, z)
    factor = _Root.of(jnp.where(held, 0.0, rows)).factor

    def bent(z):
        return _rows(objective, z)[1].T @ terms

    eye = jnp.eye(z.size, dtype=z.dtype)
    second = jax.lax.map(lambda along: jax.jvp(bent, (z,), (along,))[1], eye)
    second = jnp.where(held[:, None] | held[None], 0.0, second)
    middle = eye + factor.T @ second @ factor
    return factor @ jnp.linalg.solve(middle, factor.T @ jnp.where(held, 0.0, moved))
