"""Scores of a linear problem's weight by products with its operator alone.

In standard form (`standard.py`) the operator is H, and the posterior of weight w has the mean
(H^T H + w)^-1 H^T data. The bidiagonalisation from the data gives the mean, the residual and the
seminorm: its approximate singular vectors serve as modes do.

The degrees of freedom and the log determinant are traces of functions of H H^T. Where all singular
values are found, the traces are sums. Else those that have converged are summed, and random signs
estimate the trace over the rest (Hutchinson 1990), each by Gauss quadrature (Golub and von Matt
1997; Ubaru, Chen and Saad 2017). How the chosen weight scatters with these probes is its error.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from ...known import Numbers
from ...status import Status
from ..line.prior import Score
from ..line.rule import Rule, choose
from ..line.scorer import WeightScores
from .bidiagonal import (
    Bidiagonalisation,
    OperatorProducts,
    SingularSpace,
    Triplets,
    each_unknown,
    last_before,
    products,
)
from .modes import SCANNED, Decomposition, Modes, ModeScorer, ModeScores, box, modes_of_left
from .standard import StandardForm

FIRST_STEPS = 128  # of the bidiagonalisation, before a rule chooses a first time
SMALL = 1024  # samples or unknowns, up to which all singular vectors are found
MOST_STEPS = 1024  # beyond, orthogonal bases take longer than most operators
MOST_NUMBERS = 2**28  # in the bases, 2 GB
RESIDUAL = 1e-5  # of the normal equations, relative: scores are off by about its square
MARGIN = 0.5  # decades that a weight lies above the lowest one, or more steps are made
LOOK_PROBES = 4  # random vectors, by which a first choice shows whether more steps are needed
FIRST_PROBES, MOST_PROBES = 16, 64  # of a choice
GROUPS = 8  # of probes, of which the jackknife leaves out one
WEIGHT_ERROR = 0.02  # of the weight by its probes: below it more steps and probes are not made
QUADRATURE = 1e-2  # of the degrees of freedom: the bracket at the lowest weight, above the error
CHECKED = 16  # steps of the quadrature between two looks at its error
ROUNDING = 16.0  # times eps and the largest singular value: that of small ones, with some room
PER_DECADE = 10  # weights at which convergence is looked at


class Traces(eqx.Module):
    """Traces over the samples, by singular `values` (j,) that are known, `free` unknowns that the
    data alone determine, and probes: of each the squared singular values `nodes` (p, q), their
    `masses` (p, q), and its `share` (p,) of the estimate."""

    values: Float[Numbers, " j"]
    nodes: Float[Numbers, "p q"]
    masses: Float[Numbers, "p q"]
    share: Float[Numbers, " p"]
    free: int = eqx.field(static=True)

    def freedom(self, weight: Any) -> Any:
        """tr H H^T (H H^T + w)^-1, and one for each free unknown."""
        squares = self.values**2
        own = (self.masses * (self.nodes / (self.nodes + weight))).sum(axis=1)
        return (squares / (squares + weight)).sum() + self.share @ own + self.free

    def log_determinant(self, weight: Any) -> Any:
        """log det (1 + H H^T / w)."""
        own = (self.masses * jnp.log1p(self.nodes / weight)).sum(axis=1)
        return jnp.log1p(self.values**2 / weight).sum() + self.share @ own


class KrylovScores(WeightScores):
    """Scores by approximate singular vectors of the space that the data span, and by traces."""

    scanned: ClassVar[int | None] = SCANNED
    together: ClassVar[int] = 3
    is_double: ClassVar[bool] = True
    ritz: ModeScores
    traces: Traces

    def of(self, factor: Float[Array, " c"]) -> Score:
        score, weight = self.ritz.of(factor), factor[0] ** 2
        power, total = self.ritz.modes.power(weight)
        # The evidence of the space has its own determinant, in place of which comes that of all.
        missed = self.traces.log_determinant(weight) + jnp.sum(jnp.log(power / total))
        return score._replace(
            freedom=self.traces.freedom(weight), log_evidence=score.log_evidence - missed / 2
        )


class KrylovChoice(NamedTuple):
    """The weight that a rule has chosen.

    - `mean` (r,): of the posterior in standard form, to about `RESIDUAL`.
    - `triplets`: all of H; None where some are not known.
    - `condition`: the condition number of H stacked on the root of the weight.
    - `probes`: how many estimate the traces, 0 where they are exact. `weight_error`: the standard
      deviation of the weight's logarithm by their scatter.
    """

    weight: float
    status: Status
    mean: Float[np.ndarray, " r"]
    triplets: Triplets | None
    condition: float
    probes: int
    weight_error: float


def choose_weight(form: StandardForm, rule: Rule) -> KrylovChoice:
    """The rule's weight of a problem that is known.

    Raises `BadInput` where the operator is zero.
    """
    of, least = products(form), min(form.data.size, form.size)
    most = min(least, MOST_STEPS, max(MOST_NUMBERS // (form.data.size + form.size), FIRST_STEPS))
    space = SingularSpace(of, np.asarray(form.data, float), form.size)
    steps = least if least <= SMALL else FIRST_STEPS
    while True:
        space.extend(steps, most)
        trial = _Trial(form, rule, of, space)
        if space.is_exact:
            return trial.choice()
        trial.draw(LOOK_PROBES, 2 * steps)
        if trial.is_above() or steps >= most:
            trial.draw(FIRST_PROBES, 2 * steps)
            if steps >= most or (trial.is_above() and trial.error() <= WEIGHT_ERROR):
                return trial.choice(MOST_PROBES if steps >= most else 0, 2 * steps)
        steps = min(2 * steps, most)


class _Trial:
    """A rule's choice by the singular vectors that are found so far. `low`: the lowest log10 weight
    to choose; `is_cut`: whether the box goes on below."""

    def __init__(self, form: StandardForm, rule: Rule, of: OperatorProducts, space: SingularSpace):
        self._form, self._rule, self._of = form, rule, of
        self._rng, self._is_exact = np.random.default_rng(1), space.is_exact
        self._rules: list[Quadrature] = []
        self._chosen: dict[tuple[int, int | None], tuple[float, Status]] = {}
        self._triplets = triplets = space.triplets()
        self._known = triplets if space.is_exact else triplets.converged()
        self._modes = _modes(form, triplets)
        found = Decomposition(
            self._modes.left, triplets.values, triplets.right, self._modes.prior, None, np.ones(())
        )
        (end,), (self._high,) = np.asarray(box(found, form.data))
        count = int(PER_DECADE * (self._high - end)) + 2
        self._logs = np.linspace(self._high, end, count)
        eps = np.finfo(float).eps * max(form.data.size, form.size)
        rounding = 2 * np.log10(ROUNDING * eps * np.max(triplets.values))
        lowest = end if space.is_exact else space.first.lowest(self._logs, RESIDUAL)
        self.low = min(max(lowest, rounding), self._high)

    @property
    def is_cut(self) -> bool:
        return bool(self.low > self._logs[-1])

    def draw(self, count: int, steps: int) -> None:
        """Further probes, so many in all, each in so many steps at most."""
        margin = MARGIN if self.is_cut else 0.0
        lowest, squares = 10.0 ** (self.low + margin), self._known.values**2
        freedom = self._form.free_count + float(np.sum(squares / (squares + lowest)))
        left = self._known.left
        while len(self._rules) < count:
            signs = self._rng.choice([-1.0, 1.0], self._form.data.size)
            signs = signs - (left @ signs) @ left
            made = quadrature(self._of, signs - (left @ signs) @ left, lowest, freedom, steps)
            self._rules.append(made)
            self.low = max(self.low, made.lowest(self._logs, freedom) - margin)

    def choose(self, left_out: int | None = None) -> tuple[float, Status]:
        """The log10 weight by all probes, or by all but those of one group."""
        of = len(self._rules), left_out
        if of not in self._chosen:
            self._chosen[of] = self._choose(left_out)
        return self._chosen[of]

    def _choose(self, left_out: int | None) -> tuple[float, Status]:
        scores = KrylovScores(1, ModeScores(1, self._modes), self._traces(left_out))
        scorer = ModeScorer(scores, self._form.data.size)
        made = choose(self._rule, scorer, np.array([[self.low], [self._high]]))
        return float(made.log_weights[0]), made.status

    def _traces(self, left_out: int | None) -> Traces:
        count, longest = len(self._rules), max((each.nodes.size for each in self._rules), default=0)
        rows = max(count, FIRST_PROBES) if count else 0  # of one shape, as each makes a program
        nodes, masses, share = np.zeros((rows, longest)), np.zeros((rows, longest)), np.zeros(rows)
        for i, each in enumerate(self._rules):
            nodes[i, : each.nodes.size] = each.nodes.ravel()
            masses[i, : each.nodes.size] = each.masses.ravel() / 2
            share[i] = float(i % GROUPS != left_out)
        share = share / max(np.sum(share), 1.0)
        return Traces(self._known.values, nodes, masses, share, self._form.free_count)

    def is_above(self) -> bool:
        """Whether the choice is clearly above the lowest weight."""
        return not self.is_cut or self.choose()[0] >= self.low + MARGIN

    def error(self) -> float:
        """The jackknife's standard deviation of the weight's logarithm; 0 where the criterion has
        no traces."""
        if not self._rules or self.choose(0) == self.choose(1) == self.choose():
            return 0.0
        logs = np.log(10) * np.array([self.choose(i)[0] for i in range(GROUPS)])
        return float(np.sqrt((GROUPS - 1) * np.var(logs)))

    def choice(self, most: int = 0, steps: int = 0) -> KrylovChoice:
        """The choice, after twice as many probes at a time until its error is small, or `most`."""
        while self.error() > WEIGHT_ERROR and len(self._rules) < most:
            self.draw(2 * len(self._rules), steps)
        (log_weight, status), values = self.choose(), self._triplets.values
        weight = 10.0**log_weight
        along = self._modes.data * values / (values**2 + weight)
        return KrylovChoice(
            weight=weight,
            status=status,
            mean=along @ self._triplets.right,
            triplets=self._triplets if self._is_exact else None,
            condition=float(np.sqrt(1 + np.max(values) ** 2 / weight)),
            probes=len(self._rules),
            weight_error=self.error(),
        )


def _modes(form: StandardForm, triplets: Triplets) -> Modes:
    """Singular vectors as modes of the unknown."""
    return modes_of_left(
        triplets.left.T, np.asarray(form.data, float), each_unknown(form, triplets.right).T,
        triplets.values, np.ones(triplets.values.size), 1.0, 1.0,
    )  # fmt: skip


class Quadrature(NamedTuple):
    """A quadratic form z^T f(H H^T) z as sums of `masses` (2, q) times f at `nodes` (2, q), where
    f(0) = 0: by Radau's rule with a node at 0, and by Gauss's. The two bracket the form for the
    functions of this module (Golub and Meurant 2010, chapter 6); their mean is taken."""

    nodes: Float[np.ndarray, "2 q"]
    masses: Float[np.ndarray, "2 q"]

    def lowest(self, logs: Float[np.ndarray, " w"], known: float) -> float:
        """The lowest of falling log10 weights down to which the bracket of the degrees of freedom
        is narrow, beside those that are `known`."""
        weights = 10.0 ** logs[:, None, None]
        radau, gauss = np.sum(self.masses * self.nodes / (self.nodes + weights), axis=2).T
        return last_before(logs, np.abs(radau - gauss) <= QUADRATURE * (radau + known))


def quadrature(
    of: OperatorProducts, start: Float[np.ndarray, " s"], weight: float, known: float, most: int
) -> Quadrature:
    """The quadrature for a vector, in as many steps as its degrees of freedom need at this weight
    beside those that are `known`, or `most`."""
    part = Bidiagonalisation(of, start)
    while not part.is_exhausted and len(part.below) < most:
        part.extend(len(part.below) + CHECKED)
        radau, gauss = (_freedom(part.tridiagonal(whole), weight) for whole in (True, False))
        square = part.norm**2
        if square * abs(radau - gauss) <= QUADRATURE * (square * radau + known):
            break
    nodes, masses = np.zeros((2, 2, len(part.below) + 1))
    for i, whole in enumerate((True, False)):
        diagonal, beside = part.tridiagonal(whole)
        if diagonal.size:
            own, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside)
            nodes[i, : own.size] = np.maximum(own, 0.0)
            masses[i, : own.size] = part.norm**2 * vectors[0] ** 2
    return Quadrature(nodes, masses)


def _freedom(tridiagonal: tuple[np.ndarray, np.ndarray], weight: float) -> float:
    """The first entry of T (T + w)^-1."""
    diagonal, beside = tridiagonal
    bands = np.stack([np.concatenate([[0.0], beside]), diagonal + weight])
    unit = np.eye(1, diagonal.size)[0]
    return 1.0 - weight * float(scipy.linalg.solveh_banded(bands, unit)[0])
