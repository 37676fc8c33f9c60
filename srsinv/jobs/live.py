"""Live inversion: play a recording back as if it arrived, or read lines from standard input."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float

from .. import config
from ..errors import choice, echo, number, of_kind, refuse
from ..inverse.estimate import COMPONENTS, Estimate
from ..inverse.line.solve import solve
from ..inverse.live.live import Live, LiveCells
from ..inverse.method import Method
from ..inverse.problem import Problem
from ..inverse.wiener import Wiener
from ..modules import with_fields
from ..progress import say, stage
from ..recording.even import check_volts
from ..recording.passes import passes_of
from ..recording.stream import RowFormat
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import quantity, significant
from . import _facts, _live_plots
from ._live_stream import stream
from ._live_view import LiveView, check_display

SOURCES = ("recording", "-")
LAG_DEPTHS = 4.0  # where no lag is given
LAGS_DEPTHS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)  # that are compared, with
LONG_DEPTHS = 32.0  # one that is as good as all data
CHUNK = 10  # samples that arrive at once when a recording is played back
Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result | None:
    """The job: play back and compare lags, or read and print lines; those have no result."""
    settings = config.part(cfg, "live")
    source = choice("live.source", settings.get("source"), SOURCES)
    view = settings.get("view")
    refuse(not isinstance(view, bool), f"live.view is {echo(view)}: give true or false.")
    if view:
        check_display()
    with config.precision(cfg):
        if source == "-":
            _stream(cfg)
            return None
        return _played_back(cfg)


def _stream(cfg: config.Config) -> None:
    """Invert lines from standard input with what a recording and its sidecar state."""
    settings, method = config.part(cfg, "recording"), _method(cfg)
    earlier = None
    if settings.get("path") is not None:
        earlier = config.recorded_problem(cfg, config.recording(cfg))
        for warning in earlier.warnings:
            say(f"{earlier.name}: {warning}")

    def form(lines: Sequence[str]) -> RowFormat:
        elements = config.part(cfg, "sensor").get("elements")
        known = {"sensor": {"elements": elements}} if elements else {}
        return RowFormat("standard input", list(lines), settings, known)

    def made(rows: RowFormat) -> Live:
        check_volts(rows.recording)
        if earlier is not None:
            return _live(cfg, earlier, _prior(method, earlier))
        problem = config.streamed_problem(cfg, rows.recording)
        return _live(cfg, problem, _given(method))

    stream(made, form, LiveView if config.part(cfg, "live").get("view") else None)


def _given(method: Method) -> Method:
    """The method with its levels as they are given, where it would choose them."""
    if not method.chooses_prior:
        return method
    refuse(
        not isinstance(method, Wiener),
        f"{type(method).__name__} chooses its weights on a recording: give recording.path=FILE, an "
        "earlier recording of the sensor, or method=wiener.",
    )
    say(
        "no recording.path is given, so that the levels of p and q are those of the method: give "
        "an earlier recording of the sensor to choose them on it."
    )
    return with_fields(method, scale="given")


def _method(cfg: config.Config) -> Method:
    named = config.methods(cfg)
    refuse(
        len(named) != 1,
        f"method names {len(named)} methods: a live inversion takes one, as method=wiener.",
    )
    return of_kind("method", next(iter(named.values())), Method, "a method")


def _prior(method: Method, problem: Problem) -> Any:
    """The method's prior, its levels chosen on a recording where none are given."""
    with stage("choosing the levels of p and q"):
        return method.prior_fixed_on(problem.to_grid())


def _live(cfg: config.Config, problem: Problem, prior: Any) -> Live:
    """The live inversion of a recording's sensor, by the configuration."""
    settings, white = config.part(cfg, "live"), problem.noise.white
    refuse(
        bool(problem.noise.causes),
        f"noise=[{','.join(['white', *problem.noise.causes])}] is not done live: give "
        "noise=[white].",
    )
    speed = np.abs(np.asarray(problem.motion.speed_m_per_s))
    with stage("making the model"):
        return Live(
            problem.sensor,
            prior,
            noise="adaptive" if problem.noise.is_estimate else np.asarray(white),
            lag_m=_lag_m(settings, float(problem.sensor.depth_m)),
            cell_m=config.part(cfg, "recording").get("cell_m"),
            memory_m=settings.get("memory_m"),
            friction=None if problem.friction is None else float(problem.friction),
            nominal_pressure_Pa=problem.nominal_pressure_Pa or 0.0,
            drift=np.asarray(problem.noise.drift),
            mains_Hz=[line.frequency_Hz for line in problem.mains],
            speed_m_per_s=float(np.mean(speed)) if problem.sensor.filters else None,
        )


def _lag_m(settings: Mapping[str, Any], depth_m: float) -> float:
    given = settings.get("lag_m")
    wanted = "a length in metres from 0, or null for 4 depths"
    return LAG_DEPTHS * depth_m if given is None else number("live.lag_m", given, wanted, least=0)


def _played_back(cfg: config.Config) -> Result:
    """The longest pass of a recording, played back with several lags."""
    recording, method = config.recording(cfg), _method(cfg)
    check_volts(recording)
    problem = config.recorded_problem(cfg, recording)
    prior = _prior(method, problem)
    one = _longest_pass(problem)
    depth_m, settings = float(problem.sensor.depth_m), config.part(cfg, "live")
    lag_m = _lag_m(settings, depth_m)
    first = _live(cfg, one, prior)
    long_m = max(min(LONG_DEPTHS * depth_m, first.memory_m), lag_m)
    shorter_m = (each * depth_m for each in LAGS_DEPTHS if each * depth_m < long_m)
    lags_m = sorted({*shorter_m, lag_m, long_m})
    runs, times_s, unit = [], np.zeros(0), problem.sensor.amplifier.unit
    for each in lags_m:
        with stage(f"playing back with a lag of {quantity(each, 'm')}"):
            view = LiveView(unit) if each == lag_m and settings.get("view") else None
            cells, taken = _run(first.with_lag(each), one, view)
        runs.append(cells)
        times_s = taken if each == lag_m else times_s
    whole = _whole(one, prior, first)
    return _result(recording.name, one, runs, lags_m, lag_m, whole, times_s, {
        **_facts.of_recording(recording, problem, config.part(cfg, "recording").get("times")),
        **_facts.of_effects(config.part(cfg, "effects")),
        **_facts.of_friction(cfg["friction"]),
        "method": next(iter(config.methods(cfg))),
        "levels_chosen": int(method.chooses_prior),
        "passes": len(passes_of(np.asarray(problem.motion.position_m))),
    })  # fmt: skip


def _longest_pass(problem: Problem) -> Problem:
    """The problem of the samples of the longest pass."""
    x_m = np.asarray(problem.motion.position_m)
    longest = max(passes_of(x_m), key=lambda each: np.ptp(x_m[each.samples]))
    return problem.of_samples(longest.samples)


def _run(
    live: Live, problem: Problem, view: LiveView | None
) -> tuple[LiveCells, Float[np.ndarray, " chunk"]]:
    """All cells of a problem's samples in chunks, and the time [s] that each chunk took a sample.
    With a `view` samples arrive as fast as they were recorded."""
    motion = problem.motion
    columns = [np.asarray(each, float) for each in
               (motion.time_s, motion.position_m, motion.speed_m_per_s)]  # fmt: skip
    offset = problem.sensor.amplifier.offset
    signal = np.where(problem.observed, np.asarray(problem.data, float), np.nan)
    signal = signal + (0.0 if offset is None else float(offset))
    parts, taken, began_s = [], [], time.monotonic() - float(columns[0][0])
    for start in range(0, columns[0].size, CHUNK):
        own = slice(start, start + CHUNK)
        time_s, x_m, speed = (each[own] for each in columns)
        begun = time.perf_counter()
        parts.append(live.push(time_s, x_m, signal[:, own], speed))
        taken.append((time.perf_counter() - begun) / time_s.size)
        if view is not None:
            view.show(parts[-1])
            time.sleep(max(began_s + float(time_s[-1]) - time.monotonic(), 0.0))
    return LiveCells.joined([*parts, live.finish()]), np.array(taken)


def _whole(problem: Problem, prior: Any, live: Live) -> Estimate:
    """The estimate from all samples at once, with the same prior and cells as wide."""
    gridded = problem.to_grid(live.cell_m)
    with stage("inverting all samples at once"):
        return solve(gridded, prior(gridded))


def _result(
    name: str,
    problem: Problem,
    runs: Sequence[LiveCells],
    lags_m: Sequence[float],
    lag_m: float,
    whole: Estimate,
    times_s: np.ndarray,
    facts: Mapping[str, Any],
) -> Result:
    own = lags_m.index(lag_m)
    order = np.argsort(runs[own].x_m)
    x = runs[own].x_m[order]
    values = np.array([[each.p_Pa[order], each.q_Pa[order]] for each in runs])
    stderrs = np.array([[each.p_stderr_Pa[order], each.q_stderr_Pa[order]] for each in runs])
    line = np.asarray(whole.line.x, float)
    of_all, of_all_stderr = (
        np.stack([np.interp(x, line, row) for row in np.asarray(each, float)])
        for each in (whole.value, whole.stderr)
    )
    # Away from the ends, where the noise level has settled and short lags have their data.
    depth_m = float(problem.sensor.depth_m)
    inside = (x > x[0] + 8 * depth_m) & (x < x[-1] - 8 * depth_m)
    inside = inside if inside.any() else np.ones(x.size, bool)
    typical = np.median(stderrs[..., inside], axis=-1)
    off = np.sqrt(np.mean((values - values[-1])[..., inside] ** 2, axis=-1))
    ratio = typical[own] / typical[-1]
    unit = problem.sensor.amplifier.unit
    variables: Variables = {
        "live_estimate": (("lag", "component", "x"), values, "Pa"),
        "live_stderr": (("lag", "component", "x"), stderrs, "Pa"),
        "estimate": (("component", "x"), of_all, "Pa"),
        "estimate_stderr": (("component", "x"), of_all_stderr, "Pa"),
        "typical_stderr": (("lag", "component"), typical, "Pa"),
        "difference_rms": (("lag", "component"), off, "Pa"),
        "noise_level": (("element", "x"), runs[own].noise[:, order], unit),
        "is_settling": ("x", runs[own].is_settling[order], "1"),
        "chunk_time_s": ("chunk", times_s, "s"),
        **scalars({
            "lag_m": lag_m,
            "quality": str(whole.quality),
            "cell_m": float(np.diff(x).min()) if x.size > 1 else float("nan"),
            "cells": x.size,
            "samples": int(problem.motion.time_s.size),
            "p_stderr_Pa": typical[own, 0],
            "q_stderr_Pa": typical[own, 1],
            "p_stderr_ratio": ratio[0],
            "q_stderr_ratio": ratio[1],
            "sample_median_time_s": float(np.median(times_s)),
            "sample_99_percent_time_s": float(np.quantile(times_s, 0.99)),
        }),
    }  # fmt: skip
    coordinates = {
        "x": (x, "m"),
        "lag": (np.array(lags_m), "m"),
        "component": (list(COMPONENTS), "1"),
        "element": (problem.sensor.element_names, "1"),
    }
    data = dataset(
        variables, coordinates, **facts, depth_m=depth_m, warning=" ".join(whole.warnings)
    )
    return Result(_title(name, data), data, sections("live", "assumed", **_live_plots.PLOTS))


def _title(name: str, data: xarray.Dataset) -> str:
    ratios = [significant(float(data[f"{c}_stderr_ratio"]), 3) for c in COMPONENTS]
    lag = quantity(float(data["lag_m"]), "m", 3)
    return (
        f"{name}: {lag} behind the sensor the standard errors of p and q are {ratios[0]} and "
        f"{ratios[1]} times those {quantity(float(data['lag'][-1]), 'm', 3)} behind it"
    )
