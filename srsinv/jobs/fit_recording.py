"""Fit features of traction to a recording: where, how wide, how strong, with what friction."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from jaxtyping import Float

from ..errors import refuse, shown
from ..forward.noise import total_spectrum
from ..forward.scan import ConstantSpeed, Motion
from ..forward.sensor import Sensor
from ..grid import Periodic
from ..inverse.feature_fit import (
    CELLS_PER_DEPTH,
    FeatureFit,
    FeatureFitter,
    probabilities,
    traction_band,
)
from ..inverse.nonlinear import Spectrum, whitener
from ..inverse.problem import COMPONENTS
from ..progress import stage
from ..recording import Recording
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from . import build
from .analysis import element_names
from .recorded import (
    STEADY,
    check_cells,
    coloured_noises,
    elements_named,
    load_even,
    motion_of,
    sensor_of,
    white_rms,
)

EXAMPLE = Path(__file__).parents[1] / "examples" / "strip_two_element.csv"
GOOD_CHI2 = 1.2  # beyond, the residual is not the noise alone and the page says so
STRONG = 0.95  # a correlation that the page names


@dataclass(frozen=True)
class Measured:
    """A recording with all that a fit needs of it: `y` and `noise` as [`nonlinear.fit`][] has them.

    `noise_rms` is the white noise per sample.
    """

    recording: Recording
    sensor: Sensor
    motion: Motion
    y: Float[np.ndarray, "e sample"]
    noise: Any
    noise_rms: float


def measured(cfg: build.Config) -> Measured:
    """The recording that the configuration names, or the bundled example."""
    settings = dict(build.part(cfg, "recording"))
    settings["path"] = settings.get("path") or str(EXAMPLE)
    recording = load_even(settings, elements_named(cfg))
    sensor, motion = sensor_of(cfg, recording), motion_of(recording)
    check_cells(
        recording.name, float(np.ptp(motion.position_m)), float(sensor.depth_m) / CELLS_PER_DEPTH
    )
    spacing = float(np.max(np.abs(recording.speed_m_per_s))) / recording.sample_rate_hz
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
        named, solver = build.features(cfg), build.solver(cfg)
        choose = build.part(cfg, "fit").get("choose")
        refuse(not named, "No feature is named: give feature=[strip_load] or a sum of several.")
        refuse(not isinstance(choose, bool), f"fit.choose is {shown(choose)}: give true or false.")
        data = measured(cfg)
        sums = [{name: feature} for name, feature in named.items()] if choose else [named]
        fitter = FeatureFitter(data.sensor, data.motion, solver)
        fits, times = [], []
        for features in [{}, *sums]:
            with stage(f"fitting {' + '.join(features) or 'nothing'}"):
                start = time.perf_counter()
                fits.append(fitter(features, data.y, data.noise))
                times.append(time.perf_counter() - start)
        best = max(fits, key=lambda fit: fit.log_evidence) if choose else fits[-1]
        dataset = _dataset(data, best)
        return Outcome(
            _title(data, best),
            _metrics(data, fits, best, times),
            dataset,
            _sections(cfg, data, fits, best, times, dataset),
            _parameter_table(best),
        )


def _title(data: Measured, best: FeatureFit) -> str:
    return f"{data.recording.name}: {best.name.replace('_', ' ')}"


# --- numbers ---------------------------------------------------------------------------------


def _metrics(data: Measured, fits, best: FeatureFit, times) -> dict[str, Any]:
    share = probabilities(fits)
    metrics: dict[str, Any] = {
        "feature": best.name,
        "samples": int(np.isfinite(data.y).sum()),
        f"noise_rms_{data.recording.signal_unit}": data.noise_rms,
        "time_s_first": float(sum(times)),
        "result": best.result,
    }
    for name, (value, stderr) in best.parameters.items():
        metrics |= {name: value, f"{name}_stderr": stderr}
    for fit, probability in zip(fits, share, strict=True):
        key = fit.name.replace(" + ", "_and_")
        metrics |= {f"log_evidence_{key}": fit.log_evidence}
        metrics |= {f"probability_{key}": float(probability)}
    if best.fit is not None:
        metrics |= {
            "chi2_per_freedom": best.fit.stats["chi2_per_freedom"],
            "iterations": best.fit.stats["iterations"],
            "at_bound": ", ".join(best.fit.at_bound),
            "undetermined": "; ".join(_direction(d) for d in best.fit.undetermined),
        }
    return metrics


def _dataset(data: Measured, best: FeatureFit) -> xarray.Dataset:
    unit, motion = data.recording.signal_unit, data.motion
    model = best.model
    r, band = traction_band(best)
    left = data.y - best.signal()
    along = ("element", "sample")
    variables = {
        "time": (("sample",), np.asarray(motion.time_s), "s"),
        "position": (("sample",), np.asarray(motion.position_m), "m"),
        "speed": (("sample",), np.asarray(motion.speed_m_per_s), "m/s"),
        "signal": (along, data.y, unit),
        "fitted_signal": (along, best.signal(), unit),
        "whitened_residual": (along, _whitened(data, left), "1"),
        "estimate": (("component", "x"), r, "Pa"),
        "estimate_stderr": (("component", "x"), band, "Pa"),
    }
    coordinates = {
        "x": (("x",), np.asarray(model.line.x), {"units": "m"}),
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
        {"title": _title(data, best), "signal_unit": unit},
    )


def _whitened(data: Measured, left: np.ndarray) -> np.ndarray:
    """The residual over the noise, nan where no sample is."""
    whiten, _ = whitener(data.noise, left.shape)
    white = np.asarray(whiten(jnp.nan_to_num(jnp.asarray(left)))).reshape(left.shape)
    return np.where(np.isfinite(left), white, np.nan)


# --- the page --------------------------------------------------------------------------------


def _sections(cfg, data: Measured, fits, best: FeatureFit, times, ds) -> tuple[Section, ...]:
    return (
        Section(
            "Signal and fit",
            (_verdict(best),),
            {"fit": lambda: figures.feature_signals(ds)},
            {"fit": "What was recorded, what the fitted feature makes of it, and what is left, in "
             "standard deviations of the noise."},
        ),
        Section(
            "Traction",
            ("Pressure p and shear q of the fitted feature, as deviations from what is around it, "
             "while sliding towards +x. The band is 90 %: noise alone, if the feature is of this "
             "kind.",),
            {"traction": lambda: figures.feature_traction(ds)},
            {"traction": "p and q along the surface, of the parameters above."},
        ),
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
            tables=(_ranking(fits, times),),
        ),
        Section("What was assumed", (), tables=(Table(("what", "value"), _assumed(cfg, data)),)),
    )  # fmt: skip


def _correlation_figure(best: FeatureFit, ds):
    return {} if best.fit is None else {"correlation": lambda: figures.correlation(ds)}


def _verdict(best: FeatureFit) -> str:
    if best.fit is None:
        return "Nothing was fitted: the data are taken as noise alone."
    chi2 = best.fit.stats["chi2_per_freedom"]
    if best.result != "converged":
        return f"The fit is no answer: {best.result}."
    if chi2 > GOOD_CHI2:
        return (
            f"Chi-square per degree of freedom is {chi2:.3g}: the residual is more than the noise "
            "named below, so that the feature is not quite of this kind or the noise is not all; "
            "the standard errors hold for that noise alone and are too small."
        )
    return f"Chi-square per degree of freedom is {chi2:.3g}: what is left is noise."


def _identifiability(best: FeatureFit):
    if best.fit is None:
        return
    for direction in best.fit.undetermined:
        yield (
            f"The data do not determine the direction ({_direction(direction)}): the parameters "
            "can move along it and the signal does not change. Their standard errors are infinite."
        )
    names, correlation = best.fit.names, best.fit.correlation
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > STRONG:
                yield (
                    f"{names[j]} and {names[i]} are hard to tell apart: their errors are "
                    f"correlated by {correlation[i, j]:.3f}."
                )
    if best.fit.at_bound:
        yield f"On a bound of its range: {', '.join(best.fit.at_bound)}."
    if not best.fit.undetermined:
        yield "The data determine every parameter."


def _direction(direction: dict[str, float]) -> str:
    return ", ".join(f"{name} {move:+.3g}" for name, move in direction.items())


def _parameter_table(best: FeatureFit) -> Table:
    return Table(
        ("parameter", "value", "standard error", "relative"),
        tuple(
            (name, _to_error(value, stderr), stderr, f"{abs(stderr / value):.2%}" if value else "-")
            for name, (value, stderr) in best.parameters.items()
        ),
        f"{best.name.replace('_', ' ')}: {best.result}; SI units as in the names.",
    )


def _to_error(value: float, stderr: float) -> str:
    """The value to the second digit of its standard error."""
    if value == 0 or not 0 < stderr < np.inf:
        return f"{value:.6g}"
    digits = 2 + np.floor(np.log10(abs(value))) - np.floor(np.log10(stderr))
    return f"{value:.{int(np.clip(digits, 2, 12))}g}"


def _ranking(fits, times) -> Table:
    share = probabilities(fits)
    order = np.argsort(-share, kind="stable")
    top = max(fit.log_evidence for fit in fits)
    return Table(
        ("candidate", "probability", "log evidence below the best", "chi2 per freedom",
         "first call [s]", "result"),
        tuple(
            (
                fits[i].name.replace("_", " "), f"{share[i]:.3g}",
                top - fits[i].log_evidence,
                "-" if fits[i].fit is None else fits[i].fit.stats["chi2_per_freedom"],
                times[i], fits[i].result,
            )
            for i in order
        ),
        "The first call includes compilation.",
    )  # fmt: skip


def _assumed(cfg: build.Config, data: Measured) -> tuple[tuple[str, str], ...]:
    recording, unit = data.recording, data.recording.signal_unit
    speed = recording.speed_m_per_s
    steady = recording.is_constant_speed(STEADY)
    given = (cfg["noise"].get("white") or {}).get("rms") is not None
    off = [name for name in build.EFFECTS if name not in cfg["effects"]]
    causes = [name for name in cfg["noise"] if name != "white"]
    return (
        ("recording", f"{recording.name}, {recording.time_s.size} samples at "
         f"{recording.sample_rate_hz:.6g} Hz"),
        ("motion", f"{speed.mean():.4g} m/s, constant" if steady
         else f"measured, {speed.min():.4g} to {speed.max():.4g} m/s"),
        ("traction", "features over a uniform background, on an open line"),
        ("skin", f"half space, Poisson's ratio {float(data.sensor.skin.poisson_ratio):.4g}"),
        ("amplifier", type(data.sensor.amplifier).__name__),
        ("noise", f"white, {data.noise_rms:.3g} {unit} per sample, "
         + ("given" if given else "from the highest wavenumbers of the recording")
         + "".join(f"; {name}" for name in causes)),
        ("effects on", ", ".join(cfg["effects"]) or "none"),
        ("effects off", ", ".join(off) or "none"),
        ("solver", str(cfg["solver"]["_target_"]).rpartition(".")[2]),
    )  # fmt: skip
