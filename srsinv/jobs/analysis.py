"""Steps of every job with an inversion: run the methods, gather every stage, lay out the page."""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray

from ..effects import ScreeningResult
from ..errors import of_kind
from ..forward.sensor import Sensor
from ..grid import wavenumbers
from ..inverse.estimate import COMPONENTS, Estimate
from ..inverse.line_problem import LineProblem
from ..inverse.quality import Quality
from ..progress import stage
from ..report import figures
from ..report.outcome import Outcome, Section, Table

_VERBS = {Quality.DOUBTFUL: "is doubtful", Quality.FAILED: "failed, and is no answer"}
_IN_WORDS = ("method", "reasons")
BAND_90 = 1.6448536269514722  # half-width of a normal's central 90 %, in standard errors


@dataclass(frozen=True)
class InversionCase:
    """One inversion to run and to report.

    - `problem` to invert; `sensor`; `methods` by name.
    - `traction_unit`: "Pa", or "1" for p and q that are relative.
    - `stages`: (dims, values, units) of the simulation's stages, by variable name; the truth is
      `traction`. Empty for a recording.
    - `assumed`: rows (quantity, value) of the page's last section; `screening`: the result of
      screening effects, if any; `warnings`: those on the simulated scene.
    """

    title: str
    problem: LineProblem
    sensor: Sensor
    speed_m_per_s: float
    methods: Mapping[str, Callable[[LineProblem], Estimate]]
    signal_unit: str = "V"
    traction_unit: str = "Pa"
    stages: Mapping[str, tuple[tuple[str, ...], Any, str]] = field(default_factory=dict)
    assumed: tuple[tuple[str, str], ...] = ()
    screening: ScreeningResult | None = None
    warnings: tuple[str, ...] = ()
    time_steady: bool = True


def element_names(sensor: Sensor) -> list[str]:
    """A short name for every film element: its number and its angle."""
    names = {0.0: "1 to x, 3 to z", 90.0: "1 to z, 3 to x"}
    angles = [float(jnp.rad2deg(film.angle_rad)) for film in sensor.elements]
    return [f"{i}: {names.get(round(a, 6), f'at {a:.4g} deg')}" for i, a in enumerate(angles)]


def run(case: InversionCase) -> Outcome:
    """Invert by every method and gather the result."""
    estimates, rows = {}, []
    for name, method in case.methods.items():
        with stage(f"inverting: {name}"):
            estimates[name], first, steady = timed(
                lambda method=method: method(case.problem), repeats=3 if case.time_steady else 0
            )
        wanted = "an Estimate, as problem.on_line().estimate(...) gives it"
        answer = of_kind(f"what {name} gives", estimates[name], Estimate, wanted)
        estimates[name] = answer.with_warnings(case.warnings)
        row = _judge(name, case, estimates[name]) | _features(case, estimates[name])
        rows.append(row | {"first_call_s": first, "steady_call_s": steady})
    dataset = _dataset(case, estimates)
    return Outcome(
        case.title,
        _metrics(case, estimates, rows),
        dataset,
        _sections(case, dataset, estimates, rows),
        _summary(case, rows),
    )


def timed(work: Callable[[], Any], repeats: int) -> tuple[Any, float, float | None]:
    """The result, the first call's time [s] and the least of `repeats` further ones."""

    def once():
        start = time.perf_counter()
        result = jax.block_until_ready(work())
        return result, time.perf_counter() - start

    result, first = once()
    return result, first, min((once()[1] for _ in range(repeats)), default=None)


# --- errors ----------------------------------------------------------------------------------


def deviation(values: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Values where there are samples, less their mean."""
    values = np.asarray(values)[..., observed]
    return values - values.mean(axis=-1, keepdims=True)


def _judge(name: str, case: InversionCase, estimate: Estimate) -> dict[str, Any]:
    row: dict[str, Any] = {
        "method": name,
        "status": estimate.status,
        "quality": estimate.quality,
        "reasons": estimate.reasons,
    }
    row |= {f"{what}_{c}": None for what in ("error", "coverage") for c in COMPONENTS}
    if "traction" not in case.stages:
        return row
    observed = case.problem.observed_cells
    truth = deviation(case.stages["traction"][1], observed)
    error = deviation(np.asarray(estimate.value), observed) - truth
    stderr = np.asarray(estimate.stderr)[:, observed]
    inside = np.abs(error) <= BAND_90 * stderr
    for c, component in enumerate(COMPONENTS):
        size = np.linalg.norm(truth[c])
        row[f"error_{component}"] = float(np.linalg.norm(error[c]) / size) if size else None
        has_band = not np.isnan(stderr[c]).all()  # a method of one's own may give none
        row[f"coverage_{component}"] = float(np.mean(inside[c])) if has_band else None
    return row


def _metrics(case: InversionCase, estimates: Mapping[str, Estimate], rows) -> dict[str, Any]:
    metrics: dict[str, Any] = {"samples": case.problem.sample_count, "cells": case.problem.line.n}
    signal = np.asarray(case.problem.data)[case.problem.is_observed]
    noise_rms = case.problem.noise_rms
    metrics[f"noise_rms_{case.signal_unit.replace(' ', '_')}"] = noise_rms
    metrics["snr_dB"] = float(20 * np.log10(max(np.std(signal) / noise_rms, 1e-30)))
    if case.screening:
        metrics["effects_off_bound"] = case.screening.bound
        for name, bound in case.screening.relative_change_bounds.items():
            metrics[f"effect_bound_{name}"] = bound
            metrics[f"effect_on_{name}"] = name in case.screening.on
    for row, (name, estimate) in zip(rows, estimates.items(), strict=True):
        key = name.lower().replace(" ", "_")
        said = row | dict(estimate.stats) | in_metrics(estimate)
        named = {what: _named(case, what) for what in said if what not in _IN_WORDS}
        metrics |= {f"{new}_{key}": said[what] for what, new in named.items()}
    return metrics


def _named(case: InversionCase, key: str) -> str:
    """A number's name, without Pa where p and q have no unit."""
    if case.traction_unit == "Pa":
        return key
    return key.replace("_per_Pa2", "_relative").replace("_Pa", "_relative")


def _features(case: InversionCase, estimate: Estimate) -> dict[str, float | None]:
    """Features over the sampled cells: each component's highest value, p's main line."""
    observed = case.problem.observed_cells
    x, value = np.asarray(case.problem.line.x)[observed], np.asarray(estimate.value)[:, observed]
    row: dict[str, float | None] = {"p_line_wavelength_m": strongest_line_m(x, value[0])}
    for component, values in zip(COMPONENTS, value, strict=True):
        top = int(np.argmax(values))
        row[f"{component}_peak_position_m"] = float(x[top])
        row[f"{component}_peak_Pa"] = float(values[top])
    return row


def strongest_line_m(x: np.ndarray, values: np.ndarray) -> float | None:
    """Wavelength [m] of the strongest line of evenly spaced values, drift taken out.

    By the windowed, finely sampled periodogram of the residual of a straight line, over wavelengths
    from two cells to two fifths of the stretch (a Hann window blurs longer ones into the drift).
    """
    if len(x) < 16:
        return None
    left = values - np.polynomial.Polynomial.fit(x, values, 1)(x)
    n = 32 * len(x)
    power = np.abs(np.fft.rfft(left * np.hanning(len(x)), n)) ** 2
    frequency = np.fft.rfftfreq(n, (x[-1] - x[0]) / (len(x) - 1))
    band = frequency >= 2.5 / (x[-1] - x[0])
    top = int(np.argmax(np.where(band, power, -1.0)))
    return float(1 / frequency[top])


def in_metrics(estimate: Any) -> dict[str, str]:
    """Quality and warnings of an estimate or a fit, as values of `metrics.json`."""
    return {"quality": str(estimate.quality), "warnings": " ".join(estimate.warnings) or "none"}


def notes_on(rows: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Notes on rows (`method`, `quality`, `reasons`) that are not good, by method."""
    return tuple(
        f"{row['method']} {_VERBS[row['quality']]}: {' '.join(row['reasons'])}"
        for row in rows
        if row["reasons"]
    )


# --- every stage, as arrays ------------------------------------------------------------------


def _dataset(case: InversionCase, estimates: Mapping[str, Estimate]) -> xarray.Dataset:
    problem, sensor = case.problem, case.sensor
    n, unit, pressure = problem.line.n, case.signal_unit, case.traction_unit
    observed = problem.is_observed
    circulant = problem.forward.circulant().transfer
    k = wavenumbers(n, problem.line.cell_m)
    unknown = COMPONENTS[: problem.unknowns]

    def stacked(get):
        return np.stack([np.asarray(get(e)) for e in estimates.values()])

    def both(values):
        """Components that were not solved for are missing."""
        full = np.full((*values.shape[:1], 2, *values.shape[2:]), np.nan)
        full[:, : values.shape[1]] = values
        return full

    unresolved = np.full((len(unknown), len(unknown), n), np.nan)  # of a method without kernels
    averaging = stacked(lambda e: unresolved if e.averaging is None else e.averaging)
    diagonal = np.einsum("mccn->mcn", averaging)
    resolution = np.abs(np.fft.rfft(diagonal))
    pairs = np.full((len(estimates), 2, 2, n), np.nan)
    pairs[:, : len(unknown), : len(unknown)] = averaging / float(problem.line.cell_m)
    window = np.fft.rfft(np.asarray(problem.data))
    gain = np.full((len(sensor.elements), 2, k.size), np.nan)
    gain[:, : len(unknown)] = np.abs(circulant)
    films = sensor.elements
    variables = {
        "signal": (("element", "x"), np.where(observed, np.asarray(problem.data), np.nan), unit),
        "observed": (("element", "x"), observed.astype(np.int8), "1"),
        "estimate": (("method", "component", "x"), stacked(lambda e: e.value), pressure),
        "estimate_stderr": (("method", "component", "x"), stacked(_stderr), pressure),
        "quality": (("method",), [str(e.quality) for e in estimates.values()], "1"),
        "fitted_signal": (("method", "element", "x"), stacked(lambda e: e.fitted), unit),
        "whitened_residual": (("method", "element", "x"), stacked(lambda e: e.whitened), "1"),
        "sensor_gain": (("element", "component", "wavenumber"), gain, f"{unit}/{pressure}"),
        "signal_power": (("element", "wavenumber"), np.abs(window) ** 2 / n, f"({unit})^2"),
        "noise_power": (("wavenumber",), np.asarray(problem.noise), f"({unit})^2"),
        "resolution": (("method", "component", "wavenumber"), both(resolution), "1"),
        "cutoff": (("method", "component"), both(_cutoff(np.asarray(k), resolution)), "rad/m"),
        "averaging_kernel": (("method", "component_out", "component_in", "lag"), pairs, "1/m"),
        "element_depth": (("element",), [float(f.depth_m) for f in films], "m"),
        "element_angle": (("element",), [float(f.angle_rad) for f in films], "rad"),
        "element_width": (("element",), [float(f.width_m) for f in films], "m"),
        "element_length": (("element",), [float(f.length_m) for f in films], "m"),
        "element_offset": (("element",), [float(f.offset_m) for f in films], "m"),
    } | dict(case.stages)
    coordinates = {
        "x": (("x",), np.asarray(problem.line.x), {"units": "m"}),
        "wavenumber": (("wavenumber",), np.asarray(k), {"units": "rad/m"}),
        "lag": (
            ("lag",),
            float(problem.line.cell_m) * (np.arange(n) - n // 2),
            {"units": "m"},
        ),
        "component": (("component",), list(COMPONENTS), {"units": "1"}),
        "component_out": (("component_out",), list(COMPONENTS), {"units": "1"}),
        "component_in": (("component_in",), list(COMPONENTS), {"units": "1"}),
        "method": (("method",), list(estimates), {"units": "1"}),
        "element": (("element",), element_names(sensor), {"units": "1"}),
    }
    if "stress" in variables:
        names = ["sigma_x", "sigma_z", "tau_xz", "sigma_y"]
        coordinates["stress_name"] = (("stress_name",), names, {"units": "1"})
    statement = problem.mean_statement()
    unobserved = [c for c in COMPONENTS if statement[c].startswith(("unobserved", "weakly"))]
    return xarray.Dataset(
        {
            name: (dims, np.asarray(values), {"units": units})
            for name, (dims, values, units) in variables.items()
        },
        coordinates,
        {
            "title": case.title,
            "speed_m_per_s": case.speed_m_per_s,
            "signal_unit": unit,
            "line": "periodic" if problem.forward.is_circular else "open",
            "mean_unobserved": ",".join(unobserved),
        },
    )


def _stderr(estimate: Estimate) -> np.ndarray:
    """Standard errors (2, n) [Pa], infinite where no band is valid."""
    if estimate.quality is Quality.FAILED:
        return np.full(estimate.stderr.shape, np.inf)
    return np.asarray(estimate.stderr)


def _cutoff(k: np.ndarray, resolution: np.ndarray) -> np.ndarray:
    """Cut-off wavenumber: where the resolution (..., k) last falls through one half; NaN if
    nowhere."""
    high = resolution[..., :-1] >= 0.5
    falls = high & (resolution[..., 1:] < 0.5)
    last = falls.shape[-1] - 1 - np.argmax(falls[..., ::-1], axis=-1)
    upper = np.take_along_axis(resolution, last[..., None], -1)[..., 0]
    lower = np.take_along_axis(resolution, last[..., None] + 1, -1)[..., 0]
    fraction = (upper - 0.5) / np.where(upper > lower, upper - lower, 1.0)
    return np.where(falls.any(axis=-1), k[last] + fraction * (k[1] - k[0]), np.nan)


# --- the page --------------------------------------------------------------------------------


def _summary(case: InversionCase, rows) -> Table:
    return _against_truth(rows) if "traction" in case.stages else _recovered(case, rows)


def _against_truth(rows) -> Table:
    def cell(value, pattern="{:.3g}"):
        return "-" if value is None else pattern.format(value)

    return Table(
        ("method", "error of p", "error of q", "90 % band covers p", "covers q", "first call [s]",
         "steady [ms]", "quality"),
        tuple(
            (
                row["method"],
                cell(row["error_p"], "{:.1%}"),
                cell(row["error_q"], "{:.1%}"),
                cell(row["coverage_p"], "{:.0%}"),
                cell(row["coverage_q"], "{:.0%}"),
                row["first_call_s"],
                1e3 * row["steady_call_s"],
                str(row["quality"]),
            )
            for row in rows
        ),
        "Relative errors of the deviation from the mean; the first call includes compilation.",
        notes_on(rows),
    )  # fmt: skip


def _recovered(case: InversionCase, rows) -> Table:
    unit = "Pa" if case.traction_unit == "Pa" else "relative"
    return Table(
        ("method", f"highest p [{unit}]", "at x [mm]", "strongest line of p [mm]", "first call [s]",
         "quality"),
        tuple(
            (
                row["method"],
                *(_or_none(row, *what) for what in (("p_peak_Pa", 1.0), ("p_peak_position_m", 1e3),
                                                    ("p_line_wavelength_m", 1e3))),
                row["first_call_s"],
                str(row["quality"]),
            )
            for row in rows
        ),
        "The first call includes compilation.",
        notes_on(rows),
    )  # fmt: skip


def _or_none(row: Mapping[str, Any], name: str, factor: float) -> float | str:
    """An estimated number, where the method gave an answer with one."""
    value = row[name]
    return "-" if value is None or row["quality"] is Quality.FAILED else factor * value


def _sections(case: InversionCase, ds: xarray.Dataset, estimates, rows) -> tuple[Section, ...]:
    simulated = "traction" in ds
    parts = [
        Section(
            "Scene and sensor",
            ("Drawn to scale in the plane of sliding; z points into the finger.",),
            {"scene": lambda: figures.scene(ds)},
        )
    ]
    if simulated:
        parts.append(
            Section("Traction on the skin", (), {"traction": lambda: figures.traction(ds)})
        )
    if "stress" in ds:
        words = "What the film feels, at its depth under the skin; tension is positive."
        parts.append(
            Section("Stress at the film", (words,), {"stress": lambda: figures.stress(ds)})
        )
    if "recorded_signal" in ds:
        words = (
            "What the recorder takes along the real motion. The samples of each cell are then put "
            "together to the signal at the mean speed; those taken while sliding back are left out."
        )
        parts.append(Section("As recorded", (words,), {"record": lambda: figures.record(ds)}))
    parts += [
        Section(
            "Current and voltage" if "current" in ds else "Signal",
            ("The recorded signal with what each estimate explains of it, and what it leaves, in "
             "units of the noise.",),
            {"signals": lambda: figures.signals(ds), "residual": lambda: figures.residual(ds)},
        ),
        Section(
            "Recovered p and q",
            (*notes_on(rows), *_mean_words(case.problem)),
            {"estimates": lambda: figures.estimates(ds)},
        ),
        Section(
            "Spectra",
            ("The resolution is the part of a traction's sinusoid that the estimate keeps; the "
             "cut-off is where it falls through one half.",),
            {"spectra": lambda: figures.spectra(ds)},
            tables=(_cutoff_table(ds),),
        ),
        Section(
            "Averaging kernel",
            ("What the estimate makes of a unit line of traction in the middle of the window: its "
             "own component (a peak as narrow as the resolution) and the other one (leakage).",),
            {"averaging_kernel": lambda: figures.averaging_kernel(ds)},
        ),
        Section(
            "Errors and time",
            (),
            {"errors_and_time": lambda: figures.errors_and_time(rows)},
            tables=(_summary(case, rows),),
        ),
        *_screening_section(case.screening),
        Section(
            "What was assumed",
            (),
            tables=(
                Table(("what", "value"), case.assumed),
                *(_stats_table(case, name, e) for name, e in estimates.items()),
            ),
        ),
    ]  # fmt: skip
    return tuple(parts)


def _screening_section(screening: ScreeningResult | None) -> tuple[Section, ...]:
    """Page section of the effects that were screened."""
    if screening is None:
        return ()
    rows = tuple(
        (name, bound, "on" if name in screening.on else "off", 1e3 * screening.times_s[name])
        for name, bound in screening.relative_change_bounds.items()
    )
    return (
        Section(
            "Effects that this scene calls for",
            ("A bound on what each effect changes, found without simulating it: rms change over "
             f"rms signal. Those off change at most {screening.bound:.2g} of the signal together, "
             "with "
             "what rounding makes of it.",),
            tables=(Table(("effect", "bound", "", "time of the bound [ms]"), rows),),
        ),
    )  # fmt: skip


def _mean_words(problem: LineProblem):
    yield (
        "Bands are 90 % of the posterior (1.645 standard errors): noise and what the prior leaves "
        "open, not errors of the model."
    )
    for component, words in problem.mean_statement().items():
        yield f"Mean of {component}: {words}."


def _cutoff_table(ds: xarray.Dataset) -> Table:
    rows = []
    for method in ds["method"].values:
        for component in COMPONENTS:
            k = float(ds["cutoff"].sel({"method": method, "component": component}))
            if np.isfinite(k):
                rows.append((str(method), component, k, 2e3 * np.pi / k))
    return Table(("method", "component", "cut-off [rad/m]", "wavelength [mm]"), tuple(rows))


def _stats_table(case: InversionCase, name: str, estimate: Estimate) -> Table:
    rows = [(_named(case, key).replace("_", " "), value) for key, value in estimate.stats.items()]
    own = (("status", estimate.status), ("quality", str(estimate.quality)))
    return Table((name, "value"), (*own, *rows))
