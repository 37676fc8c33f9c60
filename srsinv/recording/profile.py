"""Reading of measured profiles from a file: heights along a line."""

import os

from srsinv.errors import refuse

from ..files import path_of, within_memory
from ._table import ColumnTable, listing
from ._units import PER_M
from .formats import BY_SUFFIX
from .reader import read_table


def load_profile(
    path: str | os.PathLike[str], key: str = "The profile's path"
) -> dict[str, list[float]]:
    """`position_m` and `profile_m`, lists of numbers, from the file's columns.

    The file is of any format that recordings have, with a column `position_m` and one `height_m`
    (or `_cm`, `_mm`, `_um`). `key` is what names the path in the configuration. Raises `BadInput`
    for files that cannot be read as such.
    """
    file = path_of(path, key)
    with within_memory(file):
        table = read_table(file, BY_SUFFIX, key)
        return {
            "position_m": _column(table, "position"),
            "profile_m": _column(table, "height"),
        }


def _column(table: ColumnTable, what: str) -> list[float]:
    known = {f"{what}_{unit}": per_m for unit, per_m in PER_M.items()}
    column = next((name for name in known if name in table), None)
    refuse(
        column is None,
        f"{table.name}: there is no column of the {what} ({', '.join(known)}) among the columns "
        f"{listing(table.columns)}: name one so.",
    )
    return (table.numbers(str(column)) / known[str(column)]).tolist()
