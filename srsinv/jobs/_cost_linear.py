"""Error against time of the forward model and the inversions, as rows of one table.

Functions are compiled with their arrays as arguments, and return the traction or the signal alone;
the direct path forms the whole covariance, too.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..forward.simulation import Simulation
from ..grid import LINES
from ..inverse import direct, iterative, spectral
from ..inverse.estimate import COMPONENTS, deviation
from ..inverse.line_problem import LineProblem
from ..inverse.prior import Prior
from ..inverse.simulated import noisy_problem
from ..timing import timed
from ._cost_settings import TIGHT

REFERENCE = 8  # refinement of the forward reference over the finest cells tried
DIRECT_CELLS = 512  # beyond, the dense factors take longer than all the rest
PRECISIONS = ("float64", "float32")
NUMPY, SCIPY = "numpy", "scipy cg"  # the peers to compare times with

Row = dict[str, Any]
Simulated = Callable[[str, int], Simulation]  # by the kind of line and the number of cells
Problems = dict[tuple[str, int], tuple[LineProblem, np.ndarray]]


def forward_rows(
    simulated: Simulated, sizes: Sequence[int], repeats: int, line: str, peers: ModuleType | None
) -> Iterator[Row]:
    """The forward model in each precision and by each peer, at every number of cells."""
    common = min(sizes)  # positions that every grid has
    operator, traction = _model(simulated(line, REFERENCE * max(sizes)))
    reference = np.asarray(operator(traction))[:, :: REFERENCE * max(sizes) // common]

    def row(family: str, cells: int, work: Callable[[], Any], compile_s: float, exact) -> Row:
        one = timed(work, repeats)
        value = np.asarray(one.value, float)
        return {
            "part": "forward",
            "line": line,
            "family": family,
            "size": cells,
            "value": value,
            "error": _relative(value[:, :: cells // common], reference),
            "algebraic_error": 0.0 if exact is None else _relative(value, exact),
            "first_call_s": compile_s + one.first_s,
            "steady_call_s": one.least_s,
            "peer": NUMPY,
            "is_peer": family not in PRECISIONS,
        }

    for cells in sizes:
        exact = None
        for precision in PRECISIONS:
            with jax.enable_x64(precision == "float64"):
                given = _model(simulated(line, cells))
                work, compile_s = _compiled(lambda operator, r: operator(r), *given)
                yield (ours := row(precision, cells, partial(work, *given), compile_s, exact))
            exact = ours["value"] if exact is None else exact
        if peers is not None:
            for family, work in peers.forward(*_model(simulated(line, cells))).items():
                yield row(family, cells, work, 0.0, exact)


def _model(sim: Simulation):
    """The operator, and the traction that it is applied to."""
    return sim.sensor.operator(sim.line, sim.scan), sim.traction(sim.line)


def noisy_problems(
    simulated: Simulated, sizes: Sequence[int], key: jax.Array, friction: float | None
) -> Problems:
    """The noisy problem and its true traction, by line and number of cells."""
    problems = {}
    for cells in sizes:
        for line in LINES:
            sim = simulated(line, cells)
            problem = noisy_problem(sim, key, friction)
            truth = np.asarray(sim.traction(sim.line))[: problem.unknowns]
            problems[line, cells] = problem, deviation(np.asarray(truth, float))
    return problems


class _Solver(NamedTuple):
    """One solver of a problem, the family to compare its time with, its compilation [s]."""

    family: str
    peer: str
    work: Callable[[], Any]
    compile_s: float = 0.0


def inversion_rows(
    tolerances: Sequence[float],
    repeats: int,
    priors: Mapping[str, Callable[[LineProblem], Prior]],
    line: str,
    problem: LineProblem,
    truth: np.ndarray,
    peers: ModuleType | None,
) -> Iterator[Row]:
    """Every way to minimise each method's squares, on one problem."""
    size = np.linalg.norm(truth, axis=1)
    size = np.where(size > 0, size, np.nan)
    for part, prior_of in priors.items():
        exact, solvers = _solvers(tolerances, problem, prior_of(problem), peers)
        for family, peer, work, compile_s in solvers:
            one = timed(work, repeats)
            value = deviation(np.asarray(one.value, float))
            errors = np.linalg.norm(value - truth, axis=1) / size
            yield {
                "part": part,
                "line": line,
                "family": family,
                "size": problem.line.n,
                "error": _relative(value, truth),
                **{f"error_{c}": float(e) for c, e in zip(COMPONENTS, errors, strict=False)},
                "algebraic_error": _relative(value, exact),
                "first_call_s": compile_s + one.first_s,
                "steady_call_s": one.least_s,
                "peer": peer,
                "is_peer": family == peer,
            }


def _solvers(
    tolerances: Sequence[float], problem: LineProblem, prior: Prior, peers: ModuleType | None
) -> tuple[np.ndarray, list[_Solver]]:
    """The exact minimiser, and the solvers to compare with it, each beside its peer.

    Exact is the spectral solution; on the open line that of conjugate gradients to `TIGHT`.
    """
    given, is_circular = (problem, prior), problem.forward.is_circular
    if is_circular:
        tolerances = [min(tolerances)]  # the preconditioner is the solution
    others: dict[str, Callable[[], Any]] = (
        {} if peers is None else peers.inversions(problem, prior, tolerances)
    )

    def beside(family: str) -> list[_Solver]:
        return [_Solver(family, family, others.pop(family))] if family in others else []

    if is_circular:
        exact, ways = _spectral_ways(given)
        ways += beside(NUMPY)
        direct_peer = NUMPY
    else:
        exact, ways = _iterative(*given, TIGHT), []
        direct_peer = f"{SCIPY}, {min(tolerances):g}"
    if problem.line.n <= DIRECT_CELLS:
        work, compile_s = _compiled(_direct, *given)
        ways.append(_Solver("direct", direct_peer, partial(work, *given), compile_s))
    for tolerance in tolerances:
        peer = f"{SCIPY}, {tolerance:g}"
        work = partial(_iterative, *given, tolerance)
        ways += [_Solver(f"iterative, {tolerance:g}", peer, work), *beside(peer)]
    for family in list(others):
        ways += beside(family)
    return deviation(np.asarray(exact, float)), ways


def _spectral_ways(given: tuple[LineProblem, Prior]) -> tuple[Any, list[_Solver]]:
    """The exact solution of a periodic problem, and its solver in each precision."""
    exactly, compile_s = _compiled(_spectral, *given)
    with jax.enable_x64(False):
        single = _single(given)
        work, single_s = _compiled(_spectral, *single)
    return exactly(*given), [
        _Solver("spectral, float64", NUMPY, partial(exactly, *given), compile_s),
        _Solver("spectral, float32", NUMPY, partial(work, *single), single_s),
    ]


def _compiled(function: Callable, *arguments) -> tuple[Callable, float]:
    """`function` compiled for such arguments, and the time [s] that this took."""
    start = time.perf_counter()
    fresh = jax.jit(lambda *given: function(*given)).lower(*arguments).compile()
    return fresh, time.perf_counter() - start


def _relative(value, reference) -> float:
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))


def _single(tree):
    """Convert arrays to the working precision, float32."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)


def _spectral(problem: LineProblem, prior: Prior):
    return spectral.solve(problem, prior).value


def _direct(problem: LineProblem, prior: Prior):
    return direct.solve(problem, prior, direct.whiten(problem)).value


def _iterative(problem: LineProblem, prior: Prior, tolerance: float) -> np.ndarray:
    return iterative.value(problem, prior, tolerance).value
