"""Hum and drift on recordings of passes: draws of them, their covariance, and treatments."""

from typing import Any

import numpy as np
import scipy

from srsinv.false_alarm import DRIFT_WHERE_NAMED
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


def recording(scans: PassScans, signal, **facts: Any) -> Recording:
    """The signal as a recording with these facts."""
    names = tuple("ab"[: len(signal)])
    time_s, position = np.asarray(scans.motion.time_s), scans.position
    return Recording(signal, time_s, scans.speed, names, facts, measured_position_m=position)


def hum_treatments(scans: PassScans):
    """Each treatment's problem of a signal with hum."""
    width = max(2.0, 1.01 / (scans.duration_s - 1 / scans.rate_Hz))

    def notched(signal):
        facts = {"notch_Hz": list(LINES_HZ), "notch_width_Hz": width}
        return scans.problem(prepare(recording(scans, signal, **facts)).signal)

    def named(signal):
        return scans.problem(signal, lines=mains_lines(signal, scans.rate_Hz, LINES_HZ))

    def auto(signal):
        return scans.problem(signal, lines=mains_lines(signal, scans.rate_Hz))

    return {"mains": named, "mains, auto": auto, "notch": notched, "untreated": scans.problem}


def hum_covariance(scans: PassScans, size: float, width_Hz: float):
    """That of white noise and of hum at all samples."""
    time_s = np.arange(scans.position.size) / scans.rate_Hz
    powers = np.square(AMPLITUDES) / np.sum(np.square(AMPLITUDES)) * (size * RMS_V) ** 2
    lines = zip(powers, LINES_HZ, strict=True)
    row = sum(power * np.cos(2 * np.pi * line * time_s) for power, line in lines)
    covariance = scipy.linalg.toeplitz(row * np.sinc(width_Hz * time_s))
    covariance.flat[:: len(covariance) + 1] += NOISE_V**2
    return covariance


def drift_treatments(scans: PassScans, drift: float):
    """Each treatment's problem of a signal that drifts by so much in a second."""

    def drifting_as_recorded(signal):
        return scans.problem(
            signal, common_level(drift_of(recording(scans, signal), DRIFT_WHERE_NAMED))
        )

    def prepared(**facts):
        return lambda signal: scans.problem(prepare(recording(scans, signal, **facts)).signal)

    return {
        "stated": lambda signal: scans.problem(signal, drift),
        "found": drifting_as_recorded,
        "high-pass": prepared(high_pass_Hz=HIGH_PASS_HZ),
        "straight line": prepared(detrend="linear"),
        "mean": prepared(detrend="constant"),
        "untreated": scans.problem,
    }


def walk_covariance(scans: PassScans, drift: float):
    """That of white noise and a random walk from zero at all samples."""
    time_s = np.arange(1, scans.position.size + 1) / scans.rate_Hz
    covariance = drift**2 * np.minimum(time_s[:, None], time_s)
    covariance.flat[:: len(covariance) + 1] += NOISE_V**2
    return covariance
