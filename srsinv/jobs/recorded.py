"""A recording as the jobs want it: even samples, and where they need it one known speed."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import refuse
from ..recording import Recording, load

STEADY = 1e-3  # how far a speed may stray from its mean and still be taken as constant
JITTER = 0.2  # of the sampling interval: beyond it there is a gap
ROUNDED = 0.25  # of an interval: time stamps nearer to even ones than this are only rounded
OF_A_JOB = ("cell_m",)  # keys of `recording` that say nothing about the file


def load_steady(settings: Mapping[str, Any], known: Mapping[str, Any]) -> Recording:
    """[`load_even`][] for what takes the speed as constant: raises `BadInput` where it varies."""
    recording = load_even(settings, known)
    refuse(
        not recording.is_constant_speed(STEADY),
        f"{recording.name}: the speed varies by more than {STEADY:.1%} of its mean, and this job "
        "takes it as constant: give recording.speed_m_per_s=... to do so all the same.",
    )
    return recording


def load_even(settings: Mapping[str, Any], known: Mapping[str, Any]) -> Recording:
    """The recording that `settings`, the configuration's `recording`, names, at even times.

    `known` are further facts of the command line, beside the sidecar's. Raises `BadInput` for a
    file that cannot be read, a speed that is 0 throughout, and uneven times.
    """
    facts = {key: value for key, value in settings.items() if key not in OF_A_JOB}
    path, missing = facts.pop("path"), facts.pop("missing", "refuse")
    refuse(path is None, "No recording is named: give recording.path=FILE.")
    recording = load(path, missing=missing, **_given(facts | dict(known)))
    refuse(
        not np.any(recording.speed_m_per_s),
        f"{recording.name}: the speed is 0, so no surface passes the sensor: give "
        "recording.speed_m_per_s=... in m/s.",
    )
    jitter = recording.sampling_jitter
    refuse(
        jitter > JITTER,
        f"{recording.name}: the sampling interval varies by {jitter:.0%}, more than {JITTER:.0%}: "
        "give recording.sample_rate_hz=... or cut the recording at the gap.",
    )
    return _uniform(recording)


def _uniform(recording: Recording) -> Recording:
    """The recording at even times.

    Stamps that are off by less than a quarter of an interval are only rounded, and are replaced:
    interpolating would colour the noise, which the rules take as white. Else the signal is
    interpolated.
    """
    time_s = recording.time_s
    even = np.linspace(time_s[0], time_s[-1], time_s.size)
    if np.max(np.abs(time_s - even)) < ROUNDED / recording.sample_rate_hz:
        return replace(recording, time_s=even)
    return recording.resample_uniform()


def _given(known: dict[str, Any]) -> dict[str, Any]:
    """What the command line gives, in depth: null means not given."""
    trimmed = {k: _given(v) if isinstance(v, dict) else v for k, v in known.items()}
    return {k: v for k, v in trimmed.items() if v is not None and v != {}}
