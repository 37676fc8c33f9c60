"""Assumptions, as attributes of a result's dataset: the page's last section words them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..effects import NAMES
from ..forward.sensor import Sensor
from ..forward.simulation import Simulation
from ..inverse.gridding.cells import FEW, sample_spacing_m
from ..inverse.line.problem import LineProblem
from ..inverse.rig.error import SensorError
from ..quantities import quantity
from ..recording import Recording
from ..recording.drift import common_level
from ..recording.even import STEADY
from ..recording.preparation import Preparation

if TYPE_CHECKING:  # with what only some jobs need
    from ..inverse.features.synthetic import SyntheticScan
    from ..inverse.problem import Problem

Facts = dict[str, Any]


def of_effects(on: Iterable[str]) -> Facts:
    """Which effects are on and off."""
    names = tuple(on)
    return {
        "effects_on": ", ".join(names) or "none",
        "effects_off": ", ".join(name for name in NAMES if name not in names) or "none",
    }


def of_sensor(sensor: Sensor) -> Facts:
    """Skin and amplifier, in words."""
    return {"skin": sensor.skin.words, "amplifier": type(sensor.amplifier).__name__}


def of_friction(friction: Any) -> Facts:
    """mu of q = mu p; None leaves p and q apart."""
    return {} if friction is None else {"friction": friction}


def of_simulation(sim: Simulation, noises: Iterable[str], effects: Iterable[str]) -> Facts:
    """A simulated scene; `noises` and `effects` are the names of those that are on."""
    line, recorder = sim.line, sim.scenario.recorder
    profiles = [type(each).__name__.removesuffix("Profile").lower() for each in
                recorder.speed_profiles]  # fmt: skip
    return {
        "line": line.kind,
        "cells": line.n,
        "cell_m": float(line.cell_m),
        "refinement": sim.refinement,
        "speed_m_per_s": float(sim.scan.speed_m_per_s),
        "speed_profiles": ", ".join(profiles),
        "noise": ", ".join(noises) or "none",
        "load_drift_not_inverted": int(bool(recorder.drift)),
        "filter_lag_not_inverted": int(bool(recorder.speed_profiles) and bool(sim.sensor.filters)),
        **of_sensor(sim.sensor),
        **of_effects(effects),
    }


def of_samples(recording: Recording, times: Any) -> Facts:
    """The samples of a recording; `times` is the configuration's word for how the file's times are
    taken."""
    missing, rows = np.isnan(recording.signal), recording.missing_rows
    return {
        "recording": recording.name,
        "recording_samples": int(recording.time_s.size),
        "sample_rate_hz": float(recording.sample_rate_hz),
        "rows_missing": int(rows),
        "rows_missing_places": int(recording.gaps),
        "other_samples_missing": int(missing.sum()) - rows * len(recording.channels),
        "times_ignored": int(times == "ignore"),
        **_of_preparation(recording),
    }


def _of_preparation(recording: Recording) -> Facts:
    """What was taken out of the signals, where they are prepared."""
    wanted = Preparation.of_facts(recording.sidecar)
    facts: Facts = {}
    if wanted.detrend is not None:
        facts["detrend"] = wanted.detrend
    if wanted.high_pass_Hz is not None:
        facts["high_pass_Hz"] = wanted.high_pass_Hz
    if wanted.notch_Hz:
        facts["notch_Hz"] = ", ".join(f"{each:.4g}" for each in wanted.notch_Hz)
        facts["notch_width_Hz"] = wanted.notch_width_Hz
    return facts


def of_recording(recording: Recording, problem: Problem, times: Any) -> Facts:
    """A recording and its problem; `times` as in `of_samples`."""
    speed, noise, unit = recording.speed_m_per_s, problem.noise, recording.signal_unit
    return {
        **of_samples(recording, times),
        "is_steady": int(recording.is_constant_speed(STEADY)),
        "speed_m_per_s": float(np.abs(speed).mean())
        if speed.min() < 0 < speed.max()
        else float(speed.mean()),
        "speed_least_m_per_s": float(speed.min()),
        "speed_greatest_m_per_s": float(speed.max()),
        **of_sensor(problem.sensor),
        "noise_rms": noise.rms,
        "noise_rms_each": _each(noise.white, unit),
        "drift": common_level(np.asarray(noise.drift)),
        "drift_each": _each(noise.drift, unit),
        "drift_time_s": quickest if np.isfinite(quickest := min(noise.drift_time_s)) else 0.0,
        "noise_unit": unit,
        "noise_is_estimate": int(noise.is_estimate),
        "noise_causes": ", ".join(noise.causes),
        "noise_is_of_quiet": int(bool(recording.sidecar.get("quiet_s"))),
        "mains_Hz": ", ".join(f"{line.frequency_Hz:.4g}" for line in problem.mains),
        "drift_is_found": int(recording.sidecar.get("drift") == "auto"),
        **of_rig(None if problem.rig is None else problem.rig.of_signals),
    }


def of_rig(rig: SensorError | None) -> dict[str, Any]:
    """What is not known exactly of a rig."""
    return {} if rig is None else {"rig_error": rig.words}


def _each(levels: Iterable[Any], unit: str) -> str:
    """The elements' levels where each has its own, else nothing."""
    each = [quantity(float(level), unit) for level in levels]
    return ", ".join(each) if len(each) > 1 else ""


def of_cells(recording: Recording, problem: Problem, gridded: LineProblem) -> Facts:
    """The line of cells that a recording is inverted on."""
    line, nominal = gridded.line, problem.nominal_pressure_Pa
    spacing = sample_spacing_m(problem.motion)
    facts = {
        "sample_spacing_m": spacing,
        "line": line.kind,
        "cells": line.n,
        "cell_m": float(line.cell_m),
        "samples_per_cell": round(float(line.cell_m) / spacing),
        "least_samples_fraction": FEW,
        "has_missing_samples": int(not np.isfinite(recording.signal).all()),
        "window_start_m": float(np.asarray(line.x)[0]),
        "window_end_m": float(np.asarray(line.x)[-1]),
    }
    return facts if nominal is None else facts | {"nominal_pressure_Pa": float(nominal)}


def of_scan(on: SyntheticScan, noises: Iterable[str]) -> Facts:
    """A scan of known features, simulated on finer cells; `noises` are the names of those on."""
    elements, samples = on.shape
    x, depth = np.asarray(on.motion.position_m), float(on.sensor.depth_m)
    return {
        "scan_samples": samples,
        "scan_elements": elements,
        "sample_spacing_m": float(abs(x[1] - x[0])),
        "scan_speed_m_per_s": float(on.scan.speed_m_per_s),
        "depth_m": depth,
        "fine_cells": on.fine.line.n,
        "fine_cell_m": float(on.fine.line.cell_m),
        "noises": ", ".join(noises) or "none",
        **of_sensor(on.sensor),
    }
