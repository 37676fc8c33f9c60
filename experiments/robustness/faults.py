"""Faults of real measurements (faults.yaml): what each does to a scan of a known truth."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .scans import (
    DEPTH_M,
    RATE_HZ,
    Rng,
    Scan,
    ScannedScene,
    TrueRig,
    clean_signal,
    ornstein_uhlenbeck,
    scan,
)

FAULTS = Path(__file__).with_name("faults.yaml")
Strengths = Mapping[str, Any]


@cache
def faults() -> Mapping[str, Strengths]:
    """All faults by their names: what each does, and its strengths."""
    return yaml.safe_load(FAULTS.read_text(encoding="utf-8"))


def suits(fault: Strengths, scene: ScannedScene) -> bool:
    """Whether a fault makes sense in a scene."""
    fits = {"two": scene.elements == 2, "surface": scene.is_of_surface}
    return fits.get(fault.get("only", ""), True)


def faulty(fault: Strengths, scene: ScannedScene, seed: int) -> Scan:
    """A scan with a fault."""
    does, rng = fault["does"], np.random.default_rng(seed)
    strengths = {key: each for key, each in fault.items() if key not in ("does", "only")}
    if does in MADE_OTHERWISE:
        return MADE_OTHERWISE[does](scene, rng, **strengths)
    return DOES[does](scan(scene, rng), **strengths)


# --- what is scanned, and by what, is another than is stated ----------------------------------


def _other_rig(scene: ScannedScene, rng: Rng, **true: float) -> Scan:
    """By a rig that is not as stated; `true`: by the names of `TrueRig`."""
    return scan(scene, rng, TrueRig(**true))


def _wrong_depth(scene: ScannedScene, rng: Rng, times: float) -> Scan:
    return scan(scene, rng, TrueRig(depth_m=DEPTH_M * times))


def _wrong_family(scene: ScannedScene, rng: Rng) -> Scan:
    return scan(scene, rng, is_other=True)


def _second_feature(scene: ScannedScene, rng: Rng, **changes: float) -> Scan:
    """With another feature of the same family, which a fit of one does not have."""
    return scan(scene, rng, others=({**scene.truth, **changes},))


def _sagging(scene: ScannedScene, rng: Rng, by_m: float) -> Scan:
    """A film whose depth rises by `by_m` along the scan, about the stated one: nearly the mix of
    the signals at the two depths."""
    made = scan(scene, rng)
    start, end = (
        clean_signal(scene, made.feature, TrueRig(depth_m=DEPTH_M + side * by_m / 2), made.motion)
        for side in (-1, 1)
    )
    along = np.linspace(0, 1, made.signal.shape[1])
    return dataclasses.replace(made, signal=(1 - along) * start + along * end)


# --- what is recorded is another than was measured --------------------------------------------


def _nothing(made: Scan) -> Scan:
    return made


def _dead(made: Scan, element: int) -> Scan:
    recorded = made.recorded
    recorded[element] = made.noise[element]
    return made.recording_of(recorded)


def _stuck(made: Scan, element: int, **where: float) -> Scan:
    recorded, n = made.recorded, made.signal.shape[1]
    start, stop = int(where["from"] * n), int(where["to"] * n)
    recorded[element, start:stop] = recorded[element, start]
    return made.recording_of(recorded)


def _swapped(made: Scan) -> Scan:
    return made.recording_of(made.recorded[::-1])


def _flipped(made: Scan, elements: list[int]) -> Scan:
    recorded = made.recorded
    present = [e for e in elements if e < len(recorded)]
    recorded[present] = -recorded[present]
    return made.recording_of(recorded)


def _glued(made: Scan, crosstalk: float, own_noise: bool) -> Scan:
    """The second channel with so much of the first in place of its own."""
    recorded = made.recorded
    source = made.signal if own_noise else made.recorded
    mixed = crosstalk * source[0] + (1 - crosstalk) * source[1]
    recorded[1] = mixed + own_noise * made.noise[1]
    return made.recording_of(recorded)


def _louder_noise(made: Scan, element: int, times: float) -> Scan:
    added = np.zeros_like(made.noise)
    added[element] = (times - 1) * made.noise[element]
    return made.plus(added)


def _wave(made: Scan, frequency_hz: float) -> np.ndarray:
    """A sine of amplitude one and random phase."""
    time_s = np.arange(made.signal.shape[1]) / RATE_HZ
    return np.sin(2 * np.pi * (frequency_hz * time_s + made.rng.random()))


def _hum(made: Scan, frequency_hz: float, of_rms: float) -> Scan:
    return made.plus(np.sqrt(2) * of_rms * made.rms * _wave(made, frequency_hz)[None])


def _drift(made: Scan, of_rms: float) -> Scan:
    return made.plus(of_rms * made.rms * np.linspace(0, 1, made.signal.shape[1])[None])


def _offset(made: Scan, of_rms: float) -> Scan:
    return made.plus(np.full_like(made.signal, of_rms * made.rms))


def _impulses(made: Scan, count: int, of_peak: float) -> Scan:
    added = np.zeros_like(made.signal)
    at = made.rng.choice(added.size, count, replace=False)
    added.ravel()[at] = of_peak * made.peak * made.rng.choice([-1, 1], count)
    return made.plus(added)


def _pink_noise(made: Scan, of_rms: float) -> Scan:
    n = made.signal.shape[1]
    weights = 1 / np.sqrt(np.maximum(np.arange(n // 2 + 1), 1))
    weights[0] = 0.0
    pink = np.fft.irfft(weights * np.fft.rfft(made.rng.normal(size=made.signal.shape)), n)
    return made.plus(of_rms * made.rms * pink / np.sqrt(np.mean(pink**2)))


def _clipped(made: Scan, at_peak_times: float) -> Scan:
    limit = at_peak_times * made.peak
    return made.recording_of(np.clip(made.recorded, -limit, limit))


def _quantised(made: Scan, step_of_peak: float) -> Scan:
    step = step_of_peak * made.peak
    return made.recording_of(step * np.round(made.recorded / step))


def _jitter(made: Scan, samples: float) -> Scan:
    n = made.signal.shape[1]
    at = np.arange(n) + samples * made.rng.normal(size=n)
    signal = np.stack([np.interp(at, np.arange(n), row) for row in made.signal])
    return made.recording_of(signal + made.noise)


def _places(made: Scan, bursts: int, samples: int) -> np.ndarray:
    starts = made.rng.choice(made.signal.shape[1] - samples, bursts, replace=False)
    return np.unique(starts[:, None] + np.arange(samples))


def _missing_rows(made: Scan, bursts: int, samples: int) -> Scan:
    """Samples that were lost and leave no gap: those after them move up."""
    left = np.delete(made.recorded, _places(made, bursts, samples), axis=1)
    missing = made.signal.shape[1] - left.shape[1]
    rest = made.scene.white * made.rng.normal(size=(len(left), missing))
    return made.recording_of(np.concatenate([left, rest], axis=1))


def _zeroed_rows(made: Scan, bursts: int, samples: int) -> Scan:
    recorded = made.recorded
    recorded[:, _places(made, bursts, samples)] = 0.0
    return made.recording_of(recorded)


def _low_pass(made: Scan, cutoff_hz: float) -> Scan:
    """A filter of first order that is not modelled, before the noise."""
    n = 4 * made.signal.shape[1]
    response = 1 / (1 + 1j * np.fft.rfftfreq(n, 1 / RATE_HZ) / cutoff_hz)
    filtered = np.fft.irfft(response * np.fft.rfft(made.signal, n), n)[:, : made.signal.shape[1]]
    return made.recording_of(filtered + made.noise)


def _wrong_speed(made: Scan, times: float) -> Scan:
    return dataclasses.replace(made, stated_times={"speed": 1 / times})


def _wrong_gain(made: Scan, times: float, elements: list[int]) -> Scan:
    """Films that give more charge than stated; the amplifier's noise is the same."""
    factor = np.ones((len(made.signal), 1))
    factor[[e for e in elements if e < len(factor)]] = times
    return dataclasses.replace(made, signal=factor * made.signal)


def _wrong_rate(made: Scan, times: float) -> Scan:
    return dataclasses.replace(made, stated_times={"sample_rate": 1 / times})


def _gain_drift(made: Scan, by: float) -> Scan:
    """A gain, or a load, that rises by so much along the scan."""
    rising = np.linspace(1, 1 + by, made.signal.shape[1])
    return dataclasses.replace(made, signal=rising * made.signal)


def _delayed(made: Scan, samples: float) -> Scan:
    """The second channel later than the first."""
    recorded, at = made.recorded, np.arange(made.signal.shape[1])
    recorded[1] = np.interp(at - samples, at, recorded[1])
    return made.recording_of(recorded)


def _speed_ripple(made: Scan, part: float, frequency_hz: float) -> Scan:
    """A speed that ripples by so much of itself, which is not in the stated one."""
    at = np.arange(made.signal.shape[1])
    phase = 2 * np.pi * frequency_hz * at / RATE_HZ
    moved = at + part * RATE_HZ / (2 * np.pi * frequency_hz) * (1 - np.cos(phase))
    signal = np.stack([np.interp(moved, at, row) for row in made.signal])
    return dataclasses.replace(made, signal=(1 + part * np.sin(phase)) * signal)


def _saturated(made: Scan, at_peak_times: float) -> Scan:
    """An amplifier that saturates softly, before the noise."""
    limit = at_peak_times * made.peak
    return dataclasses.replace(made, signal=limit * np.tanh(made.signal / limit))


def _multiplied(made: Scan, part: float) -> Scan:
    """Noise that is so much of the signal."""
    return made.plus(part * made.signal * made.rng.normal(size=made.signal.shape))


def _correlated(made: Scan, of_peak: float, correlation_s: float) -> Scan:
    """Noise of first order, of this rms."""
    step = 1 / RATE_HZ / correlation_s
    return made.plus(of_peak * made.peak * ornstein_uhlenbeck(made.rng, made.signal.shape, step))


def _heavy_tails(made: Scan, freedom: float) -> Scan:
    """Student's noise in place of normal noise, of the same scale."""
    drawn = made.rng.standard_t(freedom, size=made.signal.shape)
    return dataclasses.replace(made, noise=made.scene.white * drawn)


def _bursts(made: Scan, bursts: int, samples: int, times: float) -> Scan:
    """Stretches in which the noise is so many times as loud."""
    noise, at = made.noise.copy(), _places(made, bursts, samples)
    noise[:, at] *= times
    return dataclasses.replace(made, noise=noise)


def _sine(made: Scan, frequency_hz: float, of_peak: float) -> Scan:
    return made.plus(of_peak * made.peak * _wave(made, frequency_hz)[None])


def _walk(made: Scan, of_peak: float) -> Scan:
    """A random walk of its own in every channel, of this rms after a second."""
    steps = made.rng.normal(size=made.signal.shape) / np.sqrt(RATE_HZ)
    return made.plus(of_peak * made.peak * np.cumsum(steps, axis=-1))


def _ramp(made: Scan, of_peak: float) -> Scan:
    return made.plus(of_peak * made.peak * np.linspace(0, 1, made.signal.shape[1])[None])


def _warm_up(made: Scan, of_peak: float, time_s: float) -> Scan:
    """A baseline that settles exponentially."""
    settled = np.exp(-np.arange(made.signal.shape[1]) / RATE_HZ / time_s)
    return made.plus(of_peak * made.peak * settled[None])


def _step(made: Scan, of_peak: float, at: float) -> Scan:
    """A baseline that jumps after this part of the scan."""
    n = made.signal.shape[1]
    return made.plus(of_peak * made.peak * (np.arange(n) > at * n)[None])


MADE_OTHERWISE: Mapping[str, Callable[..., Scan]] = {
    "other_rig": _other_rig, "wrong_depth": _wrong_depth, "wrong_family": _wrong_family,
    "second_feature": _second_feature, "sagging": _sagging,
}  # fmt: skip
DOES: Mapping[str, Callable[..., Scan]] = {
    "nothing": _nothing, "dead": _dead, "stuck": _stuck, "swapped": _swapped, "flipped": _flipped,
    "glued": _glued, "louder_noise": _louder_noise, "hum": _hum, "drift": _drift,
    "offset": _offset, "impulses": _impulses, "pink_noise": _pink_noise, "clipped": _clipped,
    "quantised": _quantised, "jitter": _jitter, "lost_rows": _missing_rows,
    "lost_as_zeros": _zeroed_rows, "low_pass": _low_pass, "wrong_speed": _wrong_speed,
    "wrong_gain": _wrong_gain, "wrong_rate": _wrong_rate, "gain_drift": _gain_drift,
    "delayed": _delayed, "speed_ripple": _speed_ripple, "saturated": _saturated,
    "multiplied": _multiplied, "correlated": _correlated, "heavy_tails": _heavy_tails,
    "bursts": _bursts, "sine": _sine, "walk": _walk, "ramp": _ramp, "warm_up": _warm_up,
    "step": _step,
}  # fmt: skip
