"""Columns of numbers from files that are no recordings: profiles, and what the package wrote."""

import os
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from srsinv.errors import refuse

from ..files import path_of, within_memory
from ._table import ColumnTable, listing
from ._units import PER_M
from .formats import BY_SUFFIX
from .reader import read_table


def load_columns(
    path: str | os.PathLike[str], names: Sequence[str], key: str, wanted: str
) -> dict[str, Float[np.ndarray, " row"]]:
    """The columns of these names, read as recordings are: nothing in the file is trusted or run.

    `key` is what names the path in the configuration, `wanted` what a file with these columns is.
    Raises `BadInput` for files that cannot be read, and where a column is absent or holds no finite
    number.
    """
    file = path_of(path, key)
    with within_memory(file):
        table = read_table(file, BY_SUFFIX, key)
        missing = [name for name in names if name not in table]
        refuse(
            bool(missing),
            f"{table.name}: there is no column {missing and missing[0]}: give {key} {wanted}.",
        )
        return {name: table.numbers(name) for name in names}


def load_profile(
    path: str | os.PathLike[str], key: str = "The profile's path"
) -> dict[str, list[float]]:
    """A measured profile: `position_m` and `profile_m`, lists of numbers, from the file's columns.

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
        f"{table.name}: there is no column {', '.join(known)} among the columns "
        f"{listing(table.columns)}: rename the one of the {what} to one of these.",
    )
    return (table.numbers(str(column)) / known[str(column)]).tolist()
