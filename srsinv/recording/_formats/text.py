"""Text: a header row of names, then a row a sample, separated by commas, semicolons or tabs."""

import csv
import io
from pathlib import Path

from srsinv.errors import BadInput, refuse

from .._table import Table, is_number

_DELIMITERS = ",;\t"


def read_text(path: Path) -> Table:
    """The columns of a UTF-8 text; blank lines and lines of # before the header are skipped."""
    text = path.read_text(encoding="utf-8-sig")
    if "\0" in text:
        raise ValueError("binary")
    lines = iter(io.StringIO(text))
    header = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    delimiter = next((mark for mark in header if mark in _DELIMITERS), ",")
    names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter), [])]
    _check_names(path.name, names)
    # A blank line is the empty cell of a file of one column, and nothing at the end of any file.
    rows = [row or [""] for row in csv.reader(lines, delimiter=delimiter)]
    while rows and rows[-1] == [""]:
        rows.pop()
    _check_rows(path.name, len(names), rows)
    cells = {name: [row[index] for row in rows] for index, name in enumerate(names) if name}
    return Table(path.name, {**cells})


def _check_names(name: str, names: list[str]) -> None:
    named = [column for column in names if column]
    refuse(
        all(map(is_number, named)),
        f"{name}: there is no header row: begin the file with the names of its columns, such as "
        "time_s,speed_m_per_s,voltage_0_V.",
    )
    twice = next((column for column in named if named.count(column) > 1), None)
    refuse(
        twice is not None,
        f"{name}: column {twice!r} appears twice in the header: give every column its own name.",
    )


def _check_rows(name: str, columns: int, rows: list[list[str]]) -> None:
    odd = next((index for index, row in enumerate(rows) if len(row) != columns), None)
    if odd is not None:
        raise BadInput(
            f"{name}: data row {odd + 1} has {len(rows[odd])} cells where the header names "
            f"{columns} columns: complete the row or leave it out."
        )
