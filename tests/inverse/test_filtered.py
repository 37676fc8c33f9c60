"""Filtered recordings beside those whose hum and drift are inverted with the traction: what bands
hold, and what is said."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from srsinv.jobs._facts import of_samples
from srsinv.recorded import mains_of, problem_of
from srsinv.recording import Recording
from srsinv.recording.even import on_even_times
from tests.inverse.noise.test_nuisance import (
    COUNT,
    DEPTH,
    NOISE,
    SPEED,
    TIME_S,
    covariance_of,
    estimator,
    hum,
    problem,
    sensor,
)

COARSE_M = DEPTH / 3


class RecordedWalks:
    """Pressures that are random walks along x, as the prior has them, and recordings of them, their
    signals about 100 times the noise."""

    def __init__(self, speed):
        clean = problem(np.zeros((2, COUNT)), speed=speed).to_grid(COARSE_M)
        self.speed, self.line = speed, clean.line
        columns = jax.vmap(lambda row: clean.forward(row[None]))(jnp.eye(self.line.n))
        self.model = np.moveaxis(np.asarray(columns), 0, -1)[:, clean.observed_cells]
        self.operator = problem(np.zeros((2, COUNT)), speed=speed).operator(clean.line)
        self.cells = np.eye(clean.line.n)[clean.observed_cells]
        walk = np.cumsum(np.random.default_rng(9).normal(size=clean.line.n))
        self.step = 100 * NOISE / np.std(self.signal(walk))

    def signal(self, p):
        return np.asarray(self.operator(jnp.stack([p, 0.3 * p])))

    def errors(self, spoil, rows, **facts):
        """Errors of `rows` (row, cell) of the pressure, over the errors stated, of some draws."""
        steps = np.diff(np.eye(self.line.n), axis=0) / self.step
        precision = steps.T @ steps + 1e-9 / self.step**2 * np.eye(self.line.n)
        ratios = []
        for rng in map(np.random.default_rng, range(3)):
            p = self.step * np.cumsum(rng.normal(size=self.line.n))
            signal = self.signal(p) + NOISE * rng.normal(size=(2, COUNT)) + spoil(rng)
            speed = np.full(COUNT, self.speed)
            given = on_even_times(Recording(signal, TIME_S, speed, ("a", "b"), facts))
            drift, lines = facts.get("drift", 0.0), mains_of(given)
            gridded = problem(given.signal, drift, lines=lines, speed=self.speed).to_grid(COARSE_M)
            maps, covariance = estimator(
                self.model, [covariance_of(gridded, e) for e in range(2)], precision
            )
            data = np.asarray(gridded.data)[:, gridded.observed_cells]
            error = rows @ (sum(m @ d for m, d in zip(maps, data, strict=True)) - p)
            ratios.append(error / np.sqrt(np.diag(rows @ covariance @ rows.T)))
        return np.array(ratios)

    def less_mean(self):
        """The rows of the pressure at each cell less its mean over the scan."""
        return self.cells - self.cells.mean(axis=0)

    def waves(self, frequency_Hz):
        """The rows of the waves that pass at a frequency, tapered to the scan."""
        taper = np.hanning(len(self.cells)) @ self.cells
        phase = 2 * np.pi * frequency_Hz * np.asarray(self.line.x) / self.speed
        return taper * np.stack([np.cos(phase), np.sin(phase)])


def loud_hum(rng):
    """A line of 10 times the signal's rms."""
    return 1000 * NOISE * hum(rng, [np.sqrt(2)])


def loud_walk(rng):
    """A walk from zero that reaches 0.3 of the signal's rms."""
    return 30 * NOISE / np.sqrt(COUNT) * np.cumsum(rng.normal(size=(2, COUNT)), axis=1)


def is_chi_square(ratios, false_alarm=1e-4):
    """Whether squares of errors over standard errors, independent ones, are as they should be."""
    return false_alarm < scipy.stats.chi2.sf(np.sum(ratios**2), ratios.size) < 1 - false_alarm


@pytest.mark.full
def test_bands_hold_what_mains_cost_and_not_what_a_notch_takes():
    """50 Hz at 0.1 m/s is a wave of 2 mm, which the skin transmits."""
    walks = RecordedWalks(0.1)
    waves = walks.waves(50.1)
    assert is_chi_square(walks.errors(loud_hum, waves, mains_Hz=50.0))
    notched = walks.errors(loud_hum, waves, notch_Hz=50.1)
    print(f"with a notch, squared errors are {np.mean(notched**2):.3g} of those stated")
    assert not is_chi_square(notched)


@pytest.mark.full
def test_a_notch_above_the_skin_s_cut_off_costs_nothing():
    walks = RecordedWalks(SPEED)
    ratios = [
        walks.errors(spoil, walks.less_mean(), **facts)
        for spoil, facts in ((lambda _: 0.0, {}), (loud_hum, {"notch_Hz": 50.1}))
    ]
    # Noise is drawn before hum, so that both have the same.
    assert np.sqrt(np.mean((ratios[1] - ratios[0]) ** 2)) < 0.1


@pytest.mark.full
def test_bands_hold_what_drift_costs_and_not_what_a_high_pass_takes():
    walks = RecordedWalks(SPEED)
    rows = walks.less_mean()
    drift = 30 * NOISE / np.sqrt(TIME_S[-1])
    with_walk, filtered, clean, detrended = (
        np.mean(np.abs(walks.errors(spoil, rows, **facts)) < 1.645)
        for spoil, facts in (
            (loud_walk, {"drift": drift}),
            (loud_walk, {"high_pass_Hz": 1.0}),
            (lambda _: 0.0, {"high_pass_Hz": 1.0}),
            (lambda _: 0.0, {"detrend": "linear"}),
        )
    )
    print(f"90 % bands cover {with_walk:.2f} with drift, {filtered:.2f} filtered; of a signal "
          f"without drift {clean:.2f} filtered, {detrended:.2f} detrended")  # fmt: skip
    assert with_walk > 0.8
    assert max(filtered, clean, detrended) < 0.5


def test_a_result_records_what_was_taken():
    signal = np.random.default_rng(0).normal(size=(2, COUNT))
    facts = {"notch_Hz": [50.0, 150.0], "high_pass_Hz": 2.0, "detrend": "linear"}
    for asked in (facts, {}):
        given = Recording(signal, TIME_S, np.full(COUNT, SPEED), ("a", "b"), asked)
        recorded = of_samples(on_even_times(given), "use")
        expected = {**asked, "notch_Hz": "50, 150", "notch_width_Hz": 2.0} if asked else {}
        keys = ("detrend", "high_pass_Hz", "notch_Hz", "notch_width_Hz")
        assert {key: recorded[key] for key in keys if key in recorded} == expected


@pytest.mark.full
def test_a_filtered_recording_says_so_and_its_samples_are_judged_as_recorded():
    rng = np.random.default_rng(0)
    signal = NOISE * (rng.normal(size=(2, COUNT)) + loud_hum(rng) / NOISE)
    signal[1, 400:450] = signal[1, 400]

    def warnings(speed, **facts):
        given = Recording(signal, TIME_S, np.full(COUNT, speed), ("a", "b"), facts)
        return " ".join(problem_of(on_even_times(given), sensor(), noise=NOISE).warnings)

    # The skin transmits 12 / (2 pi) waves in a depth: up to 32 Hz at 20 mm/s, 159 Hz at 100 mm/s.
    assert "notch_Hz" not in warnings(0.02, notch_Hz=50)
    assert "recording.notch_Hz=50 removed" in warnings(0.1, notch_Hz=50)
    assert "recording.high_pass_Hz=1 removed" in warnings(0.02, high_pass_Hz=1)
    assert "b is stuck" in warnings(0.02)
    assert "b is stuck" in warnings(0.02, notch_Hz=50)
