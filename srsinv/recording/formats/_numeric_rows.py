"""Rows that hold plain numbers and nothing else, parsed together: most of any text.

Whether a block is such is told by its characters and their neighbours, without a loop over cells.
Its numbers are then parsed, correctly rounded as by `float`, by scipy's reader of Matrix Market
files (fast_float), which takes one a line. It passes over what follows a number on its line, so
that the check has to show that nothing does. Any other block is left to the reading cell by cell,
and so are all refusals.
"""

import io
import warnings

import numpy as np
import scipy
from jaxtyping import Bool, Float, UInt8

_LONGEST = 2**16  # characters of a row: longer ones are left to the reading cell by cell
# Characters: fewer are parsed by numpy before the import of scipy's reader, a tenth of a second,
# is done; of more it takes a quarter of the time.
_SHORT = 2**20
_HEADER = b"%%%%MatrixMarket matrix array real general\n%d 1\n"


def numeric_rows(
    block: str, delimiter: str, columns: int
) -> Float[np.ndarray, "row column"] | None:
    """The numbers of whole lines, NaN for an empty cell, as `float` reads each.

    None where a cell may be anything but empty or a finite number, with more than a space before
    it, where rows differ in their number of cells or are blank, and where the last line has no end.
    """
    if not block.isascii() or not _has_short_rows(block):
        return None
    if " " in block:  # one before a cell, as many writers leave; any other is in no number
        block = block.replace(f"{delimiter} ", delimiter)
    text, mark = block.encode(), delimiter.encode()
    marks = text.translate(None, b"0123456789+-").lower()
    ends = marks.translate(None, b".e")
    rows = ends.count(b"\n")
    if ends != (mark * (columns - 1) + b"\n") * rows or b".." in marks:
        return None
    cells = b"\n" + text.replace(mark, b"\n")
    characters = np.frombuffer(cells, np.uint8)
    is_end = characters == ord("\n")
    has_empty = bool(np.any(is_end[1:] & is_end[:-1]))
    if (has_empty and columns == 1) or not _are_well_formed(characters, is_end, marks):
        return None
    values = _parsed(cells, rows * columns, has_empty)
    # What is beyond float64's range is no finite number.
    if values is None or np.isinf(values).any():
        return None
    # Zeros with their sign, which scipy's reader drops.
    zero = np.flatnonzero(values == 0)
    if zero.size:
        first = characters[np.flatnonzero(is_end)[zero] + 1]
        values[zero] = np.where(first == ord("-"), -0.0, 0.0)
    return values.reshape(rows, columns)


def _has_short_rows(block: str) -> bool:
    """Whether the last line is whole, and no row longer than twice `_LONGEST`."""
    starts = range(0, len(block), _LONGEST)
    return block.endswith("\n") and all(block.find("\n", s, s + _LONGEST) >= 0 for s in starts)


def _are_well_formed(
    characters: UInt8[np.ndarray, " n"], is_end: Bool[np.ndarray, " n"], marks: bytes
) -> bool:
    """Whether cells of numeric characters, each behind a line's end, are numbers as far as they
    have digits: signs lead a cell or an exponent, which comes once and last. `marks` are the
    characters but digits and signs."""
    is_sign = (characters == ord("-")) | (characters == ord("+"))
    may_precede_sign = is_end
    if b"e" in marks:
        is_exponent = characters | 0x20 == ord("e")
        if b"ee" in marks or b"e." in marks or np.any(is_exponent[:-1] & is_end[1:]):
            return False
        may_precede_sign = is_end | is_exponent
    return not np.any(is_sign[1:] & ~may_precede_sign[:-1] | is_sign[:-1] & is_end[1:])


def _parsed(cells: bytes, count: int, has_empty: bool) -> Float[np.ndarray, " cell"] | None:
    """The numbers, NaN where there is none; None where a cell has no digit."""
    if has_empty:  # of three line's ends, one replacement finds the first two
        cells = cells.replace(b"\n\n", b"\nnan\n").replace(b"\n\n", b"\nnan\n")
    if b"+" in cells:
        cells = cells.replace(b"\n+", b"\n")  # not in the format
    try:
        if len(cells) < _SHORT:
            with warnings.catch_warnings(action="error", category=DeprecationWarning):
                values = np.fromstring(cells.decode("ascii"), sep="\n")
            return values if len(values) == count else None
        return np.asarray(scipy.io.mmread(io.BytesIO(_HEADER % count + cells[1:])))[:, 0]
    except (ValueError, DeprecationWarning):  # as numpy's version has it
        return None
