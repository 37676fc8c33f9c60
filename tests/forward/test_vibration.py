"""Readout, samples and lock-in of a charge that oscillates, against closed forms."""

import jax
import numpy as np
import pytest

from srsinv.forward.amplifier import ChargeReadout, IntegratedCurrent
from srsinv.forward.filter import Butterworth, FirstOrder
from srsinv.forward.noise import Johnson, Sliding, White
from srsinv.forward.recorder import Recorder
from srsinv.forward.sampling import Saturation
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scenario import Scenario
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import (
    PERIOD_SAMPLES,
    apparent_frequency_hz,
    gain_at_rest,
    harmonics,
    lock_in,
    measured,
    readout,
    steady_signal,
)
from tests.refusals import refused

FREQUENCY = np.geomspace(10.0, 1000.0, 9)
TURN = 2 * np.pi * np.arange(PERIOD_SAMPLES) / PERIOD_SAMPLES
KEY = jax.random.key(0)


def scenario(sensor=None, recorder=None, noises=()):
    parts = {} if recorder is None else {"recorder": recorder}
    return Scenario(None, sensor or Sensor(), ConstantSpeed(0.05), noises=noises, **parts)


def swept(own, charge=1e-12, periods=8):
    return np.array(
        [measured(own, charge * np.sin(TURN)[None], f, periods, KEY)[0] for f in FREQUENCY]
    )


def test_the_rate_of_a_sine_is_6_dB_per_octave_at_90_degrees():
    signal = readout(Sensor(), FREQUENCY)
    np.testing.assert_allclose(signal, 1e6 * 2j * np.pi * FREQUENCY, rtol=1e-14)
    np.testing.assert_allclose(swept(scenario()), 1e-12 * signal, rtol=1e-11)
    octave = np.abs(readout(Sensor(), np.array([100.0, 200.0])))
    assert 20 * np.log10(octave[1] / octave[0]) == pytest.approx(20 * np.log10(2), rel=1e-14)


def test_the_charge_itself_is_flat_and_in_phase():
    sensor = Sensor(amplifier=ChargeReadout(2e6))
    np.testing.assert_allclose(swept(scenario(sensor)), 2e-6, rtol=1e-11)


def test_filters_and_averages_by_their_closed_forms():
    sensor = Sensor(filters=[FirstOrder(1e-3), Butterworth(300.0, 2)])
    w = 2 * np.pi * FREQUENCY
    s = 1j * FREQUENCY / 300.0
    expected = 1e6 * 1j * w / (1 + 1j * w * 1e-3) / (1 + np.sqrt(2) * s + s**2)
    np.testing.assert_allclose(readout(sensor, FREQUENCY), expected, rtol=1e-12)
    mean = -np.expm1(-1j * w * 2e-3) / (1j * w * 2e-3)  # of exp(iwt) over 2 ms before
    np.testing.assert_allclose(readout(Sensor(), FREQUENCY, 2e-3), 1e6j * w * mean, rtol=1e-11)


def test_samples_show_a_wave_folded_and_a_lock_in_reads_it_all_the_same():
    rate, frequency, n = 1000.0, 790.0, 1000
    time = np.arange(n) / rate
    charge = np.sin(TURN)[None]
    signal = steady_signal(Sensor(), charge, frequency, time)[0]
    spectrum = np.abs(np.fft.rfft(signal))
    assert np.fft.rfftfreq(n, 1 / rate)[spectrum.argmax()] == pytest.approx(210.0)
    assert apparent_frequency_hz(frequency, rate) == pytest.approx(210.0)
    np.testing.assert_allclose(
        apparent_frequency_hz([100, 500, 1000, 1250], rate), [100, 500, 0, 250]
    )
    own = scenario(recorder=Recorder(sample_rate_hz=rate))
    read = measured(own, charge, frequency, 8, KEY)[0]
    assert read == pytest.approx(1e6 * 2j * np.pi * frequency, rel=1e-10)
    assert np.isnan(measured(own, charge, 500.0, 8, KEY)[0])


def test_rails_cut_the_first_harmonic_by_the_describing_function():
    """A sine of amplitude A held at L = A c: 2/pi (asin c + c sqrt(1 - c^2)) of it is left."""
    c = 0.4
    sensor = Sensor(amplifier=ChargeReadout(1.0))
    own = scenario(sensor, Recorder(sample_rate_hz=2.0**14, conversions=(Saturation(c),)))
    left = 2 / np.pi * (np.arcsin(c) + c * np.sqrt(1 - c**2))
    assert measured(own, np.sin(TURN)[None], 16.0, 8, KEY)[0] == pytest.approx(left, rel=1e-5)


def test_harmonics_of_a_sum_of_waves():
    turn = 2 * np.pi * np.arange(256) / 256
    values = 3.0 + 2 * np.sin(turn) + 0.5 * np.cos(3 * turn)
    ours = harmonics(values)
    np.testing.assert_allclose(ours[:4], [3.0, 2.0, 0.0, 0.5j], atol=1e-14)


def test_lock_in_of_an_offset_wave():
    time = np.arange(90) / 700.0
    signal = 5.0 + np.array([[2.0], [0.0]]) * np.sin(60 * time) + 3.0 * np.cos(60 * time)
    np.testing.assert_allclose(lock_in(signal, time, 60 / (2 * np.pi)), [2 + 3j, 3j], atol=1e-12)


def test_noise_of_a_lock_in():
    """White noise of rms s over n samples leaves s sqrt(2/n) in each phase; Johnson's density does
    not depend on the rate."""
    charge, periods = np.zeros((400, PERIOD_SAMPLES)), 16
    read = measured(scenario(noises=(White(1e-3),)), charge, 100.0, periods, KEY)
    n = PERIOD_SAMPLES * periods
    assert np.std(read.real) == pytest.approx(1e-3 * np.sqrt(2 / n), rel=0.1)
    johnson = measured(scenario(noises=(Johnson(),)), charge, 100.0, periods, KEY)
    density = 4 * 1.380649e-23 * 300 * 1e6
    assert np.std(johnson.imag) == pytest.approx(np.sqrt(density / (periods / 100)), rel=0.1)


def test_refusals():
    refused(lambda: gain_at_rest(IntegratedCurrent()), "IntegratedCurrent", "at rest", "current")
    own = scenario(noises=(Sliding(),))
    refused(lambda: swept(own), "Sliding", "correlated along x", "noise=[johnson]")
