"""An inversion by several methods, as every job with one has it: run them, gather every stage."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float

from ..effects import ScreeningResult
from ..errors import of_kind
from ..forward.sensor import Sensor
from ..grid import wavenumbers
from ..inverse.board.periodogram import strongest_line_m
from ..inverse.estimate import (
    COMPONENTS,
    Estimate,
    cutoff,
    full_width_at_half_maximum,
    highest,
)
from ..inverse.line.problem import LineProblem
from ..inverse.quality import Quality
from ..numerics import BAND_90
from ..progress import stage
from ..report.answers import answer_variables
from ..report.data import dataset, key_of, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import quantity, significant, unit_of
from ..timing import timed
from ._budget import highest_budget
from ._passes import pass_variables
from .estimates import (
    Answers,
    Variables,
    estimate_coordinates,
    estimate_variables,
    of_simulated,
    score_variables,
)

STRESSES = ("sigma_x", "sigma_z", "tau_xz", "sigma_y")
Estimates = Mapping[str, Estimate]


@dataclass(frozen=True)
class InversionCase:
    """One inversion to run and to report.

    - `problem` to invert; `sensor`; `methods` by name.
    - `traction_unit`: "Pa", or "1" for p and q that are relative.
    - `stages`: (dims, values, units) of the simulation's stages, by variable name; the truth is
      `traction`. Empty for a recording, which has a `name`.
    - `facts`: what was assumed, for the dataset's attributes; `screening`: the result of screening
      effects, if any; `warnings`: those on the simulated scene; `check`: gives further ones by the
      first method and its estimate.
    - `repeats`: further calls of each method that are timed.
    """

    problem: LineProblem
    sensor: Sensor
    methods: Mapping[str, Callable[[LineProblem], Estimate]]
    facts: Mapping[str, Any]
    name: str = ""
    signal_unit: str = "V"
    traction_unit: str = "Pa"
    stages: Mapping[str, tuple[tuple[str, ...], Any, str]] = field(default_factory=dict)
    screening: ScreeningResult | None = None
    warnings: tuple[str, ...] = ()
    check: Callable[[Callable[[Any], Estimate], Estimate], tuple[str, ...]] | None = None
    repeats: int = 0


def run(case: InversionCase) -> Result:
    """Invert by every method and gather the result."""
    estimates, times = {}, []
    for name, method in case.methods.items():
        with stage(f"inverting: {name}"):
            one = timed(lambda method=method: method(case.problem), repeats=case.repeats)
        wanted = "an Estimate, as problem.to_grid().estimate(...) gives it"
        estimates[name] = of_kind(f"what {name} gives", one.value, Estimate, wanted)
        times.append((one.first_s, one.least_s))
    first = next(iter(estimates))
    further = case.check(case.methods[first], estimates[first]) if case.check else ()
    for name, estimate in estimates.items():
        if "traction" in case.stages:
            truth = np.asarray(case.stages["traction"][1])
            estimate = estimate.against(truth, case.problem.observed_cells)
        estimates[name] = estimate.with_warnings((*case.warnings, *further))
    first_s, steady_s = np.array(times).T
    answers = Answers({name: [each] for name, each in estimates.items()}, first_s, steady_s)
    data = _dataset(case, answers)
    return Result(_title(case, data), data, sections("inversion", "assumed"))


def _title(case: InversionCase, data: xarray.Dataset) -> str:
    names = [str(name) for name in data["estimator"].values]
    usable = np.flatnonzero(data["quality"].values != Quality.FAILED)
    if not usable.size:
        return f"{case.name or 'Simulated scene'}: no method has an answer"
    if not case.name:
        error = data["error"].values[usable]
        m = int(np.argmin(np.nansum(error, axis=1)))
        of = {c: significant(100 * e, 2) for c, e in zip(COMPONENTS, error[m], strict=True)}
        known = {c: words for c, words in of.items() if words != "–"}
        if not known:
            return f"The scene has no p and q to recover ({', '.join(names)})"
        what = "an error" if len(known) == 1 else "errors"
        return (
            f"{names[usable[m]]} recovers {' and '.join(known)} with {what} of "
            f"{' and '.join(known.values())} %"
        )
    places = [quantity(each, "m", 4) for each in data["peak_position"].values[usable, 0].tolist()]
    if len(set(places)) == 1:
        return f"{case.name}: the pressure is highest at {places[0]}"
    said = (f"{place} ({names[m]})" for m, place in zip(usable, places, strict=True))
    return f"{case.name}: the pressure is highest at {', '.join(said)}"


def _dataset(case: InversionCase, answers: Answers[Estimate]) -> xarray.Dataset:
    estimates = answers.first
    units, cells = (case.signal_unit, case.traction_unit), case.problem.observed_cells
    own = estimate_variables(answers, (), units, cells)
    own = own if case.name else of_simulated(own)
    parts, sources = highest_budget(estimates, case.problem, case.traction_unit)
    variables = (
        _signals(case)
        | own
        | _resolution(case, answers)
        | _of_sensor(case.sensor)
        | dict(case.stages)
        | _scores(case, answers)
        | _highest(case, own["estimate"][1])
        | parts
        | answer_variables(estimates)
        | _found(estimates)
        | _screened(case.screening)
        | pass_variables(case.problem, estimates)
        | scalars(_numbers(case, estimates))
    )
    means = case.problem.mean_statement()
    said = {f"mean_of_{component}": words for component, words in means.items()}
    attributes: dict[str, Any] = {
        "signal_unit": case.signal_unit,
        "mean_unobserved": ",".join(case.problem.mean_unobserved),
    }
    if case.traction_unit != "Pa":
        attributes["is_relative"] = 1
    labels = _labels(case, list(estimates)) | sources
    labels |= {"found": (found, "1")} if (found := _names_found(estimates)) else {}
    return dataset(variables, labels, **case.facts, **attributes, **said)


def _names_found(estimates: Estimates) -> list[str]:
    """The names of the facts that methods found with the traction."""
    return list(dict.fromkeys(name for each in estimates.values() for name in each.parameters))


def _found(estimates: Estimates) -> Variables:
    """The facts that methods found with the traction, NaN of methods that found none."""
    names, unknown = _names_found(estimates), (np.nan, np.nan)
    if not names:
        return {}
    pairs = [[each.parameters.get(name, unknown) for name in names] for each in estimates.values()]
    value, stderr = np.moveaxis(np.array(pairs, float), -1, 0)
    by = "estimator", "found"
    return _found_ends(estimates, names, value, stderr) | {
        "found_value": (by, value, "SI", "{found!s}_{estimator}"),
        "found_stderr": (by, stderr, "SI", "{found!s}_stderr_{estimator}"),
        "found_unit": ("found", [unit_of(name) for name in names], "1"),
    }


def _found_ends(
    estimates: Estimates, names: Sequence[str], value: np.ndarray, stderr: np.ndarray
) -> Variables:
    """Ends of the 90 % intervals of these facts, where any is not normally distributed."""
    own = [each.intervals for each in estimates.values()]
    if not any(own):
        return {}
    low, high = value - BAND_90 * stderr, value + BAND_90 * stderr
    for row, ends in enumerate(own):
        for at, name in enumerate(names):
            low[row, at], high[row, at] = ends.get(name, (low[row, at], high[row, at]))
    by = "estimator", "found"
    return {
        "found_low": (by, low, "SI", "{found!s}_low_{estimator}"),
        "found_high": (by, high, "SI", "{found!s}_high_{estimator}"),
    }


def _labels(case: InversionCase, names: Sequence[str]) -> Variables:
    """The coordinates, those of stresses and effects where there are any."""
    line = case.problem.line
    n, cell = line.n, float(line.cell_m)
    coordinates = estimate_coordinates(case.problem, names) | {
        "wavenumber": (np.asarray(wavenumbers(n, cell)), "rad/m"),
        "lag": (cell * (np.arange(n) - n // 2), "m"),
        **dict.fromkeys(("component_out", "component_in"), (list(COMPONENTS), "1")),
    }
    if "stress" in case.stages:
        coordinates["stress_name"] = (list(STRESSES), "1")
    if case.screening:
        coordinates["effect"] = (list(case.screening.relative_change_bounds), "1")
    return coordinates


def _signals(case: InversionCase) -> Variables:
    problem, unit = case.problem, case.signal_unit
    n, observed = problem.line.n, problem.is_observed
    data, power = np.asarray(problem.data), np.asarray(problem.noise)
    power = power[0] if len(power) == 1 else power
    gain = np.full((len(case.sensor.elements), 2, n // 2 + 1), np.nan)
    gain[:, : problem.unknowns] = np.abs(problem.forward.circulant().transfer)
    along = ("element", "x")
    units = f"{unit}/{case.traction_unit}"
    return {
        "signal": (along, np.where(observed, data, np.nan), unit),
        "observed": (along, observed.astype(np.int8), "1"),
        "sensor_gain": (("element", "component", "wavenumber"), gain, units),
        "signal_power": (("element", "wavenumber"), np.abs(np.fft.rfft(data)) ** 2 / n,
                         f"({unit})^2"),
        "noise_power": (("element", "wavenumber")[-power.ndim :], power, f"({unit})^2"),
    }  # fmt: skip


def _resolution(case: InversionCase, answers: Answers[Estimate]) -> Variables:
    """Resolution, cut-off and averaging kernels; NaN for what was not solved for."""
    problem, n, c = case.problem, case.problem.line.n, case.problem.unknowns
    cell = float(problem.line.cell_m)
    unresolved = np.full((c, c, n), np.nan)  # of a method without kernels
    averaging = answers.each(lambda e: unresolved if e.averaging is None else e.averaging)
    pairs = np.full((len(averaging), 2, 2, n), np.nan)
    pairs[:, :c, :c] = averaging / cell
    own = np.einsum("mccn->mcn", pairs)
    resolution = np.abs(np.fft.rfft(own)) * cell
    lag, k = cell * (np.arange(n) - n // 2), np.asarray(wavenumbers(n, cell))
    widths = [[full_width_at_half_maximum(lag, each) for each in rows] for rows in own]
    by_component = ("estimator", "component")
    return {
        "resolution": ((*by_component, "wavenumber"), resolution, "1"),
        "cutoff": (by_component, cutoff(k, resolution), "rad/m"),
        "averaging_kernel": (("estimator", "component_out", "component_in", "lag"), pairs, "1/m"),
        "kernel_width": (by_component, widths, "m"),
    }


def _of_sensor(sensor: Sensor) -> Variables:
    films = sensor.elements
    numbers = {
        "depth": ([film.depth_m for film in films], "m"),
        "angle": ([film.angle_rad for film in films], "rad"),
        "width": ([film.width_m for film in films], "m"),
        "length": ([film.length_m for film in films], "m"),
        "offset": ([film.offset_m for film in films], "m"),
    }
    return {
        f"element_{name}": ("element", [float(each) for each in values], unit)
        for name, (values, unit) in numbers.items()
    }


def _scores(case: InversionCase, answers: Answers[Estimate]) -> Variables:
    """Error and coverage by the truth, NaN without one, and the degrees of freedom resolved."""
    by, unknown = ("estimator", "component"), np.full((len(answers.of), len(COMPONENTS)), np.nan)
    scores: Variables = dict.fromkeys(("error", "coverage"), (by, unknown, "1"))
    if "traction" in case.stages:
        truth = np.asarray(case.stages["traction"][1])
        scores = score_variables(answers, (), truth, case.problem.observed_cells)
    dof = answers.each(lambda e: [e.stats.get(f"resolved_dof_{c}", np.nan) for c in COMPONENTS])
    return {
        **{name: (*each, f"{name}_{{component}}_{{estimator}}") for name, each in scores.items()},
        "resolved_dof": (by, dof, "1"),
    }


def _highest(case: InversionCase, value: Float[np.ndarray, "method 2 n"]) -> Variables:
    """Over the sampled cells: each component's highest value, and p's main line."""
    observed = case.problem.observed_cells
    x = np.asarray(case.problem.line.x)
    peak, place = highest(value, x, observed)
    lines = [strongest_line_m(x[observed], each[0, observed]) for each in value]
    by, unit = ("estimator", "component"), "Pa" if case.traction_unit == "Pa" else "relative"
    return {
        "peak": (by, peak, case.traction_unit, f"{{component}}_peak_{unit}_{{estimator}}"),
        "peak_position": (by, place, "m", "{component}_peak_position_m_{estimator}"),
        "p_line_wavelength": ("estimator",
                              [np.nan if each is None else each for each in lines], "m",
                              "p_line_wavelength_m_{estimator}"),
    }  # fmt: skip


def _screened(screening: ScreeningResult | None) -> Variables:
    if screening is None:
        return {}
    bounds = screening.relative_change_bounds
    return {
        "effect_bound": ("effect", list(bounds.values()), "1", "effect_bound_{effect}"),
        "effect_on": ("effect", [name in screening.on for name in bounds], "1",
                      "effect_on_{effect}"),
        "effect_time": ("effect", [screening.times_s[name] for name in bounds], "s"),
        **scalars({"effects_off_bound": screening.bound}),
    }  # fmt: skip


def _numbers(case: InversionCase, estimates: Estimates) -> dict[str, Any]:
    """Numbers of the data, and of each method's solution."""
    problem = case.problem
    signal = np.asarray(problem.data)[problem.is_observed]
    numbers: dict[str, Any] = {
        "samples": problem.sample_count,
        "cells": problem.line.n,
        f"noise_rms_{case.signal_unit.replace(' ', '_')}": problem.noise_rms,
        "snr_dB": float(20 * np.log10(max(np.std(signal) / problem.noise_rms, 1e-30))),
    }
    for name, estimate in estimates.items():
        for key, value in estimate.stats.items():
            if key == "method":  # of a fit, and its own name is in the key
                continue
            if case.traction_unit != "Pa":  # p and q have no unit
                key = key.replace("_per_Pa2", "_relative").replace("_Pa", "_relative")
            numbers[f"{key}_{key_of(name)}"] = value
    return numbers
