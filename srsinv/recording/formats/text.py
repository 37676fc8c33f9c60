"""Text: a line of names, then a row a sample, as instruments and people write it."""

import codecs
import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from srsinv.errors import BadInput, refuse

from ...files import DataFile, quoted
from .._clocks import own_times, take_own_times
from .._columns import is_time
from .._stated import is_gain_of, is_of_time, is_stated_word, plain, stated
from .._table import ColumnTable, listing, marked_number
from ..reader import Reader
from ._heading import SPACE, Heading, entries_of, heading_of, units_of
from ._lines import BLOCK, LONGEST_ROW, Lines
from ._numbers import DecimalMark, has_thousands, is_mark
from ._stamps import has_date, is_date, is_stamp, stamps_s

_MOST_BLANK = 10_000  # blank lines at the end of a file of several columns
_TEXT = 80  # characters stored of a cell that is no number
_SPACES = re.compile(r"[ \t]+")
_EITHER = re.compile(r"(^|[^\d.,])[1-9]\d{0,2}[.,]\d{3}($|[^\d.,])")  # 2,000: two or thousands
_AT_ENDS = re.compile(r"(?m)^ | $")
_OTHER_STAMP = re.compile(r"\w.*(\d\D+\d|\d{4})")  # in a column of times without a number

_Rows = list[list[str]] | Float[np.ndarray, "row column"]


def _as_latin_1(error: UnicodeError) -> tuple[str, int]:
    """Bytes that are no UTF-8, as Latin-1 has them: signs of micro and of degrees."""
    if not isinstance(error, UnicodeDecodeError):
        raise error
    return error.object[error.start : error.end].decode("latin-1"), error.end


codecs.register_error("srsinv.latin_1", _as_latin_1)


class Text(Reader):
    """Text whose rows have cells separated by commas, semicolons, tabs or spaces.

    The line that names the columns stands above the rows, after whatever an instrument writes
    before; where there is none, columns are named `column_1`, `column_2`, ... Between semicolons,
    tabs or spaces the decimal mark may be a comma, throughout the file. UTF-8, UTF-16 and Latin-1
    are read.
    """

    def read(self, file: DataFile) -> ColumnTable:
        """The columns of a text, with the rate, units and start that its preamble states."""
        table = ColumnTable.of(file)
        text = io.TextIOWrapper(file, encoding=_encoding(file), errors="srsinv.latin_1")
        lines = Lines(table.name, text)
        heading = heading_of(lines.block_at_hand())
        delimiter = heading.delimiter
        lines.skip(heading.lines)
        if heading.has_comments:
            lines.leave_out_comments(delimiter)
        names, blocks = own_times(heading.names, units_of(heading))
        heading = replace(heading, names=names)
        _check_names(table, names)
        decimal = DecimalMark(delimiter != ",")
        columns = {index: _Column(decimal) for index in range(len(names))}
        for rows in _blocks(table, lines, delimiter, names, decimal):
            cells = rows.T if isinstance(rows, np.ndarray) else list(zip(*rows, strict=True))
            for index, column in columns.items():
                column.extend(cells[index])
        clocks = [column for column in columns.values() if column.is_clock]
        dates = [column for column in columns.values() if column.is_dates]
        if len(clocks) == len(dates) == 1:
            clocks[0].date(dates[0])
        for index, column in columns.items():
            _take(table, names[index] or f"column_{index + 1}", column, bool(names[index]))
        text.detach()  # the file stays open
        _refuse_thousands(table, file, heading)
        _state(table, heading, decimal.mark, {**heading.skipped, **lines.comments})
        take_own_times(table, blocks)
        return table


def _encoding(file: DataFile) -> str:
    """The encoding of a text, by the mark at its beginning or by its zero bytes."""
    start = file.read(1024)
    file.seek(0)
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    even, odd = start[::2].count(0), start[1::2].count(0)
    if 4 * max(even, odd) > len(start) and not min(even, odd):
        return "utf-16-le" if odd else "utf-16-be"
    return "utf-8-sig"


def _take(table: ColumnTable, name: str, column: "_Column", is_named: bool) -> None:
    """Take in a column; one that nobody names only where it holds anything."""
    values = column.numbers()
    if not is_named and (name in table or not np.isfinite(values).any()):
        return
    has_numbers = bool(np.isfinite(values).any())
    is_other = is_time(name) and _OTHER_STAMP.match(column.text) and not marked_number(column.text)
    if column.is_stamps or (is_other and not has_numbers):
        table.stamps.append(name)
    if name in table.stamps and column.text and not has_numbers:
        return table.leave_out(name, f"holds dates or times in no certain form, as {column.text!r}")
    table.columns[name] = values
    table.texts[name] = column.text
    if column.mark:
        table.marks[name] = column.mark


def _refuse_thousands(table: ColumnTable, file: DataFile, heading: Heading) -> None:
    """Refuse a column whose cells part thousands: -1.117 beside 385, which is -1117."""
    odd = [name for name, values in table.columns.items() if has_thousands(values)]
    if not odd:
        return
    file.seek(0)
    text = io.TextIOWrapper(file, encoding=_encoding(file), errors="srsinv.latin_1")
    at = {heading.names.index(name): name for name in odd if name in heading.names}
    whole = re.compile(r"\s*[-+]?\d{1,3}([.,]\d{3})?\s*", re.ASCII)
    cells: dict[int, str] = {}
    for number, row in enumerate(csv.reader(text, delimiter=heading.delimiter)):
        if number < heading.lines:
            continue
        for index in [index for index in at if index < len(row)]:
            if row[index].strip() and not whole.fullmatch(row[index]):
                del at[index]
            elif "." in row[index] or "," in row[index]:
                cells.setdefault(index, row[index].strip())
    text.detach()
    for index, name in at.items():
        raise BadInput(
            f"{table.name}: column {quoted(name)} has {cells.get(index, '')!r} among "
            "whole numbers, whose mark may separate thousands or decimals: write the "
            "numbers without a mark for thousands."
        )


def _state(table: ColumnTable, heading: Heading, decimal: str, skipped: Mapping[int, str]) -> None:
    """Add what the preamble, the row of units and comments state; `decimal`: the mark of the rows'
    numbers, where any has one; `skipped`: lines that are no rows, by their number."""
    table.units.update({name: unit for name, unit in units_of(heading).items() if name in table})
    if heading.line > 1:
        named = listing(name for name in heading.names if name)
        table.notes.append(f"Line {heading.line} names the columns: {named}.")
    if not heading.line:
        table.notes.append("No line names the columns: they are numbered from column_1 on.")
    if skipped:
        where = f"line{'s' * (len(skipped) > 1)} {listing(map(str, skipped))}"
        first = quoted(next(iter(skipped.values())).strip()[:_TEXT])
        table.notes.append(f"The table is read without {where}, beginning with {first!r}.")
    _state_units(table, heading)
    _state_of_labview(table, heading)
    commented = entries_of(skipped.values(), heading.delimiter)
    above = {key for key, _ in heading.above_numbers}
    for key, values in (*heading.entries, *heading.above_numbers, *commented):
        is_certain = is_stated_word(key, may_be_ambiguous=key in above) or is_gain_of(key)
        if not is_certain or (
            key in above and key in table.columns and np.isfinite(table.columns[key]).any()
        ):
            continue  # or a column of its own
        value = _stated_value(values, decimal, heading.delimiter)
        # Of starts and intervals several may be stated, or in words, and the times are there; a
        # scale that is not applied is never left out.
        if value is not None and (stated({key: value}).refused is None or not is_of_time(key)):
            table.scalars.setdefault(key, value)
            if key in above:
                table.columns.pop(key, None)
    _number_by_clock(table)


def _stated_value(values: Sequence[str], decimal: str, delimiter: str) -> str | None:
    """The value that an entry of a preamble states, with a unit in the next cell; None: none. The
    mark that is not the rows' decimal mark parts thousands; where rows have none, a number that may
    be either stays a text, which is refused."""
    filled = [value for value in values if value]
    if len(filled) == 2 and not any(each.isdigit() for each in filled[1]):
        filled = [" ".join(filled)]
    decimal = "." if delimiter == "," else decimal
    thousands = {".": ",", ",": "."}.get(decimal)
    different = dict.fromkeys(filled)
    if len(different) != 1:
        return "; ".join(different) or None
    (value,) = different
    if thousands is None:
        return value if _EITHER.search(value) else value.replace(",", ".")
    return value.replace(thousands, "").replace(decimal, ".")


def _state_units(table: ColumnTable, heading: Heading) -> None:
    """Add the units that a preamble states: of the first column, and of those after it."""
    first, *others = heading.names
    for key, values in heading.entries:
        named: list[str] = {"horizontalunits": [first], "xunits": [first], "verticalunits": others,
                 "yunits": others, "yunitlabel": others}.get(plain(key), [])  # fmt: skip
        for name, unit in zip(named, values, strict=False):
            if unit and name in table.columns:
                table.units.setdefault(name, unit)


def _state_of_labview(table: ColumnTable, heading: Heading) -> None:
    """The seconds of X_Value, and the starts and intervals of a LabVIEW file's channels."""
    entries = dict(heading.entries)
    if "X_Value" not in heading.names or "X_Dimension" not in entries:
        return
    if entries["X_Dimension"][:1] == ["Time"] and "X_Value" in table.columns:
        table.units["X_Value"] = "s"
        table.stamps.append("X_Value")
        if not np.isfinite(table.columns["X_Value"]).any():
            del table.columns["X_Value"]  # where X_Columns is No
            table.stamps.remove("X_Value")
    channels = heading.names[heading.names.index("X_Value") + 1 :]
    rows = zip(channels, entries.get("X0", ()), entries.get("Delta_X", ()), strict=False)
    clocks = {name: stated({"X0": x0, "Delta_X": step}) for name, x0, step in rows if step}
    if len({(each.start_s, each.interval_s) for each in clocks.values()}) > 1:
        for name, each in clocks.items():
            if name in table.columns and each.clock:
                table.clocks[name] = each.clock


def _number_by_clock(table: ColumnTable) -> None:
    """Turn a column of the samples' numbers into seconds, by the start and the interval."""
    clock = stated(table.scalars)
    numbered = [name for name, unit in table.units.items() if unit.casefold() == "sequence"]
    if clock.interval_s and len(numbered) == 1 and not clock.refused:
        (name,) = numbered
        table.columns[name] = (clock.start_s or 0.0) + clock.interval_s * table.columns[name]
        table.units[name] = "s"
        table.stamps.append(name)


class _Column:
    """A column's cells as numbers: NaN for one that is empty or a mark of a missing sample,
    infinite for no finite number. Dates and clock times are seconds."""

    def __init__(self, decimal: DecimalMark):
        self._parts: list[np.ndarray] = []
        self._stamps: list[str] = []
        self._decimal = decimal
        self.text = ""  # of the first cell that holds no finite number
        self.mark = ""  # the first one of a missing sample
        self.is_stamps = self.is_clock = self.is_dates = False

    def extend(self, cells: Sequence[str] | Float[np.ndarray, " row"]) -> None:
        """Add the next cells, or their numbers, finite but where a cell is empty."""
        if isinstance(cells, np.ndarray):
            self._parts.append(cells.copy())  # not a view, which would hold all columns
            return
        if not self._stamps and not sum(map(len, self._parts)):
            first = next((cell for cell in cells if cell.strip()), "")
            self.is_stamps, self.is_dates = is_stamp(first), is_date(first)
            self.is_clock = self.is_stamps and not has_date(first)
        if self.is_stamps or self.is_dates:
            self._stamps.extend(cells)
            return
        values = self._plain(cells)
        if values is None:
            values = np.fromiter(map(self._decimal.number, cells), np.float64, len(cells))
        if not self.text and np.isinf(values).any():
            self.text = cells[int(np.isinf(values).argmax())].strip()[:_TEXT]
        if not self.mark and np.isnan(values).any():
            self.mark = next((cell.strip() for cell in cells if is_mark(cell)), "")
        self._parts.append(values)

    def _plain(self, cells: Sequence[str]) -> Float[np.ndarray, " row"] | None:
        """The numbers of cells that are all finite with a point as decimal mark, quickly, or
        None."""
        text = "".join(cells)
        if self._decimal.may_differ or not text.isascii() or "_" in text:
            return None
        try:
            values = np.fromiter(map(float, cells), np.float64, len(cells))
        except ValueError:
            return None
        return values if np.isfinite(values).all() else None

    def date(self, dates: "_Column") -> None:
        """Put the dates of another column before the clock times of this one."""
        pairs = zip(dates._stamps, self._stamps, strict=True)
        self._stamps = [f"{date.strip()} {clock}" for date, clock in pairs]

    def numbers(self) -> Float[np.ndarray, " row"]:
        """All cells, removed from the column."""
        if self.is_stamps or self.is_dates:
            values = stamps_s(self._stamps)
            if values is None:
                values = np.full(len(self._stamps), np.inf)
            odd = np.isinf(values)
            self.text = self._stamps[int(odd.argmax())].strip()[:_TEXT] if odd.any() else ""
            self._stamps.clear()
            return values
        values = np.concatenate([np.zeros(0), *self._parts])
        self._parts.clear()
        return values


def _blocks(
    table: ColumnTable, lines: Lines, delimiter: str, names: list[str], decimal: DecimalMark
) -> Iterator[_Rows]:
    """Rows of as many cells as there are names, a block of them at a time.

    A blank line is a row of empty cells, and nothing at the end of any file.
    """
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=delimiter == SPACE)
    done = blank = 0
    while len(rows := _next_rows(lines, reader, delimiter, len(names), decimal)):
        at_end = 0
        while isinstance(rows, list) and rows and rows[-1] == [""]:
            rows.pop()
            at_end += 1
        blank, at_end = (blank, at_end) if len(rows) else (blank + at_end, 0)
        if len(rows) or (blank > _MOST_BLANK and len(names) > 1):
            held = ([[""]] * min(BLOCK, blank - start) for start in range(0, blank, BLOCK))
            for part in (*held, rows) if len(rows) else held:
                whole = _with_blank_rows(part, len(names))
                done = _checked(table, whole, names, done)
                yield whole
            blank = 0
        blank += at_end
        table.check_size(names[0], done + blank)


def _next_rows(
    lines: Lines,
    reader: Iterator[list[str]],
    delimiter: str,
    columns: int,
    decimal: DecimalMark,
) -> _Rows:
    """The rows of the next lines, a blank line's being one empty cell; none at the end."""
    block = lines.block_at_hand()
    if delimiter == SPACE and '"' not in block:
        block = _AT_ENDS.sub("", _SPACES.sub(" ", block))
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
        not named,
        f"{table.name}: there is no table: begin the file with the names of its columns, such as "
        "time_s,speed_m_per_s,voltage_0_V, and write a row for each sample below.",
    )
    for index, column in enumerate(named):
        table.check_name(column)
        refuse(
            column in named[:index],
            f"{table.name}: column {column!r} appears twice in the header: give every column its "
            "own name.",
        )
