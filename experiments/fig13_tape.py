"""Tape on a smooth plate, its leading edge catching the skin: the paper's Fig. 13."""

from typing import Any, NamedTuple

import numpy as np
import xarray
from scipy.interpolate import CubicSpline
from srsinv.jobs.analysis import element_names, in_metrics, notes_on
from srsinv.report.figures import tape as draw
from srsinv.report.outcome import Outcome, Section, Table

from srsinv import config
from srsinv.errors import BadInput, number, refuse
from srsinv.forward.scan import Motion
from srsinv.forward.surface import Surface, Tape
from srsinv.inverse.cells import Window
from srsinv.inverse.estimate import COMPONENTS, Estimate
from srsinv.inverse.features.fit import FeatureFitter
from srsinv.inverse.line_problem import LineProblem
from srsinv.inverse.solved_contact import SolvedContact, smoothed_truth
from srsinv.progress import stage
from srsinv.report.text import listed

EDGES = ("leading", "trailing")
CASES = ("as it is", "base friction alone", "no friction")


class Edges(NamedTuple):
    """Signals about the tape's edges.

    `signals` (case, element, x); at `from_edge` [m] their `even` and `odd` parts about the edges'
    `places` [m] (case, edge, element, from_edge); `ratio` (case, edge), rms of even over odd.
    """

    signals: np.ndarray
    places: np.ndarray
    from_edge: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    ratio: np.ndarray


def run(cfg: config.Config) -> Outcome:
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
        around = number("fig13_tape.around_edge_m", cfg["fig13_tape"]["around_edge_m"],
                        "a positive length, up to half the tape's width",
                        above=0, most=float(tape.width_m) / 2)  # fmt: skip
        problem = solved.problem(config.random_key(cfg))
        with stage("inverting"):
            estimate = method(problem)
        with stage("fitting the tape"):
            fitted = _fit(solved, feature, problem)
        edges = _edges(solved, tape, problem, around)
        dataset = _dataset(solved, problem, estimate, edges)
    assumed = (
        "Half space; Coulomb friction with a zone of its own at each edge; "
        f"{sim.line.kind} line; noise: {', '.join(cfg['noise'])}; effects on: "
        f"{listed(cfg['effects'])}. The data come from cells {sim.refinement} times finer than "
        "those of the estimate. The fit knows the load, the skin and the length over which the "
        "edges rise, nothing else."
    )
    base = float(solved.surface.base_friction)
    true = {name: getattr(tape, name, None) for name in fitted.parameters}
    true = {name: base if value is None else float(value) for name, value in true.items()}
    metrics = _metrics(solved, estimate, fitted, edges, true)
    cases = zip(dataset["case"].values, edges.ratio, strict=True)
    table = Table(
        ("", "leading edge", "trailing edge"),
        (
            *((f"antisymmetry, {case}", *map(float, row)) for case, row in cases),
            *_friction_rows(fitted.parameters, true),
        ),
        "Antisymmetry: rms of the signal's even over its odd part about the edge.",
        notes_on(
            {"method": name, "quality": each.quality, "reasons": each.reasons}
            for name, each in (("The recovery", estimate), ("The fit", fitted))
        ),
    )
    return Outcome(
        "Tape on a plate: a leading edge that catches", metrics, dataset,
        _sections(dataset, metrics, fitted.parameters, true, around, assumed), table,
    )  # fmt: skip


def _edges(solved: SolvedContact, tape: Tape, problem: LineProblem, around: float) -> Edges:
    """Edges with the given frictions, with the base's alone, with none, and with noise."""
    sim, base = solved.sim, float(solved.surface.base_friction)
    signals = [solved.signal(s) for s in (None, Surface((), base), Surface((), 0.0))]
    all_signals = np.stack([*signals, problem.data])
    half = float(sim.scan.direction) * float(tape.width_m) / 2
    places = float(tape.position_m) + half * np.array([-1.0, 1.0])
    from_edge = np.linspace(-around, around, 257)
    along = CubicSpline(np.asarray(sim.line.x), all_signals, axis=-1)
    near = along(places[:, None] + from_edge).swapaxes(1, 2)
    even, odd = (near + near[..., ::-1]) / 2, (near - near[..., ::-1]) / 2
    ratio = np.sqrt(np.sum(even**2, axis=(2, 3)) / np.sum(odd**2, axis=(2, 3)))
    return Edges(all_signals, places, from_edge, even, odd, ratio)


def _metrics(solved, estimate, fitted, edges: Edges, true) -> dict[str, Any]:
    cases = ("", "_base_friction", "_frictionless", "_with_noise")
    metrics: dict[str, Any] = {
        f"antisymmetry_{edge}{case}": float(value)
        for case, values in zip(cases, edges.ratio, strict=True)
        for edge, value in zip(EDGES, values, strict=True)
    }
    metrics |= {
        "pressure_min_Pa": float(solved.contact.pressure_Pa.min()),
        "pressure_max_Pa": float(solved.contact.pressure_Pa.max()),
        "contact": solved.contact.status,
        "recovery": estimate.status,
        "fit": fitted.status,
        "chi2_per_freedom": fitted.chi2_per_freedom,
        **{f"{what}_recovery": said for what, said in in_metrics(estimate).items()},
        **{f"{what}_fit": said for what, said in in_metrics(fitted).items()},
    }
    for name, (value, stderr) in fitted.parameters.items():
        metrics |= {name: value, f"{name}_stderr": stderr, f"{name}_true": true[name]}
    return metrics


def _dataset(solved: SolvedContact, problem: LineProblem, estimate: Estimate, edges: Edges):
    sim, truth = solved.sim, solved.traction()
    along, parts = ("component", "x"), ("case", "edge", "element", "from_edge")
    unit = sim.sensor.amplifier.unit
    variables = {
        "signal": (("case", "element", "x"), edges.signals, unit),
        "even": (parts, edges.even, unit),
        "odd": (parts, edges.odd, unit),
        "antisymmetry": (("case", "edge"), edges.ratio, "1"),
        "traction": (along, truth, "Pa"),
        "traction_resolved": (
            along,
            smoothed_truth(truth, estimate, problem.forward.is_circular),
            "Pa",
        ),
        "estimate": (along, np.asarray(estimate.value), "Pa"),
        "estimate_stderr": (along, np.asarray(estimate.stderr), "Pa"),
        "edge_position": (("edge",), edges.places, "m"),
    }
    coordinates = {
        "case": ((*CASES, "with noise"), "1"),
        "edge": (EDGES, "1"),
        "element": (element_names(sim.sensor), "1"),
        "component": (COMPONENTS, "1"),
        "x": (np.asarray(sim.line.x), "m"),
        "from_edge": (edges.from_edge, "m"),
    }
    return xarray.Dataset(
        {name: (dims, values, {"units": u}) for name, (dims, values, u) in variables.items()},
        {name: (name, list(values), {"units": u}) for name, (values, u) in coordinates.items()},
        {"speed_direction": float(sim.scan.direction)},
    )


def _only(name: str, named: dict):
    """The one value of a mapping."""
    refuse(len(named) != 1, f"{name} names {len(named)}: give one, that of a tape.")
    return next(iter(named.values()))


def _fit(solved, feature, problem):
    """The tape's parameters from the signal along x(t); white noise is known, any other kind is
    estimated from the residual."""
    sim, line, scene = solved.sim, solved.sim.line, solved.scene
    start = float(line.x[0] - sim.fine.cell_m / 2)
    window = Window(start, start + line.n * float(line.cell_m))
    in_time = slice(None, None, 1 if float(sim.scan.direction) > 0 else -1)
    time, x = np.sort(np.asarray(sim.scan.time_s(line))), np.asarray(line.x)[in_time]
    motion = Motion(time, x, np.full(line.n, float(sim.scan.speed_m_per_s)))
    features = {"tape": feature}
    pressure = float(scene.nominal_pressure_Pa)
    fitter = FeatureFitter.on_window(sim.sensor, motion, features, window, pressure)
    level = np.sqrt(np.asarray(problem.noise)[1:])
    noise = float(level[0]) if np.allclose(level, level[0]) else None
    return fitter(features, np.asarray(problem.data)[:, in_time], noise)


def _friction_rows(parameters, true):
    for what, pick in (("fitted friction", lambda name: f"{parameters[name][0]:.4f}"),
                       ("its standard error", lambda name: f"{parameters[name][1]:.4f}"),
                       ("true friction", lambda name: f"{true[name]:.4f}")):  # fmt: skip
        yield (what, *(pick(f"{edge}_edge_friction") for edge in EDGES))


def _sections(ds, metrics, parameters, true, around, assumed: str) -> tuple[Section, ...]:
    lead, trail = (metrics[f"antisymmetry_{edge}"] for edge in EDGES)
    free = [metrics[f"antisymmetry_{edge}_frictionless"] for edge in EDGES]
    rows = tuple((name, value, stderr, true[name], f"{(value - true[name]) / stderr:+.1f}")
                 for name, (value, stderr) in parameters.items())  # fmt: skip
    return (
        Section(
            "Signal",
            ("The tape's edges press hardest, and the leading one drags on the skin besides.",),
            {"tape_signals": lambda: draw.signals(ds)},
            {"tape_signals": "Without friction the signal is odd about the tape's middle, so that "
             "both edges show the same; friction adds what is even, and they differ."},
        ),
        Section(
            "Antisymmetry of an edge",
            (f"Within {1e3 * around:g} mm of an edge the signal is split into an even and an odd "
             "part about it. A line of pressure gives a charge that is even, and a rate that is "
             "odd; a line of shear an odd charge and an even rate. The index is the rms of the "
             "rate's even part, which is the charge's antisymmetric one, over that of its odd "
             "part, over both elements.",
             f"Leading {lead:.3g}, trailing {trail:.3g}; without friction {free[0]:.6g} and "
             f"{free[1]:.6g}, equal by mirror symmetry."),
            {"tape_symmetry": lambda: draw.symmetry(ds)},
            {"tape_symmetry": "Signals without noise. Even and odd parts of each element with "
             "friction (full) and without (dashed). A step of pressure alone is mostly even. "
             "Shear takes the odd part away at the leading edge and adds to it at the trailing "
             "one; the catch makes the leading edge's even part larger."},
        ),
        Section(
            "Recovered p and q",
            ("Deviations from the background, from the noisy signal.",),
            {"tape_traction": lambda: draw.traction(ds)},
            {"tape_traction": "The truth has peaks at the edges a few micrometres wide, which the "
             "film's depth rounds: dotted is the truth as the method's averaging kernels would "
             "show it without noise. The band of 90 % is of noise and of the assumed spectra, "
             "which know of no such peaks."},
        ),
        Section(
            "Fitted frictions",
            ("The tape fitted to the same signal through contact and friction: "
             f"{metrics['quality_fit']}, chi-square per degree of freedom "
             f"{metrics['chi2_per_freedom']:.4g}.",),
            tables=(Table(("parameter", "fitted", "standard error", "true",
                           "off, in standard errors"), rows),),
        ),
        Section(
            "What was assumed",
            (assumed,
             f"The pressure is nowhere below {metrics['pressure_min_Pa']:.3g} Pa: contact "
             f"{metrics['contact']}."),
        ),
    )  # fmt: skip
