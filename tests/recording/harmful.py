"""How files are made that ask for more than they hold."""

import os
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
from nptdms import ChannelObject, RootObject, TdmsWriter

from tests.recording.files import COLUMNS, N, columns, write_h5, write_nc

MB = 2**20
HEADER = "time_s,speed_m_per_s,voltage_0_V\n"
GOOD = HEADER + "0,1,1\n1,1,1\n2,1,1\n"


def text(*parts: str) -> Callable[[Path], None]:
    return lambda path: path.write_text("".join(parts), encoding="utf-8") and None


def binary(data: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(data) and None


def sparse(size: int, start: bytes = b"") -> Callable[[Path], None]:
    """A file of zeros that takes no room, but for its start."""

    def make(path: Path) -> None:
        path.write_bytes(start)
        os.truncate(path, size)

    return make


def link_to(target: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(target)


def listening(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # the path of a socket is a short one
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path.name)
    os.chdir(here)


def later(maker: Callable[[], Callable[[Path], None]]) -> Callable[[Path], None]:
    """What `maker` makes, large as it is, once it is asked for."""
    return lambda path: maker()(path)


def npz(members: dict[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        with zipfile.ZipFile(path, "w", kind) as archive:
            for name, content in members.items():
                archive.writestr(name, content)

    return make


def npy(header: str, values: bytes = b"", version: int = 1) -> bytes:
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    return b"\x93NUMPY" + bytes([version, 0]) + length + header.encode() + values


def npy_of(samples: int, values: bytes = b"") -> bytes:
    return npy(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({samples},), }}\n", values)


def h5(change: Callable[[h5py.File], object], **changes: object) -> Callable[[Path], None]:
    """The good columns, some left out, and what `change` makes of the file."""

    def make(path: Path) -> None:
        write_h5(path, columns(**changes))
        with h5py.File(path, "a") as file:
            change(file)

    return make


def without_time(change: Callable[[h5py.File], object]) -> Callable[[Path], None]:
    return h5(change, time_s=None)


def dataset(**of: object) -> Callable[[Path], None]:
    return without_time(lambda file: file.create_dataset("time_s", **of))


def bomb(file: h5py.File) -> None:
    """A chunk of 96 bytes that unpacks to 400 MB."""
    values = file.create_dataset("time_s", (N,), "f8", chunks=(N,), compression="gzip")
    packer = zlib.compressobj()
    packed = b"".join([packer.compress(bytes(MB)) for _ in range(400)] + [packer.flush()])
    values.id.write_direct_chunk((0,), packed)


def foreign_filter(file: h5py.File) -> None:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((N,))
    plist.set_filter(307, h5py.h5z.FLAG_OPTIONAL, ())
    space = h5py.h5s.create_simple((N,))
    h5py.h5d.create(file.id, b"time_s", h5py.h5t.IEEE_F64LE, space, plist)


def nc_index(path: Path) -> None:
    """An index of 4e8 values, none of them written."""
    write_nc(path, columns(time_s=None))
    with h5py.File(path, "a") as file:
        index = file.create_dataset("n0", (400_000_000,), "f8", chunks=(MB,), compression="gzip")
        index.make_scale("n0")


def unit_of(unit: str) -> Callable[[Path], None]:
    return h5(lambda file: file["voltage_0_V"].attrs.__setitem__("units", unit))


def deep(file: h5py.File) -> None:
    group = file.create_group("a")
    for _ in range(500):
        group = group.create_group("a")
    group["time_s"] = COLUMNS["time_s"]


def matlab(*parts: bytes) -> Callable[[Path], None]:
    return binary(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(parts))


def matlab_vector(rows: int, values: bytes, name: str = "time_s") -> bytes:
    body = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, rows, 1)
    body += (
        struct.pack("<II8s", 1, 6, name.encode()) + struct.pack("<II", 9, 8 * rows % 2**32) + values
    )
    return struct.pack("<II", 14, len(body)) + body


def matlab_object(name: str) -> bytes:
    """A datetime without its contents, which stand elsewhere in a file."""

    def part(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data.ljust(-(-len(data) // 8) * 8, b"\0")

    names = b"".join(part(1, each) for each in (name.encode(), b"MCOS", b"datetime"))
    body = part(6, struct.pack("<II", 17, 0)) + names + matlab_vector(1, bytes(8))
    return struct.pack("<II", 14, len(body)) + body


def packed(part: bytes) -> bytes:
    data = zlib.compress(part)
    return struct.pack("<II", 15, len(data)) + data


def wav(channels=1, rate=1000, block=2, bits=16, size=2 * N, data=bytes(2 * N), kind=1) -> bytes:
    form = struct.pack("<HHIIHH", kind, channels, rate, 2000, block, bits)
    parts = b"WAVEfmt " + struct.pack("<I", 16) + form + b"data" + struct.pack("<I", size) + data
    return b"RIFF" + struct.pack("<I", len(parts)) + parts


def tdms(old: bytes = b"", new: bytes = b"", **properties: object) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        channels = [ChannelObject("a", name, values) for name, values in COLUMNS.items()]
        with TdmsWriter(path) as file:
            file.write_segment([RootObject(properties), *channels])
        content = path.read_bytes()
        assert old in content
        path.write_bytes(content.replace(old, new, 1) if old else content)

    return make


def tdms_start(objects: int, after: bytes = b"") -> bytes:
    lead = b"TDSm" + struct.pack("<lLQQ", 6, 4713, 2**29, 2**28)
    return lead + struct.pack("<L", objects) + after
