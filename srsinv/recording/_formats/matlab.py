"""MATLAB: a column a row or column vector of numbers, in version 5 or 7.3 (which is HDF5)."""

from pathlib import Path

import h5py

from .._table import Table, quoted
from .hdf5 import members, take
from .matlab5 import NUMERIC, read_matlab5, vector


def read_matlab(path: Path) -> Table:
    """The vectors of a file; all else (structs, cells, objects, matrices) is no column."""
    return _read_7_3(path) if h5py.is_hdf5(path) else read_matlab5(path)


def _read_7_3(path: Path) -> Table:
    table = Table(path.name)
    with h5py.File(path, "r") as file:
        for name in members(file, h5py.Group).keys() - {"#refs#", "#subsystem#"}:
            table.unusable[name] = "is a MATLAB struct"
        for name, dataset in members(file, h5py.Dataset).items():
            kind = _text(dataset.attrs.get("MATLAB_class", "double"))
            if kind not in NUMERIC or "MATLAB_object_decode" in dataset.attrs:
                table.unusable[name] = f"is a MATLAB {quoted(kind)}"
            elif dataset.attrs.get("MATLAB_empty", 0):
                table.unusable[name] = "is empty"
            else:
                take(table, name, dataset, vector(dataset.shape or ()))
    return table


def _text(value: object) -> str:
    return value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
