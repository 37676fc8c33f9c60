"""Small files of every format that `load` reads, from one table of columns."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import scipy.io
import scipy.io.wavfile
import soundfile
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from pyarrow import parquet

N = 12
RATE_HZ = 1000
TIME_S = np.arange(N) / RATE_HZ
SPEED = np.linspace(0.04, 0.06, N)
SIGNAL = np.random.default_rng(7).normal(size=(2, N)) * 1e-6
COLUMNS = {
    "time_s": TIME_S,
    "speed_m_per_s": SPEED,
    "voltage_0_V": SIGNAL[0],
    "voltage_1_V": SIGNAL[1],
}
COUNTS = np.array([[0, 16384, -32768, 32767] * 3, [1, 2, 3, 4] * 3], np.int16)

Columns = Mapping[str, Any]


def columns(**changes: Any) -> dict[str, Any]:
    """The good columns with some replaced, added or, by None, left out."""
    return {name: values for name, values in (COLUMNS | changes).items() if values is not None}


def with_value(name: str, row: int, value: float) -> dict[str, Any]:
    """The good columns with one value replaced."""
    return columns(**{name: np.where(np.arange(N) == row, value, COLUMNS[name])})


def write_csv(path: Path, table: Columns) -> None:
    rows = [list(table), *zip(*(np.asarray(v).tolist() for v in table.values()), strict=True)]
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))


def write_npz(path: Path, table: Columns) -> None:
    with path.open("wb") as file:  # by a handle: numpy adds .npz to a path of another suffix
        np.savez(file, **table)


def write_h5(path: Path, table: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in table.items():
            file[name] = values


def write_nc(path: Path, table: Columns) -> None:
    variables = {}
    for name, values in table.items():
        shape = np.shape(values)
        variables[name] = (tuple(f"n{i}_{size}" for i, size in enumerate(shape)), values)
    xr.Dataset(variables).to_netcdf(path, engine="h5netcdf")


def write_mat(path: Path, table: Columns) -> None:
    with path.open("wb") as file:
        scipy.io.savemat(file, dict(table), oned_as="column")


def write_mat73(path: Path, table: Columns) -> None:
    """As MATLAB does: vectors as (1, n), the class beside them, 512 bytes of its own before."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in table.items():
            values = np.asarray(values)
            file[name] = values[None] if values.ndim == 1 else values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def write_wav(path: Path, table: Columns) -> None:
    values = np.stack([np.asarray(v) for v in table.values()], axis=1)
    scipy.io.wavfile.write(path, RATE_HZ, values)


def write_tdms(path: Path, table: Columns) -> None:
    with TdmsWriter(path) as file:
        file.write_segment([ChannelObject("scan", name, values) for name, values in table.items()])


def write_parquet(path: Path, table: Columns) -> None:
    arrays = {name: pa.array(np.asarray(values)) for name, values in table.items()}
    parquet.write_table(pa.table(arrays), path)


def write_flac(path: Path, table: Columns) -> None:
    values = np.stack([np.asarray(v) for v in table.values()], axis=1)
    soundfile.write(path, values, RATE_HZ, format="FLAC", subtype="PCM_16")


# format: (the file's name, how it is written)
FORMATS: dict[str, tuple[str, Callable[[Path, Columns], None]]] = {
    "csv": ("r.csv", write_csv),
    "npz": ("r.npz", write_npz),
    "hdf5": ("r.h5", write_h5),
    "netcdf": ("r.nc", write_nc),
    "mat": ("r.mat", write_mat),
    "mat73": ("r.mat", write_mat73),
    "wav": ("r.wav", write_wav),
    "flac": ("r.flac", write_flac),
    "tdms": ("r.tdms", write_tdms),
    "parquet": ("r.parquet", write_parquet),
}
WITHOUT_TIMES = ("wav", "flac")  # they hold a rate, and signals alone
WAV_COLUMNS = {"left": COUNTS[0], "right": COUNTS[1]}


def write(format: str, folder: Path, table: Columns | None = None) -> Path:
    """A good file of this format (with `table` in place of the good columns) in `folder`."""
    name, writer = FORMATS[format]
    good = WAV_COLUMNS if format in WITHOUT_TIMES else COLUMNS
    writer(folder / name, good if table is None else table)
    return folder / name
