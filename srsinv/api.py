"""The functions of `import srsinv`: simulate a scenario, invert a signal, fit features."""

import os
from collections.abc import Mapping
from typing import NamedTuple, overload

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .errors import BadInput, echo, of_kind, refuse, whole
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
from .inverse.linear.estimate import LinearEstimate
from .inverse.linear.problem import LinearProblem
from .inverse.method import Method
from .inverse.problem import Problem
from .inverse.simulated import noisy_problem
from .inverse.tikhonov import Tikhonov
from .inverse.wiener import Wiener
from .recorded import problem_of, ready
from .recording import Recording, load


class SimulatedProblem(NamedTuple):
    """A simulated scenario: the problem that an inversion gets, and the truth behind it.

    - `problem`: the signal with its noise, the sensor and the scan: `srsinv.invert` takes it.
    - `signal` (element, n): the signal without noise, in the amplifier's unit.
    - `traction` (2, n) [Pa]: the true p and q, cell averages on the problem's line.
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
    """Simulate the signal of a scenario on a line, with a draw of its noise.

    - `scenario`: a [`Scenario`][srsinv.Scenario] with its scene: a `TractionScene` (pressures and
      frictions along x) or a `SurfaceScene` (shapes that the skin is pressed on).
    - `line`: the cells that the problem has, one sample each: `Periodic(n, cell_m, start_m)`, which
      repeats with its window, or `Open(n, cell_m, start_m)` with nothing beyond it.
    - `refinement`: the signal is computed on cells so many times finer, a whole number from 1. With
      1 the same discretisation makes and inverts the signal, and errors come out too small.
    - `seed`: of the noise, a whole number from 0; the same seed gives the same noise.
    - `friction`: mu, where the inversion is to know that q = mu p; one element needs it. None: p
      and q are solved for separately.

    Returns `problem`, `signal` and `traction` (see [`SimulatedProblem`][]). Raises `BadInput` for a
    scenario without a scene, for what is no scenario or no line, and for a refinement below 1.
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


@overload
def invert(
    given: LinearProblem, method: Method | None = None, sensor: Sensor | None = None
) -> LinearEstimate: ...
@overload
def invert(
    given: Invertible, method: Method | None = None, sensor: Sensor | None = None
) -> Estimate: ...
def invert(
    given: Invertible | LinearProblem, method: Method | None = None, sensor: Sensor | None = None
) -> Estimate | LinearEstimate:
    """Invert a signal: pressure p and shear q along x [Pa] with their standard errors. Also any
    linear inverse problem.

    - `given`: what is inverted, one of
        - the path of a recording, with its sidecar beside it: `"scan.csv"`,
          `srsinv.examples.path("strip_two_element")` (see [`load`][srsinv.load] for formats);
        - a [`Recording`][srsinv.Recording], as `srsinv.load` gives it;
        - a [`Problem`][srsinv.Problem] of arrays, or the `problem` that `srsinv.simulate` gives;
        - a [`LinearProblem`][srsinv.LinearProblem] of any operator.
    - `method`: `srsinv.Wiener(...)`, `srsinv.Tikhonov(...)`, or one of your own that derives from
      `srsinv.kinds.Method`. None: Wiener's filter, whose levels of p and q are those under which
      the data are most likely. Of a `LinearProblem`: the posterior under its prior, or
      Tikhonov's method where it has none.
    - `sensor`: the [`Sensor`][srsinv.Sensor] that made a recording. None: the one that the sidecar
      describes. A problem has its own.

    Returns an [`Estimate`][srsinv.Estimate], of a `LinearProblem` a
    [`LinearEstimate`][srsinv.LinearEstimate]: `print` gives its report, `plot` its figure. Raises
    `BadInput` for a file that cannot be read, for facts that are missing (depth, speed, ...), for
    numbers of films and signals that differ, and for arguments of another kind.
    """
    if isinstance(given, LinearProblem):
        return _linear(given, method, sensor)
    method = Wiener(scale="evidence") if method is None else method
    wanted = "a method, such as srsinv.Tikhonov()"
    return of_kind("method", method, Method, wanted)(_problem(given, sensor))


def _linear(given: LinearProblem, method: Method | None, sensor: Sensor | None) -> LinearEstimate:
    refuse(sensor is not None, "A LinearProblem has no sensor: leave `sensor` out.")
    if method is None:
        method = Tikhonov() if given.prior is None else Wiener()
    if not isinstance(method, Tikhonov | Wiener):
        raise BadInput(
            f"A LinearProblem is solved by srsinv.Tikhonov() or srsinv.Wiener(), and method is "
            f"{echo(method)}: give one of the two."
        )
    return method(given)


def fit_recording(
    given: Invertible,
    features: Mapping[str, Feature | SurfaceFeature],
    sensor: Sensor | None = None,
) -> FeatureEstimate:
    """Fit features to a recording: position, width, load or height, and friction.

    - `given`: a path, a recording or a problem, as [`invert`][srsinv.invert] takes them.
    - `features`: by names of your own, as `{"strip": srsinv.StripFeature()}`; several are fitted
      together as a sum. All are of traction (`StripFeature` and others of
      `srsinv.forward.feature`), or all of a surface (`RidgeFeature(edge_length_m)`, `TapeFeature`
      and others of `srsinv.forward.surface_feature`), which act through the skin's contact. No
      start is needed: every feature is searched for over the scan.
    - `sensor`: the [`Sensor`][srsinv.Sensor] that made a recording. None: the one that the sidecar
      describes. A problem has its own.

    Returns a [`FeatureEstimate`][srsinv.FeatureEstimate]: `print` gives its report, `parameters`
    values and standard errors in SI units by name. Raises `BadInput` as `invert` does, for features
    of both kinds and for none, and for a surface whose nominal pressure (sidecar,
    `nominal_pressure_Pa`) or edge length is not known.
    """
    fit = FeatureFit(features)
    straight = all(each.is_straight_across for each in features.values())
    return fit(_problem(given, sensor, straight))


def _problem(
    given: Invertible, sensor: Sensor | None, are_straight_across: bool = True
) -> Problem | LineProblem:
    if isinstance(given, Problem | LineProblem):
        refuse(sensor is not None, "The problem has its sensor: leave `sensor` out.")
        return given
    recording = given if isinstance(given, Recording) else load(given)
    return problem_of(ready(recording), sensor, are_straight_across=are_straight_across)
