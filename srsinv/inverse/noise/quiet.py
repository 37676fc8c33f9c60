"""Noise of a recording from stretches in which nothing is felt: white, and what drifts beside it.

Of each element by itself, the levels of greatest restricted likelihood, an offset and the waves of
mains taken out (see sliding.py); a drift that forgets itself after a time or, where
it may as well be, a random walk.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ... import false_alarm
from ...errors import refuse
from ...forward.noise import Noise
from ...recording import Recording
from ...recording.mains import MainsLine, waves
from ...recording.passes import still_samples
from ..nonlinear import LEVEL_STDERR
from .model import LONG, SampleNoise
from .sliding import RANGE, estimate, evidence_of_sliding, first_levels

FEWEST = 100  # quiet samples of an element: their level is within 7 %
WEAK = 0.3  # of the white noise: weaker waves of mains are left to it
BESIDE_DRIFT = 3.0  # further variances of a white level, where a drift is estimated with it
AS_PROBABLE = 2.0  # in the logarithm of likelihood, which one more parameter makes once in twenty


class _Levels(NamedTuple):
    """Of one element: the white noise's rms, and the drift after a second and its time [s]."""

    white: float
    drift: float
    time_s: float


def quiet_noise(
    recording: Recording, lines: Sequence[MainsLine] = (), causes: Mapping[str, Noise] | None = None
) -> SampleNoise:
    """The noise of a recording at even times in the stretches that its fact `quiet_s` names, or, of
    `auto`, in which it stands still. Raises `BadInput` for a stretch that is not within
    the recording, and where they hold too few samples."""
    is_quiet = _quiet_samples(recording)
    time_s, y = recording.time_s[is_quiet], recording.signal[:, is_quiet]
    counts = np.isfinite(y).sum(axis=1)
    refuse(
        int(counts.min()) < FEWEST,
        f"{recording.name}: recording.quiet_s selects {int(counts.min())} samples, "
        f"fewer than {FEWEST}: give longer stretches, as [start, end] in seconds from "
        "the first sample on.",
    )
    columns = np.zeros((len(y), 0, time_s.size))
    if lines:
        least = float(np.min(first_levels(y, 1.0).white))
        columns = waves(recording.time_s, lines, least)[..., is_quiet]
    each = [_levels(*own, time_s) for own in zip(y, columns, strict=True)]
    refuse(
        not all(own.white > 0 for own in each),
        f"{recording.name}: a signal is constant in the stretches of "
        "recording.quiet_s: give noise.white.rms=... in the signal's unit, and leave "
        "recording.quiet_s out.",
    )
    white, drift, times = (list(part) for part in zip(*each, strict=True))
    own = np.isfinite(y).sum(axis=1) / (1 + BESIDE_DRIFT * (np.array(drift) > 0))
    level_stderr = float(np.hypot(LEVEL_STDERR, np.max(1 / np.sqrt(2 * own))))
    return SampleNoise(white, causes, False, drift, times, level_stderr)


def _quiet_samples(recording: Recording) -> Bool[np.ndarray, " sample"]:
    given: Any = recording.sidecar.get("quiet_s")
    time_s = recording.time_s - recording.time_s[0]
    if given == "auto":
        return still_samples(recording.speed_m_per_s, recording.sample_rate_hz)
    pairs = given if isinstance(given[0], list | tuple) else [given]
    last, spacing = float(time_s[-1]), 1 / recording.sample_rate_hz
    for start, end in pairs:
        refuse(
            not (-spacing < start and end < last + spacing),
            f"{recording.name}: recording.quiet_s has a stretch from {start:g} s to "
            f"{end:g} s: give stretches within the recording, from 0 s to {last:.6g} s.",
        )
    return np.any([(start <= time_s) & (time_s <= end) for start, end in pairs], axis=0)


def _levels(
    y: Float[np.ndarray, " sample"],
    columns: Float[np.ndarray, "m sample"],
    time_s: Float[np.ndarray, " sample"],
) -> _Levels:
    """The most probable levels of one element."""
    known = np.isfinite(y)
    y, columns, time_s = y[known], columns[:, known], time_s[known]
    noise = float(first_levels(y[None], 1.0).white[0])
    # Directions alone that are above the noise; a few samples tell few of them apart.
    _, strength, axes = np.linalg.svd(columns, full_matrices=False)
    taken = np.concatenate([np.ones((1, y.size)), axes[strength > WEAK * noise]]).T
    basis = np.linalg.qr(taken)[0]
    left = y - basis @ (basis.T @ y)
    white = float(np.sqrt(left @ left / (y.size - basis.shape[1])))
    if not white > 0:
        return _Levels(0.0, 0.0, np.inf)
    longest = float(time_s.size * np.median(np.diff(time_s)))
    levels = estimate(left[None], time_s, longest / RANGE, taken[None])
    odds = evidence_of_sliding(left[None], time_s, taken[None], levels)
    if odds < -np.log(false_alarm.DRIFT):
        return _Levels(white, 0.0, np.inf)
    time_of_drift = levels.longest_m  # in seconds, as the path is
    drift = levels.sliding_rms * float(np.sqrt(2 / time_of_drift))
    slow = LONG * longest
    walk = replace(levels, sliding=drift * float(np.sqrt(slow / 2)), correlation_m=slow)
    # The more that is remembered, the more bands at long waves hold: a walk, where it may be one.
    may_walk = odds - evidence_of_sliding(left[None], time_s, taken[None], walk) < AS_PROBABLE
    return _Levels(float(levels.white[0]), drift, np.inf if may_walk else time_of_drift)
