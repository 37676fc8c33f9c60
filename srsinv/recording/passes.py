"""Passes of a motion that turns, and what differs between those of one way (without jax)."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from srsinv.numerics import runs

SHORT = 0.1  # of the travelled range: a shorter way back is no pass
MOST_POSITIONS = 10_000  # that turns are looked for among
STILL = 0.02  # of the greatest speed: slower is standing still
SHORTEST_S = 0.2  # that it has to stand still
_LONGEST_MARGIN = 0.25  # of the shortest pass, that a turn may act on
_BINS = 40
_EXCESS = 4.0  # times the mean square before a turn; in noise alone that of so many samples is 2
_FEWEST_IN_BIN = 16  # samples
JOINT = 50  # samples, whose means join one difference to the next


class Pass(NamedTuple):
    """The `samples` of a motion from turn to turn, and whether it is towards +x."""

    samples: slice
    is_onwards: bool


def passes_of(position_m: Float[np.ndarray, " sample"]) -> tuple[Pass, ...]:
    """The passes of a motion, in the order of time: from turning points that are `SHORT` of its
    range apart, whatever it does in between. One alone where it does not turn, none where it
    stands."""
    every = max(position_m.size // MOST_POSITIONS, 1)
    x = np.asarray(position_m, float)[::every].tolist()
    least = SHORT * float(np.ptp(position_m))
    turns: list[tuple[int, bool]] = []  # where each pass starts, and its way
    low = high = 0
    for i, at in enumerate(x if least > 0 else ()):
        low, high = (i if at < x[low] else low), (i if at > x[high] else high)
        if (not turns or not turns[-1][1]) and at - x[low] >= least:
            turns.append((low, True))
            high = i
        elif (not turns or turns[-1][1]) and x[high] - at >= least:
            turns.append((high, False))
            low = i
    starts = [0, *(every * start for start, _ in turns[1:]), position_m.size]
    return tuple(
        Pass(slice(start, stop), way)
        for start, stop, (_, way) in zip(starts[:-1], starts[1:], turns, strict=False)
    )


def still_samples(
    speed_m_per_s: Float[np.ndarray, " sample"], rate_hz: float
) -> Bool[np.ndarray, " sample"]:
    """Where a sensor stands still for long enough to show its noise."""
    speed = np.abs(speed_m_per_s)
    is_still = speed < STILL * speed.max()
    for start, stop in runs(is_still):
        is_still[start:stop] = stop - start >= SHORTEST_S * rate_hz
    return is_still


def is_within(passes: Sequence[Pass], samples: int) -> Bool[np.ndarray, " sample"]:
    """Which of so many samples the passes hold."""
    inside = np.zeros(samples, bool)
    for each in passes:
        inside[each.samples] = True
    return inside


def go_both_ways(passes: Sequence[Pass]) -> bool:
    """Whether there are passes towards +x and towards -x."""
    return len({each.is_onwards for each in passes}) > 1


def near_turns(
    position_m: Float[np.ndarray, " sample"], margin_m: float
) -> Bool[np.ndarray, " sample"]:
    """Which samples lie within `margin_m` of where their pass begins or ends by a turn."""
    near, passes = np.zeros(position_m.size, bool), passes_of(position_m)
    for before, after in itertools.pairwise(passes):
        turn_m = position_m[after.samples.start]
        for each in (before.samples, after.samples):
            near[each] |= np.abs(position_m[each] - turn_m) <= margin_m
    return near


def margin_of_turns(
    signal: Float[np.ndarray, "e sample"], position_m: Float[np.ndarray, " sample"]
) -> float | None:
    """How far behind its turns a motion makes signals that are not there before them, [m]; None
    where it makes none.

    Shear turns over while the skin slips by some tenths of a millimetre after a turn. Then the mean
    square of the signals after turns exceeds that at the same distance before them, from the turn
    on. Texture makes as much on both sides.
    """
    passes = passes_of(position_m)
    shortest_m = min((np.ptp(position_m[each.samples]) for each in passes), default=0.0)
    if len(passes) < 3 or not shortest_m > 0:
        return None
    width_m = _LONGEST_MARGIN * shortest_m / _BINS
    squares = np.zeros((2, _BINS))
    counts = np.zeros((2, _BINS))
    power = np.where(np.isfinite(signal), signal - np.nanmean(signal, axis=1)[:, None], 0.0) ** 2
    for before, after in itertools.pairwise(passes):
        turn_m = position_m[after.samples.start]
        for side, each in enumerate((before.samples, after.samples)):
            at = (np.abs(position_m[each] - turn_m) / width_m).astype(int)
            inside = at < _BINS
            squares[side] += np.bincount(
                at[inside], power[:, each].sum(axis=0)[inside], minlength=_BINS
            )
            counts[side] += np.bincount(at[inside], minlength=_BINS)
    means = squares / np.maximum(counts, 1)
    exceeds = (means[1] > _EXCESS * means[0]) & (counts.min(axis=0) >= _FEWEST_IN_BIN)
    bins = int(np.argmin(exceeds)) if not exceeds.all() else _BINS
    return None if bins == 0 else (bins + 1) * width_m


def with_backlash(
    position_m: Float[np.ndarray, " sample"], backlash_m: float
) -> Float[np.ndarray, " sample"]:
    """Positions with so much added on the way back."""
    moved = np.array(position_m, float)
    for each in passes_of(position_m):
        moved[each.samples] += 0.0 if each.is_onwards else backlash_m
    return moved


def pass_differences(
    signal: Float[np.ndarray, "e sample"],
    position_m: Float[np.ndarray, " sample"],
    passes: Sequence[Pass],
) -> Float[np.ndarray, "e row"]:
    """What each pass differs by from the next of its way at the same places, over sqrt(2): noise as
    in one pass, without what repeats. One after the other, each from where the last one ended; none
    where no way is passed twice."""
    pieces = []
    for way in (True, False):
        own = [each.samples for each in passes if each.is_onwards == way]
        for before, after in zip(own[:-1:2], own[1::2], strict=False):
            x, there = position_m[before], position_m[after]
            order = np.argsort(there, kind="stable")
            inside = (there.min() <= x) & (x <= there.max())
            other = [np.interp(x[inside], there[order], row[after][order]) for row in signal]
            pieces.append((signal[:, before][:, inside] - other) / np.sqrt(2))
    joined = [np.zeros((len(signal), 0))]
    for piece in pieces:
        if joined[-1].shape[1]:
            last, first = joined[-1][:, -JOINT:], piece[:, :JOINT]
            piece = piece + np.nan_to_num(_means(last) - _means(first))[:, None]
        joined.append(piece)
    return np.concatenate(joined, axis=1)


def _means(rows: Float[np.ndarray, "e sample"]) -> Float[np.ndarray, " e"]:
    """The mean of each row's samples that are there; NaN where none is."""
    count = np.isfinite(rows).sum(axis=1)
    none = np.full(len(rows), np.nan)
    return np.divide(np.nansum(rows, axis=1), count, out=none, where=count > 0)
