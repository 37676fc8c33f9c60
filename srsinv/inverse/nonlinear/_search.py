"""Search for the best minimum from starting points: pure, compiled once for each model."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...compiled import compiled
from ...errors import BadInput, refuse
from ._lengths import lengths
from ._loss import Loss, Squares
from ._noise import Whitener, padded
from ._parameters import Layout
from ._solvers import Minimum, Solver, reached

Host = Array | np.ndarray
NEAREST = 2  # neighbours of a start for each parameter that is searched


class Objective(eqx.Module):
    """The objective, as a function of the free parameters z (m,).

    Half the sum over the data of t(r)^2, with r the whitened residual y - model and t the loss's
    root, and half the sum over the priors of ((z - mean)/stderr)^2. `is_held`: whether the model's
    facts, which are among the free parameters, are not to move; None: it has none.
    """

    model: Callable[[Any], Float[Array, "..."]]
    layout: Layout = eqx.field(static=True)
    row: Float[Host, " all"]
    y: Float[Host, "..."]
    whiten: Whitener
    scale: Float[Host, ""]
    prior_mean: Float[Host, " m"] | None
    prior_weight: Float[Host, " m"] | None
    loss: Loss
    is_held: Bool[Host, ""] | None = None

    @property
    def is_robust(self) -> bool:
        """Whether outliers weigh less than their square."""
        return not isinstance(self.loss, Squares)

    @property
    def searched(self) -> "Objective":
        """The same, linear parameters among those that are searched where the loss has no closed
        form for them: there they start from least squares."""
        layout = dataclasses.replace(self.layout, linear=())
        return dataclasses.replace(self, layout=layout) if self.is_robust else self

    @property
    def filled(self) -> "Objective":
        """The same of all samples that the model computes, of which those beyond the data are left
        out: one program serves data of many lengths."""
        model: Any = getattr(self.model, "filled", self.model)
        shape = self.y.shape
        if model is self.model:
            return self
        more = model.samples - shape[-1]
        whiten = self.whiten.filled_up(shape, more)
        if whiten is None:
            return self
        return dataclasses.replace(self, model=model, y=padded(self.y, more, 0.0), whiten=whiten)

    @property
    def facts(self) -> tuple[int, ...]:
        """Indices in the row of the model's facts: parameters that some fits hold."""
        names = getattr(self.model, "may_hold", ())
        return tuple(i for name in names for i in self.layout.indices(name, "facts"))

    def beside_facts(self) -> "Objective":
        """The same with the model's facts among the free parameters, held at their values where
        they were not: one program serves fits with and without them."""
        layout, row = self.layout, np.asarray(self.row)
        if not self.facts:
            return self
        more = set(self.facts) - set(layout.free)
        if not more:
            return dataclasses.replace(self, is_held=np.array(False))
        free = sorted({*layout.free, *more})
        own, facts = np.isin(free, layout.free), np.isin(free, self.facts)
        mean, weight = np.where(facts, row[free], 0.0), facts.astype(row.dtype)
        if self.prior_mean is not None and self.prior_weight is not None:
            mean[own], weight[own] = self.prior_mean, self.prior_weight
        layout = dataclasses.replace(layout, free=tuple(free))
        return dataclasses.replace(
            self, layout=layout, prior_mean=mean, prior_weight=weight, is_held=np.array(True)
        )

    def tree(self, z: Float[Array, " m"]) -> Any:
        """The parameters as the model takes them."""
        return self.layout.filled(jnp.asarray(self.row), self._holding(z))

    def _holding(self, z: Float[Array, " m"]) -> Float[Array, " m"]:
        """The free parameters, facts that are held at their values."""
        if self.is_held is None:
            return z
        free = np.asarray(self.layout.free)
        is_left = self.is_held & np.isin(free, self.facts)
        return jnp.where(is_left, jnp.asarray(self.row)[free], z)

    def signal(self, z: Float[Array, " m"]) -> Float[Array, "..."]:
        """The model at z. Raises `BadInput`, as it is traced, for one that jax cannot differentiate
        and for what is not like the data."""
        try:
            made = self.model(self.tree(z))
        except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError) as error:
            raise BadInput(
                "The model takes a parameter out of jax, by numpy, float() or an if: compute with "
                "jax.numpy alone, so that it can be differentiated."
            ) from error
        got, shape = getattr(made, "shape", type(made).__name__), self.y.shape
        refuse(
            got != shape,
            f"The model gives {got} where the data have shape {shape}: they must agree.",
        )
        refuse(
            jnp.issubdtype(made.dtype, jnp.complexfloating),
            "The model gives complex numbers: give their real and imaginary parts side by side.",
        )
        return made

    def white(self, z: Float[Array, " m"]) -> tuple[Float[Array, " n"], Float[Array, "..."]]:
        """The whitened residual, and the residual itself."""
        residual = jnp.asarray(self.y) - self.signal(z)
        return self.whiten(residual) / jnp.asarray(self.scale), residual

    def terms(self, z: Float[Array, " m"]) -> Float[Array, " terms"]:
        """The terms of the sum of squares."""
        return self.with_priors(self.loss.root(self.white(z)[0]), z)

    def with_priors(
        self, data: Float[Array, " n"], z: Float[Array, " m"]
    ) -> Float[Array, " terms"]:
        """The terms of the data, with those of the priors."""
        if self.prior_mean is None or self.prior_weight is None:
            return data
        return jnp.concatenate([data, (z - self.prior_mean) * self.prior_weight])

    def only(self, places: Sequence[int], z: Float[Array, " m"]) -> "Objective":
        """The objective of the data as a function of some of the free parameters alone, the others
        fixed at z: only what those enter is differentiated."""
        free = tuple(self.layout.free[place] for place in places)
        row = jnp.asarray(self.row).at[np.asarray(self.layout.free)].set(self._holding(z))
        layout = dataclasses.replace(self.layout, free=free, linear=())
        return dataclasses.replace(self, layout=layout, row=row, prior_mean=None, prior_weight=None)


class Linearised(eqx.Module):
    """Free parameters `z` (m,), the whitened residual `white` (n,) there, its derivative `jacobian`
    (n, m), and the `residual` like the data."""

    z: Float[Array, " m"]
    white: Float[Array, " n"]
    jacobian: Float[Array, "n m"]
    residual: Float[Array, "..."]


class VariableProjection(eqx.Module):
    """Variable projection: the linear parameters are the best ones for the others.

    Golub and Pereyra (1973), with the derivative of Kaufman (1975): the model's own, less its
    projection on the linear parameters' columns. The cost's gradient is exact with it.
    """

    objective: Objective

    @property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices in z of the searched and of the linear parameters."""
        free, linear = self.objective.layout.free, set(self.objective.layout.linear)
        is_linear = np.array([i in linear for i in free], bool)
        return np.flatnonzero(~is_linear), np.flatnonzero(is_linear)

    def nonlinear(self, z: Float[Array, "... m"]) -> Float[Array, "... v"]:
        """The parameters that are searched for."""
        return z[..., self._places[0]]

    def terms(self, v: Float[Array, " v"]) -> Float[Array, " terms"]:
        """The terms at the best linear parameters."""
        if not len(self._places[1]):
            return self.objective.terms(self._from(v))
        return _left(v, split=self)

    def linearised(self, v: Float[Array, " v"]) -> Linearised:
        """The whole problem at the best linear parameters.

        The model and its derivative by v are affine in the linear parameters. Both are followed
        from zero, so that what these do not enter, as a contact, is computed once.
        """
        (searched, linear), z = self._places, self._from(v)
        if not len(linear):
            return Linearised(z, *_with_columns(self.objective.white, z))

        def along(c):
            return _with_columns(lambda v: self._of_linear(v).white(c), v)

        (rest, own, residual), basis, push = self._affine(along)
        c, _ = self._best(v, rest, basis)
        _, more, change = push(c)
        jacobian = jnp.zeros((rest.size, z.size), z.dtype)
        jacobian = jacobian.at[:, searched].set(own + more).at[:, linear].set(basis)
        return Linearised(z.at[linear].set(c), rest + basis @ c, jacobian, residual + change)

    def projected(self, v: Float[Array, " v"]) -> tuple[Array, Array]:
        """`terms`, and their derivative (terms, v) after Kaufman."""
        searched, linear = self._places
        terms, jacobian = self._with_priors(self.linearised(v))
        own, basis = jacobian[:, searched], jacobian[:, linear]
        return terms, own - basis @ _least_squares(basis, own)

    def whole(self, v: Float[Array, " v"]) -> tuple[Array, Array]:
        """All free parameters, the linear ones solved for, and the terms there."""
        start, linear = self._from(v), self._places[1]
        if not len(linear):
            return start, self.objective.terms(start)
        (rest, _), basis, _ = self._affine(self._of_linear(v).white)
        c, terms = self._best(v, rest, basis)
        return start.at[linear].set(c), terms

    def _from(self, v: Float[Array, " v"]) -> Float[Array, " m"]:
        searched, linear = self._places
        return jnp.zeros(len(searched) + len(linear), v.dtype).at[searched].set(v)

    def _of_linear(self, v: Float[Array, " v"]) -> Objective:
        """The objective as a function of the linear parameters."""
        return self.objective.only(self._places[1].tolist(), self._from(v))

    def _affine(self, function: Callable[[Array], Any]) -> tuple[Any, Float[Array, "n c"], Any]:
        """An affine function of the linear parameters: its value at zero, the columns of the first
        part of it, and how it moves with them."""
        units = jnp.eye(len(self._places[1]), dtype=self.objective.row.dtype)
        rest, push = jax.linearize(function, jnp.zeros_like(units[0]))
        return rest, jax.vmap(lambda c: push(c)[0], out_axes=1)(units), push

    def _best(
        self, v: Float[Array, " v"], rest: Float[Array, " n"], basis: Float[Array, "n c"]
    ) -> tuple[Float[Array, " c"], Float[Array, " terms"]]:
        """The best linear parameters, and the terms there."""
        weight, linear = self.objective.prior_weight, self._places[1]
        if weight is not None:
            held = jnp.diag(jnp.asarray(weight))[:, linear]
            rest, basis = self.objective.with_priors(rest, self._from(v)), jnp.vstack([basis, held])
        c = _least_squares(basis, -rest)
        return c, rest + basis @ c

    def _with_priors(self, at: Linearised) -> tuple[Array, Array]:
        weight, mean = self.objective.prior_weight, self.objective.prior_mean
        if weight is None or mean is None:
            return at.white, at.jacobian
        terms = jnp.concatenate([at.white, (at.z - mean) * weight])
        return terms, jnp.concatenate([at.jacobian, jnp.diag(weight)])


def _with_columns(function: Callable[[Array], tuple[Array, Any]], at: Float[Array, " m"]):
    """A function's value, the columns of its derivative, and what else it gives."""
    value, push, more = jax.linearize(function, at, has_aux=True)
    return value, jax.vmap(push, out_axes=1)(jnp.eye(at.size, dtype=at.dtype)), more


@eqx.filter_custom_jvp
def _left(v: Float[Array, " v"], split: VariableProjection) -> Float[Array, " terms"]:
    return split.whole(v)[1]


@_left.def_jvp
def _left_jvp(primals, tangents, split: VariableProjection):
    terms, jacobian = split.projected(*primals)
    return terms, jacobian @ tangents[0]


def _least_squares(basis: Float[Array, "n m"], target: Float[Array, "n *k"]):
    """argmin |basis c - target| (m, *k), its columns scaled and slightly damped: finite where a
    column vanishes (a feature outside the scan)."""
    norm = lengths(basis)
    norm = jnp.where(norm > 0, norm, 1.0)
    size, wanted = basis.shape[1], target.reshape(len(target), -1)
    damping = jnp.finfo(basis.dtype).eps ** 0.8 * jnp.eye(size, dtype=basis.dtype)
    rows = jnp.concatenate([basis / norm, wanted], axis=1)
    below = jnp.concatenate([damping, jnp.zeros((size, wanted.shape[1]), basis.dtype)], axis=1)
    factor = jnp.linalg.qr(jnp.concatenate([rows, below]), mode="r")[:size]
    c = jax.scipy.linalg.solve_triangular(factor[:, :size], factor[:, size:]) / norm[:, None]
    return c.reshape(size, *target.shape[1:])


class SearchEnd(NamedTuple):
    """The best minimum, the problem linearised there, as its uncertainty is computed from it (see
    [`Linearised`][]); the `costs` (s,) at the ends of the searches, and the `start_costs` of every
    start."""

    z: Float[Host, " m"]
    white: Float[Host, " n"]
    jacobian: Float[Host, "n m"]
    residual: Float[Host, "..."]
    costs: Float[Host, " s"]
    start_costs: Float[Host, " starts"]
    iterations: Int[Host, ""]
    done: Bool[Host, ""]

    def of_parameters(self, own: Bool[np.ndarray, " m"]) -> "SearchEnd":
        """The same of these of its parameters."""
        z, jacobian = np.asarray(self.z), np.asarray(self.jacobian)
        return self._replace(z=z[own], jacobian=jacobian[:, own])

    def first(self, shape: tuple[int, ...], samples: int) -> "SearchEnd":
        """The same of the first of so many samples, those of data of this shape."""

        def own(rows: Any) -> np.ndarray:
            return np.asarray(rows).reshape(-1, *shape[:-1], samples)[..., : shape[-1]]

        columns = own(np.asarray(self.jacobian).T)
        return self._replace(
            white=own(self.white).ravel(),
            jacobian=columns.reshape(len(columns), -1).T,
            residual=own(self.residual)[0],
        )


@dataclass(frozen=True)
class Search:
    """A search by a solver from the `max_searches` best of `starts` (s, m), within bounds (m,)."""

    solver: Solver
    starts: Float[Host, "s m"]
    lower: Float[Host, " m"]
    upper: Float[Host, " m"]
    max_searches: int

    def __call__(self, objective: Objective) -> SearchEnd:
        """The best of the minima reached."""
        return self._run(objective, np.full_like(self.lower, np.nan))

    def traced(self, objective: Objective) -> SearchEnd:
        """The same where jax traces the objective or the starts."""
        nowhere = jnp.full_like(jnp.asarray(self.lower), jnp.nan)
        box = self.lower, self.upper
        return _searched(objective, self.solver, self.starts, *box, self.max_searches, nowhere)

    def white_at(self, objective: Objective, z: Float[Host, " m"]) -> Float[Host, " n"]:
        """The whitened residual at a point, by the search's own program: the model is nearly all of
        it, and takes seconds to compile."""
        return self._run(objective, z.astype(self.lower.dtype)).white

    def _run(self, objective: Objective, at: Float[Host, " m"]) -> SearchEnd:
        whole = objective.filled.beside_facts()
        own = np.isin(whole.layout.free, objective.layout.free)
        held = np.asarray(whole.row)[np.asarray(whole.layout.free)]

        def among(values: Any, others: Any) -> np.ndarray:
            """Values of the objective's own parameters, and others of the facts that it holds."""
            made = np.array(np.broadcast_to(others, (*np.shape(values)[:-1], own.size)), held.dtype)
            made[..., own] = values
            return made

        box = among(self.lower, -np.inf), among(self.upper, np.inf)
        there = among(at, np.nan if np.isnan(at).any() else held)
        starts = among(self.starts, held)
        end = _searched(whole, self.solver, starts, *box, self.max_searches, there)
        end = end if own.all() else end.of_parameters(own)
        shape, samples = objective.y.shape, whole.y.shape[-1]
        return end if whole.y.shape == shape else end.first(shape, samples)


@compiled
def _searched(
    objective: Objective, solver: Solver, starts, lower, upper, max_searches: int, at
) -> SearchEnd:
    """The end of a search, or, where `at` (m,) is not NaN, the residual there."""
    split = VariableProjection(objective.searched)
    count = min(max_searches, len(starts)) if split.nonlinear(at).size else 1

    def residual_there() -> SearchEnd:
        white, residual = objective.white(at)
        costs, start_costs = jnp.zeros(count, at.dtype), jnp.zeros(len(starts), at.dtype)
        slopes = jnp.zeros((white.size, at.size), white.dtype)
        no_steps, not_done = jnp.array(0), jnp.array(False)
        return SearchEnd(at, white, slopes, residual, costs, start_costs, no_steps, not_done)

    def end() -> SearchEnd:
        return _end(split, solver, _begun(objective, starts), (lower, upper), max_searches)

    return jax.lax.cond(jnp.isnan(at).any(), end, residual_there)


def _begun(objective: Objective, starts: Float[Array, "s m"]) -> Float[Array, "s m"]:
    """The starts, with the linear parameters of least squares where the loss is another."""
    if not (objective.is_robust and objective.layout.linear):
        return starts
    split = VariableProjection(dataclasses.replace(objective, loss=Squares()))
    return jax.lax.map(lambda z: split.whole(split.nonlinear(z))[0], starts)


def _end(
    split: VariableProjection, solver: Solver, starts, bounds: tuple[Any, Any], max_searches: int
) -> SearchEnd:
    """The best of the minima reached."""

    def cost(v):
        return _known(0.5 * jnp.sum(split.terms(v) ** 2))

    v0 = split.nonlinear(starts)
    box = split.nonlinear(bounds[0]), split.nonlinear(bounds[1])
    start_costs = None
    if len(v0) > max_searches:
        start_costs = jax.lax.map(cost, v0)
        v0 = v0[_promising(v0, start_costs)[:max_searches]]
    ends = _minima(split, solver, v0, box, cost)
    costs = _known(ends.cost)
    best = jax.tree.map(lambda leaf: leaf[jnp.argmin(costs)], ends)
    return SearchEnd(
        **vars(split.linearised(best.point)),
        costs=costs,
        start_costs=_known(ends.start_cost) if start_costs is None else start_costs,
        iterations=jnp.asarray(best.iterations, int),
        done=best.done,
    )


def _minima(split: VariableProjection, solver: Solver, v0, box, cost) -> Minimum:
    """The end of the search from each start; nothing is searched where all is linear."""
    if v0.shape[1] == 0:
        at = cost(v0[0])
        only = Minimum(v0[0], at, at, jnp.array(0), jnp.array(True))
    elif len(v0) == 1:
        only = reached(solver, split.terms, v0[0], box)
    else:
        # In sequence: in parallel each waits for the slowest, and jaxlib's batched LAPACK can
        # deadlock on a CPU (with 0.10.2: all workers inside, none left to work).
        return jax.lax.map(lambda v: reached(solver, split.terms, v, box), v0)
    return jax.tree.map(lambda leaf: leaf[None], only)


def _promising(v: Float[Array, "s v"], costs: Float[Array, " s"]) -> Int[Array, " s"]:
    """Starts in the order in which to search from them: first those with no better one among their
    nearest, so that they do not all fall in one wide valley (the topograph of Torn and Viitanen,
    1992)."""
    span = jnp.max(v, axis=0) - jnp.min(v, axis=0)
    unit = v / jnp.where(span > 0, span, 1.0)
    count = min(NEAREST * v.shape[1], len(v) - 1)

    def is_least(i):
        away = jnp.sum((unit - unit[i]) ** 2, axis=-1).at[i].set(jnp.inf)
        return jnp.all(costs[i] <= costs[jax.lax.top_k(-away, count)[1]])

    least = jax.lax.map(is_least, jnp.arange(len(v))) & jnp.isfinite(costs)
    return jnp.lexsort((costs, ~least))


def _known(cost):
    """The cost, infinite where it is not a number."""
    return jnp.where(jnp.isnan(cost), jnp.inf, cost)
