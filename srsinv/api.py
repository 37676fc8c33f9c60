"""The way in from Python: simulate a scenario, invert a signal, fit features to a recording."""

import os
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .errors import of_kind, refuse, whole
from .forward.feature import Feature
from .forward.scenario import Scenario
from .forward.sensor import Sensor
from .forward.simulation import Simulation
from .forward.surface_feature import SurfaceFeature
from .grid import Line
from .inverse.estimate import Estimate
from .inverse.features.estimate import FeatureEstimate
from .inverse.features.method import FeatureFit
from .inverse.line.problem import LineProblem
from .inverse.method import Method
from .inverse.problem import Problem
from .inverse.simulated import noisy_problem
from .inverse.wiener import Wiener
from .recorded import problem_of, ready
from .recording import Recording, load


class SimulatedProblem(NamedTuple):
    """A simulated scenario.

    - `problem`: of finding the traction from the signal with its noise.
    - `signal` (element, n): that without noise; `traction` (2, n) [Pa]: the true p and q, cell
      averages on the problem's line.
    """

    problem: LineProblem
    signal: Float[Array, "e n"]
    traction: Float[Array, "2 n"]


def simulate(
    scenario: Scenario,
    line: Line,
    *,
    refinement: int = 4,
    seed: int = 0,
    friction: float | None = None,
) -> SimulatedProblem:
    """The scenario on a line, its noise drawn by `seed`.

    It is computed on cells `refinement` times finer, so that what inverts the signal is not what
    made it. `friction`: mu where the inversion is to know that q = mu p. Raises `BadInput` for a
    scenario without a scene, and for what is no scenario or line.
    """
    of_kind("scenario", scenario, Scenario, "a Scenario")
    of_kind("line", line, Line, "a line, such as Periodic(256, 1.5e-4)")
    refuse(
        scenario.scene is None,
        "The scenario has no scene: give one, as Scenario(scene, sensor, scan).",
    )
    times = whole("refinement", refinement, "a whole number from 1", least=1)
    fine = type(line)(times * line.n, line.cell_m / times, line.start_m)
    sim = Simulation(scenario, line, fine, times)
    problem = noisy_problem(sim, jax.random.key(seed), friction)
    return SimulatedProblem(problem, sim.signal(), jnp.asarray(sim.traction(line)))


Invertible = Problem | LineProblem | Recording | str | os.PathLike[str]


def invert(
    given: Invertible, method: Method | None = None, sensor: Sensor | None = None
) -> Estimate:
    """p and q from a signal.

    - `given`: a problem, a recording, or the path of a file with its sidecar (see `load`).
    - `method`: None is Wiener's filter with the levels of traction that the data make likely.
    - `sensor`: of a recording; None takes the sidecar's.

    Raises `BadInput` for a file that cannot be read, and facts that are missing.
    """
    method = Wiener(scale="evidence") if method is None else method
    wanted = "a method, such as srsinv.Tikhonov()"
    return of_kind("method", method, Method, wanted)(_problem(given, sensor))


def fit_recording(
    given: Invertible,
    features: Mapping[str, Feature | SurfaceFeature],
    sensor: Sensor | None = None,
) -> FeatureEstimate:
    """Features fitted to a recording, all together as a sum.

    - `given`, `sensor`: as [`invert`][] takes them.
    - `features`: by name; all of them of traction, or all of a surface.

    Raises `BadInput` as `invert` does, for features of both kinds and for none, and for a surface
    whose nominal pressure or edges are not known.
    """
    return FeatureFit(features)(_problem(given, sensor))


def _problem(given: Invertible, sensor: Sensor | None) -> Problem | LineProblem:
    if isinstance(given, Problem | LineProblem):
        refuse(sensor is not None, "The problem has its sensor: leave `sensor` out.")
        return given
    recording = given if isinstance(given, Recording) else load(given)
    return problem_of(ready(recording), sensor)
