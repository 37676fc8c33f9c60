"""Reads damaged copies of good files until it is told to stop: run as a process of its own, which a
library that crashes takes down alone.

python -m tests.recording.fuzz FOLDER FIRST_SEED COPIES FORMAT ...
"""

import random
import sys
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording.inspection import inspect
from tests.recording.files import COLUMNS, FORMATS, WITHOUT_TIMES, write

EXTREMES = [b"\x00" * 8, b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"\xff" * 7 + b"\x7f", b"\x80" * 4]


def packed_hdf5(path: Path) -> None:
    """In a group, in chunks, by every filter that is read, with attributes."""
    kinds = ({"compression": "gzip"}, {"compression": "lzf"}, {"shuffle": True}, {})
    with h5py.File(path, "w") as file:
        for (name, values), packing in zip(COLUMNS.items(), kinds, strict=True):
            dataset = file.create_dataset(
                f"scan/{name}", data=values, chunks=(5,), fletcher32=True, **packing
            )
            dataset.attrs["units"] = "s"


def packed_netcdf(path: Path) -> None:
    """With a dimension without an end, scaled integers and a sidecar."""
    time_s, *others = COLUMNS
    table = xr.Dataset(
        {name: (time_s, COLUMNS[name]) for name in others}, {time_s: COLUMNS[time_s]}
    )
    table.attrs["sidecar"] = '{"gain": 2}'
    scaled = {"dtype": "i2", "scale_factor": 1e-9, "_FillValue": np.int16(-1), "zlib": True}
    table.to_netcdf(
        path, engine="h5netcdf", unlimited_dims=[time_s], encoding={"voltage_0_V": scaled}
    )


PACKED = {"packed hdf5": ("p.h5", packed_hdf5), "packed netcdf": ("p.nc", packed_netcdf)}


def damaged(good: bytes, chance: random.Random) -> bytes:
    """A copy with a few bytes flipped, set to extremes, cut off, left out, repeated or moved."""
    data = bytearray(good)
    for _ in range(chance.randint(1, 4)):
        at, other = (chance.randrange(len(data)) for _ in range(2))
        size = chance.choice((1, 4, 8, 64, 512))
        match chance.randrange(6):
            case 0:
                data[at] ^= 1 << chance.randrange(8)
            case 1:
                extreme = chance.choice(EXTREMES)
                data[at : at + len(extreme)] = extreme
            case 2 if chance.random() < 0.2:
                del data[at + 1 :]
            case 3:
                del data[at : at + size]
            case 4:
                data[at:at] = data[other : other + size]
            case _:
                data[at : at + size] = data[other : other + size]
        data = data or bytearray(b"x")
    return bytes(data)


def main(format: str, folder: Path, first: int, copies: int) -> None:
    """Print a line for every copy: format and seed before it is read, then what became of it."""
    if format in PACKED:
        name, make = PACKED[format]
        path = folder / name
        make(path)
    else:
        path = write(format, folder)
    good = path.read_bytes()
    known = {"speed_m_per_s": 0.05} if format in WITHOUT_TIMES else {}
    for seed in range(first, first + copies):
        print(f"{format}:", seed, end=" ", flush=True)
        path.write_bytes(damaged(good, random.Random(seed)))
        for read in (load, inspect):
            try:
                read(path, **known)
                print("read", end=" ")
            except BadInput as refusal:
                print("refused" if str(refusal).isprintable() else "unprintable", end=" ")
        print(flush=True)


if __name__ == "__main__":
    folder, first, copies, *formats = sys.argv[1:]
    assert set(formats) <= set(FORMATS | PACKED)
    for format in formats:
        main(format, Path(folder), int(first), int(copies))
