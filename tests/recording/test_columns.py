"""Columns by whatever a lab calls them: read right, or refused with the setting that says which."""

import json
import re
from typing import Any

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import load, save
from srsinv.recording.inspection import inspect
from srsinv.recording.template import sidecar_template
from tests.recording.files import write_csv

N, RATE_HZ, SPEED_M_PER_S = 400, 2000.0, 0.02
TIME_S = np.arange(N) / RATE_HZ
POSITION_M = 0.01 + SPEED_M_PER_S * TIME_S
SIGNAL_V = np.random.default_rng(1).normal(size=(2, N))
LAB = {
    "Time (ms)": 1e3 * TIME_S,
    "Ch A [V]": SIGNAL_V[0],
    "Ch B [mV]": 1e3 * SIGNAL_V[1],
    "Stage pos (mm)": 1e3 * POSITION_M,
}


def lab(**renamed):
    """The lab's columns, some under other names and in other units: {old: (new, factor)}."""
    return {
        renamed.get(name, (name, 1))[0]: values * renamed.get(name, (name, 1))[1]
        for name, values in LAB.items()
    }


def assert_right(recording):
    np.testing.assert_allclose(recording.signal, SIGNAL_V, rtol=1e-12)
    np.testing.assert_allclose(recording.time_s, TIME_S, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(recording.position_m, POSITION_M, rtol=1e-12)
    np.testing.assert_allclose(recording.speed_m_per_s, SPEED_M_PER_S, rtol=1e-6)
    assert recording.signal_unit == "V"


NAMES = {
    "as they are": {},
    "capitals": {"Time (ms)": ("TIME (MS)", 1), "Stage pos (mm)": ("STAGE POS (MM)", 1)},
    "other brackets": {"Time (ms)": ("time [ms]", 1), "Ch A [V]": ("Ch A (V)", 1)},
    "centimetres": {"Stage pos (mm)": ("Position (cm)", 0.1)},
    "micrometres": {"Stage pos (mm)": ("X [µm]", 1e3)},
    "seconds written out": {"Time (ms)": ("Elapsed time (seconds)", 1e-3)},
    "microseconds": {"Time (ms)": ("timestamp (μs)", 1e3)},
    "suffixes": {"Time (ms)": ("t_ms", 1), "Stage pos (mm)": ("encoder_mm", 1)},
    "any name in volts": {"Ch A [V]": ("front film [uV]", 1e6), "Ch B [mV]": ("back_mV", 1)},
}


@pytest.mark.parametrize("case", NAMES)
def test_names_and_units_of_a_lab(tmp_path, case):
    write_csv(tmp_path / "r.csv", lab(**NAMES[case]) | {"Temperature (C)": np.full(N, 20.0)})
    recording, inspection = load(tmp_path / "r.csv"), inspect(tmp_path / "r.csv")
    assert_right(recording)
    assert (inspection.refusal, inspection.overrides) == (None, ())
    assert len(inspection.signals) == len(recording.channels)
    for role in ("time", "position"):
        assert len(inspection.of_role(role)) == 1
    save(recording, tmp_path / "again.csv")
    assert_right(load(tmp_path / "again.csv"))


UNNAMED = {"Time (ms)": ("clock", 1), "Ch A [V]": ("front", 1), "Stage pos (mm)": ("rail", 1)}
STATED = {
    "time_column": "clock", "time_unit": "ms", "channels": ["front", "Ch B"],
    "position_column": "rail", "position_unit": "mm",
}  # fmt: skip


@pytest.mark.parametrize("in_sidecar", [False, True])
def test_columns_are_stated(tmp_path, in_sidecar):
    write_csv(tmp_path / "r.csv", lab(**UNNAMED))
    if in_sidecar:
        (tmp_path / "r.json").write_text(json.dumps(STATED))
    recording = load(tmp_path / "r.csv", **({} if in_sidecar else STATED), signal_unit=None)
    assert recording.channels == ("front", "Ch B")
    np.testing.assert_allclose(recording.time_s, TIME_S, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(recording.position_m, POSITION_M, rtol=1e-12)
    np.testing.assert_allclose(recording.signal[0], SIGNAL_V[0])
    roles = {c.name: c.role for c in inspect(tmp_path / "r.csv", **STATED).columns}
    assert roles == {"clock": "time", "front": "signal", "Ch B [mV]": "signal", "rail": "position"}


def test_names_without_a_unit_and_in_any_case(tmp_path):
    write_csv(tmp_path / "r.csv", LAB)
    stated = {"channels": ["ch a", "CH B"], "position_column": "stage POS", "time_column": "time"}
    assert_right(load(tmp_path / "r.csv", **stated))


AMBIGUOUS = {
    "two positions": ({"Pos A (mm)": 1e3 * POSITION_M, "Pos B (mm)": 0 * TIME_S}, {},
                      ["position may be any", "recording.position_column"]),
    "two times": ({"Time A (ms)": TIME_S, "Time B (ms)": TIME_S}, {},
                  ["time may be any", "recording.time_column"]),
    "a name for two": ({"Ch C [V]": TIME_S, "ch c [mV]": TIME_S}, {"channels": ["CH C"]},
                       ["'CH C' may be any of"]),
    "no such column": ({"t (s)": TIME_S}, {"position_column": "rail"}, ["no column 'rail'"]),
    "no unit": ({"t (s)": TIME_S, "rail": TIME_S}, {"position_column": "rail"},
                ["column 'rail' is not stated", "recording.position_unit"]),
    "no signal": ({"t (s)": TIME_S, "Force": TIME_S}, {}, ["recording.channels"]),
}  # fmt: skip


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_is_not_certain_is_asked_for(tmp_path, case):
    table, stated, words = AMBIGUOUS[case]
    signals = {} if case == "no signal" else {"Ch A [V]": SIGNAL_V[0]}
    signals |= {} if any("ime" in name or name[0] == "t" for name in table) else LAB
    signals.pop("Stage pos (mm)", None)
    write_csv(tmp_path / "r.csv", signals | table)
    with pytest.raises(BadInput) as caught:
        load(tmp_path / "r.csv", speed_m_per_s=None, **stated)
    for word in words:
        assert word in str(caught.value)


def test_other_axes_and_set_points_are_not_the_position(tmp_path):
    others = {"Pos Y (mm)": 0 * TIME_S, "Pos z (mm)": 0 * TIME_S, "Pos cmd (mm)": 0 * TIME_S}
    write_csv(tmp_path / "r.csv", others | LAB)
    assert_right(load(tmp_path / "r.csv"))


@pytest.mark.parametrize(
    ("fault", "stated", "expected"),
    [
        ({"missing": 7}, {"missing": "allow"}, ("recording.missing=allow",)),
        ({"bare time": 1}, {"time_unit": "ms"}, ("recording.time_unit=ms",)),
    ],
)
def test_the_override_that_inspect_offers_is_right(tmp_path, fault, stated, expected):
    table = lab(**({"Time (ms)": ("time", 2)} if "bare time" in fault else {}))
    if "missing" in fault:
        table["Ch A [V]"] = np.where(np.arange(N) == fault["missing"], np.nan, SIGNAL_V[0])
    write_csv(tmp_path / "r.csv", table)
    text = (tmp_path / "r.csv").read_text().replace("nan", "")
    (tmp_path / "r.csv").write_text(text)
    inspection = inspect(tmp_path / "r.csv")
    assert inspection.overrides == expected
    assert inspection.refusal
    recording = load(tmp_path / "r.csv", **stated)
    good = np.isfinite(recording.signal)
    np.testing.assert_allclose(recording.signal[good], SIGNAL_V[good])


UNITS_ALONE: dict[str, Any] = {
    "both": ({"Time (ms)": ("Zeit [s]", 1e-3), "Stage pos (mm)": ("Weg [cm]", 0.1)},
             {"time_column": "Zeit [s]", "position_column": "Weg [cm]"}),
    "positions": ({"Stage pos (mm)": ("Travel (um)", 1e3)}, {"position_column": "Travel (um)"}),
}  # fmt: skip


@pytest.mark.parametrize("case", UNITS_ALONE)
def test_columns_that_units_alone_tell_are_offered_and_not_taken(tmp_path, case):
    renamed, stated = UNITS_ALONE[case]
    write_csv(tmp_path / "r.csv", lab(**renamed))
    inspection = inspect(tmp_path / "r.csv")
    assert inspection.overrides == tuple(f'recording.{k}="{v}"' for k, v in stated.items())
    assert [len(inspection.of_role(role)) for role in ("time", "position")] == [1, 1]
    with pytest.raises(BadInput, match=re.escape(next(iter(stated)))):
        load(tmp_path / "r.csv")
    assert_right(load(tmp_path / "r.csv", **stated))
    (tmp_path / "r.yaml").write_text(sidecar_template(inspection))
    assert_right(load(tmp_path / "r.csv"))


@pytest.mark.parametrize("others", [["Gap y (mm)"], ["Width (mm)", "Height (mm)"], ["Force (N)"]])
def test_no_column_is_offered_that_may_be_something_else(tmp_path, others):
    table = LAB | dict.fromkeys(others, POSITION_M)
    del table["Stage pos (mm)"]
    write_csv(tmp_path / "r.csv", table)
    assert inspect(tmp_path / "r.csv").overrides == ()


def test_a_position_without_a_unit_is_asked_for_its_unit(tmp_path):
    write_csv(tmp_path / "r.csv", lab(**{"Stage pos (mm)": ("position", 1)}))
    with pytest.raises(BadInput, match=r"'?position'? is not stated.*recording\.position_unit"):
        load(tmp_path / "r.csv")
    assert_right(load(tmp_path / "r.csv", position_unit="mm"))


# Text as spreadsheets leave it


def rows(cells, delimiter=";"):
    return "".join(delimiter.join(row) + "\n" for row in cells)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_signs_of_units_in_any_encoding(tmp_path, encoding):
    write_csv(tmp_path / "r.csv", lab(**{"Stage pos (mm)": ("Stage pos (µm)", 1e3)}))
    text = (tmp_path / "r.csv").read_text(encoding="utf-8")
    (tmp_path / "r.csv").write_text(text, encoding=encoding)
    assert_right(load(tmp_path / "r.csv"))


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas(tmp_path, delimiter):
    lines = [list(LAB), *([repr(float(v)).replace(".", ",") for v in row] for row in
                          np.stack(list(LAB.values()), axis=1))]  # fmt: skip
    (tmp_path / "r.csv").write_text(rows(lines, delimiter))
    assert_right(load(tmp_path / "r.csv"))
    # Beside dates, cell by cell.
    dated = [[*line, "24.11.2026 10:00:00,5"] for line in lines]
    dated[0][-1] = "Date"
    (tmp_path / "r.csv").write_text(rows(dated, delimiter))
    assert_right(load(tmp_path / "r.csv"))


@pytest.mark.parametrize("cells", [["1.5", "2,5"], ["1,5", "2.5"], ["1,234.5", "2"]])
def test_a_comma_beside_points_is_no_decimal_mark(tmp_path, cells):
    table = [["time (s)", "a [V]"], ["0", cells[0]], ["1", cells[1]], ["2", "3"], ["3", "4"]]
    (tmp_path / "r.csv").write_text(rows(table))
    with pytest.raises(BadInput, match="not a finite number"):
        load(tmp_path / "r.csv", speed_m_per_s=0.1)


@pytest.mark.parametrize("blank", ["\n", ";;;\n", " ; ;;\n", "   \n"])
def test_blank_rows_are_samples_that_are_missing(tmp_path, blank):
    lines = [rows([list(LAB)]), *(rows([map(repr, row.tolist())]) for row in
             np.stack(list(LAB.values()), axis=1))]  # fmt: skip
    lines[101:104] = [blank] * 3
    lines.insert(50, blank)  # in no sample's place
    (tmp_path / "r.csv").write_text("".join(lines))
    recording = load(tmp_path / "r.csv")
    present = np.delete(np.arange(N), [100, 101, 102])
    np.testing.assert_allclose(recording.time_s, TIME_S[present], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(recording.signal, SIGNAL_V[:, present], rtol=1e-12)
    assert inspect(tmp_path / "r.csv").timing.gaps[0].missing == 3


def test_blank_rows_without_times_are_not_dropped(tmp_path):
    text = "a [V];b [V]\n" + "1;2\n" * 9 + "\n" + "1;2\n" * 5
    (tmp_path / "r.csv").write_text(text)
    stated = {"sample_rate_hz": 100.0, "speed_m_per_s": 0.1}
    with pytest.raises(BadInput, match=r"data row 10 is empty.*recording\.missing=allow"):
        load(tmp_path / "r.csv", **stated)
    recording = load(tmp_path / "r.csv", missing="allow", **stated)
    assert recording.time_s.size == 15
    assert np.flatnonzero(np.isnan(recording.signal[0])).tolist() == [9]


# Speed from positions


@pytest.mark.parametrize("step_m", [1e-7, 1e-6, 2.5e-6])
def test_speed_from_rounded_positions(tmp_path, step_m):
    """A spline through them would be off by the rounding over the interval: 5 m/s per metre."""
    time_s = np.arange(4000) / RATE_HZ
    speed = SPEED_M_PER_S * (1 + 0.2 * np.sin(2 * np.pi * time_s))
    exact = 0.01 + SPEED_M_PER_S * (time_s - 0.2 / (2 * np.pi) * np.cos(2 * np.pi * time_s))
    rounded = np.round(exact / step_m) * step_m
    write_csv(tmp_path / "r.csv", {"time_s": time_s, "position_m": rounded, "a_V": time_s})
    got = load(tmp_path / "r.csv").speed_m_per_s
    error = np.abs(got - speed)[64:-64]
    assert error.max() < 0.01 * SPEED_M_PER_S
    # By a spline: of the order of the step over the interval.
    assert error.max() < 0.1 * step_m * RATE_HZ or step_m < 1e-6


def test_speed_from_rounded_positions_neither_overshoots_nor_turns_back(tmp_path):
    time_s = np.arange(2000) / RATE_HZ
    exact = SPEED_M_PER_S * np.clip(time_s - 0.25, 0, 0.5)
    rounded = np.round(exact, 6)
    write_csv(tmp_path / "r.csv", {"time_s": time_s, "position_m": rounded, "a_V": time_s})
    got = load(tmp_path / "r.csv").speed_m_per_s
    increments = np.diff(rounded) * RATE_HZ
    assert got.min() >= 0
    assert got.max() <= increments.max() * (1 + 1e-9)
    np.testing.assert_allclose(got[:400], 0, atol=1e-12)
    np.testing.assert_allclose(got[700:1300], SPEED_M_PER_S, rtol=2e-3)
