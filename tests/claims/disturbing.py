"""Hum and drift on recordings of passes: draws of them, their covariances, and treatments."""

import abc
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import numpy as np
import scipy

from srsinv.false_alarm import DRIFT_WHERE_NAMED
from srsinv.inverse.problem import Problem
from srsinv.recording import Recording
from srsinv.recording.drift import common_level, drift_of
from srsinv.recording.mains import mains_lines
from srsinv.recording.preparation import prepare
from tests.claims.pass_scans import NOISE_V, SIGNAL, PassScans, Rng

LINES_HZ, AMPLITUDES, WIDEST_HZ = (50.0, 150.0), (1.0, 0.4), 2.0
WIDTHS_HZ = (1 / 3, 1.0, 5 / 3)  # in the middle of thirds: of those that draws have
MAINS_HZ = 0.2  # by so much the mains' frequency is off
HIGH_PASS_HZ = 1.0
RMS_V = SIGNAL * NOISE_V
Treatments = Mapping[str, Callable[[Any], Problem]]


class Disturbance(abc.ABC):
    """What disturbs scans, of rms `size` times the signal's.

    - `seed`: of its draws, beside their number.
    - `proper`: the treatments of which all draws are made.
    """

    seed: ClassVar[int]
    proper: ClassVar[tuple[str, ...]]

    def __init__(self, scans: PassScans, size: float):
        self.scans, self.size = scans, size

    @abc.abstractmethod
    def drawn(self, rng: Rng) -> np.ndarray:
        """One of all elements (e, sample)."""

    @abc.abstractmethod
    def covariances(self) -> Iterator[np.ndarray]:
        """At all samples, with that of white noise: of disturbances that are as likely."""

    @property
    @abc.abstractmethod
    def treatments(self) -> Treatments:
        """The problem that each treatment makes of a disturbed signal."""

    def recording(self, signal, **facts: Any) -> Recording:
        """The signal as a recording with these facts."""
        scans, names = self.scans, tuple("ab"[: len(signal)])
        time_s = np.asarray(scans.motion.time_s)
        return Recording(
            signal, time_s, scans.speed, names, facts, measured_position_m=scans.position
        )

    def prepared(self, **facts: Any) -> Callable[[Any], Problem]:
        """A treatment by the filters that the facts name."""
        scans = self.scans
        return lambda signal: scans.problem(prepare(self.recording(signal, **facts)).signal)


class Hum(Disturbance):
    """Lines that each are a narrow-band process."""

    seed = 1
    proper = ("mains",)

    def drawn(self, rng: Rng) -> np.ndarray:
        """Of random width and frequency, each line waves of random amplitude and phase."""
        time_s = np.asarray(self.scans.motion.time_s)
        return self.size * (RMS_V * hum(rng, time_s, self.scans.shape[0]))

    def covariances(self) -> Iterator[np.ndarray]:
        """Of hum of each of `WIDTHS_HZ`."""
        time_s = np.arange(self.scans.position.size) / self.scans.rate_Hz
        powers = np.square(AMPLITUDES) / np.sum(np.square(AMPLITUDES)) * (self.size * RMS_V) ** 2
        lines = zip(powers, LINES_HZ, strict=True)
        row = sum(power * np.cos(2 * np.pi * line * time_s) for power, line in lines)
        for width_Hz in WIDTHS_HZ:
            covariance = scipy.linalg.toeplitz(row * np.sinc(width_Hz * time_s))
            covariance.flat[:: len(covariance) + 1] += NOISE_V**2
            yield covariance

    @property
    def treatments(self) -> Treatments:
        """Lines that are named, that are found, notches, and none."""
        scans = self.scans
        width = max(2.0, 1.01 / (scans.duration_s - 1 / scans.rate_Hz))

        def mains(signal, *lines_Hz):
            return scans.problem(signal, lines=mains_lines(signal, scans.rate_Hz, *lines_Hz))

        return {
            "mains": lambda signal: mains(signal, LINES_HZ),
            "mains, auto": mains,
            "notch": self.prepared(notch_Hz=list(LINES_HZ), notch_width_Hz=width),
            "untreated": scans.problem,
        }


class Drift(Disturbance):
    """A random walk from zero, whose rms at the end is `size` times the signal's."""

    seed = 2
    proper = ("stated", "found")

    @property
    def rate(self) -> float:
        """Its rms after a second."""
        return self.size * RMS_V / np.sqrt(self.scans.duration_s)

    def drawn(self, rng: Rng) -> np.ndarray:
        """A walk of each element."""
        steps = rng.normal(size=self.scans.shape)
        return np.cumsum(steps, axis=1) * self.rate / np.sqrt(self.scans.rate_Hz)

    def covariances(self) -> Iterator[np.ndarray]:
        """Its own alone."""
        time_s = np.arange(1, self.scans.position.size + 1) / self.scans.rate_Hz
        covariance = self.rate**2 * np.minimum(time_s[:, None], time_s)
        covariance.flat[:: len(covariance) + 1] += NOISE_V**2
        yield covariance

    def found(self, signal) -> float:
        """The rate that a signal shows."""
        return common_level(drift_of(self.recording(signal), DRIFT_WHERE_NAMED))

    @property
    def treatments(self) -> Treatments:
        """A rate that is stated, that is found, filters, and none."""
        scans = self.scans
        return {
            "stated": lambda signal: scans.problem(signal, self.rate),
            "found": lambda signal: scans.problem(signal, self.found(signal)),
            "high-pass": self.prepared(high_pass_Hz=HIGH_PASS_HZ),
            "straight line": self.prepared(detrend="linear"),
            "mean": self.prepared(detrend="constant"),
            "untreated": scans.problem,
        }


def hum(rng: Rng, time_s, elements: int):
    """Hum (e, sample) of rms one over both lines: waves whose amplitude and phase vary."""
    n, width = time_s.size, rng.uniform(0, WIDEST_HZ)
    mains = rng.uniform(-MAINS_HZ, MAINS_HZ)
    total = np.zeros((elements, n))
    for line, amplitude in zip(LINES_HZ, AMPLITUDES, strict=True):
        offsets = rng.uniform(-width / 2, width / 2, size=24)
        size = rng.normal(size=(2, elements, offsets.size))
        phase = 2 * np.pi * np.outer(line + mains * line / LINES_HZ[0] + offsets, time_s)
        waves = size[0] @ np.cos(phase) + size[1] @ np.sin(phase)
        total = total + amplitude * waves / np.sqrt(np.mean(waves**2))
    return total / np.sqrt(np.mean(total**2))
