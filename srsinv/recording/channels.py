"""Faults of channels that their samples show by themselves: stuck, clipped, rounded.

Noise makes neighbouring samples differ. Where a fraction f of the neighbouring pairs of white noise
in steps are equal, the next sample is equal to a given one with a probability of at most root 2 f
(the normal density's peak over that of differences at zero), so that among n samples a run of L
equal ones is expected n (root 2 f)^(L - 1) times or less. Noise below half a step leaves rounding
errors that are neither white nor independent (Widrow's condition); every second pair is then equal.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .. import false_alarm, numerics
from ._health import FLAT, quantisation_step

_AS_MISSING = (
    "leave their cells empty (NaN in an array) and set recording.missing=allow, so that they are "
    "missing samples"
)
ROUNDED = 0.5  # of neighbouring pairs that are equal where a step is twice the noise


def channel_findings(
    channels: Sequence[str], signal: Float[np.ndarray, "element sample"], unit: str
) -> tuple[str, ...]:
    """Faults of channels, as sentences; NaN marks a missing sample."""
    named = zip(channels, np.asarray(signal, float), strict=True)
    return tuple(each for name, row in named for each in _findings(name, row, unit))


def _findings(name: str, values: Float[np.ndarray, " sample"], unit: str) -> Sequence[str]:
    runs, equal = repeats(values)
    pairs = np.isfinite(values[1:] - values[:-1]).sum()
    if not runs or pairs < FLAT:
        return ()
    longest = max(stop - start for start, stop in runs)
    rest = max(pairs - longest + 1, 1)
    fraction = min(max(equal - longest + 2, 1) / rest, 1.0)
    if fraction > ROUNDED:
        step = quantisation_step(values)
        steps = "" if step is None else f", in steps of {step:.3g} {unit}"
        return (
            f"{name}: {fraction:.0%} of its samples are equal to the one before{steps}: it is "
            "rounded to more than its noise, or each sample is stored several times, and the bands "
            "take neither into account: record it with more gain, or leave the rows that repeat "
            "others out, and, where there is no column of times, give recording.sample_rate_hz of "
            "those that are left.",
        )
    log_alarm = np.log(values.size) + (np.arange(longest + 1) - 1) * np.log(
        min(np.sqrt(2) * fraction, 1.0)
    )
    significant = [
        run
        for run in runs
        if run[1] - run[0] >= FLAT and log_alarm[run[1] - run[0]] < np.log(false_alarm.CHANNEL)
    ]
    return _described(name, values, significant)


def repeats(values: Float[np.ndarray, " sample"]) -> tuple[list[tuple[int, int]], int]:
    """Runs [start, stop) of two and more equal samples, and the number of equal neighbours."""
    same = values[1:] == values[:-1]
    return [(start, stop + 1) for start, stop in numerics.runs(same)], int(same.sum())


def _described(
    name: str, values: Float[np.ndarray, " sample"], runs: Sequence[tuple[int, int]]
) -> Sequence[str]:
    extremes = np.nanmin(values), np.nanmax(values)
    clipped = [run for run in runs if values[run[0]] in extremes]
    stuck = [run for run in runs if values[run[0]] not in extremes]
    words = []
    if stuck:
        words.append(
            f"{name} is stuck: {_samples(stuck)} have one value over and over, where noise makes "
            f"them differ: {_AS_MISSING}, or record it again."
        )
    if clipped:
        words.append(
            f"{name} is clipped: {_samples(clipped)} are flat at its least or greatest value: "
            f"{_AS_MISSING}, or record it again with less gain."
        )
    return words


def _samples(runs: Sequence[tuple[int, int]]) -> str:
    first, count = runs[0][0] + 1, sum(stop - start for start, stop in runs)
    more = f" at {len(runs)} places" if len(runs) > 1 else ""
    return f"{count} samples{more}, from number {first} on,"
