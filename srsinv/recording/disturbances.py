"""What is on a recording besides the touch: hum, drift, and a motion that turns."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._recording import Recording
from .drift import drift_of
from .mains import FUNDAMENTALS_HZ, MainsLine, mains_lines
from .passes import STILL, margin_of_turns, passes_of, still_samples

LONG_ENOUGH_S = 0.5  # of standing still, for a drift to be measured there


class Disturbances(NamedTuple):
    """Hum, drift and turns of a recording at even times.

    - `lines`: the lines of mains that noise does not make, `nominal_Hz` the multiples of 50 or 60
      Hz that they are.
    - `hum_rms`: (e,) of all lines together, `hum_ratio` (e,) the same over the rms of all else.
    - `drift`: (e,) rms of a random walk after a second; 0 where none is found.
    - `turn_margin_m`: how far behind turns signals are made by them; None where none is found.
    - `unit` of both, after the gain.
    - `speed_m_per_s`: mean of its size while the sensor slides; `onwards`, `back`: passes towards
      +x and -x; `duration_s`; `still_s`: for how long the sensor stands still.
    """

    lines: tuple[MainsLine, ...]
    nominal_Hz: tuple[int, ...]
    hum_rms: Float[np.ndarray, " e"]
    hum_ratio: Float[np.ndarray, " e"]
    drift: Float[np.ndarray, " e"]
    turn_margin_m: float | None
    unit: str
    speed_m_per_s: float
    onwards: int
    back: int
    duration_s: float
    still_s: float

    @property
    def overrides(self) -> tuple[str, ...]:
        """Settings with which an inversion takes hum, drift and turns into account."""
        listed = ",".join(map(str, self.nominal_Hz))
        hum = (f"recording.mains_Hz=[{listed}]",) if self.nominal_Hz else ()
        shown = "quiet_s" if self.still_s > LONG_ENOUGH_S else "drift"
        drift = (f"recording.{shown}=auto",) if self.drift.any() else ()
        turns = self.turn_margin_m
        margin = () if turns is None else (f"recording.turn_margin_m={turns:.2g}",)
        return (*hum, *drift, *margin)


def disturbances(recording: Recording) -> Disturbances:
    """Those of a recording at even times."""
    rate_hz, valid = recording.sample_rate_hz, np.isfinite(recording.signal)
    # Scaled to one: squares of a signal in femtovolts would leave float64's range.
    size = float(np.max(np.abs(recording.signal), initial=0.0, where=valid)) or 1.0
    signal = recording.signal / size
    lines = tuple(line._replace(rms=size * line.rms) for line in mains_lines(signal, rate_hz))
    squares = [(line.rms / size) ** 2 for line in lines]
    hum_rms = np.sqrt(np.sum([np.zeros(len(signal)), *squares], axis=0))
    counts = np.maximum(valid.sum(axis=1), 1)
    mean = np.sum(np.where(valid, signal, 0.0), axis=1) / counts
    square = np.sum(np.where(valid, signal - mean[:, None], 0.0) ** 2, axis=1) / counts
    # A line's rms is an estimate: where there is hardly anything else it may exceed the whole.
    rest = np.sqrt(np.maximum(square - hum_rms**2, 1e-6 * square))
    speed_m_per_s = np.abs(recording.speed_m_per_s)
    slides = speed_m_per_s >= STILL * speed_m_per_s.max()
    ways = [each.is_onwards for each in passes_of(recording.position_m)]
    return Disturbances(
        lines=lines,
        nominal_Hz=nominal(lines),
        hum_rms=size * hum_rms,
        hum_ratio=np.divide(hum_rms, rest, out=np.zeros_like(rest), where=rest > 0),
        drift=size * drift_of(replace(recording, signal=signal)),
        turn_margin_m=margin_of_turns(signal, recording.position_m),
        unit=recording.signal_unit,
        speed_m_per_s=float(np.mean(speed_m_per_s[slides])),
        onwards=sum(ways),
        back=len(ways) - sum(ways),
        duration_s=float(recording.time_s[-1] - recording.time_s[0]),
        still_s=float(still_samples(recording.speed_m_per_s, rate_hz).sum() / rate_hz),
    )


def nominal(lines: Sequence[MainsLine]) -> tuple[int, ...]:
    """The multiples of one fundamental that the lines are."""
    measured = np.array([line.frequency_Hz for line in lines])
    multiples = [each * np.maximum(np.round(measured / each), 1) for each in FUNDAMENTALS_HZ]
    nominal = min(multiples, key=lambda each: np.sum(np.abs(measured - each)))
    # Two broad maxima may be of one line.
    return tuple(dict.fromkeys(int(each) for each in nominal))
