"""Spectral lines: which wavelengths several channels have in common, beside a known pitch."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .periodogram import LOBE, TINY, Periodogram, length, spectrum
from .pitch import drift, locate, scan_pitch, unresolved, waves, without

MOST_LINES = 8


class SpectralPeak(NamedTuple):
    """A significant line: `explained_fraction` of the channels' variance (mean over channels),
    `false_alarm` the probability that noise alone has one as strong anywhere."""

    wavelength_m: float
    stderr_m: float
    explained_fraction: float
    false_alarm: float


class SpectralPeaks(NamedTuple):
    """The lines found, the strongest first, the spectrum of the residual without them, and the
    power `before` (k,) any was taken out, in the same units."""

    lines: tuple[SpectralPeak, ...]
    left: Periodogram
    before: Float[np.ndarray, " k"]

    def false_alarm_at(self, wavelength_m: float, harmonics: int) -> float:
        """Probability that noise alone is as strong anywhere as the strongest of these harmonics
        was."""
        at = [
            np.argmin(np.abs(self.left.per_m - h / wavelength_m)) for h in range(1, harmonics + 1)
        ]
        return float(np.min(self.left.false_alarm(self.before)[at]))


def find_lines(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, "c n"],
    pitch: tuple[float, int],
    longest_m: float,
    false_alarm: float,
) -> SpectralPeaks:
    """The significant lines, up to `longest_m`, beside `pitch` (its value [m] and harmonics).

    The most significant is taken out and the rest searched again, until none exceeds the level that
    noise reaches with probability `false_alarm`, or `MOST_LINES` are found. A line that the scan
    cannot resolve from one already out does not count as another.
    """
    base = [drift(x_m, 2 * longest_m), waves(x_m, *pitch)]
    detected, left, scale = _detected(x_m, signal, base, pitch, longest_m, false_alarm)
    total = without(base[0], signal)
    lines = []
    for wavelength, chance in detected.items():
        others = _with_lines(base, x_m, (other for other in detected if other != wavelength))
        alone = scan_pitch(x_m, signal, others, unresolved(x_m, wavelength), 1)
        explained_fraction = np.mean(np.sum(alone.pattern**2, axis=1) / np.sum(total**2, axis=1))
        lines.append(SpectralPeak(alone.pitch_m, alone.stderr_m, float(explained_fraction), chance))
    lines.sort(key=lambda line: -line.explained_fraction)
    before = spectrum(x_m, total / scale[:, None], longest_m).power
    return SpectralPeaks(tuple(lines), left, before)


def _detected(
    x_m: np.ndarray,
    signal: Float[np.ndarray, "c n"],
    base: list[np.ndarray],
    pitch: tuple[float, int],
    longest_m: float,
    false_alarm: float,
) -> tuple[dict[float, float], Periodogram, Float[np.ndarray, " c"]]:
    """The wavelengths of significant lines with the probability of each under noise, the spectrum
    of what they leave, and the channels' units in it."""
    taken = [h / pitch[0] for h in range(1, pitch[1] + 1)]
    detected: dict[float, float] = {}
    while True:
        known = _with_lines(base, x_m, detected)
        rest = without(known, signal)
        scale = np.maximum(rest.std(axis=1), TINY)
        left = spectrum(x_m, rest / scale[:, None], longest_m)
        distance = np.abs(left.per_m[:, None] - np.array(taken)[None]).min(axis=1)
        excess = np.where(distance < LOBE / length(x_m), 0.0, left.power / left.floor)
        top = int(np.argmax(excess))
        chance = float(left.false_alarm(left.power)[top])
        if excess[top] == 0.0 or chance > false_alarm or len(detected) == MOST_LINES:
            return detected, left, scale
        near = unresolved(x_m, 1 / left.per_m[top])
        wavelength, _ = locate(x_m, rest, known, near, 1)
        detected[wavelength] = chance
        taken.append(1 / wavelength)


def _with_lines(
    base: list[np.ndarray], x_m: np.ndarray, wavelengths_m: Iterable[float]
) -> Float[np.ndarray, "n d"]:
    """Orthonormal columns of the base and of these lines."""
    return np.linalg.qr(np.hstack([*base, *(waves(x_m, each, 1) for each in wavelengths_m)]))[0]
