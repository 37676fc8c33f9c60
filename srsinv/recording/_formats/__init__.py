"""Files of named columns, one format a file, all as one `Table`.

Nothing in a file is ever executed: no pickle, no object arrays, no MATLAB objects. What lies in
another file is not followed.
"""

import difflib
import warnings
from collections.abc import Callable
from pathlib import Path

from srsinv.errors import BadInput, refuse

from .._table import Table
from .hdf5 import read_hdf5
from .matlab import read_matlab
from .netcdf import read_netcdf
from .npz import read_npz
from .tdms import read_tdms
from .text import read_text
from .wav import read_wav

READERS: dict[str, Callable[[Path], Table]] = {
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


def read_table(path: Path) -> Table:
    """The table in `path`, by its suffix. Raises `BadInput` for a file that cannot be one."""
    suffix = path.suffix.lower()
    refuse(
        suffix not in READERS,
        f"{path.name}: a recording cannot be read from suffix {path.suffix!r}: use one of "
        f"{', '.join(READERS)}.",
    )
    _check_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = READERS[suffix](path)
    except BadInput:
        raise
    except PermissionError as error:
        raise BadInput(f"{path}: the file may not be read: change its permissions.") from error
    except MemoryError as error:
        raise BadInput(
            f"{path.name}: the file asks for more memory than there is: write it again, or in "
            "shorter parts."
        ) from error
    # On damaged bytes a library's parser raises whatever it stumbles over.
    except Exception as error:
        raise BadInput(
            f"{path.name}: the file cannot be read as {suffix}, being cut short or of another "
            "format: write it again, or give it the suffix of what it holds "
            f"({', '.join(READERS)})."
        ) from error
    refuse(
        not table.columns and not table.unusable,
        f"{path.name}: there is no column in the file: write it again, a column for each quantity.",
    )
    return table


def _check_file(path: Path) -> None:
    if not path.is_file():
        there = [p.name for p in path.parent.glob("*.*") if p.is_file()]
        there = [name for name in there if Path(name).suffix.lower() in READERS]
        near = difflib.get_close_matches(path.name, there, n=1)
        hint = f"did you mean {near[0]}?" if near else "check recording.path=..."
        raise BadInput(f"{path}: there is no such file: {hint}")
    refuse(path.stat().st_size == 0, f"{path.name}: the file is empty: record or copy it again.")
