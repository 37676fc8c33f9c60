"""Parquet: a column a column, read by pyarrow. Needs the extra `parquet`."""

from typing import Any

import numpy as np

from ...files import DataFile
from .._apart import IsolatedReader
from .._stated import is_stated_word, is_word
from .._table import ColumnTable
from ..reader import missing_package

_TYPE = 40  # characters shown of a column's type


class Parquet(IsolatedReader):
    """Parquet; needs the extra `parquet`. An empty cell is missing (NaN); dates, such as the index
    of a pandas table, are seconds since the first."""

    def read_here(self, file: DataFile) -> ColumnTable:
        """The columns, each checked against the limits before it is read; nested ones are none.

        Raises `BadInput` where the package that reads them is not installed.
        """
        table = ColumnTable.of(file)
        try:
            import pyarrow as pa
            from pyarrow import parquet
        except ImportError as error:
            raise missing_package(table.name, "parquet") from error
        pa.set_cpu_count(1)
        source = parquet.ParquetFile(file)
        schema, rows = source.schema_arrow, source.metadata.num_rows
        table.check_count(len(schema))
        whole = _attributes(schema)
        table.scalars.update({k: v for k, v in whole.items() if is_stated_word(k, False)})
        for index, field in enumerate(schema):
            is_number = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
            is_time = pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type)

            def read(index: int = index, is_time: bool = is_time) -> np.ndarray:
                column = source.read(columns=[schema.names[index]], use_threads=False).column(0)
                if is_time:
                    return _seconds(column.to_numpy())
                return np.asarray(column.cast("float64", safe=False).to_numpy(), float)

            if is_number or is_time:
                table.take(field.name, (rows,), np.dtype(float), read, _attributes(field))
                if is_time and field.name in table.columns:
                    table.stamps.append(field.name)
            else:
                table.leave_out(field.name, f"holds values of type {str(field.type)[:_TYPE]}")
        return table


def _attributes(holder: Any) -> dict[str, Any]:
    """What the metadata of a column, or of all, state, as text."""
    pairs = (holder.metadata or {}).items()
    text = {k.decode("utf-8", "replace"): v.decode("utf-8", "replace") for k, v in pairs}
    return {key: value for key, value in text.items() if is_word(key)}


def _seconds(moments: np.ndarray) -> np.ndarray:
    """Dates or durations (row,) as seconds since the first, NaT as NaN."""
    present = moments[~np.isnat(moments)]
    since = moments - (present[0] if present.size else moments[:1])
    return since / np.timedelta64(1, "s")
