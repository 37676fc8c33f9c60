"""Speed from positions, on both sides of each condition that decides how it is derived."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import load

N, RATE_HZ = 400, 1000.0
TIME_S = np.arange(N) / RATE_HZ


def speed_of(tmp_path, time_s, position_m):
    np.savez(tmp_path / "r.npz", time_s=time_s, position_m=position_m, voltage_0_V=time_s)
    return load(tmp_path / "r.npz").speed_m_per_s


# Of the mean interval, from the shortest to where a spline is taken: a sample more, or a few.
CLOSE = 10.0 ** -np.array([2, 3, 5, 8, 11])


@pytest.mark.parametrize("place", [0, 200, N - 1])
@pytest.mark.parametrize("count", [1, 3, 50])
def test_times_that_are_close_together(tmp_path, place, count):
    """However close, the speed is right to a hundredth and what rounding of positions makes."""
    for close in CLOSE:
        apart_s = close / RATE_HZ
        time_s = np.sort(np.append(TIME_S, TIME_S[place] + apart_s * np.arange(1, count + 1)))
        position_m = 0.05 * time_s + 1e-3 * np.sin(7 * time_s)
        true = 0.05 + 7e-3 * np.cos(7 * time_s)
        rounding = np.finfo(float).eps * position_m.max() / np.diff(time_s).min()
        got = speed_of(tmp_path, time_s, position_m)
        np.testing.assert_allclose(got, true, rtol=0.01, atol=8 * rounding, err_msg=f"{close}")


@pytest.mark.parametrize(
    ("shortest_s", "is_refused"),
    [(1e-17, True), (1e-16, True), (5e-16, True), (2e-15, False), (1e-9, False)],
)
def test_times_that_nothing_is_between(tmp_path, shortest_s, is_refused):
    """A float64 resolves 2e-16 of the four seconds."""
    time_s = np.array([0.0, shortest_s, 2 * shortest_s, 1.0, 2.0, 3.0, 4.0])
    if is_refused:
        with pytest.raises(BadInput, match=r"too close together"):
            speed_of(tmp_path, time_s, time_s)
    else:
        np.testing.assert_allclose(speed_of(tmp_path, time_s, time_s), 1.0, rtol=1e-9)


def test_times_that_only_a_start_far_away_sets_apart(tmp_path):
    with pytest.raises(BadInput, match=r"too close together"):
        speed_of(tmp_path, np.array([-1.0, 1e-17, 2e-17, 1.0]), np.arange(4.0))


@pytest.mark.parametrize("start_m", [0.0, 0.01, -3.0, 1e3])
@pytest.mark.parametrize("span_m", [1e-12, 1e-10, 1e-8, 1e-6, 1e-3])
def test_positions_that_are_nearly_equal(tmp_path, start_m, span_m):
    """The mean speed is theirs, within the rounding of positions, or zero of a range that is
    rounding alone."""
    unit_m = np.spacing(abs(start_m) + span_m)
    position_m = start_m + span_m * TIME_S / TIME_S[-1]
    speed = speed_of(tmp_path, TIME_S, position_m)
    if span_m < 2 * unit_m:
        np.testing.assert_array_equal(speed, 0.0)
    else:
        left = 0.02 * span_m + 8 * unit_m
        assert abs(speed.mean() * TIME_S[-1] - np.ptp(position_m)) <= left


@pytest.mark.parametrize(("ulps", "stands"), [(0, True), (1, True), (3, True), (8, False)])
@pytest.mark.parametrize("start_m", [0.01, -7.0, 1e3])
def test_places_that_differ_by_rounding(tmp_path, start_m, ulps, stands):
    drawn = np.random.default_rng(0).integers(0, ulps + 1, N)
    drawn[:2] = 0, ulps
    speed = speed_of(tmp_path, TIME_S, start_m + drawn * np.spacing(abs(start_m)))
    assert np.isfinite(speed).all()
    assert (not speed.any()) == stands


# Positions that are exact, few, at rest, or rounded by an encoder


def test_speed_from_positions_converges_with_fifth_order(tmp_path):
    errors = []
    for n in (20, 40, 80):
        time_s = np.linspace(5.0, 6.0, n)
        speed = speed_of(tmp_path, time_s, np.sin(4 * time_s))
        errors.append(np.max(np.abs(speed - 4 * np.cos(4 * time_s))))
    slopes = np.diff(np.log2(errors))
    assert np.all(slopes < -4.5), slopes


@pytest.mark.parametrize("samples", [3, 4, 5, 6])
def test_speed_of_few_positions(tmp_path, samples):
    time_s = np.arange(samples) * 0.1
    speed = speed_of(tmp_path, time_s, 2 - 3 * time_s**2)
    np.testing.assert_allclose(speed, -6 * time_s, atol=1e-12)


def test_positions_that_stand_still_or_start(tmp_path):
    """No swing of a spline makes a motion of rest, or turns one that never goes back."""
    at_rest, starting = 0.01 + 0 * TIME_S, 0.05 * np.maximum(TIME_S - 0.1, 0)
    for position_m, fastest in ((at_rest, 0.0), (starting, 0.05)):
        speed = speed_of(tmp_path, TIME_S, position_m)
        assert speed.min() >= 0
        np.testing.assert_allclose(speed.max(), fastest, rtol=1e-9)


@pytest.mark.parametrize("step_m", [1e-7, 1e-6, 2.5e-6])
def test_rounded_positions(tmp_path, step_m):
    """A spline through them would be off by the rounding over the interval: 5 m/s per metre."""
    rate_hz, mean = 2000.0, 0.02
    time_s = np.arange(4000) / rate_hz
    speed = mean * (1 + 0.2 * np.sin(2 * np.pi * time_s))
    exact = 0.01 + mean * (time_s - 0.2 / (2 * np.pi) * np.cos(2 * np.pi * time_s))
    got = speed_of(tmp_path, time_s, np.round(exact / step_m) * step_m)
    error = np.abs(got - speed)[64:-64]
    assert error.max() < 0.01 * mean
    # By a spline: of the order of the step over the interval.
    assert error.max() < 0.1 * step_m * rate_hz or step_m < 1e-6


def test_rounded_positions_neither_overshoot_nor_turn_back(tmp_path):
    rate_hz, mean = 2000.0, 0.02
    time_s = np.arange(2000) / rate_hz
    rounded = np.round(mean * np.clip(time_s - 0.25, 0, 0.5), 6)
    got = speed_of(tmp_path, time_s, rounded)
    assert got.min() >= 0
    assert got.max() <= np.diff(rounded).max() * rate_hz * (1 + 1e-9)
    np.testing.assert_allclose(got[:400], 0, atol=1e-12)
    np.testing.assert_allclose(got[700:1300], mean, rtol=2e-3)
