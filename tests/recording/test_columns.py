"""Columns by whatever a lab calls them: stated, asked for where they are not certain, offered."""

import json
from typing import Any

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording.inspection import inspect
from srsinv.recording.template import sidecar_template
from tests.recording.files import write_csv
from tests.recording.scan import MM, POSITION_M, SIGNAL_V, TIME_S, A, B, N, assert_is_scan, rows_of

LAB = {"Time (ms)": 1e3 * TIME_S, "Ch A [V]": A, "Ch B [mV]": 1e3 * B, "Stage pos (mm)": MM}


def lab(*renamed: tuple[str, str, float]) -> dict[str, Any]:
    """The lab's columns, some under another name and in another unit."""
    other = {old: (new, factor) for old, new, factor in renamed}
    return {
        other.get(name, (name, 1))[0]: values * other.get(name, (name, 1))[1]
        for name, values in LAB.items()
    }


UNNAMED = lab(("Time (ms)", "clock", 1), ("Ch A [V]", "front", 1), ("Stage pos (mm)", "rail", 1))
STATED = {
    "time_column": "clock", "time_unit": "ms", "channels": ["front", "Ch B"],
    "position_column": "rail", "position_unit": "mm",
}  # fmt: skip


@pytest.mark.parametrize("in_sidecar", [False, True])
def test_columns_are_stated(tmp_path, in_sidecar):
    path = tmp_path / "r.csv"
    write_csv(path, UNNAMED)
    if in_sidecar:
        path.with_suffix(".json").write_text(json.dumps(STATED))
    recording = load(path, **({} if in_sidecar else STATED))
    assert recording.channels == ("front", "Ch B")
    np.testing.assert_allclose(recording.time_s, TIME_S, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(recording.position_m, POSITION_M, rtol=1e-12)
    np.testing.assert_allclose(recording.signal[0], A)
    roles = {c.name: c.role for c in inspect(path, **STATED).columns}
    assert roles == {"clock": "time", "front": "signal", "Ch B [mV]": "signal", "rail": "position"}


def test_names_without_a_unit_and_in_any_case(tmp_path):
    write_csv(tmp_path / "r.csv", LAB)
    stated = {"channels": ["ch a", "CH B"], "position_column": "stage POS", "time_column": "time"}
    assert_is_scan(load(tmp_path / "r.csv", **stated))


def test_other_axes_and_set_points_are_not_the_position(tmp_path):
    others = {"Pos Y (mm)": 0 * TIME_S, "Pos z (mm)": 0 * TIME_S, "Pos cmd (mm)": 0 * TIME_S}
    write_csv(tmp_path / "r.csv", others | LAB)
    assert_is_scan(load(tmp_path / "r.csv"))


# Columns in place of the lab's, and what the refusal asks for
AMBIGUOUS = {
    "a position of no unit": (lab(("Stage pos (mm)", "position", 1)), "recording.position_unit"),
    "no signal": ({"t (s)": TIME_S, "Force": TIME_S}, "recording.channels"),
}


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_is_not_certain_is_asked_for(tmp_path, case):
    table, asked = AMBIGUOUS[case]
    write_csv(tmp_path / "r.csv", table)
    with pytest.raises(BadInput) as caught:
        load(tmp_path / "r.csv")
    assert asked in str(caught.value)


HOLE = np.where(np.arange(N) == 7, np.nan, A).astype(object)
HOLE[7] = ""
# Columns, settings that are offered, and samples that are then missing
OFFERED = {
    "missing": (LAB | {"Ch A [V]": HOLE}, {"missing": "allow"}, [7]),
    "a unit": (lab(("Time (ms)", "time", 1e3)), {"time_unit": "us"}, []),
    "columns that units alone tell": (
        lab(("Time (ms)", "Zeit [s]", 1e-3), ("Stage pos (mm)", "Weg [cm]", 0.1)),
        {"time_column": '"Zeit [s]"', "position_column": '"Weg [cm]"'}, [],
    ),
    "a position that its unit alone tells": (
        lab(("Stage pos (mm)", "Travel (um)", 1e3)), {"position_column": '"Travel (um)"'}, [],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", OFFERED)
def test_what_is_offered_is_right_and_not_taken_unasked(tmp_path, case):
    table, stated, missing = OFFERED[case]
    path = tmp_path / "r.csv"
    write_csv(path, table)
    inspection = inspect(path)
    assert inspection.overrides == tuple(f"recording.{k}={v}" for k, v in stated.items())
    with pytest.raises(BadInput, match=next(iter(stated))):
        load(path)
    known = {key: value.strip('"') for key, value in stated.items()}
    assert_is_scan(load(path, **known), missing=missing)
    if "missing" not in stated:
        path.with_suffix(".yaml").write_text(sidecar_template(inspection))
        assert_is_scan(load(path))


@pytest.mark.parametrize("others", [["Gap y (mm)"], ["Width (mm)", "Height (mm)"], ["Force (N)"]])
def test_no_column_is_offered_that_may_be_something_else(tmp_path, others):
    table = LAB | dict.fromkeys(others, POSITION_M)
    del table["Stage pos (mm)"]
    write_csv(tmp_path / "r.csv", table)
    assert inspect(tmp_path / "r.csv").overrides == ()


# Rows and cells of a text


@pytest.mark.parametrize("cells", [["1.5", "2,5"], ["1,5", "2.5"], ["1,234.5", "2"]])
def test_a_comma_beside_points_is_no_decimal_mark(tmp_path, cells):
    text = f"time (s);a [V]\n0;{cells[0]}\n1;{cells[1]}\n2;3\n3;4\n"
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(BadInput, match="not a finite number"):
        load(tmp_path / "r.csv", speed_m_per_s=0.1)


@pytest.mark.parametrize("blank", ["\n", ";;;\n", " ; ;;\n"])
def test_blank_rows_are_samples_that_are_missing(tmp_path, blank):
    rows = rows_of(*LAB.values(), delimiter=";").splitlines(keepends=True)
    rows[100:103] = [blank] * 3
    rows.insert(49, blank)  # in no sample's place
    (tmp_path / "r.csv").write_text(";".join(LAB) + "\n" + "".join(rows))
    recording = load(tmp_path / "r.csv")
    present = np.delete(np.arange(N), [100, 101, 102])
    np.testing.assert_allclose(recording.time_s, TIME_S[present], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(recording.signal, SIGNAL_V[:, present], rtol=1e-12)
    timing = inspect(tmp_path / "r.csv").timing
    assert timing
    assert timing.gaps[0].missing == 3


def test_blank_rows_without_times_are_not_dropped(tmp_path):
    (tmp_path / "r.csv").write_text("a [V];b [V]\n" + "1;2\n" * 9 + "\n" + "1;2\n" * 5)
    stated = {"sample_rate_hz": 100.0, "speed_m_per_s": 0.1}
    with pytest.raises(BadInput, match=r"data row 10 .*recording\.missing=allow"):
        load(tmp_path / "r.csv", **stated)
    recording = load(tmp_path / "r.csv", missing="allow", **stated)
    assert recording.time_s.size == 15
    assert np.flatnonzero(np.isnan(recording.signal[0])).tolist() == [9]
