"""Whether lines of mains in a recording are named, and whether what is named may be a texture.

A texture of wavelength L that is passed at the speed u makes a line at u / L, as mains may do. The
skin passes its waves on by e^(-k z), k = 2 pi f / u: a line of a frequency at which nothing is
passed on is no texture. Nor is one that is narrower than the speed's variation makes a texture's.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...recording import Recording
from ...recording.disturbances import nominal
from ...recording.mains import WANDER_HZ, MainsLine, standing_lines

# Of a wave's amplitude: where the skin passes on less, a line of 1 % of a feature's signal would be
# a texture of the feature's own pressure.
PASSED_ON = 0.01
WEAK = 0.3  # of the white noise: weaker lines change no answer
MOVING = 0.5  # of the greatest speed: faster is no start and no turn


class Hum(NamedTuple):
    """The `lines` of mains in a recording that are above `WEAK`, and whether they are named."""

    recording: Recording
    depth_m: float
    lines: Sequence[MainsLine]
    is_named: bool

    @classmethod
    def of(
        cls,
        recording: Recording,
        depth_m: float,
        named: Sequence[MainsLine],
        noise_rms: float,
    ) -> "Hum":
        """That of a recording at even times.

        - `depth_m`: of the film nearest to the skin. `noise_rms`: of the white noise per sample.
        - `named`: the lines that the facts name, as the recording has them.
        """
        is_named = recording.sidecar.get("mains_Hz") is not None
        lines = named if is_named else standing_lines(recording.signal, recording.sample_rate_hz)
        strong = [line for line in lines if float(np.max(line.rms)) > WEAK * noise_rms]
        return cls(recording, depth_m, strong, is_named)

    @property
    def unnamed(self) -> tuple[MainsLine, ...]:
        """The lines that nobody named and that are no texture."""
        if self.is_named:
            return ()
        return tuple(line for line in self.lines if not self._may_be_texture(line))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on lines that nobody named and that are no texture, and on those that may be
        one: named ones, and those that lie where mains have theirs."""
        texture = [line for line in self.lines if self._may_be_texture(line)]
        if self.is_named:
            return _ambiguous(texture, self._fastest) if texture else ()
        hum = self.unnamed
        either = [line for line in texture if _is_where_mains_are(line)]
        return (
            *(self._found(hum) if hum else ()),
            *(_hum_or_texture(either, self._fastest) if either else ()),
        )

    @property
    def _speeds(self) -> np.ndarray:
        speed = np.abs(np.asarray(self.recording.speed_m_per_s))
        return speed[speed > MOVING * speed.max()]

    @property
    def _fastest(self) -> float:
        return float(np.max(self._speeds, initial=0.0))

    def _may_be_texture(self, line: MainsLine) -> bool:
        speeds = self._speeds
        if not speeds.size:
            return False
        fastest, frequency = float(speeds.max()), line.frequency_Hz
        is_passed_on = np.exp(-2 * np.pi * frequency / fastest * self.depth_m) > PASSED_ON
        # A texture's line is as wide as the speed varies, and its halves, a fifth and more.
        slow, fast = np.quantile(speeds, [0.1, 0.9])
        is_wide_enough = line.half_Hz >= frequency * (fast - slow) / (fast + slow) / 2
        return bool(is_passed_on and is_wide_enough)

    def _found(self, lines: Sequence[MainsLine]) -> tuple[str, ...]:
        squares = np.sum([line.rms**2 for line in lines], axis=0)
        signal = self.recording.signal
        share = float(np.max(np.sqrt(squares) / np.nanstd(signal, axis=1)))
        listed = ", ".join(f"{line.frequency_Hz:.4g} Hz" for line in lines)
        return (
            f"Hum was found at {listed}, {share:.2g} of the signal's rms, where the skin transmits "
            "no texture. It is estimated jointly with the traction. To confirm it, give "
            f"{_setting(lines)}; if there is none, recording.mains_Hz=[].",
        )


def _is_where_mains_are(line: MainsLine) -> bool:
    """Whether a line's frequency is one that mains wander to."""
    (named,) = nominal([line])
    return abs(line.frequency_Hz - named) <= WANDER_HZ


def _setting(lines: Sequence[MainsLine]) -> str:
    return f"recording.mains_Hz=[{','.join(map(str, nominal(lines)))}]"


def _listed(lines: Sequence[MainsLine], speed: float) -> str:
    return " and ".join(
        f"{line.frequency_Hz:.4g} Hz ({1e3 * speed / line.frequency_Hz:.3g} mm)" for line in lines
    )


def _hum_or_texture(lines: Sequence[MainsLine], speed: float) -> tuple[str, ...]:
    return (
        f"The line at {_listed(lines, speed)} may be hum or a texture of that wavelength. The "
        f"answer treats it as a texture. If it is hum, give {_setting(lines)}. To decide, scan at "
        "another speed, which changes the frequency of a texture.",
    )


def _ambiguous(lines: Sequence[MainsLine], speed: float) -> tuple[str, ...]:
    return (
        f"The line at {_listed(lines, speed)} may be a texture of that wavelength. As hum it is "
        "left out of the traction; if it is both, the bands are invalid. Remove it from "
        "recording.mains_Hz, or scan at another speed, which changes the frequency of a texture.",
    )
