"""Files of named columns, one format a file, all as one `ColumnTable`.

Nothing in a file is ever executed: no pickle, no object arrays, no MATLAB objects, no filter that
is loaded. Links to other files are not followed.
"""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import ArrayLike

from srsinv.errors import BadInput, refuse

from ...files import DataFile, quoted
from .._table import ColumnTable
from ..reader import Reader

# The format that the suffix of a file's name, in small letters, stands for: a module here and its
# class. Imported when a file asks for it, as each has a library of its own.
SUFFIXES: Mapping[str, str] = {
    ".csv": "text.Text",
    ".txt": "text.Text",
    ".tsv": "text.Text",
    ".npz": "npz.Npz",
    ".h5": "hdf5.Hdf5",
    ".hdf5": "hdf5.Hdf5",
    ".nc": "netcdf.NetCdf",
    ".mat": "matlab.Matlab",
    ".wav": "wav.Wav",
    ".flac": "flac.Flac",
    ".tdms": "tdms.Tdms",
    ".parquet": "parquet.Parquet",
}
_SUCH_AS = "such as .csv, .npz or .hdf5"


def reader_of(name: str) -> Reader:
    """The format of this name, "module.Class"."""
    module, _, kind = name.partition(".")
    return getattr(importlib.import_module(f".{module}", __name__), kind)()


@dataclass(frozen=True)
class BySuffix(Reader):
    """The package's own formats, chosen by the suffix of the file's name."""

    def check_path(self, path: Path) -> None:
        refuse(
            path.suffix.lower() not in SUFFIXES,
            f"{quoted(path.name)}: a recording cannot be read from suffix {path.suffix!r}: give it "
            f"the suffix of its format ({', '.join(SUFFIXES)}), or name that by reader=...",
        )

    def read(self, file: DataFile) -> Mapping[str, ArrayLike] | ColumnTable:
        name, suffix = quoted(file.path.name), file.path.suffix.lower()
        try:
            return reader_of(SUFFIXES[suffix]).read(file)
        except (BadInput, MemoryError):
            raise
        except UnicodeDecodeError as error:
            raise BadInput(
                f"{name}: the file cannot be read as {suffix}, as it is not UTF-8 text: save it as "
                f"UTF-8, or give it the suffix of its format, {_SUCH_AS}."
            ) from error
        # On damaged bytes a library's parser raises arbitrary exceptions.
        except Exception as error:
            raise BadInput(
                f"{name}: the file cannot be read as {suffix}, being cut short or of another "
                f"format: write it again, or give it the suffix of its format, {_SUCH_AS}."
            ) from error


BY_SUFFIX = BySuffix()
