"""The pitch of a ridged surface from all channels of a recording together, and its other lines.

Method and derivation of the standard errors: [`srsinv.inverse.board.pitch`][].
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float
from matplotlib.figure import Figure

from .. import config, plot
from ..inverse.board.pitch import Pitch, channel_pitches, drift, fit_pitch
from ..inverse.board.spectral_lines import SpectralPeak, SpectralPeaks, find_lines
from ..inverse.quality import Quality, quality, reasons
from ..progress import stage
from ..recording import Recording
from ..recording.even import load_steady
from ..report.answers import answer_of
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import quantity_with_error
from ..status import Status
from ._board import PitchSettings, along_x, settings_for, without_gaps
from ._facts import of_samples

LONGEST_LINE = 0.25  # of the scan: longer periods are not distinguished from drift
HIGHEST_FRACTION = 6  # of one line to another: beyond, some fraction always fits
Variables = dict[str, tuple[Any, ...]]


@dataclass(frozen=True)
class BoardPitch:
    """The pitch of a board and what it came from; `channels` and their standard errors are pitches
    (c,) [m]."""

    recording: Recording
    x_m: Float[np.ndarray, " n"]
    signal: Float[np.ndarray, "c n"]
    settings: PitchSettings
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


def run(cfg: config.Config) -> Result:
    """The job: load, fit the pitch, look for other lines, report."""
    with config.precision(cfg):
        recording = load_steady(cfg["recording"], {}, config.reader(cfg))
        x_m, signal = along_x(recording)
        pitch_range = cfg["feature"]["pitch_range_m"]
        settings = settings_for(cfg["fit_fabricslide"], pitch_range, recording.name, x_m)
        signal = without_gaps(recording.name, x_m, signal, settings.range_m[0])
        slow = drift(x_m, 2 * settings.range_m[1])
        with stage("fitting the pitch"):
            pitch = fit_pitch(x_m, signal, slow, settings.range_m, settings.harmonics)
            alone = channel_pitches(x_m, signal, slow, pitch.pitch_m, settings.harmonics)
        with stage("looking for other lines"):
            longest_m = LONGEST_LINE * (x_m[-1] - x_m[0])
            given = pitch.pitch_m, settings.harmonics
            others = find_lines(x_m, signal, given, longest_m, settings.false_alarm)
    board = BoardPitch(recording, x_m, signal, settings, slow.shape[1] - 1, pitch, *alone, others)
    variables = _fit(board) | _spectrum(board) | _peaks(board) | _numbers(board)
    data = dataset(
        variables | answer_of(board),
        {
            "x": (x_m, "m"),
            "channel": (list(recording.channels), "1"),
            "period_x": ("period", pitch.shifts.x_m, "m"),
            "per_m": (others.left.per_m, "1/m"),
            "number": ("line", [str(1 + i) for i in range(len(others.lines))], "1"),
            "peak": (list(_named_peaks(board)), "1"),
        },
        title=recording.name,
        range_least_m=settings.range_m[0], range_greatest_m=settings.range_m[1],
        false_alarm=settings.false_alarm,
        longest_line=LONGEST_LINE,
        spacing_m=float(x_m[1] - x_m[0]),
        speed_m_per_s=abs(float(np.mean(recording.speed_m_per_s))),
        **of_samples(recording, cfg["recording"].get("times")),
    )  # fmt: skip
    words = f"pitch {quantity_with_error(pitch.pitch_m, pitch.stderr_m, 'm')}"
    title = f"{recording.name}: {'no pitch found' if board.quality is Quality.FAILED else words}"
    plots = {"fits": channel_fits, "shifts": pattern_shifts, "alone": pitches, "lines": spectrum}
    return Result(title, data, sections("fit_fabricslide", **plots))


# --- data ------------------------------------------------------------------------------------


def _fit(board: BoardPitch) -> Variables:
    unit, pitch, traces = board.recording.signal_unit, board.pitch, ("channel", "x")
    return {
        "signal": (traces, board.signal, unit),
        "fitted_signal": (traces, board.signal - pitch.rest, unit),
        "pattern": (traces, pitch.pattern, unit),
        "noise": ("channel", pitch.noise, unit),
        "channel_pitch": ("channel", board.channels, "m"),
        "channel_pitch_stderr": ("channel", board.channels_stderr, "m"),
        "shift": ("period", pitch.shifts.shift_m, "m"),
        "pitch": ((), pitch.pitch_m, "m"),
        "pitch_stderr": ((), pitch.stderr_m, "m"),
        "pitch_range": ("end", np.array(board.settings.range_m), "m"),
    }


def _spectrum(board: BoardPitch) -> Variables:
    others = board.others
    wavelength, stderr, explained, false_alarm = (
        np.array(others.lines).reshape(-1, len(SpectralPeak._fields)).T
    )
    return {
        "power": ("per_m", others.before, "1"),
        "power_left": ("per_m", others.left.power, "1"),
        "false_alarm_level": ("per_m", others.left.level(board.settings.false_alarm), "1"),
        "line_wavelength": ("line", wavelength, "m", "line_{number}_m"),
        "line_stderr": ("line", stderr, "m", "line_{number}_m_stderr"),
        "line_explained_fraction": ("line", explained, "1", "line_{number}_explained_fraction"),
        "line_false_alarm": ("line", false_alarm, "1", "line_{number}_false_alarm"),
    }


def _peaks(board: BoardPitch) -> Variables:
    """The pitch and every other line, with the line that it is a fraction of."""
    pitch, named = board.pitch, _named_peaks(board)
    wavelength, stderr, explained, false_alarm = np.array(list(named.values())).T
    return {
        "peak_wavelength": ("peak", wavelength, "m"),
        "peak_stderr": ("peak", stderr, "m"),
        "peak_explained_fraction": ("peak", explained, "1"),
        "peak_false_alarm": ("peak", false_alarm, "1"),
        "peak_remark": ("peak", [_fraction(each, named) for each in named.values()], "1"),
        "pattern_rms": ("channel", pitch.pattern.std(axis=1), board.recording.signal_unit),
    }


def _named_peaks(board: BoardPitch) -> dict[str, SpectralPeak]:
    pitch = board.pitch
    total = np.sum(pitch.pattern**2 + pitch.rest**2, axis=1)
    explained = float(np.mean(np.sum(pitch.pattern**2, axis=1) / total))
    of_pitch = SpectralPeak(pitch.pitch_m, pitch.stderr_m, explained, board.false_alarm)
    lines = {f"line {i}": line for i, line in enumerate(board.others.lines, start=1)}
    return {"the pitch": of_pitch} | lines


def _fraction(line: SpectralPeak, named: dict[str, SpectralPeak]) -> str:
    """The line of which this one is a whole fraction, within both errors."""
    for name, base in named.items():
        n = round(base.wavelength_m / line.wavelength_m)
        error = 2 * np.hypot(line.stderr_m, base.stderr_m / max(n, 1))
        if 2 <= n <= HIGHEST_FRACTION and abs(base.wavelength_m / n - line.wavelength_m) < error:
            return f"1/{n} of {name}"
    return ""


def _numbers(board: BoardPitch) -> Variables:
    pitch, x_m = board.pitch, board.x_m
    return scalars({
        "pitch_m": pitch.pitch_m,
        "pitch_m_stderr": pitch.stderr_m,
        "pitch_m_stderr_white": pitch.stderr_white_m,
        "pitch_false_alarm": board.false_alarm,
        "pitch_channel_spread_m": float(np.std(board.channels)),
        "harmonics": board.settings.harmonics,
        "periods": pitch.shifts.shift_m.size,
        "drift_degree": board.degree,
        "channels": len(board.recording.channels),
        "samples": x_m.size,
        "scan_length_m": float(x_m[-1] - x_m[0]),
        "lines": len(board.others.lines),
    })  # fmt: skip


# --- plots -----------------------------------------------------------------------------------


def channel_fits(ds: xarray.Dataset) -> Figure:
    """Every channel less its drift, with the pattern fitted to it."""
    pattern = ds["pattern"].values
    signal = pattern + ds["signal"].values - ds["fitted_signal"].values
    across, up = (
        plot.PanelAxis("position x", "m"),
        plot.PanelAxis("signal", ds["signal"].attrs["units"]),
    )
    data, fit = {"color": "#b5bcc2", "linewidth": 2.2}, {"color": "#d55e00", "linewidth": 1.0}
    parts = [
        plot.Panel(
            [
                plot.Curve(signal[c], "signal less drift", look=data),
                plot.Curve(pattern[c], "pattern of the pitch", look=fit),
            ],
            across, up, ds["x"].values, str(name),
        )
        for c, name in enumerate(ds["channel"].values)
    ]  # fmt: skip
    return plot.panels(plot.in_columns(parts), height_in=1.1)


def pattern_shifts(ds: xarray.Dataset) -> Figure:
    """Forward shift along x of the pattern of all channels from the fit, period by period."""
    look = {"linestyle": "none", "marker": "o"}
    x = ds["x"].values
    across = plot.PanelAxis("position x", "m", limits=(float(x[0]), float(x[-1])))
    dots = plot.Curve(ds["shift"].values, look=look)
    zero = plot.Mark(0.0, axis="y")
    up = plot.PanelAxis("shift", "m")
    return plot.panels([plot.Panel([dots], across, up, ds["period_x"].values, "", [zero])])


def pitches(ds: xarray.Dataset) -> Figure:
    """The pitch of each channel alone, beside that of all together."""
    heading, (pitch, stderr) = "pitch", (float(ds[n]) for n in ("pitch", "pitch_stderr"))
    # A channel with hardly any signal has bars that would dominate the scale.
    widest = float(np.max(np.abs(ds["channel_pitch"].values - pitch)))
    reach = 1.1 * widest + max(float(np.median(ds["channel_pitch_stderr"].values)), stderr)
    return plot.spread(
        ds, {heading: "channel_pitch"}, "channel",
        bands={heading: (pitch - stderr, pitch + stderr)}, band_label="all channels together",
        limits={heading: (pitch - reach, pitch + reach)}, labels={"channel_pitch": "one channel"},
    )  # fmt: skip


def spectrum(ds: xarray.Dataset) -> Figure:
    """The channels' common periodogram, with and without the lines found, over wavelength."""
    least = 0.3 * float(np.quantile(ds["power_left"], 0.05))
    lower, upper = (float(end) for end in ds["pitch_range"])
    dashed = {"color": "#009e73", "linestyle": "--"}
    marks = [
        plot.Mark(lower, "range of the pitch", until=upper, look={"color": "#dfe3e7", "zorder": 0}),
        plot.Mark(float(ds["pitch"]), "pitch", look={"color": "#d55e00"}),
        *(plot.Mark(float(at), "other lines", look=dashed) for at in ds["line_wavelength"]),
    ]
    level = {"color": "#000000", "linestyle": ":"}
    curves = [
        plot.Curve(ds["power"].values, "signals less drift", look={"color": "#6b747c"}),
        plot.Curve(ds["power_left"].values, "without the lines", look={"color": "#0072b2"}),
        plot.Curve(ds["false_alarm_level"].values, "false-alarm level", look=level),
    ]
    across, up = (
        plot.PanelAxis("wavelength", "m", True),
        plot.PanelAxis("power", "1", True, (least, None)),
    )
    return plot.panels(
        [plot.Panel(curves, across, up, 1 / ds["per_m"].values, "", marks)], height_in=3.4
    )
