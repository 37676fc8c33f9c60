"""A measured signal with its times, its sliding speed and facts about the experiment."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from srsinv.errors import LARGEST, BadInput, refuse
from srsinv.numerics import pairwise_cumsum

MIN_SAMPLES = 3
TIME, SPEED, POSITION = "time_s", "speed_m_per_s", "position_m"
# Words in place of tolerances: all facts are exact; all have the tolerances of a rig made by hand.
NO_TOLERANCE, HAND_MADE = TOLERANCE_WORDS = "none", "default"


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording of one scan: signals, times, motion and the facts of its sidecar.

    Arrays are stored as read-only float64 copies.

    - `signal`: (element, sample), in `signal_unit`; NaN marks a missing sample.
    - `time_s` (sample,) [s]: strictly increasing, from any origin.
    - `speed_m_per_s` (sample,) [m/s]: sliding speed along x.
    - `channels`: the elements' names, in the order of `signal`'s rows.
    - `sidecar`: the experimenter's facts, a nested dict with SI units in its keys.
    - `signal_unit`: "V", "counts" or another.
    - `name`: for messages and titles; the file's name when it was loaded.
    - `measured_position_m` (sample,) [m]: position along x where it was measured, else None.
    - `missing_rows`, `gaps`: number of rows missing by the times, and of gaps; they are missing
      samples.
    - `notes`: what was done while the file was read, in sentences; `doubts`: what is uncertain
      about it, so that no answer from it is sure.
    - `raw_signal`: (element, sample), the signal before its preparation; None for
      one that is as recorded.

    Raises `BadInput` for shapes that do not agree, fewer than 3 samples, times that do not increase
    strictly, infinite values, NaN outside `signal`, names that cannot head a column, and facts that
    a sidecar cannot state.
    """

    signal: np.ndarray
    time_s: np.ndarray
    speed_m_per_s: np.ndarray
    channels: tuple[str, ...]
    sidecar: dict[str, Any] = field(default_factory=dict)
    signal_unit: str = "V"
    name: str = "recording"
    measured_position_m: np.ndarray | None = None
    missing_rows: int = 0
    gaps: int = 0
    raw_signal: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def __post_init__(self):
        for key in ("signal", TIME, SPEED, "measured_position_m", "raw_signal"):
            if getattr(self, key) is None:
                continue
            values = np.array(getattr(self, key), dtype=np.float64)
            values.setflags(write=False)
            object.__setattr__(self, key, values)
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "sidecar", copy.deepcopy(dict(self.sidecar)))
        from ._schema import check_facts  # pydantic, for what is read from files alone

        check_facts(self.name, self.sidecar)
        self._check_shapes()
        self._check_channels()
        self._check_values()

    def _check_shapes(self) -> None:
        samples, elements = self.time_s.size, len(self.channels)
        shapes = (self.signal.shape, self.time_s.shape, self.speed_m_per_s.shape)
        refuse(
            shapes != ((elements, samples), (samples,), (samples,)),
            f"{self.name}: signal, time_s and speed_m_per_s have shapes {shapes[0]}, {shapes[1]} "
            f"and {shapes[2]} for {elements} channels: give (element, sample), (sample,) and "
            "(sample,).",
        )
        position = self.time_s if self.measured_position_m is None else self.measured_position_m
        refuse(
            position.shape != (samples,),
            f"{self.name}: measured_position_m has shape {position.shape} for {samples} samples: "
            "give (sample,).",
        )
        check_samples(self.name, samples)

    def _check_channels(self) -> None:
        refuse(
            not self.channels,
            f"{self.name}: no channel: name at least one in recording.channels=[...].",
        )
        for index, channel in enumerate(self.channels):
            refuse(
                channel in self.channels[:index],
                f"{self.name}: channel {channel!r} is named twice: name each channel once.",
            )
            refuse(
                channel in ("", TIME, SPEED, POSITION) or channel != channel.strip(),
                f"{self.name}: {channel!r} cannot name a channel: use a name that is not empty, "
                f"{TIME}, {SPEED} or {POSITION}, without spaces around it.",
            )

    def _check_values(self) -> None:
        named = {TIME: self.time_s, SPEED: self.speed_m_per_s}
        if self.measured_position_m is not None:
            named[POSITION] = self.measured_position_m
        infinite = {column: ~np.isfinite(values) for column, values in named.items()}
        infinite |= dict(zip(self.channels, np.isinf(self.signal), strict=True))
        for column, bad in infinite.items():
            refuse(
                bool(bad.any()),
                f"{self.name}: {column} is not finite at data row {bad.argmax() + 1}: "
                "correct the value or drop the row.",
            )
        for column, values in named.items():
            check_range(self.name, column, values)
        check_times(self.name, self.time_s)

    @property
    def sample_rate_hz(self) -> float:
        """Mean sample rate [Hz] over the recording."""
        return (self.time_s.size - 1) / float(self.time_s[-1] - self.time_s[0])

    @property
    def sampling_jitter(self) -> float:
        """Largest departure of a sampling interval from their median, as a fraction of it."""
        interval_s = np.diff(self.time_s)
        median_s = np.median(interval_s)
        return float(np.max(np.abs(interval_s - median_s)) / median_s)

    @property
    def position_m(self) -> np.ndarray:
        """Position (sample,) [m]: as measured, or else the exact integral of the piecewise linear
        speed, starting at the sidecar's `scan_start_m`, or at 0.

        Linear, because a smoother curve through the speeds would ring where a scan starts or stops
        abruptly.
        """
        if self.measured_position_m is not None:
            return self.measured_position_m
        mean_speed = (self.speed_m_per_s[1:] + self.speed_m_per_s[:-1]) / 2
        travelled_m = pairwise_cumsum(mean_speed * np.diff(self.time_s))
        return self._scan_start_m + np.concatenate(([0.0], travelled_m))

    @property
    def _scan_start_m(self) -> float:
        start_m = self.sidecar.get("scan_start_m")
        return 0.0 if start_m is None else float(start_m)

    def is_constant_speed(self, rtol: float = 1e-6) -> bool:
        """Whether the speed stays within `rtol` of its mean."""
        mean = np.mean(self.speed_m_per_s)
        return bool(np.max(np.abs(self.speed_m_per_s - mean)) <= rtol * abs(mean))

    def resample_uniform(self) -> "Recording":
        """Signal, speed and measured position, interpolated linearly at evenly spaced times between
        the same ends.

        It is meant for a small `sampling_jitter`. A sample is missing if one of the two that it is
        interpolated from is missing.
        """
        time_s = np.linspace(self.time_s[0], self.time_s[-1], self.time_s.size)

        def at_even_times(values: np.ndarray) -> np.ndarray:
            return np.interp(time_s, self.time_s, values)

        position_m = self.measured_position_m
        resampled = replace(
            self,
            signal=np.stack([at_even_times(row) for row in self.signal]),
            time_s=time_s,
            speed_m_per_s=at_even_times(self.speed_m_per_s),
            measured_position_m=None if position_m is None else at_even_times(position_m),
        )
        if "sample_rate_hz" in resampled.sidecar:
            resampled.sidecar["sample_rate_hz"] = resampled.sample_rate_hz
        return resampled


def check_samples(name: str, samples: int) -> None:
    """Refuse a recording of too few samples."""
    refuse(
        samples < MIN_SAMPLES,
        f"{name}: {samples} samples are too few: give a recording of at least {MIN_SAMPLES}.",
    )


def _number(index: int) -> int:
    """The number of a data row where all are there."""
    return index + 1


def check_range(
    name: str, column: str, values: np.ndarray, row_of: Callable[[int], int] = _number
) -> None:
    """Refuse times, speeds or positions (sample,) that are beyond `LARGEST` SI units."""
    outside = np.abs(values) > LARGEST
    if outside.any():
        row = int(outside.argmax())
        raise BadInput(
            f"{name}: {column} is {values[row]:g} at data row {row_of(row)}, beyond {LARGEST:g}: "
            "correct the value or its unit, or drop the row if the file has times."
        )


def check_times(name: str, time_s: np.ndarray, row_of: Callable[[int], int] = _number) -> None:
    """Refuse times (sample,) [s] that do not increase strictly, or hardly."""
    check_range(name, TIME, time_s, row_of)
    stuck = np.flatnonzero(np.diff(time_s) <= 0)
    if stuck.size:
        row = int(stuck[0]) + 1
        is_equal = time_s[row] == time_s[row - 1]
        remedy = "drop it or write more digits" if is_equal else "reorder the rows"
        raise BadInput(
            f"{name}: data row {row_of(row)} ({time_s[row]} s) does not come after data row "
            f"{row_of(row - 1)} ({time_s[row - 1]} s): {remedy}, or, if only the times are wrong, "
            "give recording.times=ignore and recording.sample_rate_hz=..."
        )
    close = np.flatnonzero(np.diff(time_s) < 1 / LARGEST)
    if close.size:
        row = int(close[0]) + 1
        raise BadInput(
            f"{name}: data row {row_of(row)} comes {time_s[row] - time_s[row - 1]:g} s after data "
            f"row {row_of(row - 1)}, less than {1 / LARGEST:g} s: correct the times or their unit."
        )
