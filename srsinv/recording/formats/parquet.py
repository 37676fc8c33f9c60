"""Parquet: a column a column, read by pyarrow. Needs the extra `parquet`."""

import numpy as np

from srsinv.errors import BadInput

from ...files import DataFile
from .._apart import IsolatedReader
from .._table import ColumnTable

_TYPE = 40  # characters shown of a column's type


class Parquet(IsolatedReader):
    """Parquet; needs the extra `parquet`. An empty cell is missing (NaN)."""

    def read_here(self, file: DataFile) -> ColumnTable:
        """The columns, each checked against the limits before it is read; nested ones are none.

        Raises `BadInput` where the package that reads them is not installed.
        """
        table = ColumnTable.of(file)
        try:
            import pyarrow as pa
            from pyarrow import parquet
        except ImportError as error:
            raise BadInput(
                f"{table.name}: reading .parquet takes a package that is not installed: add it by "
                "pip install srsinv[parquet], or save the recording in another format."
            ) from error
        pa.set_cpu_count(1)
        source = parquet.ParquetFile(file)
        schema, rows = source.schema_arrow, source.metadata.num_rows
        table.check_count(len(schema))
        for index, field in enumerate(schema):
            is_number = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)

            def read(index: int = index) -> np.ndarray:
                column = source.read(columns=[schema.names[index]], use_threads=False).column(0)
                return np.asarray(column.cast("float64", safe=False).to_numpy(), float)

            if is_number:
                table.take(field.name, (rows,), np.dtype(float), read)
            else:
                table.leave_out(field.name, f"holds values of type {str(field.type)[:_TYPE]}")
        return table
