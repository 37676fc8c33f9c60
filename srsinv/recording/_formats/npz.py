"""NumPy archives: a column an array."""

import zipfile
from pathlib import Path

import numpy as np

from .._table import Table

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_npz(path: Path) -> Table:
    """The arrays of an archive. Headers are read first: one can state any size, or objects."""
    table = Table(path.name)
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            _take(table, archive, info)
    return table


def _take(table: Table, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> None:
    name = info.filename.removesuffix(".npy")
    try:
        with archive.open(info) as member:
            shape, _, dtype = _HEADERS[np.lib.format.read_magic(member)](member)
    except (ValueError, LookupError):
        table.unusable[name] = "is not a plain array"
        return
    if dtype.hasobject:
        table.unusable[name] = "is not a plain array"
        return

    def read() -> np.ndarray:
        if shape[0] * dtype.itemsize > info.file_size:
            raise EOFError("fewer values than the header states")
        with archive.open(info) as member:
            return np.asarray(np.lib.format.read_array(member, allow_pickle=False))

    table.take(name, shape, dtype, read)
