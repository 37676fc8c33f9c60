"""Columns of numbers from a file that the package wrote, of lengths of their own."""

import os
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from srsinv.errors import refuse

from ..files import path_of, within_memory
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
