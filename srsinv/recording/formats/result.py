"""What the variables of a run's `result.nc` are metrics of: attributes alone, no array."""

import h5py

from ...files import DataFile
from .._apart import IsolatedReader
from .._table import ColumnTable
from .hdf5 import attribute, members, open_hdf5
from .netcdf import word


class UnitsByPattern(IsolatedReader):
    """netCDF-4 that `srsinv.report` wrote: the units of its metrics, by their patterns."""

    def read_here(self, file: DataFile) -> ColumnTable:
        """No columns; `sidecar` has the attribute `units` of the root's variables by their
        attribute `metric`, of those that have both."""
        table = ColumnTable.of(file)
        with open_hdf5(file) as opened:
            for dataset in members(table, opened, h5py.Dataset).values():
                pattern, unit = (
                    word(attribute(table, dataset, key)) for key in ("metric", "units")
                )
                if isinstance(pattern, str) and isinstance(unit, str):
                    table.sidecar[pattern] = unit
        return table
