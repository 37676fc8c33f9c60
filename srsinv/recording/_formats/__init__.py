"""Files of named columns, one format a file, all as one `Table`.

Nothing in a file is ever executed: no pickle, no object arrays, no MATLAB objects, no filter that
is loaded. Links to other files are not followed.
"""

import warnings
from collections.abc import Callable
from pathlib import Path

from srsinv.errors import BadInput, refuse

from .._apart import read_apart
from .._guard import DataFile, open_file, quoted
from .._table import ColumnTable
from .hdf5 import read_hdf5
from .matlab import read_matlab
from .netcdf import read_netcdf
from .npz import read_npz
from .tdms import read_tdms
from .text import read_text
from .wav import read_wav

READERS: dict[str, Callable[[DataFile], ColumnTable]] = {
    ".csv": read_text,
    ".txt": read_text,
    ".tsv": read_text,
    ".npz": read_npz,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".nc": read_netcdf,
    ".mat": read_matlab,
    ".wav": read_wav,
    ".tdms": read_tdms,
}
# HDF5, whose library a damaged file can crash or put in an endless loop.
_APART = (".h5", ".hdf5", ".nc", ".mat")


def read_table(path: Path, key: str = "recording.path") -> ColumnTable:
    """The table in `path`, by its suffix; `key` is what names the path in the configuration.

    Raises `BadInput` for a file that cannot be one, and `MemoryError` as Python does.
    """
    name, suffix = quoted(path.name), path.suffix.lower()
    refuse(
        suffix not in READERS,
        f"{name}: a recording cannot be read from suffix {path.suffix!r}: use one of "
        f"{', '.join(READERS)}.",
    )
    with open_file(path, key=key) as file:
        table = _parsed(file, name, suffix)
    refuse(
        not table.columns and not table.unusable,
        f"{name}: there is no column in the file: write it again, a column for each quantity.",
    )
    return table


def _parsed(file: DataFile, name: str, suffix: str) -> ColumnTable:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read_apart(file, READERS) if suffix in _APART else READERS[suffix](file)
    except (BadInput, MemoryError):
        raise
    # On damaged bytes a library's parser raises arbitrary exceptions.
    except Exception as error:
        raise BadInput(
            f"{name}: the file cannot be read as {suffix}, being cut short or of another "
            "format: write it again, or give it the suffix of what it holds "
            f"({', '.join(READERS)})."
        ) from error
