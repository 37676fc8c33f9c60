"""Which line of a text names its columns, and what the lines before it state.

An instrument writes a preamble before its table. The rows of the table have one width and hold
numbers; the header is the nearest line above them of their width that holds none, and a row of
units may stand between. What the preamble says of the rate and the scale is read by its key words.
"""

import csv
import re
from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
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
_COMMENT_OR_SEMICOLON = re.compile(rf"{_COMMENT.pattern}|\s*;+\s*")  # where that parts no cells
_SEPARATOR = re.compile(r"\s*\"?sep=(.)\"?\s*", re.IGNORECASE)
_WITH_UNIT = re.compile(r"\"[^\"]*\"|\S+(?: ?(?:\([^()]*\)|\[[^][]*\]))?")
_LABEL = re.compile(r'\s*"([^"]*)"')  # of a row, as R writes it
_ROWS = 3  # in succession that begin a table
_DESCRIPTIONS = 2  # rows of them, at most, between a row of units and the numbers
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
    - `skipped`: lines below the header that describe the columns, by their number.
    - `has_comments`: whether a line that begins with a comment's mark is no row.
    """

    names: list[str]
    delimiter: str
    line: int
    lines: int
    units: list[str] = field(default_factory=list)
    entries: tuple[tuple[str, list[str]], ...] = ()
    above_numbers: tuple[tuple[str, list[str]], ...] = ()
    skipped: Mapping[int, str] = field(default_factory=dict)
    has_comments: bool = True


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of a line, without spaces around them."""
    if delimiter == SPACE:
        return [cell.strip('"') for cell in _WITH_UNIT.findall(line)]
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
    cells = [cells_of(_uncommented(line, delimiter), delimiter) for line in lines]
    marked = {index for index, line in enumerate(lines) if is_comment(line, delimiter)}
    numeric, width = _numeric_columns(cells, begin)
    first = _first_row(cells, numeric, width, begin, marked)
    if first is None:  # no row of numbers: the first line names what there is
        first = next((i for i in range(begin, len(lines)) if _names_columns(lines[i])), None)
        if first is None:
            return Heading([], delimiter, 0, len(lines))
        return Heading(cells[first], delimiter, first + 1, first + 1)
    if _is_labelled(lines[first]) and width - 1 in numeric:  # R's header has no name for labels
        cells[:first] = [["", *row] if len(row) == width - 1 else row for row in cells[:first]]
    head, units, after = _header(cells, numeric, width, range(begin, first), marked)
    if head is None:
        return _without_names(lines, cells, numeric, width, first, delimiter)
    names, below = cells[head], cells[units] if units is not None else []
    equations = [name for name in names if "=" in name and is_stated_word(name.partition("=")[0])]
    entries = (*entries_of(lines[:head], delimiter), *entries_of(equations, delimiter))
    pairs = zip(names, below, strict=False)
    stated = tuple((name, [cell]) for name, cell in pairs if is_number(cell))
    if _fits(names, numeric, width):
        names = ["" if name in equations else name for name in names]
        # The rows alone, or the header alone, may end in a delimiter.
        names = [*names, ""] if len(names) == width - 1 else names[:width]
    between = (index for index in range(head + 1, after + 1) if index != units)
    return Heading(
        names, delimiter, head + 1, after + 1, below, entries, stated,
        skipped={index + 1: lines[index] for index in between if any(cells[index])},
        has_comments=first not in marked,
    )  # fmt: skip


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
    return Heading(names, delimiter, 0, first, [], entries_of(lines[:first], delimiter))


def is_comment(line: str, delimiter: str) -> bool:
    """Whether a line begins with a comment's mark, and not with that of a missing sample."""
    if _mark(line, delimiter) is None:
        return False
    cells = cells_of(line, delimiter)
    return not (cells and is_mark(cells[0]))


def _mark(line: str, delimiter: str) -> re.Match[str] | None:
    return (_COMMENT if delimiter == ";" else _COMMENT_OR_SEMICOLON).match(line)


def _uncommented(line: str, delimiter: str) -> str:
    """A line without the mark that makes it a comment."""
    mark = _mark(line, delimiter)
    return line[mark.end() :] if mark else line


def _is_labelled(row: str) -> bool:
    """Whether a row begins with a name in quotation marks, and ends in none."""
    label = _LABEL.match(row)
    return label is not None and not is_stamp(label[1]) and not row.rstrip().endswith('"')


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
    cells: Sequence[Sequence[str]],
    numeric: Sequence[int],
    width: int,
    begin: int,
    marked: Container[int],
) -> int | None:
    """The first of several rows in succession that hold numbers where the table does, comments
    aside unless all are such."""
    filled = [index for index in range(begin, len(cells)) if any(cells[index])]
    for lines in ([index for index in filled if index not in marked], filled):
        flags = [_is_row(cells[index], numeric, width) for index in lines]
        for at, index in enumerate(lines):
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
    cells: Sequence[Sequence[str]],
    numeric: Sequence[int],
    width: int,
    preamble: range,
    marked: Container[int],
) -> tuple[int | None, int | None, int]:
    """The line of the preamble that names the columns of the rows below it, the one of their units,
    and the last one above the rows."""

    def has_value(index: int) -> bool:
        row = cells[index]
        return any(_holds_value(row[column]) for column in numeric if column < len(row))

    above = [
        index for index in reversed(preamble)
        if any(cells[index]) and not all(is_mark(cell) for cell in cells[index] if cell)
    ]  # fmt: skip
    for at, units in enumerate(above[: _DESCRIPTIONS + 1]):
        names = _nearest(above[at + 1 :], cells, numeric, width, marked)
        if names is None and at == 1:  # the units stand above the names
            names = _nearest(above[:1], cells, numeric, width, marked)
        if names is not None and _is_of_units(cells[units]):
            named = [cell for cell in cells[names] if cell]
            if not all(map(_holds_value, named)):
                return names, units, above[0]
        if has_value(units):
            break
    # A row above a line shows that the line is a row with other things in it, not the header; in
    # a single column every line has the table's width, and the first one is the header.
    rows = [i for i in above if i not in marked and _is_row(cells[i], numeric, width)]
    above = [index for index in above if index < min(rows, default=preamble.stop)]
    above = above[-1:] if width == 1 and above and above[-1] not in marked else above
    plain_lines = [index for index in above if index not in marked]
    for index in [*plain_lines, *(index for index in above if index in marked)]:
        if _fits(cells[index], numeric, width) and not has_value(index):
            return index, None, index
    # Names may look like numbers: most of a line's do not.
    if above and _fits(cells[above[0]], numeric, width) and above[0] not in marked:
        named = [cell for cell in cells[above[0]] if cell]
        if not _holds_value(named[0]) and 2 * sum(map(_holds_value, named)) <= len(named):
            return above[0], None, above[0]
    # One that names too few, or too many, is refused with the first row, but for a sentence.
    near = next(iter(plain_lines), None)
    if near is None or any(map(_holds_value, cells[near])) or len(cells[near]) == 1 < width:
        return None, None, 0
    return near, None, near


def _nearest(
    above: Sequence[int],
    cells: Sequence[Sequence[str]],
    numeric: Sequence[int],
    width: int,
    marked: Container[int],
) -> int | None:
    """The nearest line that may name the columns, comments of another width aside."""
    near = (i for i in above if i not in marked or _fits(cells[i], numeric, width))
    index = next(near, None)
    return index if index is not None and _fits(cells[index], numeric, width) else None


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


def entries_of(lines: Iterable[str], delimiter: str) -> tuple[tuple[str, list[str]], ...]:
    """Keys and values of a preamble's lines, split by the delimiter, a colon or an equals sign."""
    entries = []
    for line in lines:
        text = _uncommented(line, delimiter).strip().lstrip(f"{delimiter};").strip()
        cells = cells_of(text, delimiter) if delimiter != SPACE else [text]
        entry = _ENTRY.fullmatch(cells[0]) if len([c for c in cells if c]) == 1 else None
        if entry:
            cells = [entry[1], entry[2]]
        if len(cells) > 1 and plain(cells[0].rstrip(":")):
            # A scope that writes a block for each channel has the key in each.
            values = ["" if cell == cells[0] else cell for cell in cells[1:]]
            entries.append((cells[0].rstrip(":").strip(), values))
    return tuple(entries)


def units_of(heading: Heading) -> Mapping[str, str]:
    """The units that a row below the names states, by name."""
    pairs = zip(heading.names, heading.units, strict=False)
    return {name: unit.strip("()[] ") for name, unit in pairs if unit and not is_number(unit)}
