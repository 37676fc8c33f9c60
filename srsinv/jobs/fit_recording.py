"""Fit of features to a recording: position, width, height or amplitude, and friction.

Features of traction, or features of a surface that act through contact.
"""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from .. import config
from ..errors import refuse, shown
from ..inverse.cells import check_cells
from ..inverse.diagnostics import direction_in_words
from ..inverse.estimate import COMPONENTS
from ..inverse.features.estimate import FeatureEstimate, probabilities
from ..inverse.features.method import FeatureFit
from ..inverse.nonlinear import Solver
from ..inverse.problem import Problem
from ..inverse.quality import Quality
from ..progress import stage
from ..recording import Recording
from ..recording.even import STEADY, check_volts
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from ..resolution import cell_m
from .analysis import element_names, in_metrics
from .fit_surface import contact_section, ground, surface_fit
from .recorded import RecordedProblem, Rows, effects_rows, times_rows

EXAMPLE = Path(__file__).parents[1] / "examples" / "strip_two_element.csv"
NO_FEATURE = "No feature is named: give feature=[strip_load] or a sum of several."
STRONG = 0.95  # a correlation that the page names
_WORTH = {
    Quality.GOOD: "good: what is left is noise.",
    Quality.DOUBTFUL: "doubtful, for the reasons below.",
    Quality.FAILED: "failed: these numbers are no answer, for the reasons below.",
}


@dataclass(frozen=True)
class Candidate:
    """Fitted features, and the time [s]."""

    fit: FeatureEstimate
    time_s: float


@dataclass(frozen=True)
class _Fitted:
    """A recording's problem, every candidate that was fitted to it, and the one chosen."""

    recorded: RecordedProblem
    candidates: list[Candidate]
    best: FeatureEstimate
    method: FeatureFit

    @property
    def recording(self) -> Recording:
        """What was recorded."""
        return self.recorded.recording

    @property
    def problem(self) -> Problem:
        """What was fitted."""
        return self.recorded.problem

    @property
    def noise_rms(self) -> float:
        """The white noise per sample, as the best fit has it."""
        levels = self.best.levels
        known = self.recorded.noise_rms
        return known if levels is None else float(np.sqrt(np.mean(levels.white**2)))


def check(recording: Recording) -> None:
    """Refuse a recording that no feature can be fitted to."""
    check_volts(recording)
    refuse(
        bool(np.all(np.nanmax(recording.signal, axis=-1) == np.nanmin(recording.signal, axis=-1))),
        f"{recording.name}: every channel has one value throughout (at the recorder's rail, or not "
        "connected), so that there is nothing to fit: record it again within the range.",
    )


def _refuse_friction(mu: float | None, names: Sequence[str]) -> None:
    """Refuse a friction beside that of the features."""
    refuse(
        mu is not None,
        f"friction is {mu}, and here features have their own: leave it out, or give a feature of "
        f"traction what is known, as feature.{names[0]}.friction={mu}.",
    )


def run(cfg: config.Config) -> Outcome:
    """The job: fit every candidate, rank them, report the most probable one."""
    with config.precision(cfg):
        settings = _settings(config.part(cfg, "fit"))
        surfaces = config.surface_features(cfg)
        refuse(
            not (surfaces or config.features(cfg)),
            "No feature is named: give feature=[strip_load] or a sum of several.",
        )
        _refuse_friction(config.friction(cfg), list(config.part(cfg, "feature")))
        solver = config.solver(cfg)
        recording = config.recording(cfg, str(EXAMPLE))
        check(recording)
        recorded = RecordedProblem(recording, config.recorded_problem(cfg, recording))
        if surfaces:
            method = surface_fit(recorded, surfaces, solver, settings)
        else:
            _refuse_surface_only(settings)
            _check_length(recorded.problem)
            method = FeatureFit(config.features(cfg), solver)
        fitted = _fit(method, recorded, settings["select"])
        times = config.part(cfg, "recording").get("times")
        dataset = _dataset(fitted)
        assumed = _assumed(fitted, solver, times, config.part(cfg, "effects"))
        return Outcome(
            _title(fitted),
            _metrics(fitted),
            dataset,
            _sections(fitted, dataset, assumed),
            _parameter_table(fitted.best),
        )


def _check_length(problem: Problem) -> None:
    scanned = float(np.ptp(problem.motion.position_m))
    check_cells(problem.name, scanned, cell_m("load", float(problem.sensor.depth_m)))


def _fit(method: FeatureFit, recorded: RecordedProblem, select: bool) -> _Fitted:
    """All features together and nothing, or each of them and nothing, of which one is selected."""
    named = method.features
    sums = [{name: feature} for name, feature in named.items()] if select else [named]
    # Nothing comes last: the programs of the first search serve all.
    fits = [_timed(method, features, recorded.problem) for features in [*sums, {}]]
    candidates = [fits[-1], *fits[:-1]]
    best = max(candidates, key=lambda each: each.fit.log_evidence) if select else candidates[-1]
    return _Fitted(recorded, candidates, best.fit, method)


def _settings(given: Mapping[str, Any]) -> Mapping[str, Any]:
    known = {"select": False, "free": None, "start": None}
    unknown = sorted(set(given) - set(known))
    refuse(bool(unknown), f"fit has no key {unknown and unknown[0]!r}: {', '.join(known)}.")
    select = given.get("select", False)
    refuse(not isinstance(select, bool), f"fit.select is {shown(select)}: give true or false.")
    return known | dict(given)


def _refuse_surface_only(settings: Mapping[str, Any]) -> None:
    for key in ("free", "start"):
        refuse(
            bool(settings[key]),
            f"fit.{key} is {shown(settings[key])}: it is for features of a surface (ridge, tape, "
            "step_up, step_down); leave it out.",
        )


def _timed(method: FeatureFit, features: Any, problem: Problem) -> Candidate:
    with stage(f"fitting {' + '.join(features) or 'nothing'}"):
        start = time.perf_counter()
        estimate = method.candidate(features, problem)
        return Candidate(estimate, time.perf_counter() - start)


def _title(fitted: _Fitted) -> str:
    best = fitted.best
    failed = " (failed)" if best.quality is Quality.FAILED else ""
    return f"{fitted.recording.name}: {best.name.replace('_', ' ')}{failed}"


# --- numbers ---------------------------------------------------------------------------------


def _metrics(fitted: _Fitted) -> dict[str, Any]:
    fits, best = [candidate.fit for candidate in fitted.candidates], fitted.best
    posterior, unit = probabilities(fits), fitted.recording.signal_unit
    metrics: dict[str, Any] = {
        "feature": best.name,
        "samples": int(fitted.problem.observed.sum()),
        f"noise_rms_{unit}": fitted.noise_rms,
        "first_call_s": float(sum(candidate.time_s for candidate in fitted.candidates)),
        "status": best.status,
        "chi2_per_freedom": best.chi2_per_freedom,
        **in_metrics(best),
    }
    if best.levels is not None:
        metrics |= {
            f"noise_sliding_rms_{unit}": best.levels.sliding,
            "noise_sliding_correlation_m": best.levels.correlation_m,
        }
    for name, (value, stderr) in best.parameters.items():
        metrics |= {name: value, f"{name}_stderr": stderr}
    for fit, probability in zip(fits, posterior, strict=True):
        key = fit.name.replace(" + ", "_and_")
        metrics |= {f"log_evidence_{key}": fit.log_evidence}
        metrics |= {f"probability_{key}": float(probability)}
    if best.fit is not None:
        metrics |= {
            "iterations": best.fit.stats["iterations"],
            "at_bound": ", ".join(best.fit.at_bound),
            "undetermined": "; ".join(direction_in_words(d) for d in best.fit.undetermined),
            "undetected_features": ", ".join(best.undetected),
        }
    return metrics


PROFILE_UNITS = {"p": "Pa", "q": "Pa", "height": "m", "gap": "m", "friction": "1"}


def _dataset(fitted: _Fitted) -> xarray.Dataset:
    best, problem, unit = fitted.best, fitted.problem, fitted.recording.signal_unit
    motion, profiles = problem.motion, best.profiles()
    along, over = ("element", "sample"), ("component", "x")
    variables = {
        "time": (("sample",), motion.time_s, "s"),
        "position": (("sample",), motion.position_m, "m"),
        "speed": (("sample",), motion.speed_m_per_s, "m/s"),
        "signal": (along, best.data, unit),
        "fitted_signal": (along, best.fitted, unit),
        "whitened_residual": (along, best.whitened, "1"),
    }
    for name in [name for name in profiles if name not in COMPONENTS]:
        for key, values in zip((name, f"{name}_stderr"), profiles[name], strict=True):
            variables[key] = (("x",), values, PROFILE_UNITS[name])
    value, stderr = (np.stack(each) for each in zip(*map(profiles.get, COMPONENTS), strict=True))
    variables |= {"estimate": (over, value, "Pa"), "estimate_stderr": (over, stderr, "Pa")}
    coordinates = {
        "x": (("x",), np.asarray(best.model.line.x), {"units": "m"}),
        "component": (("component",), list(COMPONENTS), {"units": "1"}),
        "element": (("element",), element_names(problem.sensor), {"units": "1"}),
    }
    if best.fit is not None:
        names = list(best.fit.names)
        variables["correlation"] = (("parameter", "parameter_2"), best.fit.correlation, "1")
        for dim in ("parameter", "parameter_2"):
            coordinates[dim] = ((dim,), names, {"units": "1"})
    return xarray.Dataset(
        {k: (dims, np.asarray(v), {"units": units}) for k, (dims, v, units) in variables.items()},
        coordinates,
        {"title": _title(fitted), "signal_unit": unit, "quality": str(best.quality)},
    )


# --- the page --------------------------------------------------------------------------------


def _sections(fitted: _Fitted, ds: xarray.Dataset, assumed) -> tuple[Section, ...]:
    best = fitted.best
    return (
        Section(
            "Signal and fit",
            _verdict(best),
            {"fit": lambda: figures.feature_signals(ds)},
            {"fit": "What was recorded, what the fitted feature makes of it, and what is left, in "
             "standard deviations of the noise."},
        ),
        Section(
            "Traction",
            ("Pressure p and shear q of the fitted feature, as deviations from what is around it, "
             "while sliding towards +x. The band is 90 %: noise alone, if the feature is there "
             "and of this kind.",),
            {"traction": lambda: figures.feature_traction(ds)},
            {"traction": "p and q along the surface, of the parameters above."},
        ),
        *contact_section(ds),
        Section(
            "Identifiability",
            tuple(_identifiability(best)),
            _correlation_figure(best, ds),
            {"correlation": "Correlation of the parameters' errors: near 1 or -1 a pair is told "
             "together rather than apart."},
        ),
        Section(
            "Which feature",
            ("The evidence is the probability of the data under a candidate, all of its parameters "
             "integrated out (Laplace's method), so that more parameters have to earn their place. "
             "All candidates are taken as equally probable beforehand.",),
            tables=(_ranking(fitted.candidates),),
        ),
        Section(
            "What was assumed",
            (),
            tables=(Table(("what", "value"), assumed),),
        ),
    )  # fmt: skip


def _correlation_figure(best: FeatureEstimate, ds):
    return {} if best.fit is None else {"correlation": lambda: figures.correlation(ds)}


def _verdict(best: FeatureEstimate) -> tuple[str, ...]:
    """Quality of the fit, and the reasons against it."""
    chi2 = best.chi2_per_freedom
    left = "" if chi2 is None else f" Chi-square per degree of freedom is {chi2:.3g}."
    what = "Nothing was fitted: the data are taken as noise alone. " if best.fit is None else ""
    return (f"{what}{_WORTH[best.quality].capitalize()}{left}", *best.reasons)


def _identifiability(best: FeatureEstimate):
    if best.fit is None:
        return
    names, correlation = best.fit.names, best.fit.correlation
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > STRONG:
                yield (
                    f"{names[j]} and {names[i]} are hard to tell apart: their errors are "
                    f"correlated by {correlation[i, j]:.3f}."
                )
    if best.fit.undetermined or best.fit.at_bound or best.undetected:
        yield "The data do not determine every parameter: see the first part."
    else:
        yield "The data determine every parameter."


def _parameter_table(best: FeatureEstimate) -> Table:
    return Table(
        ("parameter", "value", "standard error", "relative"),
        tuple(
            (name, _to_error(value, stderr), *_errors(value, stderr))
            for name, (value, stderr) in best.parameters.items()
        ),
        f"{best.name.replace('_', ' ')}, {_WORTH[best.quality]} SI units as in the names.",
        best.reasons,
    )


def _errors(value: float, stderr: float) -> tuple[float | str, str]:
    """A standard error, and relative to its value."""
    if not np.isfinite(stderr):
        return "not known", "-"
    return stderr, f"{abs(stderr / value):.2%}" if value else "-"


def _to_error(value: float, stderr: float) -> str:
    """The value to the second digit of its standard error."""
    if value == 0 or not 0 < stderr < np.inf:
        return f"{value:.6g}"
    digits = 2 + np.floor(np.log10(abs(value))) - np.floor(np.log10(stderr))
    return f"{value:.{int(np.clip(digits, 2, 12))}g}"


def _ranking(candidates: list[Candidate]) -> Table:
    fits, times = [c.fit for c in candidates], [c.time_s for c in candidates]
    chi2 = [fit.chi2_per_freedom for fit in fits]
    posterior = probabilities(fits)
    order = np.argsort(-posterior, kind="stable")
    top = max(fit.log_evidence for fit in fits)
    return Table(
        ("candidate", "probability", "log evidence below the best", "chi2 per freedom",
         "first call [s]", "quality"),
        tuple(
            (
                fits[i].name.replace("_", " "), f"{posterior[i]:.3g}",
                top - fits[i].log_evidence,
                "-" if chi2[i] is None else chi2[i],
                times[i], str(fits[i].quality),
            )
            for i in order
        ),
        "The first call includes compilation.",
    )  # fmt: skip


def _assumed(fitted: _Fitted, solver: Solver, times: Any, effects: Iterable[str]) -> Rows:
    recording, problem = fitted.recording, fitted.problem
    speed, unit = recording.speed_m_per_s, recording.signal_unit
    steady, causes = recording.is_constant_speed(STEADY), problem.noise.causes
    return (
        ("recording", f"{recording.name}, {recording.time_s.size} samples at "
         f"{recording.sample_rate_hz:.6g} Hz"),
        *times_rows(recording, times),
        ("motion", f"{speed.mean():.4g} m/s, constant" if steady
         else f"measured, {speed.min():.4g} to {speed.max():.4g} m/s"),
        *ground(problem, fitted.best),
        ("skin", problem.sensor.skin.words),
        ("amplifier", type(problem.sensor.amplifier).__name__),
        ("noise", f"white, {fitted.noise_rms:.3g} {unit} per sample, "
         + _noise_source(fitted, unit) + "".join(f"; {name}" for name in causes)),
        *effects_rows(effects),
        ("solver", type(solver).__name__),
    )  # fmt: skip


def _noise_source(fitted: _Fitted, unit: str) -> str:
    levels = fitted.best.levels
    if levels is None:
        is_given = not fitted.problem.noise.is_estimate
        return "given" if is_given else "from the highest wavenumbers of the recording"
    return (
        f"and {levels.sliding:.3g} {unit} correlated over {1e3 * levels.correlation_m:.3g} mm "
        "along the motion, both from what the fit leaves"
    )
