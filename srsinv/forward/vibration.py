"""What a resting sensor records of a charge that oscillates: readout, samples and lock-in.

Nothing slides, so that an amplifier's gain d^n Q/dx^n acts as d^n/dt^n: a charge Im[Q exp(iwt)]
gives the signal Im[S exp(iwt)] with S = g (iw)^n H(w) Q, H of the filters. A lock-in fits
S' sin(wt) + S'' cos(wt) + constant to the samples.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, PRNGKeyArray

from ..errors import refuse
from ..grid import Periodic, as_real
from .amplifier import Amplifier
from .noise import Noise, draw, split_gaussian, total_spectrum
from .scan import ConstantSpeed
from .scenario import Scenario
from .sensor import Sensor

PERIOD_SAMPLES = 64  # of a charge over one period, and of a signal whose rate nothing sets
SAME_GAIN = 1e-5  # of numbers that only rounding tells apart, in single precision too
_DISTINCT = 1e-6  # of the samples' sine and cosine: below, one of them is not seen


def gain_at_rest(amplifier: Amplifier) -> float:
    """g in signal = g d^n Q/dt^n, n the amplifier's order.

    Raises `BadInput` for an amplifier whose gain goes with the speed in any other way, as one that
    integrates along x.
    """
    one, two = (float(amplifier.at_speed(as_real(u))) / u**amplifier.order for u in (1.0, 2.0))
    refuse(
        abs(two - one) > SAME_GAIN * abs(one),
        f"{type(amplifier).__name__} integrates along x, but the rig's sensor is at "
        "rest: give amplifier=current or amplifier=charge_dc.",
    )
    return one


def readout(
    sensor: Sensor, frequency_hz: Float[np.ndarray, "*f"], averaged_s: float = 0.0
) -> Complex[np.ndarray, "*f"]:
    """Complex amplitude of the signal over that of the charge at each frequency [Hz], through
    amplifier and filters.

    `averaged_s` [s]: a sample is the mean over so long before it, as an integrating converter
    takes it. Raises `BadInput` as `gain_at_rest` does.
    """
    omega = 2 * np.pi * np.asarray(frequency_hz, float)
    total = gain_at_rest(sensor.amplifier) * (1j * omega) ** sensor.amplifier.order
    for each in sensor.filters:
        total = total * np.asarray(each.response(jnp.asarray(omega))).reshape(omega.shape)
    mean = np.sinc(omega * averaged_s / (2 * np.pi)) * np.exp(-0.5j * omega * averaged_s)
    return total * mean


def harmonics(values: Float[np.ndarray, "*row sample"]) -> Complex[np.ndarray, "*row order"]:
    """Complex amplitudes of values over one even period from t = 0: the n-th is c in
    Im[c exp(i n w t)], that at 0 the mean."""
    n = values.shape[-1]
    amplitude = 2j * np.fft.rfft(values, axis=-1) / n
    amplitude[..., 0] /= 2j
    return amplitude


def apparent_frequency_hz(frequency_hz: Any, rate_hz: float) -> np.ndarray:
    """The frequency [Hz] at which samples show a wave: folded into 0 to half their rate."""
    frequency = np.asarray(frequency_hz, float)
    return np.asarray(np.abs(frequency - rate_hz * np.round(frequency / rate_hz)))


def lock_in(
    signal: Float[np.ndarray, "*row sample"], time_s: Float[np.ndarray, " sample"], frequency_hz
) -> Complex[np.ndarray, "*row"]:
    """Complex amplitude c (*row,) of Im[c exp(iwt)] in the samples, by least squares beside a
    constant; NaN where the samples show no more than one phase of the wave, as at half their
    rate."""
    turn = 2 * np.pi * float(frequency_hz) * np.asarray(time_s)
    base = np.stack([np.sin(turn), np.cos(turn), np.ones_like(turn)], axis=-1)
    sizes = np.linalg.svd(base, compute_uv=False)
    if sizes[-1] < _DISTINCT * sizes[0]:
        return np.full(np.shape(signal)[:-1], np.nan + 0j)
    in_phase, ahead, _ = np.moveaxis(np.asarray(signal) @ np.linalg.pinv(base).T, -1, 0)
    return in_phase + 1j * ahead


def steady_signal(
    sensor: Sensor,
    charge_C: Float[np.ndarray, "*row sample"],
    frequency_hz: float,
    time_s: Float[np.ndarray, " time"],
    averaged_s: float = 0.0,
) -> Float[np.ndarray, "*row time"]:
    """The signal at any times of a charge given over one even period from t = 0, without its mean:
    every harmonic of it through amplifier and filters."""
    amplitude = harmonics(charge_C)[..., 1 : (charge_C.shape[-1] + 1) // 2]
    frequency = frequency_hz * np.arange(1, amplitude.shape[-1] + 1)
    waves = np.exp(2j * np.pi * np.outer(frequency, np.asarray(time_s)))
    return np.imag((amplitude * readout(sensor, frequency, averaged_s)) @ waves)


def measured(
    scenario: Scenario,
    charge_C: Float[np.ndarray, "row sample"],
    frequency_hz: float,
    periods: int,
    key: PRNGKeyArray,
    averaged_s: float = 0.0,
) -> Complex[np.ndarray, " row"]:
    """Complex amplitude (row,) of the signal as a lock-in finds it in the recorded samples.

    - `charge_C` [C]: of every row over one even period from t = 0.
    - `periods`: how many are recorded, at least; at the recorder's rate, or 64 samples each.
    - `averaged_s` [s]: before each sample, that it is the mean of.

    Raises `BadInput` for noise that is correlated along x, which a sensor at rest has not.
    """
    recorder = scenario.recorder
    rate = recorder.sample_rate_hz or PERIOD_SAMPLES * frequency_hz
    # A power of two, so that many frequencies share few programs.
    count = 2 ** int(np.ceil(np.log2(max(periods * rate / frequency_hz, PERIOD_SAMPLES))))
    time = np.arange(count) / rate
    signal = steady_signal(scenario.sensor, charge_C, frequency_hz, time, averaged_s)
    signal = as_real(signal)
    if scenario.noises:
        signal = signal + _noise(scenario, signal, rate, key)
    return lock_in(np.asarray(recorder.convert(signal), float), time, frequency_hz)


def noise_rms_at_rest(noises: tuple[Noise, ...], rate_hz: float, signal_rms: float) -> float:
    """Noise [signal units, rms] of each sample of a resting sensor.

    Raises `BadInput` for noise that is correlated along x.
    """
    if not noises:
        return 0.0
    power = _power_at_rest(noises, 4, rate_hz, signal_rms)
    return float(np.sqrt(np.asarray(power)[-1]))


def _noise(scenario: Scenario, signal: Any, rate_hz: float, key: PRNGKeyArray) -> Any:
    """Noise (row, sample) of the scenario's causes."""
    rms = np.sqrt(np.mean(np.asarray(signal) ** 2))
    power = _power_at_rest(scenario.noises, signal.shape[-1], rate_hz, rms)
    return draw(key, power, *signal.shape)


def _power_at_rest(noises: tuple[Noise, ...], count: int, rate_hz: float, signal_rms: Any) -> Any:
    """The power (k,) of so many samples, of causes of which one that slides has no meaning."""
    gaussian, others = split_gaussian(noises)
    line, passing = Periodic(count, 1 / rate_hz), ConstantSpeed(1.0)
    power = total_spectrum(gaussian, line, passing, signal_rms)
    values = np.asarray(power)
    names = ", ".join(type(each).__name__ for each in noises)
    refuse(
        bool(others) or bool(np.ptp(values) > SAME_GAIN * np.max(values)),
        f"noise names one that is correlated along x ({names}), but the rig's sensor "
        "is at rest: give noise=[johnson], noise=[white] or noise=[snr].",
    )
    return power
