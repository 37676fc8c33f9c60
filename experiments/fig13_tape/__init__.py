"""Tape on a smooth plate, its leading edge catching the skin: the paper's Fig. 13."""

from typing import Any

import numpy as np
import scipy

from srsinv import config
from srsinv.errors import BadInput, number, refuse
from srsinv.forward.surface import Surface, Tape
from srsinv.inverse.estimate import COMPONENTS, Estimate
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.solved_contact import SolvedContact, smoothed_truth
from srsinv.jobs.estimates import of_simulated
from srsinv.progress import stage
from srsinv.report.answers import answer_variables
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import format_with_error, listed

from .figures import EDGES, symmetry

CASES = {  # with the end of its metrics' names
    "as it is": "",
    "base friction alone": "_base_friction",
    "no friction": "_frictionless",
    "with noise": "_with_noise",
}


def run(cfg: config.Config) -> Result:
    """Signal, recovered p and q, each edge's antisymmetry and the fitted frictions.

    Raises `BadInput` for a scene that is not one tape, a feature that is not a tape, and edges
    whose surroundings reach beyond the tape's middle.
    """
    with config.precision(cfg):
        sim, method = config.simulation(cfg), _only("method", config.methods(cfg))
        feature = _only("feature", config.surface_features(cfg))
        solved = SolvedContact(sim)
        _only("scene.surfaces", dict(enumerate(solved.surface.shapes)))
        tape = solved.surface.only(Tape)
        if tape is None:
            raise BadInput("scene is not one tape: use scene=tape.")
        wanted = "a positive length, up to half the tape's width"
        around = number("fig13_tape.around_edge_m", cfg["fig13_tape"]["around_edge_m"], wanted,
                        above=0, most=float(tape.width_m) / 2)  # fmt: skip
        problem = solved.problem(config.random_key(cfg))
        with stage("inverting"):
            estimate = method(problem)
        with stage("fitting the tape"):
            fitted = solved.fit({"tape": feature}, problem)
        from_edge = np.linspace(-around, around, 257)
        variables = _edges(solved, tape, problem, from_edge)
        variables |= _recovered(solved, tape, problem, estimate, fitted)
    data = dataset(
        variables | of_simulated(answer_variables({"recovery": estimate, "fit": fitted}, "answer")),
        {"case": (list(CASES), "1"), "metric_end": ("case", list(CASES.values()), "1"),
         "edge": (list(EDGES), "1"), "element": (sim.sensor.element_names, "1"),
         "component": (list(COMPONENTS), "1"), "answer": (["recovery", "fit"], "1"),
         "parameter": (list(fitted.parameters), "1"),
         "x": (np.asarray(sim.line.x), "m"), "from_edge": (from_edge, "m")},
        speed_direction=float(sim.scan.direction), around_edge_m=around, line=sim.line.kind,
        refinement=sim.refinement, noise=", ".join(cfg["noise"]), effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    mu = {name: format_with_error(*each) for name, each in fitted.parameters.items()}
    title = "The leading edge has a friction of {leading_edge_friction}, the base {base_friction}"
    return Result(title.format(**mu), data, sections(__file__, symmetry=symmetry))


def _only(name: str, named: dict):
    """The one value of a mapping."""
    refuse(len(named) != 1, f"{name} names {len(named)}: give one, that of a tape.")
    return next(iter(named.values()))


def _edges(
    solved: SolvedContact, tape: Tape, problem: LineProblem, from_edge: np.ndarray
) -> dict[str, tuple[Any, ...]]:
    """Signals with the given frictions, with the base's alone, with none, and with noise; their
    parts even and odd about each edge, and the antisymmetry, rms of even over odd."""
    sim, base = solved.sim, float(solved.surface.base_friction)
    signals = [solved.signal(s) for s in (None, Surface((), base), Surface((), 0.0))]
    signals = np.stack([*signals, problem.data])
    half = float(sim.scan.direction) * float(tape.width_m) / 2
    places = float(tape.position_m) + half * np.array([-1.0, 1.0])
    along = scipy.interpolate.CubicSpline(np.asarray(sim.line.x), signals, axis=-1)
    near = along(places[:, None] + from_edge).swapaxes(1, 2)
    even, odd = (near + near[..., ::-1]) / 2, (near - near[..., ::-1]) / 2
    ratio = np.sqrt(np.sum(even**2, axis=(2, 3)) / np.sum(odd**2, axis=(2, 3)))
    parts, unit = ("case", "edge", "element", "from_edge"), sim.sensor.amplifier.unit
    return {
        "signal": (("case", "element", "x"), signals, unit),
        "even": (parts, even, unit),
        "odd": (parts, odd, unit),
        "antisymmetry": (parts[:2], ratio, "1", "antisymmetry_{edge}{metric_end}"),
        "edge_position": ("edge", places, "m"),
    }


def _recovered(
    solved: SolvedContact, tape: Tape, problem: LineProblem, estimate: Estimate, fitted: Estimate
) -> dict[str, tuple[Any, ...]]:
    """The traction recovered, and numbers of the contact, the recovery and the fit, whose
    parameters stand beside their true values."""
    truth, base, along = solved.traction(), float(solved.surface.base_friction), ("component", "x")
    resolved = smoothed_truth(truth, estimate, problem.forward.is_circular)
    numbers: dict[str, Any] = {
        "pressure_min_Pa": float(solved.contact.pressure_Pa.min()),
        "pressure_max_Pa": float(solved.contact.pressure_Pa.max()),
        "contact": solved.contact.status,
        "recovery": estimate.status,
        "fit": fitted.status,
        "chi2_per_freedom": fitted.chi2_per_freedom,
    }
    for name, (value, stderr) in fitted.parameters.items():
        true = getattr(tape, name, None)  # None: that of the base, or the base's own
        true = base if true is None else float(true)
        numbers |= {name: value, f"{name}_stderr": stderr, f"{name}_true": true}
    return {
        "traction": (along, truth, "Pa"),
        "traction_resolved": (along, resolved, "Pa"),
        "estimate": (along, np.asarray(estimate.value), "Pa"),
        "estimate_stderr": (along, np.asarray(estimate.stderr), "Pa"),
        **scalars(numbers),
    }
