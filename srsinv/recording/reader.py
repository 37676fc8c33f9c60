"""Readers: a file format, as the columns of a file.

The configuration alone says which reader is used (its group `reader`), never by a data file
or a sidecar. The package's own are in `formats`.
"""

import abc
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from srsinv.errors import BadInput, echo, refuse

from ..files import DataFile, open_file, quoted
from ._table import ColumnTable, listing

_REASON = 200  # characters shown of a reader's own exception
_AHEAD: dict[tuple[Any, ...] | None, tuple["Reader", ColumnTable]] = {}  # one table at most
_REMEDY = "choose another one by reader=..., or correct it."


class Reader(abc.ABC):
    """Base of readers: a format of recorded files. `read` is to be defined."""

    def check_path(self, path: Path) -> None:
        """Refuse, before it is opened, a path that this reader does not read."""
        del path

    @abc.abstractmethod
    def read(self, file: DataFile) -> Mapping[str, ArrayLike] | ColumnTable:
        """The columns of a file, by name: 1-D arrays (sample,) of real numbers, of equal length.

        `file` is open for reading bytes, `file.path` its path. Names are those that the package's
        own formats have: `time_s`, `speed_m_per_s`, `voltage_0_V`, ... A `ColumnTable` holds the
        file's own units and facts besides. Whatever it raises is refused; `BadInput` has the
        sentence for it.
        """


def read_table(path: Path, reader: Reader, key: str = "recording.path") -> ColumnTable:
    """The table in `path`, by a reader; `key` is what names the path in the configuration.

    Raises `BadInput` for a file that cannot be one, for a reader that fails on it or gives no
    columns of numbers, and `MemoryError` as Python does.
    """
    name = quoted(path.name)
    with _refusing(reader, name):
        reader.check_path(path)
    with (
        open_file(path, key=key) as file,
        _refusing(reader, name),
        DataFile(os.dup(file.fileno()), path) as own,  # which a reader may close
    ):
        table = _checked(reader, name, reader.read(own))
    refuse(
        not table.columns and not table.unusable,
        f"{name}: the file has no columns: write it again, with a column for each quantity.",
    )
    return table


def store(path: Path, reader: Reader, table: ColumnTable) -> None:
    """Store the table that a check of settings has read, for the [`take_table`][] of its job."""
    _AHEAD[_state(path)] = reader, table


def take_table(path: Path, reader: Reader) -> ColumnTable:
    """The table in `path`, the one that [`store`][] was given if file and reader are the same.

    Raises `BadInput` as `read_table` does.
    """
    by, table = _AHEAD.pop(_state(path), (None, None))
    _AHEAD.clear()  # of another file, or of this one before it changed
    return read_table(path, reader) if table is None or not _is_same(by, reader) else table


def _is_same(one: Any, other: Reader) -> bool:
    """Whether two readers read alike: a data class whose fields are equal; else one object."""
    try:
        return bool(one == other)
    except Exception:  # of a user's own fields, such as arrays
        return False


def _state(path: Path) -> tuple[Any, ...] | None:
    """Identity of a file: path, device, inode, size and modification time; None: absent."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return str(path), stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns


@contextmanager
def _refusing(reader: Reader, name: str) -> Iterator[None]:
    """Refuse whatever a reader raises, which may be a user's own; its warnings are not shown."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (BadInput, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:_REASON]
        reason = reason if reason.isprintable() else ascii(reason)
        raise BadInput(
            f"{name}: reader {_label(reader)} cannot read the file ({reason}): {_REMEDY}"
        ) from error


def _checked(reader: Reader, name: str, given: Any) -> ColumnTable:
    """What a reader gave, each column taken in anew."""
    refuse(
        not isinstance(given, Mapping | ColumnTable),
        f"{name}: reader {_label(reader)} gives {echo(given)}, not a mapping of "
        f"column names to 1-D arrays: {_REMEDY}",
    )
    whole = given if isinstance(given, ColumnTable) else ColumnTable(name, dict(given))
    table = replace(
        whole, name=name, columns={}, unusable=dict(whole.unusable), scalars=dict(whole.scalars)
    )
    for column, values in whole.columns.items():
        refuse(
            not isinstance(column, str),
            f"{name}: reader {_label(reader)} names a column {echo(column)}, which is no text: "
            f"{_REMEDY}",
        )
        if isinstance(values, np.ma.MaskedArray):  # what is masked is missing
            values = np.ma.filled(values.astype(float), np.nan)
        array = np.asarray(values)
        table.take(column, array.shape, array.dtype, lambda array=array: array)
    if not isinstance(given, ColumnTable):
        _check_equal(reader, table)
    table.state_rate()
    return table


def _check_equal(reader: Reader, table: ColumnTable) -> None:
    """Refuse columns that are no numbers, or not of equal length."""
    for column, reason in table.unusable.items():
        raise BadInput(
            f"{table.name}: reader {_label(reader)} gives column {quoted(column)}, which {reason}, "
            f"not a 1-D array of real numbers: {_REMEDY}"
        )
    lengths = listing(f"{column} {values.size}" for column, values in table.columns.items())
    refuse(
        len({values.size for values in table.columns.values()}) > 1,
        f"{table.name}: reader {_label(reader)} gives columns that differ in length ({lengths}): "
        f"{_REMEDY}",
    )
    refuse(
        not any(np.isfinite(values).any() for values in table.columns.values()),
        f"{table.name}: reader {_label(reader)} gives no number in any column, among "
        f"{listing(table.columns)}: {_REMEDY}",
    )


def missing_package(name: str, extra: str) -> BadInput:
    """The refusal of a file in a format that is read by a package, which the `extra` of the
    format's name installs."""
    return BadInput(
        f"{name}: reading .{extra} takes a package that is not installed: add it by pip install "
        f"srsinv[{extra}], or save the recording in another format."
    )


def _label(reader: Reader) -> str:
    return f"{type(reader).__module__}.{type(reader).__qualname__}"
