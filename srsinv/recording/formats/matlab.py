"""MATLAB: a column a row or column vector of numbers, in version 5 or 7.3 (which is HDF5)."""

import math
import re
import warnings
from io import BytesIO
from typing import Any

import h5py
import numpy as np
from scipy.io.matlab import MatlabOpaque, loadmat, varmats_from_mat, whosmat
from scipy.sparse import issparse

from srsinv.errors import echo

from ...files import DataFile, quoted
from .._apart import IsolatedReader
from .._table import ColumnTable
from .hdf5 import attribute, leave_links_out, members, open_hdf5, take, vector

_NUMERIC = {"double", "single"} | {f"{sign}int{8 << i}" for sign in ("", "u") for i in range(4)}
# Of the arrays of a dtype's kind that scipy makes of a struct's fields.
_CLASSES = {"O": "cell", "U": "char", "V": "struct or object", "b": "logical"}
_HDF5 = b"\x89HDF\r\n\x1a\n"
_FIRST_BLOCK = 512  # bytes; HDF5 begins at 0, at this or at a double of it


class Matlab(IsolatedReader):
    """MATLAB 5 and 7.3."""

    def read_here(self, file: DataFile) -> ColumnTable:
        """The vectors of a file, and those of its structs; all else (cells, objects, matrices) is
        no column."""
        table = _read_7_3(file) if _is_hdf5(file) else _read_5(file)
        _name_fields(table)
        # PicoScope's files have a channel's letter for its name.
        if "Tinterval" in table.scalars:
            table.signals.extend(name for name in table.columns if re.fullmatch("[A-H]", name))
        return table


def _name_fields(table: ColumnTable) -> None:
    """Call the fields of a struct by their own names, where one struct alone has columns."""
    structs = {name.partition(".")[0] for name in table.columns if "." in name}
    if len(structs) != 1 or any("." not in name for name in table.columns):
        return
    for part in (table.columns, table.unusable, table.units, table.scalars, table.gains):
        held: dict[str, Any] = part  # pyright: ignore[reportAssignmentType]
        own = {name.partition(".")[2] or name: value for name, value in held.items()}
        held.clear()
        held.update(own)


def _is_hdf5(file: DataFile) -> bool:
    at, has_signature = 0, False
    while at < file.size and not has_signature:
        file.seek(at)
        has_signature = file.read(len(_HDF5)) == _HDF5
        at = max(_FIRST_BLOCK, 2 * at)
    file.seek(0)
    return has_signature


def _read_5(file: DataFile) -> ColumnTable:
    table = ColumnTable.of(file)
    with warnings.catch_warnings(action="ignore"):
        for name, variable in varmats_from_mat(file):
            if name:  # without one it belongs to functions and objects
                _take_variable(table, name, variable)
    return table


def _take_variable(table: ColumnTable, name: str, variable: BytesIO) -> None:
    """Take in the one variable of a file of its own; what is no column is not loaded."""
    if name == "None":  # scipy's name for an object such as a datetime, which has no shape
        value = loadmat(variable)[name]
        if isinstance(value, MatlabOpaque):
            table.leave_out(value["s0"].item().decode("ascii"), "is a MATLAB opaque object")
            return
    ((_, shape, kind),) = whosmat(variable)
    if kind == "struct" and math.prod(shape) == 1:
        for field, value in _fields(table, name, variable).items():
            _take_value(table, f"{name}.{field}", value)
    elif kind not in _NUMERIC:
        table.leave_out(name, f"is a MATLAB {kind}")
    elif len(vector(shape)) != 1:
        table.leave_out(name, f"has shape {echo(shape)}")
    else:
        table.check_size(name, math.prod(shape))
        _take_value(table, name, loadmat(variable)[name])


def _fields(table: ColumnTable, name: str, variable: BytesIO) -> dict[str, Any]:
    """The fields of a struct."""
    struct = loadmat(variable)[name]
    table.check_count(len(struct.dtype))
    fields = {field: struct[field].item() for field in struct.dtype.names or ()}
    # Only by `mat_dtype` are logical values no integers; complex ones lose a part by it.
    small = [field for field, value in fields.items() if value.dtype == np.uint8]
    if small:
        typed = loadmat(variable, mat_dtype=True)[name]
        fields |= {field: typed[field].item() for field in small}
    return fields


def _take_value(table: ColumnTable, name: str, value: Any) -> None:
    kind = "sparse" if issparse(value) else _CLASSES.get(value.dtype.kind)
    if kind:
        table.leave_out(name, f"is a MATLAB {kind}")
    else:
        table.take(name, vector(value.shape), value.dtype, value.ravel)


def _read_7_3(file: DataFile) -> ColumnTable:
    table = ColumnTable.of(file)
    with open_hdf5(file) as opened:
        leave_links_out(table, opened)
        for name, dataset in members(table, opened, h5py.Dataset).items():
            _take(table, name, dataset)
        for name, group in members(table, opened, h5py.Group).items():
            if name in ("#refs#", "#subsystem#"):
                continue
            leave_links_out(table, group)
            for field, dataset in members(table, group, h5py.Dataset).items():
                _take(table, f"{name}.{field}", dataset)
    return table


def _take(table: ColumnTable, name: str, dataset: h5py.Dataset) -> None:
    kind = attribute(table, dataset, "MATLAB_class")
    if isinstance(kind, bytes):
        kind = kind.decode("ascii", "replace")
    kind = "double" if kind is None else str(kind)
    if kind not in _NUMERIC or "MATLAB_object_decode" in dataset.attrs:
        table.leave_out(name, f"is a MATLAB {quoted(kind)}")
    elif attribute(table, dataset, "MATLAB_empty"):
        table.leave_out(name, "is empty")
    else:
        take(table, name, dataset, vector(dataset.shape or ()))
