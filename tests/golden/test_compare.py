"""What counts as moved, and what a golden file says."""

import numpy as np
import pytest

from tests.golden.compare import differences
from tests.golden.entries import entry, read, write
from tests.golden.record import renewed

OLD = {
    "height_m": entry(2.0),
    "height_m_stderr": entry(0.1),
    "count": entry(7),
    "word": entry("converged"),
    "flag": entry(True),
    "hole": entry(np.nan),
    "p": entry(np.arange(200.0).reshape(2, 100), "Pa"),
    "p_stderr": entry(np.full((2, 100), 5.0), "Pa"),
}


def moved(changes, case="family/name"):
    """Names of what has moved, and where; without a rule by more than 1e-9."""
    moves = differences(case, OLD, OLD | changes)
    return {(each.name.rpartition("/")[2], each.where) for each in moves}


def shifted(at, by):
    values = np.arange(200.0).reshape(2, 100)
    values[at] += by
    return entry(values, "Pa")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, set()),
        ({"height_m": 2.0 + 1e-9}, set()),
        ({"height_m": 2.0 + 3e-9}, {("height_m", "")}),
        ({"count": 8}, {("count", "")}),
        ({"word": "not converged"}, {("word", "")}),
        ({"flag": False}, {("flag", "")}),
        ({"flag": 1}, {("flag", "")}),
        ({"hole": 0.0}, {("hole", "")}),
        ({"new": 1.0}, {("new", "")}),
        ({"p": shifted((1, 99), 1e-6)}, {("p", "[1, 99]")}),
        ({"p": shifted((1, 99), 1e-8)}, set()),
        ({"p": shifted((0, 0), 1e-7)}, {("p", "[0, 0]")}),
        ({"p": entry(np.arange(200.0), "Pa")}, {("p", "shape")}),
        ({"p": entry(np.arange(200.0).reshape(2, 100), "kPa")}, {("p", "units")}),
    ],
)
def test_moved(changes, expected):
    assert moved(changes) == expected


@pytest.mark.parametrize(("by", "expected"), [(0.09, set()), (0.2, {("p", "[1, 99]")})])
def test_standard_errors_allow_what_they_are(by, expected):
    """The rule of fits allows 0.02 of them."""
    assert moved({"p": shifted((1, 99), by)}, "public/fit_name") == expected


def test_a_sample_between_shows_in_the_norm():
    assert moved({"p": shifted((1, 40), 1.0)}) == {("p", "norm")}


def test_a_movement_names_all_that_matters():
    (move,) = differences("f/n", OLD, OLD | {"height_m": 2.5})
    assert str(move) == "f/n/height_m was 2.0 and is 2.5: 2.5e+08 times its tolerance, 2e-09"


def test_a_file_gives_back_its_entries_and_shows_a_change_as_a_line(tmp_path):
    changed = OLD | {"count": 8, "height_m": 2.0 + 1e-12}
    for name, entries in (("old", OLD), ("new", renewed("family/name", OLD, changed))):
        write(tmp_path / name, entries)
    assert read(tmp_path / "old") == OLD
    lines = [(tmp_path / name).read_text().splitlines() for name in ("old", "new")]
    assert [pair for pair in zip(*lines, strict=True) if pair[0] != pair[1]] == [
        (' "count": 7,', ' "count": 8,')
    ]
