"""Numbers in a text's cells, with a point or a comma as decimal mark."""

import math

import numpy as np
from jaxtyping import Float

from ._numeric_rows import numeric_rows


class DecimalMark:
    """A file's decimal mark, a point or a comma: the first that one of its numbers has.

    A comma is one only where `may_be_comma`; after a point it is none, as it may part thousands.
    """

    def __init__(self, may_be_comma: bool):
        self._may_be_comma, self._mark = may_be_comma, ""

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
        """The number in a cell: NaN only if the cell is empty, infinite if it holds none."""
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


def _number(cell: str) -> float:
    """The number in a cell: NaN only if the cell is empty, infinite if it holds no finite one."""
    if not cell or cell.isspace():
        return math.nan
    try:
        number = float(cell)
    except ValueError:
        return math.inf
    return number if math.isfinite(number) else math.inf
