"""Cells of a text are read as Python reads each, however many are read together."""

import math
import random
from pathlib import Path

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording.formats.text import Text
from srsinv.recording.reader import read_table
from tests.tiers import quick

NAMES = ("time_s", "speed_m_per_s", "voltage_0_V")
_EDGES = (
    "-0.000 .5 5. -.5e3 1E5 1e+05 1.E-7 +0 -0 00012.50 0e999 1e-999 -1e-999 4.9e-324 "
    "2.4703282292062327e-324 2.4703282292062328e-324 9007199254740993 1.7976931348623157e308 "
    "2.2250738585072011e-308 0.1000000000000000055511151231257827021181583404541015625"
)
SPACED = ["", " ", " 1", "1 ", "  -2.5 ", "1_0", "\u0661"]
_WRONG = (
    "nan NaN inf -inf 1e999 abc --5 +-5 1-2 1.2.3 1e 1e+ e5 . - + 1e5e6 1e2.5 1.e.5 0x10 1% 1d5 "
    "1e5- -e5 .e5 5- -. 1.-2 nan(1) 1e-+5 e -.e1"
)
MARKS = ("nan", "NaN", "-", ".")
EDGES, WRONG = _EDGES.split(), _WRONG.split()


def number(chance: random.Random) -> str:
    """A number, written in any way."""
    value, digits = chance.gauss(0, 1) * 10 ** chance.randint(-9, 9), chance.randrange(24)
    ways = (repr(value), f"{value:.{digits}e}", f"{value:+.{digits}g}", f"{value:.6f}")
    return chance.choice((*ways, str(round(value)), chance.choice(EDGES)))


def as_python_reads(cell: str) -> float:
    """NaN for an empty cell or a mark of none, infinite for one that is no finite number. Python
    also takes digits of other scripts, and marks between digits."""
    if not cell.strip() or cell in MARKS:
        return math.nan
    if not cell.isascii() or "_" in cell:
        return math.inf
    try:
        value = float(cell)
    except ValueError:
        return math.inf
    return value if math.isfinite(value) else math.inf


def check(path: Path, rows: list[list[str]], delimiter: str, end: str, names=NAMES) -> None:
    lines = (delimiter.join(cells) for cells in (names, *rows))
    path.write_text(end.join([*lines, ""]), encoding="utf-8", newline="")
    table = read_table(path, Text())
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        exact = np.array([as_python_reads(cell) for cell in cells])
        assert table.columns[name].tobytes() == exact.tobytes()
        assert bool(table.texts[name]) == np.isinf(exact).any()


@pytest.mark.parametrize("odd", [[], SPACED, WRONG], ids=["none", "spaced", "wrong"])
def test_random_cells_are_what_python_reads(tmp_path, odd):
    for seed in range(60):
        chance = random.Random(seed)
        rows = [[number(chance) for _ in NAMES] for _ in range(chance.randint(1, 30))]
        if odd:
            chance.choice(rows)[chance.randrange(3)] = chance.choice(odd)
        delimiter, end = chance.choice((",", ";", "\t", ", ")), chance.choice(("\n", "\r\n"))
        check(tmp_path / "r.csv", rows, delimiter, end)
        check(tmp_path / "r.csv", [row[:1] for row in rows if row[0]], ",", end, NAMES[:1])


@pytest.mark.parametrize("cell", quick(WRONG[2::8], WRONG[2]))
def test_a_wrong_cell_far_inside_a_long_file_is_named(tmp_path, cell):
    path, samples, row = tmp_path / "r.csv", 150_000, 100_000
    lines = [f"{index / 1000},0.05,{index % 7 - 3}e-1" for index in range(samples)]
    path.write_text("\n".join([",".join(NAMES), *lines]))
    recording = load(path)
    assert recording.time_s[row] == row / 1000
    np.testing.assert_array_equal(recording.signal[0, :7], [float(f"{v}e-1") for v in range(-3, 4)])
    lines[row] = f"{row / 1000},0.05,{cell}"
    path.write_text("\n".join([",".join(NAMES), *lines]))
    with pytest.raises(BadInput, match=f"data row {row + 1} of column voltage_0_V is"):
        load(path)
    lines[row] = "1,2"
    path.write_text("\n".join([",".join(NAMES), *lines]))
    with pytest.raises(BadInput, match=f"data row {row + 1} has 2 cells where"):
        load(path)
