"""A measured profile's way in from a file: heights along a line."""

import os
from pathlib import Path
from typing import Any

from srsinv.errors import refuse, shown

from ._formats import read_table
from ._table import Table, listing
from ._units import PER_M, POSITIONS, names

HEIGHTS = names("height", PER_M)


def load_profile(path: str | os.PathLike[str]) -> dict[str, Any]:
    """`position_m` and `profile_m`, lists of numbers, from the file's columns.

    The file is of any format that recordings have, with a column `position_m` (or `_mm`, `_um`) and
    one `height_m` (or `_mm`, `_um`). Raises `BadInput` for what cannot be read as such.
    """
    refuse(
        not isinstance(path, str | os.PathLike),
        f"The profile's path is {shown(path)}: give the name of a file.",
    )
    table = read_table(Path(path).expanduser())
    return {
        "position_m": _column(table, "position", POSITIONS),
        "profile_m": _column(table, "height", HEIGHTS),
    }


def _column(table: Table, what: str, known: dict[str, int]) -> list[float]:
    column = next((name for name in known if name in table), None)
    refuse(
        column is None,
        f"{table.name}: there is no column of the {what} ({', '.join(known)}) among the columns "
        f"{listing(table.columns)}: name one so.",
    )
    return (table.numbers(str(column)) / known[str(column)]).tolist()
