"""Faults of channels that their samples show by themselves: stuck, clipped, rounded.

Noise makes neighbouring samples differ. Where a fraction f of the neighbouring pairs of white noise
in steps are equal, the next sample is equal to a given one with a probability of at most root 2 f
(the normal density's peak over that of differences at zero), so that among n samples a run of L
equal ones is expected n (root 2 f)^(L - 1) times or less. Noise below half a step leaves rounding
errors that are neither white nor independent (Widrow's condition); every second pair is then equal.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .. import false_alarm, numerics
from ._health import FLAT, quantisation_step

MISSING_INSTEAD = "Set recording.unusable=missing, so that they are missing samples"
ROUNDED = 0.5  # of neighbouring pairs that are equal where a step is twice the noise
Run = tuple[int, int]


class FlatSamples(NamedTuple):
    """Samples (sample,) of a channel that are one value over and over: [start, stop) of the runs
    that are `stuck`, and of those that are `clipped` at the least or greatest value; `rounded`: a
    sentence where the channel is in steps above its noise, and no run means anything."""

    stuck: Sequence[Run] = ()
    clipped: Sequence[Run] = ()
    rounded: str = ""

    def masks(self, values: Float[np.ndarray, " sample"]) -> tuple[np.ndarray, np.ndarray]:
        """Which samples (sample,) of these values are stuck, and which are clipped: of a clipped
        extreme also those that are alone."""
        stuck = np.zeros(values.shape, bool)
        for start, stop in self.stuck:
            stuck[start:stop] = True
        return stuck, np.isin(values, [values[start] for start, _ in self.clipped])


def channel_findings(
    channels: Sequence[str], signal: Float[np.ndarray, "element sample"], unit: str
) -> tuple[str, ...]:
    """Faults of channels, as sentences; NaN marks a missing sample."""
    named = zip(channels, np.asarray(signal, float), strict=True)
    return tuple(each for name, row in named for each in _findings(name, row, unit))


def _findings(name: str, values: Float[np.ndarray, " sample"], unit: str) -> Iterable[str]:
    flat = flat_samples(name, values, unit)
    return [flat.rounded] if flat.rounded else flat_sentences(name, flat, values, MISSING_INSTEAD)


def flat_samples(name: str, values: Float[np.ndarray, " sample"], unit: str) -> FlatSamples:
    """The samples of a channel that are flat where noise makes them differ; NaN is missing."""
    runs, equal = repeats(values)
    pairs = np.isfinite(values[1:] - values[:-1]).sum()
    if not runs or pairs < FLAT:
        return FlatSamples()
    longest = max(stop - start for start, stop in runs)
    rest = max(pairs - longest + 1, 1)
    fraction = min(max(equal - longest + 2, 1) / rest, 1.0)
    if fraction > ROUNDED:
        step = quantisation_step(values)
        steps = "" if step is None else f", in steps of {step:.3g} {unit}"
        return FlatSamples(
            rounded=f"{name}: {100 * fraction:.0f} % of its samples are equal to the one "
            f"before{steps}: it is rounded to more than its noise, or each sample is stored "
            "several times, and the bands take neither into account: record it with more gain, or "
            "leave the rows that repeat others out, and, where there is no column of times, give "
            "recording.sample_rate_hz of those that are left.",
        )
    log_alarm = np.log(values.size) + (np.arange(longest + 1) - 1) * np.log(
        min(np.sqrt(2) * fraction, 1.0)
    )
    significant = [
        run
        for run in runs
        if run[1] - run[0] >= FLAT and log_alarm[run[1] - run[0]] < np.log(false_alarm.CHANNEL)
    ]
    extremes = np.nanmin(values), np.nanmax(values)
    return FlatSamples(
        [run for run in significant if values[run[0]] not in extremes],
        [run for run in significant if values[run[0]] in extremes],
    )


def repeats(values: Float[np.ndarray, " sample"]) -> tuple[list[Run], int]:
    """Runs [start, stop) of two and more equal samples, and the number of equal neighbours."""
    same = values[1:] == values[:-1]
    return [(start, stop + 1) for start, stop in numerics.runs(same)], int(same.sum())


def flat_sentences(
    name: str, flat: FlatSamples, values: Float[np.ndarray, " sample"], kept: str = ""
) -> Iterator[str]:
    """What is stuck and what is clipped in a channel. It is taken as missing, or, where there is a
    remedy for that in `kept`, stays."""
    stuck, clipped = flat.masks(values)
    missing = "They are taken as missing"
    if stuck.any():
        fate = f"The answer uses them. {kept}" if kept else f"{missing}. Check the wiring"
        yield (
            f"{name} is stuck: {samples_of(stuck)} repeat one value, although noise should make "
            f"them differ. {fate}, or record it again."
        )
    if clipped.any():
        fate = (
            f"The answer uses them. {kept}, or record it again with less gain."
            if kept
            else f"{missing}, so the answer lacks the strongest part of the signal. Record it "
            "again with less gain."
        )
        yield (
            f"{name} is clipped: {samples_of(clipped)} are flat at its least or greatest value. "
            f"{fate}"
        )


def samples_of(mask: Bool[np.ndarray, " sample"]) -> str:
    """How many samples, and where the first is."""
    runs, count = numerics.runs(mask), int(mask.sum())
    more = f" at {len(runs)} places" if len(runs) > 1 else ""
    number = f"number {runs[0][0] + 1}"
    return f"1 sample, {number}," if count == 1 else f"{count} samples{more}, from {number} on,"
