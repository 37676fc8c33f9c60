"""Tikhonov's method: a penalty on the traction or its derivatives, its weight chosen by a rule."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import choice, number, of_kind, refuse, whole
from ..grid import Line, as_real
from ..known import array_module, as_number, namespace
from ..status import Status
from .diagnostics import undetermined_weights
from .estimate import Estimate, Numbers, TractionEstimate
from .line.constrained import constrained
from .line.constraint import Constraint, checked_constraint, refuse_constraint
from .line.prior import Prior, squared_differences
from .line.problem import LineProblem
from .line.rule import Choice, Evidence, Rule, choose, to_score
from .line.scorer import Family, LineScorer
from .line.solve import PATHS, choose_path, conditioned, solve
from .line.spectral import square, white_model
from .linear.estimate import LinearEstimate
from .linear.problem import LinearProblem
from .linear.solve import Regularisation
from .linear.solve import solve as solve_linear
from .method import Method
from .problem import Problem


class DerivativePenalty(Prior):
    """lambda_c |(length_m d/dx)^order r_c|^2 by forward differences, no wrap on the open line."""

    weights: Float[Numbers, " c"]
    length_m: Float[Any, ""]
    order: int = eqx.field(static=True)

    def root(self, line: Line) -> Float[Any, "c k"]:
        xp = namespace(line, self)
        symbol = 2 * self.length_m / line.cell_m * xp.sin(line.k * line.cell_m / 2)
        return xp.sqrt(self.weights)[:, None] * symbol**self.order

    def apply(self, line: Line, r: Float[Any, "c n"]) -> Float[Any, "c n"]:
        order, weights = self.differences(line)
        if namespace(line, self, r) is np:
            return weights[:, None] * squared_differences(r, order, wraps=line.kind == "periodic")

        def penalised(r):
            return line.differences(r, order)

        transpose = jax.linear_transpose(penalised, r)
        (penalty,) = transpose(penalised(r))
        return weights[:, None] * penalty

    def differences(self, line: Line) -> tuple[int, Float[Numbers, " c"]]:
        return self.order, self.weights * (self.length_m / line.cell_m) ** (2 * self.order)


class Penalties(Family):
    """Derivative penalties by their log10 weights."""

    sign: ClassVar[int] = 1
    length_m: Float[Any, ""]
    order: int = eqx.field(static=True)

    def __call__(self, log_weights: Float[Numbers, " c"]) -> DerivativePenalty:
        return DerivativePenalty(10.0**log_weights, self.length_m, self.order)


Weights = Sequence[Float[Array, ""] | None]


def _weight(name: str, value) -> Float[Array, ""] | None:
    if value is None:
        return None
    wanted = "a positive weight in 1/Pa^2, or null to let the rule choose"
    return as_real(number(f"method.tikhonov.{name}", value, wanted, above=0))


class Tikhonov(Method):
    """Tikhonov's method: a penalty on the traction or its derivatives along x.

    It minimises |N^(-1/2) (m - G r)|^2 + sum_c lambda_c |(z d/dx)^order r_c|^2: m the signal, N the
    noise's power, r the traction.

    - `order`: 0 penalises the value, 1 the first, 2 the second derivative; `length_m` [m] is the z
      that makes it dimensionless.
    - `weight_p`, `weight_q` [1/Pa^2]: the weights; None lets `rule` choose, [`Evidence`][] where
      none is given.
    - `path`, `tolerance`: see [`solve`][srsinv.inverse.line.solve.solve].
    - `constraint`: what is known beside the penalty, as `srsinv.Admissible()` or `srsinv.Edges()`,
      with which p and q are the most probable ones. None: nothing.

    Of a [`LinearProblem`][srsinv.LinearProblem] it penalises differences from one unknown to the
    next, without `length_m`; where that has a prior, the weight multiplies the prior's precision,
    and `order` is not used. `weight_p` is the weight there.

    The standard error is that of the posterior under the Gaussian prior that the penalty stands
    for (Wahba 1983). Raises `BadInput` for an order other than 0, 1, 2 or a negative weight.
    """

    rule: Rule
    weight_p: Float[Array, ""] | None
    weight_q: Float[Array, ""] | None
    length_m: Float[Any, ""]
    order: int = eqx.field(static=True)
    path: str = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)
    constraint: Constraint

    def __init__(
        self,
        order: Any = 1,
        weight_p=None,
        weight_q=None,
        rule: Any = None,
        length_m=0.75e-3,
        path: Any = "auto",
        tolerance: Any = 1e-10,
        constraint: Any = None,
    ):
        key = "method.tikhonov."
        self.order = whole(f"{key}order", order, "0, 1 or 2", least=0, most=2)
        self.weight_p, self.weight_q = _weight("weight_p", weight_p), _weight("weight_q", weight_q)
        rule = Evidence() if rule is None else rule
        self.rule = of_kind(
            f"{key}rule",
            rule,
            Rule,
            f"a Rule, or on the command line rule=gcv or rule=evidence in place of {key}rule",
        )
        self.length_m = as_real(
            number(f"{key}length_m", length_m, "a positive length in metres", above=0)
        )
        self.path = choice(f"{key}path", path, PATHS)
        wanted = "a positive number below 1"
        self.tolerance = number(f"{key}tolerance", tolerance, wanted, above=0, below=1)
        self.constraint = checked_constraint(f"{key}constraint", constraint)

    @overload
    def __call__(self, problem: LinearProblem) -> LinearEstimate: ...
    @overload
    def __call__(self, problem: Problem | LineProblem) -> Estimate: ...
    def __call__(self, problem: Problem | LineProblem | LinearProblem) -> Estimate | LinearEstimate:
        """Estimate of p and q or of a linear problem's unknown, with the weights that were given or
        chosen in its stats."""
        if isinstance(problem, LinearProblem):
            return self._linear(problem)
        problem = problem.to_grid()
        given = (self.weight_p, self.weight_q)[: problem.unknowns]
        known = _known(given)
        if known is not None:
            return self._solved(problem, known, "given", Status.GIVEN)
        choice = self._choose(problem, given)
        is_free = np.array([weight is None for weight in given])
        return conditioned(
            lambda decades: self._solved(
                problem,
                10.0 ** (choice.log_weights + decades * is_free),
                self.rule.name,
                choice.status,
                self.rule.band_warnings,
            )
        )

    def _linear(self, problem: LinearProblem) -> LinearEstimate:
        """The estimate of a linear problem, whose prior is weighed, or the differences of its
        unknown."""
        refuse_constraint(self.constraint)
        refuse(
            self.weight_q is not None,
            "A LinearProblem has one unknown: give weight_p alone, without weight_q.",
        )
        stats: dict[str, Any] = {"method": "tikhonov"}
        stats |= {"order": self.order} if problem.prior is None else {}
        weight = None if self.weight_p is None else as_number(self.weight_p)
        how = self.path, self.tolerance, stats
        return solve_linear(problem, Regularisation(weight, self.rule, self.order, *how))

    def _solved(
        self,
        problem: LineProblem,
        weights: Float[Numbers, " c"],
        rule: str,
        status: Status,
        of_rule: Sequence[str] = (),
    ) -> TractionEstimate:
        """The estimate of these weights; `of_rule`: warnings on who chose them."""
        prior = DerivativePenalty(weights, self.length_m, self.order)
        stats = {"method": "tikhonov", "order": self.order, "rule": rule, "rule_status": status}
        stats |= {f"weight_{c}_per_Pa2": as_number(w) for c, w in zip("pq", weights, strict=False)}
        how, warnings = (self.path, self.tolerance), (*of_rule, *undetermined_weights(status))
        estimate = solve(problem, prior, *how, stats=stats, warnings=warnings)
        return constrained(problem, prior, estimate, self.constraint)

    @property
    def chooses_prior(self) -> bool:
        return self.weight_p is None or self.weight_q is None

    def prior_fixed_on(self, problem: LineProblem) -> Callable[[LineProblem], Prior]:
        refuse_constraint(self.constraint)
        problem = problem.to_grid()  # without its sensor, which may hold words
        given = (self.weight_p, self.weight_q)[: problem.unknowns]
        weights = _known(given)
        weights = 10.0 ** self._choose(problem, given).log_weights if weights is None else weights

        def of(each: LineProblem) -> Prior:
            # The penalty is a sum over cells: of wider ones each stands for more.
            wider = float(each.line.cell_m) / float(problem.line.cell_m)
            return DerivativePenalty(wider * weights, self.length_m, self.order)

        return of

    def _choose(self, problem: LineProblem, given: Weights) -> Choice:
        """The rule's choice of the weights that are not given."""
        box, family = self._box(problem, given), Penalties(self.length_m, self.order)
        problem = to_score(problem, family, box, self.path)
        return choose(self.rule, LineScorer(family, problem, self.path), box)

    def _box(self, problem: LineProblem, given: Weights) -> Float[Numbers, "2 c"]:
        """Range of the log10 weight: from far below to above the signal's information per mode."""
        # Normal equations square the condition number, so there round-off sets the lower end.
        below = 12.0
        if choose_path(problem, self.path) != "spectral":
            below = min(below, -4.0 - float(np.log10(jnp.finfo(problem.data.dtype).eps)))
        xp = array_module(problem, given)
        information = xp.sum(square(white_model(problem)), axis=0)
        most = xp.log10(xp.max(information, axis=-1))
        each = zip(most, given, strict=True)
        middle = xp.stack([own if weight is None else xp.log10(weight) for own, weight in each])
        is_free = np.array([weight is None for weight in given])
        box = xp.stack([middle - below * is_free, middle + 4.0 * is_free])
        return as_real(box) if xp is jnp else np.asarray(as_real(box))


def _known(weights: Weights) -> Float[Numbers, " c"] | None:
    """The weights, where all are given."""
    if any(weight is None for weight in weights):
        return None
    return array_module(weights).stack(list(weights))
