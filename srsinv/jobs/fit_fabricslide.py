"""The pitch of a ridged surface from all channels of a recording together, and its other lines.

Method and derivation of the standard errors: [`srsinv.inverse.spectral_lines`][].
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float

from .. import config
from ..errors import is_number, refuse
from ..inverse.quality import Quality, quality, reasons
from ..inverse.spectral_lines import (
    LEAST_PERIODS,
    Pitch,
    SpectralPeak,
    SpectralPeaks,
    channel_pitches,
    drift,
    find_lines,
    fit_pitch,
)
from ..progress import stage
from ..recording import Recording
from ..recording.even import load_steady
from ..recording.noise import filled
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from ..report.text import format_with_error
from ..status import Status
from .analysis import in_metrics
from .recorded import times_rows

LONGEST_LINE = 0.25  # of the scan: longer periods are not distinguished from drift
HIGHEST_FRACTION = 6  # of one line to another: beyond, some fraction always fits
SHORT_GAP = 0.25  # of the shortest pitch: a spline over it is off by some hundredths of a pattern
MM = 1e3

Rows = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Settings:
    """`feature` and `fit_fabricslide` of the configuration, checked against the recording."""

    range_m: tuple[float, float]
    harmonics: int
    false_alarm: float


@dataclass(frozen=True)
class BoardPitch:
    """Results for the page; `channels` and their standard errors are pitches (c,) [m]."""

    recording: Recording
    x_m: Float[np.ndarray, " n"]
    signal: Float[np.ndarray, "c n"]
    settings: Settings
    degree: int
    pitch: Pitch
    channels: Float[np.ndarray, " c"]
    channels_stderr: Float[np.ndarray, " c"]
    others: SpectralPeaks

    @property
    def false_alarm(self) -> float:
        """Probability that noise alone has a line as strong as the pitch's strongest."""
        return self.others.false_alarm_at(self.pitch.pitch_m, self.settings.harmonics)

    @property
    def status(self) -> Status:
        """How the search ended; an insignificant pitch is no answer."""
        if self.pitch.status.is_answer and self.false_alarm > self.settings.false_alarm:
            return Status.NOT_SIGNIFICANT
        return self.pitch.status

    @property
    def quality(self) -> Quality:
        """Good or failed: the standard error is the scan's own, whatever the noise is."""
        return quality(self.status, None, self.warnings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on the pitch: none beside its status."""
        return ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings)


def run(cfg: config.Config) -> Outcome:
    """The job: load, fit the pitch, look for other lines, report."""
    with config.precision(cfg):
        recording = load_steady(cfg["recording"], {}, config.reader(cfg))
        x_m, signal = _along_x(recording)
        pitch_range = cfg["feature"]["pitch_range_m"]
        settings = _settings(cfg["fit_fabricslide"], pitch_range, recording.name, x_m)
        signal = _without_gaps(recording.name, x_m, signal, settings.range_m[0])
        slow = drift(x_m, 2 * settings.range_m[1])
        with stage("fitting the pitch"):
            pitch = fit_pitch(x_m, signal, slow, settings.range_m, settings.harmonics)
            alone = channel_pitches(x_m, signal, slow, pitch.pitch_m, settings.harmonics)
        with stage("looking for other lines"):
            others = find_lines(
                x_m,
                signal,
                (pitch.pitch_m, settings.harmonics),
                LONGEST_LINE * (x_m[-1] - x_m[0]),
                settings.false_alarm,
            )
    analysis = BoardPitch(
        recording, x_m, signal, settings, slow.shape[1] - 1, pitch, *alone, others
    )
    return Outcome(
        _title(analysis),
        _metrics(analysis),
        _dataset(analysis),
        _sections(analysis, times_rows(recording, cfg["recording"].get("times"))),
        _summary(analysis),
    )


def _title(analysis: BoardPitch) -> str:
    name, pitch = analysis.recording.name, analysis.pitch
    if analysis.quality is Quality.FAILED:
        return f"{name}: no pitch found"
    return f"{name}: a pitch of {_mm(pitch.pitch_m, pitch.stderr_m)}"


def _along_x(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Even positions that grow (n,) [m], and the signals (c, n) there, NaN where all miss one."""
    x_m, signal = recording.position_m, recording.signal
    if x_m[-1] < x_m[0]:
        x_m, signal = x_m[::-1], signal[:, ::-1]
    in_some = ~np.isnan(signal).all(axis=0)
    for channel, values in zip(recording.channels, signal[:, in_some], strict=True):
        refuse(
            bool(np.isnan(values).any()),
            f"{recording.name}: channel {channel} has missing samples, and the pitch needs all: "
            "leave it out of recording.channels.",
        )
        refuse(
            bool(np.ptp(values) == 0),
            f"{recording.name}: channel {channel} is constant ({values[0]:.4g}) and feels no "
            "surface: leave it out of recording.channels.",
        )
    return np.linspace(x_m[0], x_m[-1], x_m.size), np.ascontiguousarray(signal)


def _without_gaps(name: str, x_m: np.ndarray, signal: np.ndarray, shortest_m: float) -> np.ndarray:
    """The signals (c, n) with gaps that are short beside the shortest pitch interpolated from their
    neighbours."""
    rows = np.flatnonzero(~np.isnan(signal).any(axis=0))
    if rows.size == x_m.size:
        return signal
    refuse(rows.size < 2, f"{name}: only {rows.size} samples are there: record the scan again.")
    longest = int(np.argmax(np.diff(rows)))
    start_m, end_m = float(x_m[rows[longest]]), float(x_m[rows[longest + 1]])
    refuse(
        end_m - start_m > SHORT_GAP * shortest_m,
        f"{name}: no channel has samples from {start_m:.4g} to {end_m:.4g} m, more than "
        f"{SHORT_GAP:.3g} of the shortest pitch of {shortest_m:.4g} m: cut the recording there, or "
        "raise the shortest of feature.pitch_range_m.",
    )
    return np.stack([filled(row) for row in signal])


def _settings(given: Mapping[str, Any], ends: Any, name: str, x_m: np.ndarray) -> Settings:
    """Those given, and the range `ends` of the pitch, for a recording at `x_m`."""
    key, example = f"feature.pitch_range_m is {ends}", "such as [0.015,0.03]"
    refuse(
        not (isinstance(ends, list | tuple) and len(ends) == 2 and all(map(is_number, ends))),
        f"{key}: give two numbers, the shortest and the longest pitch in metres, {example}.",
    )
    refuse(
        not 0 < ends[0] < ends[1],
        f"{key}: give the shortest pitch, above 0, and then the longest, {example}.",
    )
    step, length = x_m[1] - x_m[0], x_m[-1] - x_m[0]
    refuse(
        ends[1] > length / LEAST_PERIODS,
        f"{key}, but {name} is {length:.4g} m long and a pitch has to come {LEAST_PERIODS} times: "
        f"give a longest pitch up to {length / LEAST_PERIODS:.4g} m.",
    )
    refuse(
        ends[0] < 2 * step,
        f"{key}, but the samples of {name} are {step:.4g} m apart, which shows no pitch below two "
        f"of them: give a shortest pitch from {2 * step:.4g} m on.",
    )
    harmonics, false_alarm = given["harmonics"], given["false_alarm"]
    refuse(
        not (isinstance(harmonics, int) and not isinstance(harmonics, bool) and harmonics >= 1),
        f"fit_fabricslide.harmonics is {harmonics}: give a whole number from 1.",
    )
    refuse(
        not (is_number(false_alarm) and 0 < false_alarm < 1),
        f"fit_fabricslide.false_alarm is {false_alarm}: give a number between 0 and 1.",
    )
    resolved = int(ends[0] / (2 * step))
    return Settings((float(ends[0]), float(ends[1])), min(harmonics, resolved), false_alarm)


def _mm(value_m: float, stderr_m: float) -> str:
    """Value and standard error in mm."""
    return f"{format_with_error(MM * value_m, MM * stderr_m)} mm"


# --- the page --------------------------------------------------------------------------------


def _metrics(analysis: BoardPitch) -> dict[str, Any]:
    pitch = analysis.pitch
    metrics: dict[str, Any] = {
        "pitch_m": pitch.pitch_m,
        "pitch_m_stderr": pitch.stderr_m,
        "pitch_m_stderr_white": pitch.stderr_white_m,
        "pitch_false_alarm": analysis.false_alarm,
        "pitch_channel_spread_m": float(np.std(analysis.channels)),
        "status": analysis.status,
        **in_metrics(analysis),
        "harmonics": analysis.settings.harmonics,
        "periods": pitch.shifts.shift_m.size,
        "drift_degree": analysis.degree,
        "channels": len(analysis.recording.channels),
        "samples": analysis.x_m.size,
        "scan_length_m": float(analysis.x_m[-1] - analysis.x_m[0]),
        "lines": len(analysis.others.lines),
    }
    for i, line in enumerate(analysis.others.lines, start=1):
        metrics |= {
            f"line_{i}_m": line.wavelength_m,
            f"line_{i}_m_stderr": line.stderr_m,
            f"line_{i}_explained_fraction": line.explained_fraction,
            f"line_{i}_false_alarm": line.false_alarm,
        }
    return metrics


def _dataset(analysis: BoardPitch) -> xarray.Dataset:
    unit, pitch, others = analysis.recording.signal_unit, analysis.pitch, analysis.others
    by_line = np.array(others.lines).reshape(-1, len(SpectralPeak._fields)).T
    m, one, traces, per_line = {"units": "m"}, {"units": "1"}, ("channel", "x"), "line"
    return xarray.Dataset(
        {
            "signal": (traces, analysis.signal, {"units": unit}),
            "fitted_signal": (traces, analysis.signal - pitch.rest, {"units": unit}),
            "pattern": (traces, pitch.pattern, {"units": unit}),
            "noise": ("channel", pitch.noise, {"units": unit}),
            "channel_pitch": ("channel", analysis.channels, m),
            "channel_pitch_stderr": ("channel", analysis.channels_stderr, m),
            "shift": ("period", pitch.shifts.shift_m, m),
            "power": ("per_m", others.before, one),
            "power_left": ("per_m", others.left.power, one),
            "false_alarm_level": ("per_m", others.left.level(analysis.settings.false_alarm), one),
            "line_wavelength": (per_line, by_line[0], m),
            "line_stderr": (per_line, by_line[1], m),
            "line_explained_fraction": (per_line, by_line[2], one),
            "line_false_alarm": (per_line, by_line[3], one),
            "pitch": ((), pitch.pitch_m, m),
            "pitch_stderr": ((), pitch.stderr_m, m),
            "pitch_range": ("end", np.array(analysis.settings.range_m), m),
        },
        {
            "x": ("x", analysis.x_m, m),
            "channel": ("channel", list(analysis.recording.channels), one),
            "period_x": ("period", pitch.shifts.x_m, m),
            "per_m": ("per_m", others.left.per_m, {"units": "1/m"}),
        },
        {"title": analysis.recording.name},
    )


def _summary(analysis: BoardPitch) -> Table:
    pitch, failed = analysis.pitch, analysis.quality is Quality.FAILED
    lines = ", ".join(_mm(line.wavelength_m, line.stderr_m) for line in analysis.others.lines)
    return Table(
        ("what", "value"),
        (
            ("pitch", "-" if failed else _mm(pitch.pitch_m, pitch.stderr_m)),
            ("quality", str(analysis.quality)),
            ("spread of the channels' own pitches", f"{MM * np.std(analysis.channels):.3g} mm"),
            ("periods seen", pitch.shifts.shift_m.size),
            ("other significant lines, strongest first", lines or "none"),
        ),
        notes=analysis.reasons,
    )


def _sections(analysis: BoardPitch, times: Rows) -> tuple[Section, ...]:
    """The page; `times` are rows about the recording's times."""
    data = _dataset(analysis)
    return (
        _pitch_section(analysis, data),
        Section(
            "The channels one by one",
            (
                "The same fit to every channel alone, on the line found by all. The channels are "
                "not independent: their scatter is no measure of the common error.",
            ),
            {"channel_pitches": lambda: figures.channel_pitches(data)},
            tables=(_channel_table(analysis),),
        ),
        Section(
            "Other lines",
            (
                "Everything else that repeats: the most significant line is taken out and the "
                "rest looked at again, until nothing exceeds what noise alone reaches anywhere "
                f"once in {1 / analysis.settings.false_alarm:.4g} scans. The level follows the "
                "periodogram's running median and the covariance of the channels.",
            ),
            {"line_spectrum": lambda: figures.line_spectrum(data)},
            tables=(_line_table(analysis),),
        ),
        Section("What was assumed", tables=(Table(("what", "value"), _assumed(analysis, times)),)),
    )


def _pitch_section(analysis: BoardPitch, data: xarray.Dataset) -> Section:
    pitch = analysis.pitch
    ratio = pitch.stderr_m / pitch.stderr_white_m
    return Section(
        "Pitch",
        (
            f"All {len(analysis.recording.channels)} channels together give "
            f"{_mm(pitch.pitch_m, pitch.stderr_m)} ({analysis.quality}).",
            *analysis.reasons,
            "The standard error comes from the scan itself: each of the "
            f"{pitch.shifts.shift_m.size} periods is one reading of how far the pattern of all "
            "channels lies from the fit, and the scatter of these readings about a straight line "
            "is the error of the pitch. It allows for noise that is coloured and common to "
            f"channels; taking every sample as independent would give an error {ratio:.2g} times "
            "smaller. It does not hold what is the same in every scan, such as a speed that is "
            "off or a finger that rolls.",
        ),
        {
            "channel_fits": lambda: figures.channel_fits(data),
            "pattern_shifts": lambda: figures.pattern_shifts(data),
        },
        {
            "pattern_shifts": "The standard error is as honest as these readings are independent: "
            "a slow wave through many of them would be missed."
        },
    )


def _channel_table(analysis: BoardPitch) -> Table:
    amplitude = analysis.pitch.pattern.std(axis=1)
    rows = zip(
        analysis.recording.channels,
        (MM * analysis.channels).tolist(),
        (MM * analysis.channels_stderr).tolist(),
        amplitude.tolist(),
        analysis.pitch.noise.tolist(),
        strict=True,
    )
    unit = analysis.recording.signal_unit
    columns = ("channel", "pitch [mm]", "standard error [mm]", f"pattern, rms [{unit}]",
               f"rest, rms [{unit}]")  # fmt: skip
    return Table(columns, tuple(rows))


def _line_table(analysis: BoardPitch) -> Table:
    """The pitch and every other line, with the line that it is a fraction of."""
    speed = abs(float(np.mean(analysis.recording.speed_m_per_s)))
    total = np.sum(analysis.pitch.pattern**2 + analysis.pitch.rest**2, axis=1)
    explained_fraction = np.mean(np.sum(analysis.pitch.pattern**2, axis=1) / total)
    pitch = SpectralPeak(
        analysis.pitch.pitch_m,
        analysis.pitch.stderr_m,
        float(explained_fraction),
        analysis.false_alarm,
    )
    named = {"the pitch": pitch}
    named |= {f"line {i}": line for i, line in enumerate(analysis.others.lines, start=1)}
    rows = tuple(
        (
            name,
            MM * line.wavelength_m,
            MM * line.stderr_m,
            speed / line.wavelength_m,
            100 * line.explained_fraction,
            line.false_alarm,
            _fraction(line, named),
        )
        for name, line in named.items()
    )
    columns = ("line", "wavelength [mm]", "standard error [mm]", "in time [Hz]",
               "share of the variance [%]", "false-alarm probability", "remark")  # fmt: skip
    return Table(columns, rows, "The pitch's share is of what its drift leaves, harmonics and all.")


def _fraction(line: SpectralPeak, named: dict[str, SpectralPeak]) -> str:
    """The line of which this one is a whole fraction, within both errors."""
    for name, base in named.items():
        n = round(base.wavelength_m / line.wavelength_m)
        error = 2 * np.hypot(line.stderr_m, base.stderr_m / max(n, 1))
        if 2 <= n <= HIGHEST_FRACTION and abs(base.wavelength_m / n - line.wavelength_m) < error:
            return f"1/{n} of {name}"
    return ""


def _assumed(analysis: BoardPitch, times: Rows) -> Rows:
    settings, x_m = analysis.settings, analysis.x_m
    low, high = (MM * end for end in settings.range_m)
    return (
        ("recording", f"{analysis.recording.name}, {x_m.size} samples "
         f"{1e6 * (x_m[1] - x_m[0]):.4g} um apart, taken as even"),
        *times,
        ("speed", f"{abs(float(np.mean(analysis.recording.speed_m_per_s))):.4g} m/s throughout; an "
         "error of it is one of every wavelength"),
        ("pitch", f"{low:.4g} to {high:.4g} mm, nothing else known of it"),
        ("pattern", f"{settings.harmonics} harmonics, with amplitude and phase of each channel's "
         "own, the same from end to end"),
        ("drift", f"of each channel's own, a polynomial of degree {analysis.degree}: none faster "
         "than twice the longest pitch"),
        ("noise", "of each channel's own level; its colour, and what channels share, enter by the "
         "standard error"),
        ("other lines", f"from two samples to {LONGEST_LINE:.4g} of the scan, no nearer to one "
         "another than the scan resolves"),
    )  # fmt: skip
