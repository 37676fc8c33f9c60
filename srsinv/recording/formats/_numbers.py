"""Numbers in a text's cells, with a point or a comma as decimal mark."""

import math

import numpy as np
from jaxtyping import Float

from ._numeric_rows import numeric_rows

# What programs write for a sample that is missing or beyond the range.
_MARKS_WORDS = """
    nan -nan +nan nan(ind) -nan(ind) nan(snan) -nan(snan) 1.#qnan -1.#qnan 1.#ind -1.#ind
    #n/a #na n/a na null none nil missing overload over overrange over-range overflow ovld
    ovl ol +over -over n.a. #div/0! #num! #value! ***** -overload +overload - -- --- ---- ----- . ?
"""
_MARKS = frozenset(_MARKS_WORDS.split())
_THOUSAND = 1000
_FEW = 10  # whole numbers that a column of decimals may hold
_RARE = 0.05  # of the values: whole numbers among decimals of three digits are one in a thousand


class DecimalMark:
    """A file's decimal mark, a point or a comma: the first that one of its numbers has.

    A comma is one only where `may_be_comma`; after a point it is none, as it may part thousands.
    """

    def __init__(self, may_be_comma: bool):
        self._may_be_comma, self._mark = may_be_comma, ""

    @property
    def mark(self) -> str:
        """The mark that the numbers have; empty as long as none has one."""
        return self._mark

    @property
    def may_differ(self) -> bool:
        """Whether a number may have another mark than a point."""
        return self._may_be_comma

    def numeric_rows(
        self, block: str, delimiter: str, columns: int
    ) -> Float[np.ndarray, "row column"] | None:
        """[`numeric_rows`][] of a block, whose decimal marks are all the same."""
        mark = "," if self._may_be_comma and "," in block else "." if "." in block else ""
        if (mark == "," and "." in block) or self._differs(mark):
            return None
        text = block.replace(",", ".") if mark == "," else block
        rows = numeric_rows(text, delimiter, columns)
        self._mark = self._mark if rows is None else self._mark or mark
        return rows

    def number(self, cell: str) -> float:
        """The number in a cell: NaN only if the cell is empty or a mark of a missing sample,
        infinite if it holds none."""
        mark = "," if self._may_be_comma and "," in cell else "." if "." in cell else ""
        text = cell.replace(",", ".") if mark == "," and "." not in cell else cell
        value = _number(text)
        if math.isfinite(value):
            if self._differs(mark):
                return math.inf
            self._mark = self._mark or mark
        return value

    def _differs(self, mark: str) -> bool:
        return self._may_be_comma and bool(mark and self._mark) and mark != self._mark


def is_number(cell: str) -> bool:
    """Whether a cell holds a finite number."""
    return math.isfinite(_number(cell))


def is_mark(cell: str) -> bool:
    """Whether a cell holds a mark of a missing sample, as `NaN` or `OVERLOAD`."""
    return cell.strip().casefold() in _MARKS


def has_thousands(values: Float[np.ndarray, " row"]) -> bool:
    """Whether numbers (row,) may have been read from cells in which a mark parts thousands: whole
    numbers below a thousand, and among them some with three decimals, from 1 on."""
    valid = values[np.isfinite(values)]
    if not valid.size or np.max(np.abs(valid)) >= _THOUSAND:
        return False
    is_whole = valid == np.round(valid)
    parted = np.unique(valid[~is_whole])
    if not parted.size or np.min(np.abs(parted)) < 1:
        return False
    scaled = _THOUSAND * parted
    whole = np.unique(valid[is_whole]).size
    return bool(
        np.all(np.abs(scaled - np.round(scaled)) < 1e-6) and whole > max(_FEW, _RARE * parted.size)
    )


def _number(cell: str) -> float:
    """The number in a cell: NaN only if it is empty or a mark of a missing sample, infinite if it
    holds no finite one."""
    if not cell or cell.isspace():
        return math.nan
    try:
        # Python also takes digits of other scripts, and marks between digits.
        number = float(cell) if cell.isascii() and "_" not in cell else math.inf
    except ValueError:
        return math.nan if is_mark(cell) else math.inf
    return number if math.isfinite(number) else math.nan if is_mark(cell) else math.inf
