"""A measured signal with its times, its sliding speed and what is known about the experiment."""

import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from srsinv.errors import BadInput, refuse

MIN_SAMPLES = 3
TIME, SPEED = "time_s", "speed_m_per_s"


@dataclass(frozen=True, eq=False)
class Recording:
    """One scan. Arrays are kept as read-only float64 copies.

    - `signal`: (element, sample), in `signal_unit`; NaN marks a missing sample.
    - `time_s`: (sample,), strictly increasing [s], from any origin.
    - `speed_m_per_s`: (sample,), sliding speed along x [m/s].
    - `channels`: the elements' names, in the order of `signal`'s rows.
    - `sidecar`: what the experimenter knows, a plain nested dict with SI units in its keys.
    - `signal_unit`: "V", "counts" or another.
    - `name`: what messages and titles call it; the file's name when it was loaded.

    Raises `BadInput` for shapes that do not agree, fewer than 3 samples, times that do not increase
    strictly, infinite values, NaN outside `signal`, and names that cannot head a column.
    """

    signal: np.ndarray
    time_s: np.ndarray
    speed_m_per_s: np.ndarray
    channels: tuple[str, ...]
    sidecar: dict[str, Any] = field(default_factory=dict)
    signal_unit: str = "V"
    name: str = "recording"

    def __post_init__(self):
        for key in ("signal", TIME, SPEED):
            values = np.array(getattr(self, key), dtype=np.float64)
            values.setflags(write=False)
            object.__setattr__(self, key, values)
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "sidecar", copy.deepcopy(dict(self.sidecar)))
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
        refuse(
            samples < MIN_SAMPLES,
            f"{self.name}: too few samples: {samples} where at least {MIN_SAMPLES} are needed: "
            "give a longer recording.",
        )

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
                channel in ("", TIME, SPEED) or channel != channel.strip(),
                f"{self.name}: {channel!r} cannot name a channel: use a name that is not empty, "
                f"{TIME} or {SPEED}, without spaces around it.",
            )

    def _check_values(self) -> None:
        named = {TIME: self.time_s, SPEED: self.speed_m_per_s}
        infinite = {column: ~np.isfinite(values) for column, values in named.items()}
        infinite |= dict(zip(self.channels, np.isinf(self.signal), strict=True))
        for column, bad in infinite.items():
            refuse(
                bool(bad.any()),
                f"{self.name}: {column} is not finite at data row {bad.argmax() + 1}: "
                "correct the value or leave the row out.",
            )
        stuck = np.flatnonzero(np.diff(self.time_s) <= 0)
        if stuck.size:
            row = int(stuck[0]) + 1
            before, after = self.time_s[row - 1], self.time_s[row]
            raise BadInput(
                f"{self.name}: time must increase strictly, but data row {row + 1} ({after} s) "
                f"does not come after data row {row} ({before} s): drop or reorder the rows, or "
                "give recording.sample_rate_hz=... in place of the times."
            )

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
        """Position (sample,) [m]: the exact integral of the piecewise linear speed, starting at the
        sidecar's `scan_start_m`, or at 0."""
        mean_speed = (self.speed_m_per_s[1:] + self.speed_m_per_s[:-1]) / 2
        travelled_m = np.cumsum(mean_speed * np.diff(self.time_s))
        return self._scan_start_m + np.concatenate(([0.0], travelled_m))

    @property
    def _scan_start_m(self) -> float:
        start_m = self.sidecar.get("scan_start_m")
        return 0.0 if start_m is None else float(start_m)

    def is_constant_speed(self, rtol: float = 1e-6) -> bool:
        """Whether the speed stays within `rtol` of its mean."""
        mean = np.mean(self.speed_m_per_s)
        return bool(np.max(np.abs(self.speed_m_per_s - mean)) <= rtol * abs(mean))

    def block_average(self, r: int) -> "Recording":
        """Means over blocks of `r` consecutive samples; what is left over at the end is dropped.

        A block with a missing sample is missing. Positions keep their origin. Raises `BadInput`
        for r < 1 or when fewer than 3 blocks are left.
        """
        samples = self.time_s.size
        most = samples // MIN_SAMPLES
        refuse(
            not 1 <= r <= most,
            f"{self.name}: blocks of {r} samples cannot be averaged in a recording of {samples}: "
            f"choose a block length from 1 to {most}, which leaves at least {MIN_SAMPLES} blocks.",
        )
        kept = samples // r * r

        def means(values: np.ndarray) -> np.ndarray:
            return values[..., :kept].reshape(*values.shape[:-1], -1, r).mean(axis=-1)

        # A block stands at the middle of its samples, so the first no longer stands at the start.
        shift_m = means(self.position_m)[0] - self._scan_start_m
        return self._resampled(
            means(self.signal), means(self.time_s), means(self.speed_m_per_s), float(shift_m)
        )

    def resample_uniform(self) -> "Recording":
        """Signal and speed interpolated linearly onto as many uniform times between the same ends.

        Meant for a small `sampling_jitter`; a sample is missing where a neighbour that it is drawn
        from is.
        """
        time_s = np.linspace(self.time_s[0], self.time_s[-1], self.time_s.size)
        signal, speed = (
            np.stack([np.interp(time_s, self.time_s, row) for row in rows])
            for rows in (self.signal, self.speed_m_per_s[None])
        )
        return self._resampled(signal, time_s, speed[0], 0.0)

    def _resampled(self, signal, time_s, speed_m_per_s, shift_m: float) -> "Recording":
        """The same scan at other times, the sidecar's rate and start following suit."""
        resampled = replace(self, signal=signal, time_s=time_s, speed_m_per_s=speed_m_per_s)
        if shift_m:
            resampled.sidecar["scan_start_m"] = self._scan_start_m + shift_m
        if "sample_rate_hz" in resampled.sidecar:
            resampled.sidecar["sample_rate_hz"] = resampled.sample_rate_hz
        return resampled
