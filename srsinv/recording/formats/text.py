"""Text: a header row of names, then a row a sample, separated by commas, semicolons or tabs."""

import csv
import io
import re
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from srsinv.errors import BadInput, refuse

from ...files import DataFile
from .._table import ColumnTable
from ..reader import Reader
from ._numbers import DecimalMark, is_number

_DELIMITERS = "\t;,"  # the first that the header has: a name may hold a comma, hardly the others
_QUOTED = re.compile('"[^"]*"')
LONGEST_ROW = 2**18  # characters: a thousand names of two hundred, with their commas
_BLOCK = 2**20  # characters whose cells are turned into numbers together
_MOST_BLANK = 10_000  # blank lines at the end of a file of several columns
_TEXT = 80  # characters stored of a cell that is no number

_Rows = list[list[str]] | Float[np.ndarray, "row column"]


class Text(Reader):
    """Text with a header row, cells separated by commas, semicolons or tabs.

    Between semicolons or tabs the decimal mark may be a comma, throughout the file.
    """

    def read(self, file: DataFile) -> ColumnTable:
        """The columns of a UTF-8 text; blank lines and lines of # before the header are skipped."""
        table = ColumnTable.of(file)
        text = io.TextIOWrapper(file, encoding="utf-8-sig")
        lines = _Lines(table.name, text)
        header = next((line for line in lines if line.strip() and not line.startswith("#")), "")
        delimiter = next((mark for mark in _DELIMITERS if mark in _QUOTED.sub("", header)), ",")
        names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter), [])]
        _check_names(table, names)
        lines.begin_after(1)
        decimal = DecimalMark(delimiter != ",")
        columns = {index: _Column(decimal) for index, name in enumerate(names) if name}
        for rows in _blocks(table, lines, delimiter, names, decimal):
            cells = rows.T if isinstance(rows, np.ndarray) else list(zip(*rows, strict=True))
            for index, column in columns.items():
                column.extend(cells[index])
        for index, column in columns.items():
            table.columns[names[index]] = column.numbers()
            table.texts[names[index]] = column.text
        text.detach()  # the file stays open
        return table


class _Lines(Iterator[str]):
    """Lines of a text, read in blocks.

    Raises `BadInput` where the lines since the last row's end are longer than `LONGEST_ROW`: a row
    may take several, where one of its cells does.
    """

    def __init__(self, name: str, text: io.TextIOWrapper):
        self._name, self._text = name, text
        self._begun, self._block, self._at = "", "", 0
        self._rows, self._characters = 0, 0

    def begin_after(self, rows: int) -> None:
        """Begin the next row, after `rows` of them."""
        self._rows, self._characters = self._rows + rows, 0

    def has_more_at_hand(self) -> bool:
        """Whether a line is buffered."""
        return self._at < len(self._block)

    def block_at_hand(self) -> str:
        """All buffered lines, read if there are none; empty at the end of the text."""
        if not self.has_more_at_hand():
            self._fill()
        return self._block[self._at :]

    def pass_over(self) -> None:
        """Take all buffered lines as read."""
        self._at = len(self._block)

    def __next__(self) -> str:
        if not self.has_more_at_hand():
            self._fill()
        if not self.has_more_at_hand():
            raise StopIteration
        begin, self._at = self._at, self._block.find("\n", self._at) + 1 or len(self._block)
        self._characters += self._at - begin
        if self._characters > LONGEST_ROW:
            raise self.too_long()
        return self._block[begin : self._at]

    def too_long(self) -> BadInput:
        """The refusal of the row that was begun last."""
        where = f"data row {self._rows}" if self._rows else "the header"
        return BadInput(
            f"{self._name}: {where} is longer than {LONGEST_ROW} characters, or a cell of it half "
            "as long: write a row for each sample, and close every quotation mark."
        )

    def _fill(self) -> None:
        """Buffer lines, unless the text is at its end."""
        read, self._block, self._at = " ", "", 0
        while read and not self._block:
            read = self._text.read(_BLOCK)
            if "\0" in read:
                raise ValueError("binary")
            lines, end, self._begun = (self._begun + read).rpartition("\n")
            self._block = lines + end
            # The last line needs no end; nor is the end of one read that is too long already.
            if self._begun and (not read or len(self._begun) > LONGEST_ROW):
                self._block += self._begun
                self._begun = ""


class _Column:
    """A column's cells as numbers: NaN for one that is empty, infinite for no finite number."""

    def __init__(self, decimal: DecimalMark):
        self._parts: list[np.ndarray] = []
        self._decimal = decimal
        self.text = ""  # of the first cell that holds no finite number

    def extend(self, cells: tuple[str, ...] | Float[np.ndarray, " row"]) -> None:
        """Add the next cells, or their numbers, finite but where a cell is empty."""
        if isinstance(cells, np.ndarray):
            self._parts.append(cells.copy())  # not a view, which would hold all columns
            return
        try:
            values = np.fromiter(map(float, cells), np.float64, len(cells))
        except ValueError:
            values = np.full(1, np.nan)
        if self._decimal.may_differ or not np.isfinite(values).all():
            values = np.fromiter(map(self._decimal.number, cells), np.float64, len(cells))
            if not self.text and np.isinf(values).any():
                self.text = cells[int(np.isinf(values).argmax())].strip()[:_TEXT]
        self._parts.append(values)

    def numbers(self) -> Float[np.ndarray, " row"]:
        """All cells, removed from the column."""
        values = np.concatenate([np.zeros(0), *self._parts])
        self._parts.clear()
        return values


def _blocks(
    table: ColumnTable, lines: _Lines, delimiter: str, names: list[str], decimal: DecimalMark
) -> Iterator[_Rows]:
    """Rows of as many cells as there are names, a block of them at a time.

    A blank line is a row of empty cells, and nothing at the end of any file.
    """
    reader = csv.reader(lines, delimiter=delimiter)
    done = blank = 0
    while len(rows := _next_rows(lines, reader, delimiter, len(names), decimal)):
        at_end = 0
        while isinstance(rows, list) and rows and rows[-1] == [""]:
            rows.pop()
            at_end += 1
        blank, at_end = (blank, at_end) if len(rows) else (blank + at_end, 0)
        if len(rows) or (blank > _MOST_BLANK and len(names) > 1):
            held = ([[""]] * min(_BLOCK, blank - start) for start in range(0, blank, _BLOCK))
            for part in (*held, rows) if len(rows) else held:
                whole = _with_blank_rows(part, len(names))
                done = _checked(table, whole, names, done)
                yield whole
            blank = 0
        blank += at_end
        table.check_size(names[0], done + blank)


def _next_rows(
    lines: _Lines,
    reader: Iterator[list[str]],
    delimiter: str,
    columns: int,
    decimal: DecimalMark,
) -> _Rows:
    """The rows of the next lines, a blank line's being one empty cell; none at the end."""
    block = lines.block_at_hand()
    rows = decimal.numeric_rows(block, delimiter, columns)
    if rows is None:
        rows = _simple_rows(block, delimiter)
    if len(rows):
        lines.pass_over()
        lines.begin_after(len(rows))
        return rows
    rows = []
    try:
        for row in reader:
            rows.append(row or [""])
            lines.begin_after(1)
            if not lines.has_more_at_hand():
                break
    except csv.Error as error:  # of a cell longer than csv takes
        raise lines.too_long() from error
    return rows


def _simple_rows(block: str, delimiter: str) -> list[list[str]]:
    """The rows of a block of lines each of which is certainly one; else none."""
    if '"' in block or "\n\n" in block or block.startswith("\n"):
        return []
    lines = block.split("\n")
    return (
        list(csv.reader(filter(None, lines), delimiter=delimiter))
        if max(map(len, lines)) < LONGEST_ROW
        else []
    )


def _with_blank_rows(rows: _Rows, columns: int) -> _Rows:
    """The rows with a row of empty cells for each blank line."""
    if isinstance(rows, np.ndarray):
        return rows
    return [[""] * columns if len(row) == 1 and not row[0].strip() else row for row in rows]


def _checked(table: ColumnTable, rows: _Rows, names: list[str], done: int) -> int:
    """Number of rows in all: these and the first `done`."""
    lengths = [rows.shape[1]] if isinstance(rows, np.ndarray) else map(len, rows)
    odd = next((index for index, size in enumerate(lengths) if size != len(names)), None)
    if odd is not None:
        raise BadInput(
            f"{table.name}: data row {done + odd + 1} has {len(rows[odd])} cells where the header "
            f"names {len(names)} columns: complete the row, or leave it out if the file has times."
        )
    done += len(rows)
    table.check_size(names[0], done * len(names))
    return done


def _check_names(table: ColumnTable, names: list[str]) -> None:
    table.check_count(len(names))
    named = [column for column in names if column]
    refuse(
        all(map(is_number, named)),
        f"{table.name}: there is no header row: begin the file with the names of its columns, such "
        "as time_s,speed_m_per_s,voltage_0_V.",
    )
    for index, column in enumerate(named):
        table.check_name(column)
        refuse(
            column in named[:index],
            f"{table.name}: column {column!r} appears twice in the header: give every column its "
            "own name.",
        )
