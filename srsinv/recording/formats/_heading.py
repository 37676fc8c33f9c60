"""Which line of a text names its columns, and what the lines before it state.

An instrument writes a preamble before its table. The rows of the table have one width and hold
numbers; the header is the nearest line above them of their width that holds none, and a row of
units may stand between. What the preamble says of the rate and the scale is read by its key words.
"""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from .._stated import is_stated_word, plain
from .._units import is_any_unit, is_foreign_unit
from ._numbers import is_mark, is_number
from ._stamps import is_stamp

SPACE = " "
_DELIMITERS = "\t;,"  # in the order of trust: a name may hold a comma, hardly the others
_QUOTED = re.compile('"[^"]*"')
_MOST_LINES = 2_000  # that a preamble and the first rows are looked for in
_COMMENT = re.compile(r"\s*(#+|%+|//+|!)\s*")
_SEPARATOR = re.compile(r"\s*\"?sep=(.)\"?\s*", re.IGNORECASE)
_WITH_UNIT = re.compile(r"\S+(?: ?(?:\([^()]*\)|\[[^][]*\]))?")
_ROWS = 3  # in succession that begin a table
_ENTRY = re.compile(r"([^:=]*[^:=\s])\s*[:=]\s*(.*)")
# Units rows: words that stand there besides units.
_NO_UNIT = ("", "sequence", "sample", "samples", "points", "counts", "count", "-", "1", "n/a")


@dataclass(frozen=True)
class Heading:
    """The lines above the rows of a text.

    - `names`: of the columns, as many as the rows have cells where that is certain; `units` below
      them, or none; `line` the number of the line that names them, 0 where no line does.
    - `lines`: how many lines stand above the first row.
    - `entries`: what the preamble states, as key and values; `above_numbers` what stands so in the
      header and the row of units, as a scope's start and increment.
    """

    names: list[str]
    delimiter: str
    line: int
    lines: int
    units: list[str] = field(default_factory=list)
    entries: tuple[tuple[str, list[str]], ...] = ()
    above_numbers: tuple[tuple[str, list[str]], ...] = ()


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of a line, without spaces around them."""
    if delimiter == SPACE:
        return _WITH_UNIT.findall(line)
    try:
        rows = csv.reader([line.rstrip("\r\n")], delimiter=delimiter)
        return [cell.strip() for cell in next(rows, [])]
    except csv.Error:
        return []


def heading_of(block: str) -> Heading:
    """The heading of a text that begins with `block`, its first lines."""
    lines = block.split("\n", _MOST_LINES)[:_MOST_LINES]
    if lines[-1] == "":
        lines.pop()
    begin = next((i for i, line in enumerate(lines) if line.strip()), 0)
    separator = _SEPARATOR.fullmatch(lines[begin]) if lines else None
    begin = begin + 1 if separator else 0
    delimiter = separator[1] if separator else _delimiter(lines)
    cells = [cells_of(_uncommented(line), delimiter) for line in lines]
    numeric, width = _numeric_columns(cells, begin)
    first = _first_row(cells, numeric, width, begin)
    if first is None:  # no row of numbers: the first line names what there is
        first = next((i for i in range(begin, len(lines)) if _names_columns(lines[i])), None)
        if first is None:
            return Heading([], delimiter, 0, len(lines))
        return Heading(cells[first], delimiter, first + 1, first + 1)
    head, units = _header(lines, cells, numeric, width, begin, first)
    if head is None:
        return _without_names(lines, cells, numeric, width, first, delimiter)
    names, below = cells[head], cells[units] if units is not None else []
    entries = _entries(lines[:head], delimiter)
    pairs = zip(names, below, strict=False)
    stated = tuple((name, [cell]) for name, cell in pairs if is_number(cell))
    after = head if units is None else units
    if _fits(names, numeric, width):
        names = _fitted(names, width)
    return Heading(names, delimiter, head + 1, after + 1, below, entries, stated)


def _without_names(
    lines: Sequence[str],
    cells: Sequence[Sequence[str]],
    numeric: Sequence[int],
    width: int,
    first: int,
    delimiter: str,
) -> Heading:
    """The heading of a table whose columns no line names, from its first line on: rows with cells
    that are no numbers belong to it. Numbers from 0 on are names, as pandas writes them."""
    while first and len(cells[first - 1]) == width:
        if not any(_holds_value(cells[first - 1][index]) for index in numeric):
            break
        first -= 1
    if list(cells[first]) == [str(index) for index in range(width)] and width > 1:
        first += 1
    names = [f"column_{index + 1}" for index in range(width)]
    return Heading(names, delimiter, 0, first, [], _entries(lines[:first], delimiter))


def _uncommented(line: str) -> str:
    """A line without the mark that makes it a comment."""
    mark = _COMMENT.match(line)
    return line[mark.end() :] if mark else line


def _names_columns(line: str) -> bool:
    return bool(line.strip()) and not line.startswith("#")


def _delimiter(lines: Sequence[str]) -> str:
    """The delimiter of most lines in the second half, where the rows are."""
    filled = [_QUOTED.sub("", line) for line in lines if _names_columns(line)]
    tail = filled[len(filled) // 2 :]
    split = [line.split() for line in tail]
    spaced = sum(len(each) > 1 and all(map(_holds_value, each)) for each in split)
    for mark in _DELIMITERS:
        # Between spaces a comma may be the decimal mark.
        is_decimal = mark == "," and 2 * spaced > len(tail)
        if 2 * sum(mark in line for line in tail) > len(tail) and not is_decimal:
            return mark
    return SPACE if 2 * spaced > len(tail) else ","


def _holds_value(cell: str) -> bool:
    return is_number(cell) or is_number(cell.replace(",", ".", 1)) or is_stamp(cell)


def _numeric_columns(cells: Sequence[Sequence[str]], begin: int) -> tuple[list[int], int]:
    """The columns that hold numbers or stamps in most lines of the usual width, and that width."""
    widths = Counter(len(row) for row in cells[begin:] if any(map(_holds_value, row)))
    if not widths:
        return [], 0
    most = max(widths.values())
    width = max(size for size, count in widths.items() if count == most)
    rows = [row for row in cells[begin:] if len(row) == width]
    rows = rows[len(rows) // 2 :]
    held = [sum(_holds_value(row[index]) for row in rows) for index in range(width)]
    return [index for index, count in enumerate(held) if 2 * count > len(rows)], width


def _first_row(
    cells: Sequence[Sequence[str]], numeric: Sequence[int], width: int, begin: int
) -> int | None:
    """The first of several rows in succession that hold numbers where the table does."""
    filled = [index for index in range(begin, len(cells)) if any(cells[index])]
    flags = [_is_row(cells[index], numeric, width) for index in filled]
    for at, index in enumerate(filled):
        if flags[at] and all(flags[at : at + _ROWS]):
            return index
    return None


def _is_row(row: Sequence[str], numeric: Sequence[int], width: int) -> bool:
    """Whether a line holds numbers where the table does, marks of missing samples aside."""
    if len(row) != width or not any(_holds_value(row[index]) for index in numeric):
        return False
    return all(
        _holds_value(row[index]) or is_mark(row[index]) or not row[index] for index in numeric
    )


def _header(
    lines: Sequence[str],
    cells: Sequence[Sequence[str]],
    numeric: Sequence[int],
    width: int,
    begin: int,
    first: int,
) -> tuple[int | None, int | None]:
    """The line that names the columns of the rows from `first` on, and the one of their units."""
    above = [index for index in range(first - 1, begin - 1, -1) if any(cells[index])]
    if len(above) > 1 and _is_of_units(cells[above[0]]) and _fits(cells[above[1]], numeric, width):
        named = [cell for cell in cells[above[1]] if cell]
        if not all(map(_holds_value, named)):
            return above[1], above[0]
    # A row above a line shows that the line is a row with other things in it, not the header; in
    # a single column every line has the table's width, and the first one is the header.
    rows = [index for index in above if _is_row(cells[index], numeric, width)]
    above = [index for index in above if index < min(rows, default=first)]
    above = above[-1:] if width == 1 and above and not lines[above[-1]].startswith("#") else above
    marked = [index for index in above if lines[index].startswith("#")]
    for index in [*(each for each in above if each not in marked), *marked]:
        row = cells[index]
        if _fits(row, numeric, width) and not any(
            _holds_value(row[column]) for column in numeric if column < len(row)
        ):
            return index, None
    # Names may look like numbers: most of a line's do not.
    if above and _fits(cells[above[0]], numeric, width) and not lines[above[0]].startswith("#"):
        named = [cell for cell in cells[above[0]] if cell]
        if not _holds_value(named[0]) and 2 * sum(map(_holds_value, named)) <= len(named):
            return above[0], None
    # One that names too few, or too many, is refused with the first row, but for a sentence.
    near = next((index for index in above if index not in marked), None)
    is_list = near is not None and (len(cells[near]) > 1 or width == 1)
    return (near if is_list and not any(map(_holds_value, cells[near or 0])) else None), None


def _fits(row: Sequence[str], numeric: Sequence[int], width: int) -> bool:
    """Whether a line has as many cells as the rows, aside from those at either's end that need none
    in the other."""
    if len(row) == width - 1:
        return width - 1 not in numeric
    return len(row) >= width and all(map(_needs_no_cell, row[width:]))


def _needs_no_cell(name: str) -> bool:
    """Whether rows may lack a cell for a name at a header's end: none, LabVIEW's comment, or a
    scope's start and increment, which stand above the rows."""
    return not name or name.casefold() == "comment" or "=" in name or is_stated_word(name)


def _is_of_units(row: Sequence[str]) -> bool:
    """Whether a line holds units, numbers and nothing else, and a unit at least."""
    bare = [cell.strip("()[] ") for cell in row]
    return any(map(is_any_unit, bare)) and all(
        is_any_unit(cell) or is_foreign_unit(cell) or cell.casefold() in _NO_UNIT or is_number(cell)
        for cell in bare
    )


def _fitted(names: Sequence[str], width: int) -> list[str]:
    """The names, with one for a delimiter that the rows alone end in, or without one for a
    delimiter that the header alone ends in."""
    return [*names, ""] if len(names) == width - 1 else list(names[:width])


def _entries(lines: Sequence[str], delimiter: str) -> tuple[tuple[str, list[str]], ...]:
    """Keys and values of a preamble's lines, split by the delimiter, a colon or an equals sign."""
    return tuple(_split_entries(lines, delimiter))


def _split_entries(lines: Sequence[str], delimiter: str) -> Iterator[tuple[str, list[str]]]:
    for line in lines:
        text = _uncommented(line).strip().lstrip(f"{delimiter};").strip()
        cells = cells_of(text, delimiter) if delimiter != SPACE else [text]
        entry = _ENTRY.fullmatch(cells[0]) if len([c for c in cells if c]) == 1 else None
        if entry:
            cells = [entry[1], entry[2]]
        if len(cells) > 1 and plain(cells[0].rstrip(":")):
            yield cells[0].rstrip(":").strip(), cells[1:]


def units_of(heading: Heading) -> Mapping[str, str]:
    """The units that a row below the names states, by name."""
    pairs = zip(heading.names, heading.units, strict=False)
    return {name: unit.strip("()[] ") for name, unit in pairs if unit and not is_number(unit)}
