"""netCDF-4: a column a variable of the root, packed values unpacked.

Read as HDF5, so that nothing is built or followed beside the columns; xarray's own conventions
unpack the values.
"""

import h5py
import numpy as np
import xarray as xr
from xarray.conventions import decode_cf_variable

from ...errors import echo, is_number
from ...files import DataFile
from .._apart import IsolatedReader
from .._sidecar import parse
from .._table import ColumnTable
from .hdf5 import (
    attribute,
    attributes,
    check_chunks,
    leave_links_out,
    members,
    open_hdf5,
    state_scalars,
    why_no_column,
)

_PACKING = ("_FillValue", "missing_value", "scale_factor", "add_offset", "_Unsigned", "dtype")
# How the format marks a dimension that is no variable, and a variable named as another's dimension.
_ONLY_A_DIMENSION = b"This is a netCDF dimension but not a netCDF variable"
_NOT_THE_DIMENSION = "_nc4_non_coord_"


class NetCdf(IsolatedReader):
    """netCDF-4."""

    def read_here(self, file: DataFile) -> ColumnTable:
        """The variables of the root with their `units`, and the sidecar in attribute `sidecar`."""
        table = ColumnTable.of(file)
        with open_hdf5(file) as opened:
            leave_links_out(table, opened)
            for name, dataset in members(table, opened, h5py.Dataset).items():
                mark = attribute(table, dataset, "NAME")
                if not (isinstance(mark, bytes) and mark.startswith(_ONLY_A_DIMENSION)):
                    _take(table, name.replace(_NOT_THE_DIMENSION, ""), dataset)
            state_scalars(table, opened)
            sidecar = word(attribute(table, opened, "sidecar"))
            if sidecar is not None:
                table.sidecar.update(
                    parse(f"{table.name}, attribute sidecar", str(sidecar), "JSON")
                )
        return table


def _take(table: ColumnTable, name: str, dataset: h5py.Dataset) -> None:
    if reason := why_no_column(dataset):
        table.leave_out(name, reason, word(attribute(table, dataset, "units")))
        return
    # The format's own words of packing are applied below.
    facts = {k: v for k, v in attributes(table, dataset).items() if k not in _PACKING}
    if len(dataset.shape or ()) != 1 or dataset.dtype.kind not in "iuf":
        table.take(name, dataset.shape or (), dataset.dtype, lambda: np.zeros(0), facts)
        return
    packing = {key: word(attribute(table, dataset, key)) for key in _PACKING}
    packing = {key: value for key, value in packing.items() if value is not None}
    for key in ("scale_factor", "add_offset"):
        value = packing.get(key, 1)
        if not is_number(value) or (key == "scale_factor" and value == 0):
            value = value.item() if isinstance(value, np.generic) else value
            table.leave_out(name, f"is packed with {key} {echo(value)}")
            return

    def unpacked(values: np.ndarray) -> xr.Variable:
        variable = xr.Variable(("sample",), values, packing)
        # Where units say "seconds", xarray would turn the numbers into dates or durations.
        return decode_cf_variable(name, variable, decode_times=False, decode_timedelta=False)

    def read() -> np.ndarray:
        check_chunks(table, name, dataset)
        return unpacked(dataset[...]).to_numpy()

    dtype = np.dtype(unpacked(np.zeros(0, dataset.dtype)).dtype)
    table.take(name, dataset.shape, dtype, read, facts)


def word(value: object) -> object:
    """An attribute as netCDF means it: text as such, and one number not as an array of one."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.flat[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
