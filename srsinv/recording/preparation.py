"""Preparation of a recording's signals: offset or trend, slow waves and lines filtered out (without
jax).

Filters run forwards and backwards, so that they shift no phase and act twice. With c = tan(pi f /
rate), a high-pass (Butterworth, order 2) at f_0 leaves 1 / (1 + (c_0 / c)^4) of an amplitude, half
at f_0; a notch (second order) of width w leaves half at both its edges, w apart, and nothing at its
centre. What a filter stops has to be stopped at the ends as well: each way begins in that state,
of the samples before the first, which leaves the least output, weighted by a taper, so that other
waves are not taken for the filter's own. A wave in a notch, or a straight line through a high-pass,
then leaves nothing from the first sample to the last, where zeros or a reflection before it would
leave a transient as large as the wave.

A missing sample stays missing. A filter takes it as what was filtered out there, and its neighbours
without that, interpolated, so that hum does not seem to pause there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.errors import is_number, refuse

from ._recording import Recording
from .mains import HIGHEST
from .noise import CUBIC, filled

NOTCH_WIDTH_HZ = 2.0  # where none is given: lines of mains wander by less than 1 Hz
ORDER = 2  # of the high-pass: what a random walk has below it is finite
DEGREES = {"constant": 0, "linear": 1}  # of the polynomial that each way of detrending fits
MOST_OF_BAND = 0.1  # that notches take: of more, the noise's level would be found too low
LEAST_OBSERVED = 0.5  # of a channel's samples: of fewer, a filter has interpolated ones to work on
LASTS = 25.0  # time constants, after which 1e-11 of a filter's response is left
TAPERED = 8.0  # time constants from either end that its state there is found from
MOST_ROUNDS = 30  # of filling; a gap of 50 ms in a notch of 2 Hz takes five
CLOSE = 1e-3  # of a filtered signal's rms, to which its missing samples are filled

Filter = tuple[Float[np.ndarray, " coefficient"], Float[np.ndarray, " coefficient"]]


class Preparation(NamedTuple):
    """What is taken out of every signal: its mean (`detrend` "constant") or straight line
    ("linear"), waves below `high_pass_Hz`, and those in notches `notch_width_Hz` wide."""

    detrend: str | None = None
    high_pass_Hz: float | None = None
    notch_Hz: tuple[float, ...] = ()
    notch_width_Hz: float = NOTCH_WIDTH_HZ

    @classmethod
    def of_facts(cls, facts: Mapping[str, Any]) -> "Preparation":
        """As a recording's facts ask for it."""
        high_pass, notch = facts.get("high_pass_Hz"), facts.get("notch_Hz")
        listed = [] if notch is None else notch if isinstance(notch, list) else [notch]
        return cls(
            facts.get("detrend"),
            None if high_pass is None else float(high_pass),
            tuple(float(each) for each in listed),
            float(facts.get("notch_width_Hz") or NOTCH_WIDTH_HZ),
        )

    @property
    def is_empty(self) -> bool:
        """Whether signals stay as they are."""
        return self.detrend is None and not self.has_filters

    @property
    def has_filters(self) -> bool:
        """Whether anything is filtered out."""
        return self.high_pass_Hz is not None or bool(self.notch_Hz)

    def filters(self, rate_hz: float) -> list[Filter]:
        """Numerator and denominator of each filter."""
        wanted = [
            scipy.signal.iirnotch(each, each / self.notch_width_Hz, fs=rate_hz)
            for each in self.notch_Hz
        ]
        if self.high_pass_Hz is not None:
            wanted.insert(0, scipy.signal.butter(ORDER, self.high_pass_Hz, "highpass", fs=rate_hz))
        return wanted


def prepare(recording: Recording) -> Recording:
    """The recording, at even times, with its signals prepared as its facts ask, and as they were in
    `raw_signal`; one that is prepared already stays as it is.

    Raises `BadInput` for frequencies beyond half the sampling rate, filters that the recording is
    too short for, and channels of which most samples are missing.
    """
    wanted = Preparation.of_facts(recording.sidecar)
    refuse(
        not wanted.notch_Hz and recording.sidecar.get("notch_width_Hz") is not None,
        f"{recording.name}: recording.notch_width_Hz is {wanted.notch_width_Hz!r} "
        "without recording.notch_Hz: give recording.notch_Hz, or leave the width out.",
    )
    _check_named_once(recording, wanted)
    if wanted.is_empty or recording.raw_signal is not None:
        return recording
    _check_high_pass(recording, wanted)
    _check_notches(recording, wanted)
    if wanted.has_filters:
        _check_observed(recording)
    filters = wanted.filters(recording.sample_rate_hz)
    rows = [_filtered(_detrended(row, wanted.detrend), filters) for row in recording.signal]
    return replace(recording, signal=np.stack(rows), raw_signal=recording.signal)


def _check_named_once(recording: Recording, wanted: Preparation) -> None:
    """Refuse a line that is to be filtered out and inverted beside the traction."""
    named = recording.sidecar.get("mains_Hz")
    for line in named if isinstance(named, list) else [named]:
        refuse(
            is_number(line) and any(abs(line - each) < 1 for each in wanted.notch_Hz),
            f"{recording.name}: {line} Hz is both in recording.notch_Hz and in "
            "recording.mains_Hz: leave it out of recording.notch_Hz.",
        )


def preparation_warnings(
    recording: Recording, highest_Hz: float, is_mean_known: bool = False
) -> tuple[str, ...]:
    """Warnings on what its preparation has taken of a recording's signals.

    `highest_Hz`: up to there lies what is to be found; a notch above it costs nothing.
    `is_mean_known`: whether the signal's mean shows the traction's, as that of a rate does not.
    """
    wanted = Preparation.of_facts(recording.sidecar)
    words = []
    not_held = "Bands and standard errors do not include this loss. Leave the setting out"
    if wanted.detrend == "linear" or (wanted.detrend == "constant" and is_mean_known):
        of_it = "the straight line" if wanted.detrend == "linear" else "the mean"
        words.append(
            f"recording.detrend={wanted.detrend} removed {of_it} of each signal, and with it a "
            f"part of the traction's signal. {not_held}, and give recording.drift, whose "
            "uncertainty they include."
        )
    if wanted.high_pass_Hz is not None:
        words.append(
            f"recording.high_pass_Hz={wanted.high_pass_Hz:g} removed slow waves of the traction's "
            f"signal with the drift. {not_held}, and give recording.drift, whose uncertainty they "
            "include."
        )
    inside = [each for each in wanted.notch_Hz if each - wanted.notch_width_Hz / 2 < highest_Hz]
    if inside:
        lines = ", ".join(f"{each:g}" for each in inside)
        words.append(
            f"recording.notch_Hz={lines} removed waves of the traction's signal, which reaches "
            f"{highest_Hz:.3g} Hz, with the hum. {not_held}, and give recording.mains_Hz, whose "
            "uncertainty they include."
        )
    return tuple(words)


def _check_high_pass(recording: Recording, wanted: Preparation) -> None:
    """Refuse a high-pass that is none: beyond the samples, or of a period beyond the recording."""
    if wanted.high_pass_Hz is None:
        return
    key = f"{recording.name}: recording.high_pass_Hz is {wanted.high_pass_Hz!r}"
    highest = HIGHEST * recording.sample_rate_hz / 2
    refuse(
        wanted.high_pass_Hz >= highest,
        f"{key}, too high for {recording.sample_rate_hz:.4g} samples per second: give "
        f"a frequency below {_rounded(highest)} Hz.",
    )
    lasts_s = _duration_s(recording)
    refuse(
        wanted.high_pass_Hz * lasts_s < 1,
        f"{key}, whose period is longer than the recording of {lasts_s:.4g} s: give "
        f"at least {_rounded(1 / lasts_s, up=True)}, or recording.detrend=linear "
        "instead.",
    )
    lowest = min(wanted.notch_Hz, default=np.inf) - wanted.notch_width_Hz / 2
    refuse(
        wanted.high_pass_Hz >= lowest,
        f"{key}, which also removes the notch from {_rounded(lowest)} Hz on: give "
        "less, or leave that notch out of recording.notch_Hz.",
    )


def _check_notches(recording: Recording, wanted: Preparation) -> None:
    """Refuse notches beyond the samples' frequencies, or too narrow or too wide for them."""
    name, half_width = recording.name, wanted.notch_width_Hz / 2
    half = recording.sample_rate_hz / 2
    for each in wanted.notch_Hz:
        refuse(
            each - half_width <= 0 or each + half_width >= HIGHEST * half,
            f"{name}: the notch of recording.notch_Hz at {each!r} Hz, "
            f"{wanted.notch_width_Hz!r} Hz wide, is not between 0 and "
            f"{_rounded(HIGHEST * half)} Hz: give another frequency or "
            "recording.notch_width_Hz, or leave it out.",
        )
    width = f"{name}: recording.notch_width_Hz is {wanted.notch_width_Hz!r}"
    count, lasts_s = len(wanted.notch_Hz), _duration_s(recording)
    refuse(
        count > 0 and wanted.notch_width_Hz * lasts_s < 1,
        f"{width}, too narrow for a recording of {lasts_s:.4g} s: give at least "
        f"{_rounded(1 / lasts_s, up=True)}, or use recording.mains_Hz instead of "
        "recording.notch_Hz.",
    )
    most = MOST_OF_BAND * half
    refuse(
        count * wanted.notch_width_Hz > most,
        f"{width} at {count} frequencies, more than {_rounded(most)} Hz in all, a "
        "tenth of the band: give narrower or fewer notches.",
    )


def _check_observed(recording: Recording) -> None:
    """Refuse channels with too few samples to filter."""
    for channel, row in zip(recording.channels, recording.signal, strict=True):
        count = int(np.isfinite(row).sum())
        refuse(
            count <= CUBIC or count < LEAST_OBSERVED * row.size,
            f"{recording.name}: channel {channel} has {count} of {row.size} samples, but "
            f"a filter needs {100 * LEAST_OBSERVED:.0f} %: leave out the channel, or "
            "recording.high_pass_Hz and recording.notch_Hz.",
        )


def _rounded(bound: float, *, up: bool = False) -> str:
    """A bound to four digits, towards what is within it: who gives these is not refused."""
    if not 0 < bound < np.inf:
        return f"{bound:.4g}"
    digit = 10.0 ** (np.floor(np.log10(bound)) - 3)
    steps = np.ceil(bound / digit - 1e-9) if up else np.floor(bound / digit + 1e-9)
    return f"{steps * digit:.4g}"


def _duration_s(recording: Recording) -> float:
    return float(recording.time_s[-1] - recording.time_s[0])


def _detrended(row: Float[np.ndarray, " sample"], way: str | None) -> Float[np.ndarray, " sample"]:
    """The row less its least-squares polynomial over the samples that are not missing."""
    observed = np.isfinite(row)
    if way is None or not observed.any():
        return row
    powers = np.linspace(-1, 1, row.size)[:, None] ** np.arange(DEGREES[way] + 1)
    return row - powers @ np.linalg.lstsq(powers[observed], row[observed], rcond=None)[0]


def _filtered(
    row: Float[np.ndarray, " sample"], filters: Sequence[Filter]
) -> Float[np.ndarray, " sample"]:
    """The row through all filters, both ways."""
    if not filters:
        return row
    at = np.flatnonzero(np.isfinite(row))
    inside = slice(int(at[0]), int(at[-1]) + 1)  # a spline is no guide beyond its ends
    result = row.copy()
    result[inside] = _filtered_between(row[inside], filters)
    return result


def _filtered_between(
    row: Float[np.ndarray, " sample"], filters: Sequence[Filter]
) -> Float[np.ndarray, " sample"]:
    """As `_filtered`, of a row whose first and last samples are not missing."""
    observed = np.isfinite(row)
    whole = filled(row)
    passed = _through(whole, filters)
    for _ in range(0 if observed.all() else MOST_ROUNDS):
        better = filled(np.where(observed, passed, np.nan)) + whole - passed
        change = np.max(np.abs(better - whole)[~observed])
        whole = np.where(observed, row, better)
        passed = _through(whole, filters)
        if change <= CLOSE * np.std(passed[observed]):
            break
    return np.where(observed, passed, np.nan)


def _through(
    row: Float[np.ndarray, " sample"], filters: Sequence[Filter]
) -> Float[np.ndarray, " sample"]:
    for each in filters:
        row = _one_way(_one_way(row, each)[::-1], each)[::-1]
    return row


def _one_way(row: Float[np.ndarray, " sample"], given: Filter) -> Float[np.ndarray, " sample"]:
    """The row through a filter, from that initial state which leaves the least output."""
    numerator, denominator = given
    result = scipy.signal.lfilter(numerator, denominator, row)
    slowest = float(np.max(np.abs(np.roots(denominator))))
    time_constant = -1 / np.log(slowest) if 0 < slowest < 1 else 1.0  # in samples
    count = int(min(row.size, np.ceil(LASTS * time_constant) + ORDER))
    responses = np.stack(
        [
            scipy.signal.lfilter(numerator, denominator, np.zeros(count), zi=state)[0]
            for state in np.eye(ORDER)
        ],
        axis=1,
    )
    near = int(min(row.size, np.ceil(TAPERED * time_constant) + ORDER))
    taper = scipy.signal.windows.hann(near + 2)[1:-1]
    state = np.linalg.lstsq(taper[:, None] * responses[:near], taper * result[:near], rcond=None)[0]
    result[:count] -= responses @ state
    return result
