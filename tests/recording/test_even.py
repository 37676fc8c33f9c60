"""Rows that were lost, stamps that are rounded, drift or jitter, and rates that disagree."""

import subprocess
import sys

import numpy as np
import pytest

from srsinv.recording import Recording, save
from srsinv.recording._timing import even_times
from srsinv.recording.even import load_even, on_even_times
from tests.refusals import refused

N = 2000
ROW = np.arange(N)
RNG = np.random.default_rng(0)


def all_but(*dropped):
    observed = np.ones(N, bool)
    for each in dropped:
        observed[each] = False
    return observed


DROPOUTS = {
    "none": all_but(),
    "one": all_but(1234),
    "the second": all_but(1),
    "the last but one": all_but(-2),
    "the first and the last": all_but(0, 1, -1),
    "one in ten": all_but(slice(5, None, 10)),
    "a tenth": all_but(1 + np.flatnonzero(RNG.random(N - 2) < 0.1)),
    "a half": all_but(1 + np.flatnonzero(RNG.random(N - 2) < 0.5)),
    "a burst": all_but(slice(700, 1100)),
    "many bursts": all_but(
        *(slice(start, start + 3 + start % 40) for start in range(50, 1900, 90))
    ),
}
# Stamps [s], whether rows are put where they stand (else their signal is interpolated), and how
# far from its stamp a row may come to stand, in intervals: half of a last digit at most.
STAMPS = {
    "6 digits": (np.round(ROW * 1e-4, 6), True, 1e-6),
    "from 1970 on": (1.7e9 + ROW * 1e-3, True, 1e-3),
    "whole ms, 1000 Hz": (ROW / 1000, True, 1e-6),
    "whole ms, 500 Hz": (2 * ROW / 1000, True, 1e-6),
    "whole ms, 400 Hz": (np.round(2.5 * ROW) / 1000, True, 0.25),
    "whole ms, 300 Hz": (np.round(ROW / 0.3) / 1000, True, 0.25),
    "whole ms, 35.5 Hz": (np.round(28.14 * ROW) / 1000, True, 0.05),
    "jitter of 5 %": ((ROW + RNG.uniform(-0.05, 0.05, N)) * 1e-4, True, 0.15),
    "a clock that drifts": (ROW * 1e-4 * (1 + 1e-4 * ROW / N), True, 0.15),
    "a clock that drifts much": (ROW * 1e-4 * (1 + 5e-3 * ROW / N), False, 0.0),
    "jitter that adds up": (np.cumsum(RNG.uniform(0.9, 1.1, N)) * 1e-4, False, 0.0),
}


def recorded(time_s, observed, position=False):
    """A signal that says at what time it was taken, at a speed that grows."""
    own = time_s - time_s[0]
    return Recording(
        own[observed][None], time_s[observed], 0.05 + own[observed], ("voltage_0_V",),
        measured_position_m=2 * own[observed] if position else None,
    )  # fmt: skip


@pytest.mark.parametrize("dropout", DROPOUTS)
@pytest.mark.parametrize("stamps", STAMPS)
def test_every_row_stays_where_its_stamp_is(stamps, dropout):
    """The signal is its own time: what is on an even time was taken then."""
    (time_s, placed, most), observed = STAMPS[stamps], DROPOUTS[dropout]
    given = recorded(time_s, observed, position=True)
    even = on_even_times(given)
    step = np.diff(even.time_s)
    assert np.ptp(step) < 1e-6 * step.mean() + 4 * np.spacing(even.time_s[-1])
    taken = even.signal[0] + time_s[0]
    off = np.abs(taken - even.time_s)[np.isfinite(taken)] / step.mean()
    assert off.max() <= most + 0.02
    np.testing.assert_allclose(even.speed_m_per_s, 0.05 + even.time_s - time_s[0], atol=2e-3)
    np.testing.assert_allclose(even.position_m, 2 * (even.time_s - time_s[0]), atol=2e-3)
    between = np.ptp(np.flatnonzero(observed)) + 1 - observed.sum()
    if placed:
        assert even.missing_rows == np.isnan(even.signal[0]).sum() == between
        np.testing.assert_array_equal(even.signal[0][~np.isnan(even.signal[0])], given.signal[0])
    else:  # the clock is elsewhere by the end of a long gap
        assert abs(even.missing_rows - between) <= 0.01 * max(between, 1)
        # Nothing is drawn across rows that are not there.
        row, stood_s = np.flatnonzero(observed), time_s[observed]
        before = np.searchsorted(stood_s[1:-1], even.time_s, side="right")
        across = (np.diff(row) > 1)[before] & (even.time_s > stood_s[before])
        np.testing.assert_array_equal(
            np.isnan(even.signal[0]), across & (even.time_s < stood_s[before + 1])
        )


def test_nothing_is_moved_where_no_row_is_lost():
    given = recorded(STAMPS["6 digits"][0], DROPOUTS["none"])
    even = on_even_times(given)
    np.testing.assert_array_equal(even.signal, given.signal)
    np.testing.assert_array_equal(even.time_s, np.linspace(0, given.time_s[-1], N))
    assert (even.missing_rows, even.gaps) == (0, 0)


def test_a_stated_rate_tells_rounding_from_lost_rows():
    """833 Hz in whole milliseconds looks like 1000 Hz with a sixth of the rows lost."""
    time_s = np.round(1.2 * ROW) / 1000
    assert even_times("r", time_s).missing_rows > 300
    assert even_times("r", time_s, 833.3).missing_rows == 0
    assert even_times("r", np.arange(N) / 1000, 1000).missing_rows == 0


REFUSED = {
    "jitter": (np.cumsum(RNG.uniform(0.5, 1.5, N)), "even times", "recording.times=ignore"),
    "a day's rest": (
        np.concatenate([ROW[:1000], ROW[1000:] + 86_400_000]) / 1000.0,
        "cut the recording", "after data row 1000",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_times_that_are_not_even(name):
    time_s, *words = REFUSED[name]
    refused(lambda: on_even_times(recorded(time_s, DROPOUTS["none"])), *words)


# Stated beside stamps of 2000 Hz, and whether it is said to agree.
RATES = {2000: True, 2000.0003: True, 1995: True, 2100: False, 1000: False, 2e6: False}


@pytest.mark.parametrize("by", ["sidecar", "command line"])
@pytest.mark.parametrize("rate", RATES)
def test_a_rate_beside_times(tmp_path, rate, by):
    """Lost rows change nothing of that: the interval is what a rate states."""
    observed = DROPOUTS["a tenth"]
    scan = recorded(ROW / 2000, observed)
    path = tmp_path / "r.nc"
    save(scan, path)
    (tmp_path / "r.json").write_text(f'{{"sample_rate_hz": {rate}}}' if by == "sidecar" else "{}")
    settings = {"path": str(path)} | ({} if by == "sidecar" else {"sample_rate_hz": rate})
    if RATES[rate]:
        assert load_even(settings, {}).missing_rows == np.sum(~observed)
        return
    refused(
        lambda: load_even(settings, {}),
        f"sample_rate_hz is {rate:.6g}", "2000 Hz", "recording.sample_rate_hz=2000",
        "recording.times=ignore",
    )  # fmt: skip
    forced = load_even(settings | {"times": "ignore"}, {})
    assert forced.missing_rows == 0
    assert forced.sample_rate_hz == pytest.approx(rate)


def test_times_left_out_need_a_rate(tmp_path):
    save(recorded(ROW / 2000, DROPOUTS["none"]), tmp_path / "r.nc")
    settings = {"path": str(tmp_path / "r.nc"), "times": "ignore"}
    refused(lambda: load_even(settings, {}), "recording.times=ignore", "recording.sample_rate_hz")


@pytest.mark.full
def test_no_jax_is_needed():
    """So that a bad recording is refused within a second."""
    heavy = "[m for m in sys.modules if m.split('.')[0] in ('jax', 'equinox')]"
    code = f"import sys, srsinv.recording.even, srsinv.recording.noise; sys.exit(len({heavy}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
