"""Inversions: method, rule, path and tolerance, whole estimates with their standard errors."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache, partial
from itertools import product, zip_longest
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..grid import LINES
from ..inverse.estimate import COMPONENTS, Estimate, deviation, relative_error
from ..inverse.line import iterative
from ..inverse.line.prior import Prior
from ..inverse.line.problem import LineProblem
from ..inverse.line.rule import Evidence, GeneralisedCrossValidation
from ..inverse.line.solve import DIRECT_LIMIT, solve
from ..inverse.method import Method
from ..inverse.simulated import noisy_problem
from ._cost_forward import Simulated
from ._cost_settings import TIGHT, CostSettings
from ._cost_trials import cost_trial, failure_of, relative
from .trials import Row, Trial, Work

GROUP = "inversion"
NUMPY, SCIPY = "numpy", "scipy cg"  # the peers to compare times with, of values alone
# By their short names, the settings under which a method chooses its prior by a rule.
RULES: dict[str, dict[str, Any]] = {
    "rule": {
        "gcv": {"rule": GeneralisedCrossValidation(), "weight_p": None, "weight_q": None},
        "evidence": {"rule": Evidence(), "weight_p": None, "weight_q": None},
    },
    "scale": {"evidence": {"scale": "evidence"}},
}


class Way(NamedTuple):
    """One way to an estimate.

    - `prepare`: from a problem and the prior with fixed weights, the work. `rule`: the short name
      of what chooses the prior, "" of the fixed one. `peer`: the family to compare the time with.
    """

    family: str
    prepare: Callable[[LineProblem, Prior], Work]
    peer: str
    rule: str = ""
    is_peer: bool = False


def trials(
    simulated: Simulated,
    settings: CostSettings,
    methods: Mapping[str, Method],
    key: jax.Array,
    friction: float | None,
    peers: ModuleType | None,
) -> Iterator[Trial]:
    """Every way of every method, on every line, at every number of cells."""
    problems = Problems(simulated, key, friction, min(settings.inverse_cells))
    unknowns = 2 if friction is None else 1
    for cells in sorted(settings.inverse_cells):
        is_direct = unknowns * cells <= DIRECT_LIMIT
        of_each = []
        for line, (part, method) in product(LINES, methods.items()):
            bench = Inversions(problems, part, method, line, cells)
            ways = ways_of(method, line, is_direct, settings.tolerances, peers)
            of_each.append(map(bench.trial, ways))
        yield from (each for turn in zip_longest(*of_each) for each in turn if each is not None)


def ways_of(
    method: Method, line: str, is_direct: bool, tolerances: Any, peers: ModuleType | None
) -> Iterator[Way]:
    """The ways of a method on a line, from what is used most to what is used least."""
    is_circular = line == "periodic"
    # On a periodic line the preconditioner is the solution.
    tolerances = [min(tolerances)] if is_circular and tolerances else sorted(tolerances)
    others = {} if peers is None else peers.inversions(is_circular, tolerances)
    exact = NUMPY if is_circular else f"{SCIPY}, {min(tolerances, default=TIGHT):g}"
    paths = ["spectral"] * is_circular + ["iterative"] + ["direct"] * is_direct
    iterative_ways = [
        Way(f"iterative, {each:g}", _fixed("iterative", each), f"{SCIPY}, {each:g}")
        for each in tolerances
    ]
    ruled = [_by_rule(method, rule, path) for path in paths for rule in _rules(method)]
    if is_circular:
        yield Way("spectral, float64", _fixed("spectral"), NUMPY)
    else:
        yield from iterative_ways
    yield from (Way(family, other, family, is_peer=True) for family, other in others.items())
    yield from ruled[: len(_rules(method))]
    if is_circular:
        yield Way("spectral, float32", _single, NUMPY)
        yield from iterative_ways
    if is_direct:
        yield Way("direct", _fixed("direct"), exact)
    yield from ruled[len(_rules(method)) :]


def _by_rule(method: Method, rule: str, path: str) -> Way:
    """The whole method with a rule, by a path."""
    ruled = dataclasses.replace(method, path=path, **_rules(method)[rule])
    return Way(f"{path}, {rule}", lambda problem, _: partial(ruled, problem), "", rule)


class Problems:
    """The noisy problem and its true traction, by line and number of cells; a rule's weights come
    from the problem of `smallest` periodic cells."""

    def __init__(self, simulated: Simulated, key: jax.Array, friction: Any, smallest: int):
        self._given, self.smallest = (simulated, key, friction), smallest
        self.of = lru_cache(self._of)
        self._fixed: dict[str, Callable[[LineProblem], Prior]] = {}

    def _of(self, line: str, cells: int) -> tuple[LineProblem, np.ndarray]:
        simulated, key, friction = self._given
        sim = simulated(line, cells)
        problem = noisy_problem(sim, key, friction)
        truth = np.asarray(sim.traction(sim.line), float)[: problem.unknowns]
        return problem.to_grid(), truth

    def fixed_prior(self, part: str, method: Method, problem: LineProblem) -> Prior:
        """The prior of a method, its weights chosen on the smallest problem, once."""
        if part not in self._fixed:
            self._fixed[part] = method.prior_fixed_on(self.of("periodic", self.smallest)[0])
        return self._fixed[part](problem)


class Inversions:
    """The inversions of one problem by one method."""

    def __init__(self, problems: Problems, part: str, method: Method, line: str, cells: int):
        self.problems, self.part, self.method = problems, part.lower(), method
        self.line, self.cells = line, cells
        self.exact = lru_cache(self._exact)

    def trial(self, way: Way) -> Trial:
        """One way as a trial."""
        return cost_trial(
            GROUP, self.part, self.line, way.family, self.cells,
            prepare=lambda: way.prepare(*self._problem()), score=partial(self._score, way),
            peer=way.peer, is_peer=way.is_peer, rests_on={"smallest": self.problems.smallest},
        )  # fmt: skip

    def _problem(self) -> tuple[LineProblem, Prior]:
        problem, _ = self.problems.of(self.line, self.cells)
        return problem, self.problems.fixed_prior(self.part, self.method, problem)

    def _score(self, way: Way, given) -> Row:
        """Against the truth, and against the exact solution with the same rule."""
        problem, truth = self.problems.of(self.line, self.cells)
        value = _value(given, problem.unknowns)
        exact, true = self.exact(way.rule), deviation(truth)
        errors = relative_error(value, truth)
        measures: Row = {"error": relative(value, true)}
        measures |= {f"error_{c}": float(e) for c, e in zip(COMPONENTS, errors, strict=False)}
        if exact is not None:
            measures["algebraic_error"] = relative(value, exact)
        if way.is_peer:
            return measures
        applications = _applications(given, problem.unknowns)
        return measures | {"applications": applications, "failure": failure_of(given.status)}

    def _exact(self, rule: str) -> np.ndarray | None:
        """The solution by an exact path; with fixed weights, where there is none, by conjugate
        gradients to `TIGHT`."""
        problem, prior = self._problem()
        path = "spectral" if problem.separable else "direct"
        if rule:
            if path == "direct" and problem.unknowns * problem.line.n > DIRECT_LIMIT:
                return None
            ruled = dataclasses.replace(self.method, path=path, **_rules(self.method)[rule])
            return _value(ruled(problem), problem.unknowns)
        if path == "direct":
            return deviation(iterative.value(problem, prior, TIGHT).value)
        return _value(solve(problem, prior, path), problem.unknowns)


def _rules(method: Method) -> dict[str, dict[str, Any]]:
    """What has to be set for each rule that a method takes."""
    if not hasattr(method, "path"):
        return {}
    return next((RULES[name] for name in RULES if hasattr(method, name)), {})


def _fixed(path: str, tolerance: float = 1e-10) -> Callable[[LineProblem, Prior], Work]:
    """The estimate by a path under a prior whose weights are fixed."""
    return lambda problem, prior: partial(solve, problem, prior, path, tolerance)


def _single(problem: LineProblem, prior: Prior) -> Work:
    """The same by the spectral path in single precision."""
    with jax.enable_x64(False):
        single = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), (problem, prior))

    def work() -> Estimate:
        with jax.enable_x64(False):
            return solve(single[0], single[1], "spectral")

    return work


def _value(given: Any, unknowns: int) -> np.ndarray:
    """Deviation from the mean of what is solved for: of an estimate, or of a peer's traction."""
    value = given.value if hasattr(given, "status") else given
    return deviation(np.asarray(value, float)[:unknowns])


def _applications(estimate: Estimate, unknowns: int) -> float:
    """Applications of the operator or its transpose for the value: two in each iteration; one to
    every unit traction on the direct path; one where each wavenumber is solved for itself."""
    stats = estimate.stats
    if stats.get("path") == "direct":
        return float(estimate.line.n * unknowns)
    return 2.0 * stats.get("iterations", 0) + 1.0
