"""What is improbable is read, and doubted; what nothing can be found in is refused."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import Recording
from srsinv.recording.even import load_even, usable
from srsinv.recording.inspection import inspect
from tests.recording.scan import (
    MM,
    POSITION_M,
    SIGNAL_V,
    SPEED_M_PER_S,
    TIME_S,
    A,
    B,
    N,
    rows_of,
)

IMPROBABLE = {
    "seconds called milliseconds": {"time_ms": TIME_S},
    "a code for out of range": {"voltage_1_V": np.where(np.arange(N) % 150 == 7, -9999.0, B)},
    "metres called millimetres": {"position_m": MM, "position_mm": None},
    "seconds called hours": {"time_ms": 3.6e9 * TIME_S},
    "an unsigned speed there and back": {
        "position_mm": np.where(np.arange(N) < N // 2, MM, MM[::-1]),
        "speed_mm_per_s": np.full(N, 20.0),
    },
    "a position that jumps": {"position_mm": MM + 131.0 * (np.arange(N) > 250)},
    "blocks of 128 rows": {"position_mm": MM[np.arange(N) % 128]},
    "held, with noise": {
        "position_mm": MM[np.arange(N) // 20 * 20] + 1e-4 * np.sin(7 * np.arange(N))
    },
}


@pytest.mark.parametrize("case", IMPROBABLE)
def test_what_is_improbable_is_doubted(tmp_path, case):
    columns = {"time_ms": 1e3 * TIME_S, "position_mm": MM, "voltage_0_V": A, "voltage_1_V": B}
    columns = {k: v for k, v in (columns | IMPROBABLE[case]).items() if v is not None}
    rows = ",".join(columns) + "\n" + rows_of(*columns.values())
    (tmp_path / "r.csv").write_text(rows)
    recording = load_even({"path": str(tmp_path / "r.csv")}, {})
    assert recording.doubts
    assert inspect(tmp_path / "r.csv").doubts[: len(recording.doubts)] == recording.doubts


def test_facts_that_are_improbable_are_doubted(tmp_path):
    rows = "time_s,position_m,voltage_0_V,voltage_1_V\n" + rows_of(TIME_S, POSITION_M, A, B)
    (tmp_path / "r.csv").write_text(rows)
    for depth_m, doubted, said in ((0.75e-3, 0, 0), (0.75, 1, 1), (5e-5, 0, 1)):
        known = {"sensor": {"depth_m": depth_m}}
        assert len(load_even({"path": str(tmp_path / "r.csv")}, known).doubts) == doubted
        assert len(inspect(tmp_path / "r.csv", **known).doubts) == said
    for window_m, doubted in (([0.0, 0.1], 0), ([0.0, 0.011], 1)):
        known = {"path": str(tmp_path / "r.csv"), "contact_window_m": window_m}
        assert len(load_even(known, {}).doubts) == doubted


@pytest.mark.parametrize(("factor", "is_doubted"), [(1.0, False), (10.0, False), (1e4, True)])
def test_pressure_far_above_the_modulus_is_doubted(factor, is_doubted):
    """10 kPa at the film's depth, by the same order of magnitude."""
    element = {"strip_width_m": 7e-4, "active_length_m": 8e-3}
    sensor = {"depth_m": 1e-3, "feedback_resistance_ohm": 1e6, "elements": [element]}
    signal_V = factor * 1e4 * 2.3e-11 * 7e-4 * 8e-3 * SPEED_M_PER_S / 1e-3 * 1e6
    signal = signal_V * np.sin(2 * np.pi * TIME_S / 0.05)[None]
    speed = np.full(N, SPEED_M_PER_S)
    recording = Recording(signal, TIME_S, speed, ("voltage_0_V",), {"sensor": sensor})
    assert bool(usable(recording).doubts) == is_doubted


@pytest.mark.parametrize(("rows", "value"), [(3, None), (N, 0.5)])
def test_nothing_to_find_is_refused_by_all(tmp_path, rows, value):
    signals = SIGNAL_V if value is None else np.full((2, N), value)
    columns = [each[:rows] for each in (TIME_S, POSITION_M, *signals)]
    text = "time_s,position_m,voltage_0_V,voltage_1_V\n" + rows_of(*columns)
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(BadInput) as refusal:
        load_even({"path": str(tmp_path / "r.csv")}, {})
    assert inspect(tmp_path / "r.csv").refusal == str(refusal.value)


@pytest.mark.parametrize("word", ["NaN", "OVERLOAD", "-nan(ind)", "#N/A", "9.9E+37", ""])
def test_marks_of_missing_samples(tmp_path, word):
    cells = np.array([repr(float(v)) for v in B], object)
    cells[[5, 200]] = word
    rows = "time_s,position_m,voltage_0_V,voltage_1_V\n" + rows_of(TIME_S, POSITION_M, A, cells)
    (tmp_path / "r.csv").write_text(rows)
    with pytest.raises(BadInput, match=r"recording\.missing=allow"):
        load_even({"path": str(tmp_path / "r.csv")}, {})
    signal = load_even({"path": str(tmp_path / "r.csv"), "missing": "allow"}, {}).signal
    assert np.flatnonzero(np.isnan(signal[1])).tolist() == [5, 200]
    np.testing.assert_array_equal(signal[0], A)
    assert inspect(tmp_path / "r.csv").overrides == ("recording.missing=allow",)
