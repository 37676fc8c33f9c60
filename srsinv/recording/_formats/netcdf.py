"""netCDF-4: a column a variable of the root, packed values unpacked."""

from pathlib import Path

import h5py
import numpy as np
import xarray as xr

from .._sidecar import parse
from .._table import Table
from .hdf5 import members


def read_netcdf(path: Path) -> Table:
    """The variables of the root with their `units`, and the sidecar in attribute `sidecar`."""
    table = Table(path.name)
    inside = _in_the_file(path)
    # Where units say "seconds", xarray would turn the numbers into dates or durations.
    with xr.open_dataset(
        path, engine="h5netcdf", decode_times=False, decode_timedelta=False
    ) as dataset:
        for name, variable in dataset.variables.items():
            if str(name) in inside:
                read, unit = variable.to_numpy, variable.attrs.get("units")
                table.take(str(name), variable.shape, np.dtype(variable.dtype), read, unit)
            else:
                table.unusable[str(name)] = "lies in another file"
        sidecar = dataset.attrs.get("sidecar", "{}")
        table.sidecar.update(parse(f"{path.name}, attribute sidecar", str(sidecar), "JSON"))
    return table


def _in_the_file(path: Path) -> set[str]:
    with h5py.File(path, "r") as file:
        own = members(file, h5py.Dataset)
        return {name for name, each in own.items() if not (each.is_virtual or each.external)}
