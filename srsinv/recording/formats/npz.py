"""NumPy archives: a column an array."""

import io
import math
import zipfile

import numpy as np

from ...files import DataFile
from .._table import MOST_COLUMNS, ColumnTable
from ..reader import Reader

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
_LONGEST_HEADER = 2**16  # bytes; NumPy itself takes 10,000 of them
_LARGEST_DIRECTORY = 4096 * MOST_COLUMNS  # bytes; an entry is its name and some 50 more
_WRITTEN_BY_NUMPY = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class Npz(Reader):
    """NumPy archives."""

    def read(self, file: DataFile) -> ColumnTable:
        """The arrays of an archive. Headers are read first: one can state any size, or objects."""
        table = ColumnTable.of(file)
        file.limit(most_bytes=_LARGEST_DIRECTORY)
        with zipfile.ZipFile(file) as archive:
            table.check_count(len(archive.infolist()))
            for info in archive.infolist():
                _take(table, archive, info)
        return table


def _take(table: ColumnTable, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> None:
    name = info.filename.removesuffix(".npy")
    header = _header(archive, info)
    if header is None:
        table.leave_out(name, "is not a plain array")
        return
    shape, dtype = header

    def read() -> np.ndarray:
        size = math.prod(shape)
        if size < 0 or size * dtype.itemsize > info.file_size:
            raise EOFError("fewer values than the header states")
        with archive.open(info) as member:
            return np.asarray(np.lib.format.read_array(member, allow_pickle=False))

    table.take(name, shape, dtype, read)


def _header(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype] | None:
    """The shape and type that a member states, or None where it is no array of numbers."""
    if info.compress_type not in _WRITTEN_BY_NUMPY:
        return None
    with archive.open(info) as member:
        start = io.BytesIO(member.read(_LONGEST_HEADER))
    try:
        shape, _, dtype = _HEADERS[np.lib.format.read_magic(start)](start)
    except (ValueError, LookupError):
        return None
    return None if dtype.hasobject else (shape, dtype)
