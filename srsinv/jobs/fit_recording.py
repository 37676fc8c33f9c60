"""Fit of features to a recording: position, width, height or amplitude, and friction.

Features of traction, or features of a surface that act through contact.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray

from ..config import reader
from ..errors import refuse, shown
from ..forward.noise import total_spectrum
from ..forward.scan import ConstantSpeed
from ..grid import Periodic
from ..inverse.diagnostics import direction_in_words
from ..inverse.feature_fit import FeatureFitter
from ..inverse.feature_model import CELLS_PER_DEPTH
from ..inverse.feature_result import FeatureFit, probabilities, traction_band
from ..inverse.nonlinear import Spectrum, whitener
from ..inverse.problem import COMPONENTS
from ..inverse.quality import Quality
from ..inverse.surface_fit import PROFILES, surface_band
from ..inverse.surface_model import SurfaceModel
from ..progress import stage
from ..recording import Recording
from ..recording.even import STEADY, check_volts, load_even
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from . import build
from .analysis import element_names, in_metrics
from .fit_surface import Candidate, Measured, contact_section, ground, surface_fitter
from .recorded import (
    check_cells,
    coloured_noises,
    elements_named,
    motion_of,
    sensor_of,
    times_rows,
    white_rms,
)

EXAMPLE = Path(__file__).parents[1] / "examples" / "strip_two_element.csv"
STRONG = 0.95  # a correlation that the page names
_WORTH = {
    Quality.GOOD: "good: what is left is noise.",
    Quality.DOUBTFUL: "doubtful, for the reasons below.",
    Quality.FAILED: "failed: these numbers are no answer, for the reasons below.",
}


def measured(cfg: build.Config) -> Measured:
    """The recording that the configuration names, or the bundled example."""
    settings = dict(build.part(cfg, "recording"))
    settings["path"] = settings.get("path") or str(EXAMPLE)
    recording = load_even(settings, elements_named(cfg), reader(cfg))
    check_volts(recording)
    sensor, motion = sensor_of(cfg, recording), motion_of(recording)
    check_cells(
        recording.name, float(np.ptp(motion.position_m)), float(sensor.depth_m) / CELLS_PER_DEPTH
    )
    spacing = float(np.max(np.abs(recording.speed_m_per_s))) / recording.sample_rate_hz
    refuse(
        bool(np.all(np.nanmax(recording.signal, axis=-1) == np.nanmin(recording.signal, axis=-1))),
        f"{recording.name}: every channel has one value throughout (at the recorder's rail, or not "
        "connected), so that there is nothing to fit: record it again within the range.",
    )
    rms = white_rms(cfg, recording, float(sensor.depth_m), spacing)
    offset = sensor.amplifier.offset
    y = recording.signal - (0.0 if offset is None else float(offset))
    noise = _noise(cfg, recording, y, rms)
    return Measured(recording, sensor, motion, y, noise, rms)


def _noise(cfg: build.Config, recording: Recording, y, rms: float) -> Any:
    """White, or with the coloured causes that are named a spectrum along the scan."""
    causes, missing = coloured_noises(cfg), ~np.isfinite(y)
    if not causes:
        return np.where(missing, np.inf, rms)
    refuse(
        bool(missing.any()) or not recording.is_constant_speed(STEADY),
        f"{recording.name}: coloured noise ({', '.join(cfg['noise'])}) is known along x, for a "
        "recording at constant speed without missing samples: name white noise only.",
    )
    speed = float(np.mean(recording.speed_m_per_s))
    line = Periodic(y.shape[-1], abs(speed) / recording.sample_rate_hz)
    signal_rms = jnp.sqrt(jnp.mean(jnp.asarray(y) ** 2))
    coloured = total_spectrum(causes, line, ConstantSpeed(speed), signal_rms)
    return Spectrum(np.asarray(coloured) + rms**2)


def run(cfg: build.Config) -> Outcome:
    """The job: fit every candidate, rank them, report the most probable one."""
    with build.precision(cfg):
        settings = _settings(cfg)
        surfaces = build.surface_features(cfg)
        named = surfaces or build.features(cfg)
        refuse(not named, "No feature is named: give feature=[strip_load] or a sum of several.")
        data = measured(cfg)
        if surfaces:
            one = surface_fitter(cfg, data, surfaces, settings)
        else:
            _refuse_surface_only(settings)
            one = _traction_fitter(cfg, data)
        sums = [{n: feature} for n, feature in named.items()] if settings["select"] else [named]
        # The first one in the search: its programs serve all.
        candidates = [_timed(one, features) for features in [*sums, {}]]
        candidates = [candidates[-1], *candidates[:-1]]
        if settings["select"]:
            best = max(candidates, key=lambda candidate: candidate.fit.log_evidence)
        else:
            best = candidates[-1]
        data = replace(data, noise=best.noise)
        if best.levels is not None:
            data = replace(data, noise_rms=float(np.sqrt(np.mean(best.levels.white**2))))
        dataset = _dataset(data, best)
        return Outcome(
            _title(data, best.fit),
            _metrics(data, candidates, best),
            dataset,
            _sections(cfg, data, candidates, best, dataset),
            _parameter_table(best.fit),
        )


def _settings(cfg: build.Config) -> Mapping[str, Any]:
    given = build.part(cfg, "fit")
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


def _timed(one: Callable[[Any], Candidate], features: Any) -> Candidate:
    with stage(f"fitting {' + '.join(features) or 'nothing'}"):
        start = time.perf_counter()
        candidate = one(features)
        return replace(candidate, time_s=time.perf_counter() - start)


def _traction_fitter(cfg: build.Config, data: Measured) -> Callable[[Any], Candidate]:
    fitter = FeatureFitter(data.sensor, data.motion, build.solver(cfg))

    def one(features) -> Candidate:
        return Candidate(fitter(features, data.y, data.noise), data.noise, None, 0.0)

    return one


def _title(data: Measured, best: FeatureFit) -> str:
    failed = " (failed)" if best.quality is Quality.FAILED else ""
    return f"{data.recording.name}: {best.name.replace('_', ' ')}{failed}"


# --- numbers ---------------------------------------------------------------------------------


def _metrics(data: Measured, candidates: list[Candidate], chosen: Candidate) -> dict[str, Any]:
    fits, best = [candidate.fit for candidate in candidates], chosen.fit
    posterior = probabilities(fits)
    metrics: dict[str, Any] = {
        "feature": best.name,
        "samples": int(np.isfinite(data.y).sum()),
        f"noise_rms_{data.recording.signal_unit}": data.noise_rms,
        "first_call_s": float(sum(candidate.time_s for candidate in candidates)),
        "status": best.status,
        "chi2_per_freedom": best.chi2_per_freedom,
        **in_metrics(best),
    }
    if chosen.levels is not None:
        metrics |= {
            f"noise_sliding_rms_{data.recording.signal_unit}": chosen.levels.sliding,
            "noise_sliding_correlation_m": chosen.levels.correlation_m,
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


def _dataset(data: Measured, chosen: Candidate) -> xarray.Dataset:
    best, unit, motion = chosen.fit, data.recording.signal_unit, data.motion
    fitted = _fitted(data, best)
    along, over = ("element", "sample"), ("component", "x")
    variables = {
        "time": (("sample",), np.asarray(motion.time_s), "s"),
        "position": (("sample",), np.asarray(motion.position_m), "m"),
        "speed": (("sample",), np.asarray(motion.speed_m_per_s), "m/s"),
        "signal": (along, data.y, unit),
        "fitted_signal": (along, fitted, unit),
        "whitened_residual": (along, _whitened(data, data.y - fitted), "1"),
    }
    if isinstance(best.model, SurfaceModel):
        profiles, bands = surface_band(best)
        for name, value, band in zip(PROFILES, profiles[2:], bands[2:], strict=True):
            units = "1" if name == "friction" else "m"
            variables[name] = (("x",), value, units)
            variables[f"{name}_stderr"] = (("x",), band, units)
        r, band = profiles[:2], bands[:2]
    else:
        r, band = traction_band(best)
    variables |= {"estimate": (over, r, "Pa"), "estimate_stderr": (over, band, "Pa")}
    coordinates = {
        "x": (("x",), np.asarray(best.model.line.x), {"units": "m"}),
        "component": (("component",), list(COMPONENTS), {"units": "1"}),
        "element": (("element",), element_names(data.sensor), {"units": "1"}),
    }
    if best.fit is not None:
        names = list(best.fit.names)
        variables["correlation"] = (("parameter", "parameter_2"), best.fit.correlation, "1")
        for dim in ("parameter", "parameter_2"):
            coordinates[dim] = ((dim,), names, {"units": "1"})
    return xarray.Dataset(
        {k: (dims, np.asarray(v), {"units": units}) for k, (dims, v, units) in variables.items()},
        coordinates,
        {"title": _title(data, best), "signal_unit": unit, "quality": str(best.quality)},
    )


def _fitted(data: Measured, best: FeatureFit) -> np.ndarray:
    """The fitted signal; from the fit's own residual where no sample is missing."""
    if best.fit is not None and bool(np.isfinite(best.fit.residual).all()):
        return data.y - best.fit.residual
    return best.signal()


def _whitened(data: Measured, left: np.ndarray) -> np.ndarray:
    """The residual over the noise, nan where a sample is missing."""
    whiten, _ = whitener(data.noise, left.shape)
    white = np.asarray(whiten(jnp.nan_to_num(jnp.asarray(left)))).reshape(left.shape)
    return np.where(np.isfinite(left), white, np.nan)


# --- the page --------------------------------------------------------------------------------


def _sections(cfg, data: Measured, candidates, chosen: Candidate, ds) -> tuple[Section, ...]:
    best = chosen.fit
    return (
        Section(
            "Signal and fit",
            _verdict(chosen),
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
            tables=(_ranking(candidates),),
        ),
        Section(
            "What was assumed",
            (),
            tables=(Table(("what", "value"), _assumed(cfg, data, chosen)),),
        ),
    )  # fmt: skip


def _correlation_figure(best: FeatureFit, ds):
    return {} if best.fit is None else {"correlation": lambda: figures.correlation(ds)}


def _verdict(chosen: Candidate) -> tuple[str, ...]:
    """Quality of the fit, and the reasons against it."""
    best = chosen.fit
    chi2 = best.chi2_per_freedom
    left = "" if chi2 is None else f" Chi-square per degree of freedom is {chi2:.3g}."
    what = "Nothing was fitted: the data are taken as noise alone. " if best.fit is None else ""
    return (f"{what}{_WORTH[best.quality].capitalize()}{left}", *best.reasons)


def _identifiability(best: FeatureFit):
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


def _parameter_table(best: FeatureFit) -> Table:
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
                "-" if fits[i].chi2_per_freedom is None else fits[i].chi2_per_freedom,
                times[i], str(fits[i].quality),
            )
            for i in order
        ),
        "The first call includes compilation.",
    )  # fmt: skip


def _assumed(cfg: build.Config, data: Measured, chosen: Candidate) -> tuple[tuple[str, str], ...]:
    recording, unit = data.recording, data.recording.signal_unit
    speed = recording.speed_m_per_s
    steady = recording.is_constant_speed(STEADY)
    given = (cfg["noise"].get("white") or {}).get("rms") is not None
    causes = [name for name in cfg["noise"] if name != "white"]
    return (
        ("recording", f"{recording.name}, {recording.time_s.size} samples at "
         f"{recording.sample_rate_hz:.6g} Hz"),
        *times_rows(cfg, recording),
        ("motion", f"{speed.mean():.4g} m/s, constant" if steady
         else f"measured, {speed.min():.4g} to {speed.max():.4g} m/s"),
        *ground(data, chosen.fit),
        ("skin", data.sensor.skin.words),
        ("amplifier", type(data.sensor.amplifier).__name__),
        ("noise", f"white, {data.noise_rms:.3g} {unit} per sample, "
         + _noise_source(chosen, given, unit) + "".join(f"; {name}" for name in causes)),
        *build.effects_rows(cfg),
        ("solver", str(cfg["solver"]["_target_"]).rpartition(".")[2]),
    )  # fmt: skip


def _noise_source(chosen: Candidate, given: bool, unit: str) -> str:
    levels = chosen.levels
    if levels is None:
        return "given" if given else "from the highest wavenumbers of the recording"
    return (
        f"and {levels.sliding:.3g} {unit} correlated over {1e3 * levels.correlation_m:.3g} mm "
        "along the motion, both from what the fit leaves"
    )
