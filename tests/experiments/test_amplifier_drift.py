"""Feedback circuits and the warmth that reaches a film, against closed forms."""

import numpy as np
import pytest

from experiments.amplifier_drift import FeedbackCircuit, warming

CURRENT = FeedbackCircuit(1e6, 1e-11)
LEAK = FeedbackCircuit(1e9, 1e-10)
CHARGE = FeedbackCircuit(np.inf, 1e-10)
CIRCUITS = pytest.mark.parametrize("circuit", [CURRENT, LEAK, CHARGE])


@CIRCUITS
def test_a_constant_current_charges_the_capacitor_through_its_leak(circuit):
    time = np.concatenate([[0], np.geomspace(1e-6, 100, 301)])
    output, r, c = circuit.over_time(2e-12 * time, time), *circuit
    leaks = 2e-12 * r * -np.expm1(-time / (r * c)) if np.isfinite(r) else 2e-12 * time / c
    np.testing.assert_allclose(output, leaks, rtol=1e-9, atol=1e-30)


@CIRCUITS
def test_a_wave_over_time_becomes_the_steady_one(circuit):
    """After ten time constants; without a leak the start is a constant that stays."""
    period, n, cycles = 0.05, 500, 40
    time = period * np.arange(n * cycles) / n
    wave = 1e-15 * np.sin(2 * np.pi * time / period)
    last = circuit.over_time(wave, time)[-n:]
    steady = circuit.periodic(wave[:n], period)
    np.testing.assert_allclose(last - last.mean(), steady, atol=2e-2 * np.abs(steady).max())
    turn = 2 * np.pi / period
    size = 1e-15 * turn / np.abs(1 / circuit.resistance_ohm + 1j * turn * circuit.capacitance_F)
    assert np.abs(steady).max() == pytest.approx(size, rel=1e-4)


def test_warmth_arrives_by_diffusion():
    """The rate is greatest at z^2/(6 a): (6^1.5/(2 sqrt(pi))) exp(-1.5) a/z^2."""
    depth, a = 0.75e-3, 1e-7
    time = np.linspace(0, 10, 100_001)
    rate = np.diff(warming(time, depth, a)) / np.diff(time)
    assert time[rate.argmax()] == pytest.approx(depth**2 / (6 * a), rel=1e-3)
    greatest = 6**1.5 / (2 * np.sqrt(np.pi)) * np.exp(-1.5) * a / depth**2
    assert rate.max() == pytest.approx(greatest, rel=1e-6)
    assert warming(np.array([0.0, 1e9]), depth, a) == pytest.approx([0, 1], abs=1e-4)
