"""Files of named columns: CSV, NPZ, HDF5 and netCDF, all as one `Table`.

Nothing in a file is ever executed: no pickle, no object arrays.
"""

import csv
import difflib
import io
import math
import zipfile
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
import xarray as xr

from srsinv.errors import BadInput, refuse

from ._sidecar import parse

_LISTED = 20
_DELIMITERS = ",;\t"
_Member = TypeVar("_Member")


def listing(names: Iterable[str]) -> str:
    """The first names, and how many more there are."""
    names = list(names)
    more = len(names) - _LISTED
    shown = ", ".join(repr(name) if name != name.strip() else name for name in names[:_LISTED])
    return (shown or "none") + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class Table:
    """The columns of one file, by name: text cells or 1-D arrays of real numbers.

    `unusable` says of every other array why it is no column; `units` holds the file's own words;
    `sidecar` what the file itself carries of one.
    """

    name: str
    columns: dict[str, list[str] | np.ndarray]
    unusable: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    sidecar: dict[str, Any] = field(default_factory=dict)

    def __contains__(self, column: str) -> bool:
        return column in self.columns or column in self.unusable

    def numbers(self, column: str, *, allow_missing: bool = False) -> np.ndarray:
        """Column `column` as float64 (row,); NaN where its cell is empty, if that is allowed.

        An array has no other way to leave a cell empty than NaN. Raises `BadInput` for a column
        that is absent or unusable, and for a cell that is not a finite number.
        """
        refuse(
            column in self.unusable,
            f"{self.name}: column {column} {self.unusable.get(column)}: store it as a 1-D array of "
            "real numbers.",
        )
        if column not in self.columns:
            raise BadInput(self._no_column(column))
        raw = self.columns[column]
        values = np.array([_number(cell) for cell in raw]) if isinstance(raw, list) else raw
        values = values.astype(np.float64)
        bad = ~np.isfinite(values) if not allow_missing else np.isinf(values)
        if bad.any():
            self._refuse_cell(column, raw, int(bad.argmax()))
        return values

    def _no_column(self, column: str) -> str:
        near = difflib.get_close_matches(column, self.columns, n=1, cutoff=0.0)
        nearest = f"the nearest is {near[0]}, and " if near else ""
        return (
            f"{self.name}: there is no column {column!r}: {nearest}the columns are "
            f"{listing(self.columns)}: name one of them."
        )

    def _refuse_cell(self, column: str, raw: list[str] | np.ndarray, row: int) -> None:
        cell = str(raw[row]).strip()
        found = f"holds {cell[:40]!r}, not a finite number" if cell else "is empty"
        raise BadInput(
            f"{self.name}: column {column}, data row {row + 1} {found}: correct it or leave the "
            "row out, or, if this is a missing sample of a signal, leave the cell empty (NaN in an "
            "array) and set recording.missing=allow."
        )


def _number(cell: str) -> float:
    """The number in a cell: NaN only if the cell is empty, infinite if it holds no finite one."""
    if not cell or cell.isspace():
        return math.nan
    try:
        number = float(cell)
    except ValueError:
        return math.inf
    return number if math.isfinite(number) else math.inf


def read_table(path: Path) -> Table:
    """The table in `path`, by its suffix. Raises `BadInput` for a file that cannot be one."""
    suffix = path.suffix.lower()
    refuse(
        suffix not in _READERS,
        f"{path.name}: a recording cannot be read from suffix {path.suffix!r}: use one of "
        f"{', '.join(_READERS)}.",
    )
    _check_file(path)
    try:
        return _READERS[suffix](path)
    except BadInput:
        raise
    except PermissionError as error:
        raise BadInput(f"{path}: the file may not be read: change its permissions.") from error
    except _BROKEN as error:
        raise BadInput(
            f"{path.name}: the file cannot be read as {suffix}, being cut short or of another "
            "format: write it again, or give it the suffix of what it holds "
            f"({', '.join(_READERS)})."
        ) from error


def _check_file(path: Path) -> None:
    if not path.is_file():
        there = [p.name for p in path.parent.glob("*.*") if p.is_file()]
        there = [name for name in there if Path(name).suffix.lower() in _READERS]
        near = difflib.get_close_matches(path.name, there, n=1)
        hint = f"did you mean {near[0]}?" if near else "check recording.path=..."
        raise BadInput(f"{path}: there is no such file: {hint}")
    refuse(path.stat().st_size == 0, f"{path.name}: the file is empty: record or copy it again.")


def _read_csv(path: Path) -> Table:
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
    cells = [[row[index] for row in rows] for index in range(len(names))]
    columns: dict[str, list[str] | np.ndarray] = dict(zip(names, cells, strict=True))
    columns.pop("", None)
    return Table(path.name, columns)


def _check_names(name: str, names: list[str]) -> None:
    named = [column for column in names if column]
    refuse(
        all(math.isfinite(_number(column)) for column in named),
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


def _read_npz(path: Path) -> Table:
    table = Table(path.name, {})
    # By a handle: numpy leaves a file that it opened itself open when the archive is broken.
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        for name in arrays.files:
            try:
                array = np.asarray(arrays[name])
            except ValueError:
                table.unusable[name] = "is not a plain array"
            else:
                _add(table, name, array)
    return table


def _read_hdf5(path: Path) -> Table:
    table = Table(path.name, {})
    with h5py.File(path, "r") as file:
        columns = _members(_group_of_columns(path.name, file), h5py.Dataset)
        for name, dataset in columns.items():
            _add(table, name, dataset, dataset.attrs.get("units"))
    return table


def _group_of_columns(name: str, file: h5py.File) -> h5py.Group:
    """The root if it has columns, else the one group that has."""
    if _members(file, h5py.Dataset):
        return file
    groups = _members(file, h5py.Group)
    filled = [group for group in groups if _members(groups[group], h5py.Dataset)]
    refuse(
        len(filled) != 1,
        f"{name}: columns are looked for at the root or in one group, but the groups that hold any "
        f"are {listing(filled)}: keep one recording in one file.",
    )
    return groups[filled[0]]


def _members(group: h5py.Group, kind: type[_Member]) -> dict[str, _Member]:
    """The members of `kind` in the file itself: a link may lead to another file, or nowhere."""
    links = {str(name): group.get(name, getlink=True) for name in group}
    own = {name: group[name] for name, link in links.items() if isinstance(link, h5py.HardLink)}
    return {name: member for name, member in own.items() if isinstance(member, kind)}


def _read_netcdf(path: Path) -> Table:
    table = Table(path.name, {})
    # Where units say "seconds", xarray would turn the numbers into dates or durations.
    with xr.open_dataset(
        path, engine="h5netcdf", decode_times=False, decode_timedelta=False
    ) as dataset:
        for name, variable in dataset.variables.items():
            _add(table, str(name), variable, variable.attrs.get("units"))
        sidecar = dataset.attrs.get("sidecar", "{}")
        table.sidecar.update(parse(f"{path.name}, attribute sidecar", sidecar, "JSON"))
    return table


def _add(table: Table, name: str, array: Any, units: Any = None) -> None:
    """Take `array` into the table; its values are read only if it is a column."""
    if array.ndim != 1:
        table.unusable[name] = f"has shape {array.shape}"
    elif array.dtype.kind not in "iuf":
        table.unusable[name] = f"holds values of type {array.dtype}"
    else:
        table.columns[name] = np.asarray(array[...])
        if isinstance(units, str):
            table.units[name] = units


# What the libraries raise on a file that is cut short, corrupt or of another format.
_BROKEN = (
    OSError,
    ValueError,
    TypeError,
    KeyError,
    RuntimeError,
    EOFError,
    csv.Error,
    zipfile.BadZipFile,
    zlib.error,
)
_READERS: dict[str, Callable[[Path], Table]] = {
    ".csv": _read_csv,
    ".txt": _read_csv,
    ".tsv": _read_csv,
    ".npz": _read_npz,
    ".h5": _read_hdf5,
    ".hdf5": _read_hdf5,
    ".nc": _read_netcdf,
}
