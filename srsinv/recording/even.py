"""Recordings for jobs: at even times, missing rows as missing samples (without jax)."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from srsinv.errors import LARGEST, choice, mapping, number, refuse

from ..files import path_of
from ._doubts import doubts
from ._read import MISSING, TIMES_OF_ROWS, load
from ._recording import MIN_SAMPLES, Recording
from ._timing import EvenTimes, even_times
from .formats import BY_SUFFIX
from .passes import near_turns, still_samples
from .preparation import prepare
from .reader import Reader

STEADY = 1e-3  # largest relative deviation of a constant speed from its mean
VOLTS = ("V", "V m")  # units of amplifiers: a voltage, or its integral along x
FEWEST_SAMPLES = 16  # fewer than that have no spectrum in which a noise level shows
OF_A_JOB = ("cell_m",)  # keys of `recording` that are not facts of the file
MOTION = {
    "sample_rate_hz": "a positive number in Hz",
    "speed_m_per_s": "a speed in m/s",
    "scan_start_m": "a position in metres",
}


def load_steady(settings: Any, known: Mapping[str, Any], reader: Reader = BY_SUFFIX) -> Recording:
    """[`load_even`][] for jobs at constant speed: raises `BadInput` where it varies."""
    recording = load_even(settings, known, reader)
    refuse(
        not recording.is_constant_speed(STEADY),
        f"{recording.name}: the speed varies by more than {100 * STEADY:.1f} % of its mean, "
        "but this job needs a constant one: give recording.speed_m_per_s=... to "
        "replace it.",
    )
    return recording


def load_even(settings: Any, known: Mapping[str, Any], reader: Reader = BY_SUFFIX) -> Recording:
    """The recording that `settings`, the configuration's `recording`, names, at even times.

    `known` are further facts of the command line, beside the sidecar's. Rows missing by the time
    stamps are missing samples. Raises `BadInput` for a file that cannot be read, a speed that is 0
    throughout, and times that cannot be put on even ones.
    """
    named = mapping("recording", settings)
    facts = {key: value for key, value in named.items() if key not in OF_A_JOB}
    path, missing = facts.pop("path", None), facts.pop("missing", MISSING[0])
    times = facts.pop("times", TIMES_OF_ROWS[0])
    refuse(path is None, "No recording is named: give recording.path=FILE.")
    path = path_of(path, "recording.path")
    facts |= sidecar_paths(facts)
    for key, wanted in MOTION.items():
        if (given := facts.get(key)) is not None:
            number(f"recording.{key}", given, wanted)
    missing = choice("recording.missing", missing, MISSING)
    times = choice("recording.times", times, TIMES_OF_ROWS)
    stated = _without_nulls(facts | dict(known))
    recording = load(path, reader=reader, missing=missing, times=times, **stated)
    return usable(recording)


def usable(recording: Recording) -> Recording:
    """The recording at even times, as every job takes it, with its doubts; the one place that
    decides whether it can be used.

    Raises `BadInput` for too few samples, channels that are all constant or beyond the range of
    quantities, a speed that is 0 throughout, and times that cannot be put on even ones.
    """
    refuse(
        recording.time_s.size < FEWEST_SAMPLES,
        f"{recording.name}: {recording.time_s.size} samples are too few to separate a "
        f"touch from noise: give a recording of at least {FEWEST_SAMPLES}.",
    )
    _check_signal(recording)
    refuse(
        not np.any(recording.speed_m_per_s),
        f"{recording.name}: the speed is 0, so no surface passes the sensor: give "
        "recording.speed_m_per_s=... in m/s.",
    )
    even = _without_turns(on_even_times(recording))
    return replace(even, doubts=doubts(even))


def _without_turns(recording: Recording) -> Recording:
    """The recording with missing samples next to where its motion turns, as its facts ask; where
    it stands still it shows its noise, and stays.

    Raises `BadInput` where it does not turn, and where nothing would be left.
    """
    margin_m = recording.sidecar.get("turn_margin_m")
    if margin_m is None:
        return recording
    near = near_turns(recording.position_m, float(margin_m))
    its = f"{recording.name}: recording.turn_margin_m is {margin_m:g}"
    refuse(not near.any(), f"{its}, but the motion does not turn: leave it out.")
    near &= ~still_samples(recording.speed_m_per_s, recording.sample_rate_hz)
    signal = np.where(near, np.nan, recording.signal)
    fewest = int(np.isfinite(signal).sum(axis=1).min())
    refuse(
        fewest < FEWEST_SAMPLES,
        f"{its}, which leaves {fewest} samples: give a smaller one.",
    )
    return replace(recording, signal=signal)


def sidecar_paths(settings: Mapping[str, Any]) -> dict[str, Path | None]:
    """The files beside a recording that the configuration's `recording` names. Raises `BadInput`
    for what is no path."""
    return {
        key: None if settings.get(key) is None else path_of(settings[key], f"recording.{key}")
        for key in ("sidecar", "calibration")
    }


def _check_signal(recording: Recording) -> None:
    """Refuse a signal with hardly any valid samples, or beyond the range of quantities."""
    present = np.isfinite(recording.signal)
    for channel, row, observed in zip(recording.channels, recording.signal, present, strict=True):
        refuse(
            np.sum(observed) < MIN_SAMPLES,
            f"{recording.name}: channel {channel} has {np.sum(observed)} valid samples, "
            f"fewer than {MIN_SAMPLES}: leave it out of recording.channels.",
        )
        largest = float(np.max(np.abs(row[observed])))
        refuse(
            largest > LARGEST,
            f"{recording.name}: channel {channel} reaches {largest:.3g} after division by "
            f"its gain, beyond {LARGEST:g}: check recording.gain and "
            "recording.signal_unit.",
        )
    refuse(
        all(np.nanmax(row) == np.nanmin(row) for row in recording.signal),
        f"{recording.name}: every channel is constant, as at the recorder's rail or "
        "when not connected: record it again within the range.",
    )


def check_volts(recording: Recording) -> None:
    """Refuse a signal in no unit of voltage, which does not give Pa."""
    unit = recording.signal_unit
    refuse(
        unit not in VOLTS,
        f"{recording.name}: the signal is in {unit}, so pressures in Pa are not "
        f"known: give recording.gain ({unit} per volt) or recording.signal_unit, or "
        "use experiment=invert_recording traction_unit=relative.",
    )


def _without_nulls(known: dict[str, Any]) -> dict[str, Any]:
    """The values given on the command line, in depth: null means not given."""
    trimmed = {k: _without_nulls(v) if isinstance(v, dict) else v for k, v in known.items()}
    return {k: v for k, v in trimmed.items() if v is not None and v != {}}


def on_even_times(recording: Recording) -> Recording:
    """The recording at even times, its signals prepared as its facts ask (preparation.py). Raises
    `BadInput` for intervals that vary too much, and where it cannot be prepared so."""
    return prepare(_at_even_times(recording))


def _at_even_times(recording: Recording) -> Recording:
    """The recording with missing samples for rows missing by its time stamps; speed and measured
    position are interpolated there.

    Stamps that are off by less than a quarter of an interval, or than half their last digit, are
    only rounded, and are replaced: interpolating would colour the noise, which the rules take as
    white. Else the signal is interpolated.
    """
    even = even_times(recording.name, recording.time_s, recording.sidecar.get("sample_rate_hz"))
    if even.is_rounded and not even.missing_rows:
        return replace(recording, time_s=even.time_s)
    if not even.missing_rows:
        return recording.resample_uniform()
    if even.is_rounded:
        signal = np.full((len(recording.channels), even.time_s.size), np.nan)
        signal[:, even.row] = recording.signal
        # By the rows' numbers, so that each has its own speed and position.
        at, every = even.row, np.arange(even.time_s.size)
    else:
        signal = _interpolated(recording, even)
        at, every = recording.time_s, even.time_s
    position_m = recording.measured_position_m
    return replace(
        recording,
        signal=signal,
        time_s=even.time_s,
        speed_m_per_s=np.interp(every, at, recording.speed_m_per_s),
        measured_position_m=None if position_m is None else np.interp(every, at, position_m),
        missing_rows=even.missing_rows,
        gaps=even.gaps,
    )


def _interpolated(recording: Recording, even: EvenTimes) -> np.ndarray:
    """The signal interpolated from the rows before and after, where none is missing between
    them."""
    time_s = recording.time_s
    before = np.clip(np.searchsorted(time_s, even.time_s, side="right") - 1, 0, time_s.size - 2)
    is_between = (even.time_s > time_s[before]) & (even.time_s < time_s[before + 1])
    signal = np.stack([np.interp(even.time_s, time_s, row) for row in recording.signal])
    return np.where(even.is_gap[before] & is_between, np.nan, signal)
