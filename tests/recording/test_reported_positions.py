"""Positions that a stage reports now and then, in motions of several kinds."""

from pathlib import Path

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import Recording
from srsinv.recording.even import load_even
from tests.recording.scan import RATE_HZ, rows_of

T_S = np.arange(3000) / RATE_HZ
NOISE = np.random.default_rng(3).normal(size=T_S.size)
# motion [mm] of the time, samples between reports, the first of these samples
HELD = {
    "even": (lambda t: 20 * t, 40, 0),
    "from another sample": (lambda t: 20 * t, 40, 13),
    "accelerated": (lambda t: 5 * t + 8 * t**2, 20, 3),
    "there and back": (lambda t: 10 - 10 * np.cos(2 * np.pi * t / 1.5), 25, 0),
    "every second": (lambda t: 20 * t + 3 * t**2, 2, 0),
    "with rests": (lambda t: 4 - 4 * np.cos(np.pi * np.clip((t - 0.4) / 0.7, 0, 1)), 20, 5),
}


def of_stage(folder: Path, position_mm) -> Recording:
    """Noise beside these positions, read."""
    rows = rows_of(1e3 * T_S, NOISE, position_mm)
    (folder / "r.csv").write_text("Time (ms),Ch 0 [V],Stage pos (mm)\n" + rows)
    return load_even({"path": str(folder / "r.csv")}, {})


@pytest.mark.parametrize("case", HELD)
def test_positions_held_between_reports(tmp_path, case):
    motion_mm, every, phase = HELD[case]
    last = (np.arange(T_S.size) - phase) // every * every + phase
    recording = of_stage(tmp_path, np.round(motion_mm(last / RATE_HZ), 4))
    inner = slice(every, -2 * every)
    off_mm = 1e3 * recording.position_m - motion_mm(T_S)
    assert np.max(np.abs(off_mm[inner])) < 0.011  # 10 um, and the report's rounding
    assert recording.notes or recording.doubts
    moving = recording.speed_m_per_s[inner] > 1e-3
    assert np.all(moving) or case in ("there and back", "with rests")


@pytest.mark.parametrize(
    ("case", "blank"), [("even", ""), ("from another sample", "NaN"), ("with rests", "")]
)
def test_positions_that_are_written_now_and_then(tmp_path, case, blank):
    motion_mm, every, phase = HELD[case]
    at = np.arange(phase, T_S.size, every)
    cells = np.full(T_S.size, blank, object)
    cells[at] = [repr(float(v)) for v in np.round(motion_mm(T_S[at]), 4)]
    recording = of_stage(tmp_path, cells)
    left = slice(at[0], at[-1] + 1)
    np.testing.assert_array_equal(recording.signal[0], NOISE[left])
    assert np.max(np.abs(1e3 * recording.position_m - motion_mm(T_S)[left])) < 0.011
    assert any(f"reported in {at.size} of" in note for note in recording.notes)
    assert any("left out" in note for note in recording.notes) == (recording.time_s.size < T_S.size)


def test_few_positions_are_not_interpolated(tmp_path):
    cells = np.full(T_S.size, "", object)
    cells[[0, -1]] = ["10.0", "13.99"]
    with pytest.raises(BadInput, match=r"data row 2 of column Stage pos \(mm\) is empty"):
        of_stage(tmp_path, cells)


def test_reports_that_come_unevenly(tmp_path):
    """The stage is busy at times: 20 samples between reports, and half as many more or fewer."""
    at = np.cumsum(np.random.default_rng(8).integers(10, 31, size=400))
    last = at[np.searchsorted(at, np.arange(T_S.size), side="right") - 1]
    position_mm = np.round(20 * last / RATE_HZ + 3 * (last / RATE_HZ) ** 2, 4)
    position_mm[: at[0]] = 0.0
    off_mm = 1e3 * of_stage(tmp_path, position_mm).position_m - (20 * T_S + 3 * T_S**2)
    assert np.max(np.abs(off_mm[60:-60])) < 0.011


@pytest.mark.parametrize(
    ("count_mm", "digits"), [(2e-3, 9), (10e-3, 9), (4.8828e-3, 3), (12.207e-3, 4)]
)
def test_counts_of_an_encoder_are_no_reports(tmp_path, count_mm, digits):
    position_mm = np.round(count_mm * np.round(2 * T_S / count_mm), digits)  # 1 um a sample
    recording = of_stage(tmp_path, position_mm)
    assert recording.notes == ()
    if digits == 9:  # else its steps are rounded, too
        assert recording.doubts == ()
        np.testing.assert_allclose(1e3 * recording.position_m, position_mm, atol=1e-9)
