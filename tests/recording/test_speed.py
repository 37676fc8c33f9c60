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
        with pytest.raises(BadInput, match=r"no speed can be derived"):
            speed_of(tmp_path, time_s, time_s)
    else:
        np.testing.assert_allclose(speed_of(tmp_path, time_s, time_s), 1.0, rtol=1e-9)


def test_times_that_only_a_start_far_away_sets_apart(tmp_path):
    with pytest.raises(BadInput, match=r"no speed can be derived"):
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
