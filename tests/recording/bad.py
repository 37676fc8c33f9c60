"""Bad recordings as data: how each file is made, and what the sentence that refuses it names.

`BAD` are mistakes of people and programs; `HARMFUL` ask a reader for more than they hold, for
another file, or for something to be run, and are read in a process of their own (`reading`).
"""

import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import scipy.sparse
from nptdms import ChannelObject, RootObject, TdmsWriter

from tests.recording.files import (
    COLUMNS,
    FORMATS,
    SIGNAL,
    TIME_S,
    N,
    columns,
    with_value,
    write_csv,
    write_h5,
    write_mat,
    write_nc,
)

MB = 2**20
HEADER = "time_s,speed_m_per_s,voltage_0_V\n"
GOOD = HEADER + "0,1,1\n1,1,1\n2,1,1\n"
ROWS = HEADER + "0,1,1\n1,1,{}\n2,1,1\n3,1,1\n"
Make = Callable[[Path], object]


class Bad(NamedTuple):
    """A file's name, how it is made, words of the sentence that refuses it, and what is stated
    beside it when it is read."""

    file: str
    make: Make
    words: Sequence[str]
    known: Mapping[str, Any] = {}


# How files are made


def text(*parts: str) -> Make:
    return lambda path: path.write_text("".join(parts), encoding="utf-8")


def raw(data: bytes) -> Make:
    return lambda path: path.write_bytes(data)


def table(**changes: Any) -> Make:
    """The good columns with some changed, in the format of the file's suffix."""
    writers = {name.rpartition(".")[2]: writer for name, writer in FORMATS.values()}
    writers["mat"] = write_mat
    return lambda path: writers[path.suffix[1:]](path, columns(**changes))


def other(format: str) -> Make:
    """A good file of another format under this name."""
    return lambda path: FORMATS[format][1](path, COLUMNS)


def beside(name: str, content: str) -> Make:
    """A good recording beside a file of this text."""

    def make(path: Path) -> None:
        write_csv(path, COLUMNS)
        (path.parent / name).write_text(content)

    return make


def latin_sidecar(path: Path) -> None:
    write_csv(path, COLUMNS)
    path.with_suffix(".yaml").write_bytes("description: µ".encode("latin-1"))


def two_sidecars(path: Path) -> None:
    beside("r.json", "{}")(path)
    (path.parent / "r.yaml").write_text("{}")


def sparse(size: int, start: bytes = b"") -> Make:
    """A file of zeros that takes no room, but for its start."""

    def make(path: Path) -> None:
        path.write_bytes(start)
        os.truncate(path, size)

    return make


def link_to(target: str) -> Make:
    return lambda path: path.symlink_to(target)


def later(maker: Callable[[], Make]) -> Make:
    """What `maker` makes, large as it is, once it is asked for."""
    return lambda path: maker()(path)


def npz(members: dict[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> Make:
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


RUNNING = "{'descr': __import__('os').getcwd(), 'fortran_order': False, 'shape': (1,), }\n"


def h5(change: Callable[[h5py.File], object], **changes: object) -> Make:
    """The good columns, some left out, and what `change` makes of the file."""

    def make(path: Path) -> None:
        write_h5(path, columns(**changes))
        with h5py.File(path, "a") as file:
            change(file)

    return make


def without_time(change: Callable[[h5py.File], object]) -> Make:
    return h5(change, time_s=None)


def dataset(**of: object) -> Make:
    return without_time(lambda file: file.create_dataset("time_s", **of))


def link(target: Any) -> Make:
    return without_time(lambda file: file.__setitem__("time_s", target))


def two_groups(file: h5py.File) -> None:
    for group in "ab":
        for name, values in COLUMNS.items():
            file[f"{group}/{name}"] = values


def virtual(path: Path) -> None:
    write_h5(path, columns(time_s=None))
    write_h5(path.with_name("other.h5"), COLUMNS)
    layout = h5py.VirtualLayout((N,), "f8")
    layout[:] = h5py.VirtualSource(path.with_name("other.h5"), "time_s", (N,))
    with h5py.File(path, "a") as file:
        file.create_virtual_dataset("time_s", layout)


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


def long_attribute(path: Path) -> None:
    with h5py.File(path, "w", libver="latest") as file:
        for name, values in COLUMNS.items():
            file[name] = values
        file["time_s"].attrs.create("units", np.zeros(2**20 + 8, np.int8))


def nc_index(path: Path) -> None:
    """An index of 4e8 values, none of them written."""
    write_nc(path, columns(time_s=None))
    with h5py.File(path, "a") as file:
        index = file.create_dataset("n0", (400_000_000,), "f8", chunks=(MB,), compression="gzip")
        index.make_scale("n0")


def unit_of(unit: str) -> Make:
    return h5(lambda file: file["voltage_0_V"].attrs.__setitem__("units", unit))


def deep(file: h5py.File) -> None:
    group = file.create_group("a")
    for _ in range(500):
        group = group.create_group("a")
    group["time_s"] = COLUMNS["time_s"]


def mat73_of(kind: str, name: str = "time_s") -> Make:
    def make(path: Path) -> None:
        with h5py.File(path, "w", userblock_size=512) as file:
            for each, values in columns(time_s=None).items():
                file[each] = values[None]
            file[name] = TIME_S[None]
            file["time_s"].attrs["MATLAB_class"] = np.bytes_(kind)

    return make


def matlab(*parts: bytes) -> Make:
    return raw(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(parts))


def matlab_vector(rows: int, values: bytes, name: str = "time_s") -> bytes:
    body = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, rows, 1)
    size = 8 * rows % 2**32
    body += struct.pack("<II8s", 1, 6, name.encode()) + struct.pack("<II", 9, size) + values
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


def wav(channels=1, rate=1000, block=2, bits=16, size=2 * N, data=bytes(2 * N)) -> bytes:
    form = struct.pack("<HHIIHH", 1, channels, rate, 2000, block, bits)
    parts = b"WAVEfmt " + struct.pack("<I", 16) + form + b"data" + struct.pack("<I", size) + data
    return b"RIFF" + struct.pack("<I", len(parts)) + parts


def tdms(old: bytes = b"", new: bytes = b"", **properties: object) -> Make:
    def make(path: Path) -> None:
        channels = [ChannelObject("a", name, values) for name, values in COLUMNS.items()]
        with TdmsWriter(path) as file:
            file.write_segment([RootObject(properties), *channels])
        content = path.read_bytes()
        assert old in content
        path.write_bytes(content.replace(old, new, 1) if old else content)

    return make


def tdms_start(objects: int) -> bytes:
    lead = b"TDSm" + struct.pack("<lLQQ", 6, 4713, 2**29, 2**28)
    return lead + struct.pack("<L", objects)


# Mistakes

MANY = {"voltage_0_V": None, "voltage_1_V": None, **{f"c{i}": TIME_S for i in range(30)}}
STUCK = np.where(np.arange(N) == 6, TIME_S[5], TIME_S)
STRUCT = np.array([(1.0, 2.0)], dtype=[("a", "f8"), ("b", "f8")])
OBJECTS = np.array([1.0, {"a": 1}] * 6, dtype=object)
FILMS = {"sensor": {"elements": [{}]}}
BAD: dict[str, Bad] = {
    # No such file, or no table
    "no file": Bad(
        "r.csv", lambda path: write_csv(path.with_name("rr.csv"), COLUMNS), ["did you mean rr.csv"]
    ),
    "suffix": Bad("r.xlsx", text("x"), ["'.xlsx'", ".csv", ".nc"]),
    "empty": Bad("r.npz", raw(b""), ["is empty"]),
    "only comments": Bad("r.csv", text("# nothing\n\n"), ["there is no table"]),
    "only a header": Bad("r.csv", text(HEADER[:-1]), ["0", "at least 3"]),
    "no header": Bad("r.csv", text("0,1,2\n1,2,3\n"), ["column_1", "recording.channels"]),
    "HDF5 as CSV": Bad("r.csv", other("hdf5"), ["cannot be read as .csv", "suffix"]),
    "CSV as netCDF": Bad("r.nc", other("csv"), ["cannot be read as .nc"]),
    "old netCDF": Bad("r.nc", raw(b"CDF\x01" + bytes(40)), ["cannot be read as .nc"]),
    "half a character": Bad("r.csv", raw(b"\xed\xa0\x80," + GOOD.encode()), [".csv"]),
    "zero byte": Bad("r.csv", text(GOOD, "\0\n", GOOD), [".csv"]),
    "archive of nothing": Bad("r.npz", npz({}), ["the file has no columns"]),
    # Rows and cells
    "a row cut short": Bad("r.csv", text(ROWS.format(1), "4,1"), ["row 5 has 2 cells", "3"]),
    "one cell too many": Bad("r.csv", text(ROWS.format("0,05")), ["row 2 has 4 cells"]),
    "one huge cell": Bad("r.csv", text("a\n", "9" * 200_000), ["cannot be read as .csv"]),
    "column twice": Bad("r.csv", text("a, b,a\n1,2,3\n"), ["'a' appears twice"]),
    "empty cell": Bad("r.csv", text(ROWS.format("")), ["voltage_0_V", "row 2", "missing=allow"]),
    "a word": Bad(
        "r.csv", text(ROWS.format("bad")), ["voltage_0_V", "row 2", "'bad'"], {"missing": "allow"}
    ),
    "overflow": Bad("r.csv", text(ROWS.format("1e999")), ["row 2", "'1e999'"]),
    "infinite": Bad(
        "r.nc", table(**with_value("voltage_1_V", 5, np.inf)), ["row 6", "'inf'"],
        {"missing": "allow"},
    ),
    "no time at a row": Bad(
        "r.csv", table(**with_value("time_s", 1, np.nan)), ["time_s", "row 2"], {"missing": "allow"}
    ),
    "no speed at a row": Bad(
        "r.npz", table(**with_value("speed_m_per_s", 2, np.nan)), ["speed_m_per_s", "row 3"],
        {"missing": "allow"},
    ),
    "no position at a row": Bad(
        "r.nc", table(speed_m_per_s=None, position_m=np.where(TIME_S > 0.005, np.nan, TIME_S)),
        ["position_m", "row 7"],
    ),
    # Columns
    "time stands still": Bad("r.csv", table(time_s=STUCK), ["row 7 (0.005 s)", "not come after"]),
    "time goes back": Bad("r.tdms", table(time_s=-TIME_S), ["row 2", "not come after", "reorder"]),
    "no time": Bad("r.csv", table(time_s=None), ["time", "recording.sample_rate_hz"]),
    "no speed": Bad("r.csv", table(speed_m_per_s=None), ["recording.speed_m_per_s=..."]),
    "no signals": Bad("r.csv", table(**MANY), ["c17 and 12 more", "recording.channels=[...]"]),
    "time of no unit": Bad("r.csv", table(time_s=None, time=TIME_S), ["'time'", "s, ms, us"]),
    "lengths": Bad("r.npz", table(voltage_1_V=TIME_S[1:]), ["voltage_1_V 11", "same number"]),
    "lengths in netCDF": Bad("r.nc", table(time_s=TIME_S[1:]), ["time_s 11"]),
    "lengths in TDMS": Bad("r.tdms", table(time_s=TIME_S[1:]), ["time_s 11"]),
    "a table in a table": Bad("r.npz", table(time_s=TIME_S[None]), ["(1, 12)", "1-D"]),
    "a signal of two rows in netCDF": Bad("r.nc", table(voltage_0_V=SIGNAL), ["voltage_0_V"]),
    "complex in MATLAB": Bad("r.mat", table(time_s=TIME_S * 1j), ["time_s", "1-D"]),
    "a signal of two rows": Bad("r.h5", table(voltage_0_V=SIGNAL), ["voltage_0_V has shape"]),
    "one number": Bad("r.h5", table(speed_m_per_s=0.1), ["speed_m_per_s has shape ()"]),
    "complex": Bad("r.h5", table(time_s=TIME_S * 1j), ["time_s", "complex128"]),
    "words": Bad("r.npz", table(time_s=["0"] * N), ["of type <U1", "real numbers"]),
    "truth values": Bad("r.tdms", table(voltage_0_V=TIME_S > 0.005), ["voltage_0_V", "real"]),
    "pickled objects": Bad("r.npz", table(time_s=OBJECTS), ["time_s is not a plain array"]),
    "words in HDF5": Bad("r.h5", dataset(data=["a"] * N), ["time_s", "real numbers"]),
    "nothing in HDF5": Bad("r.h5", dataset(data=h5py.Empty("f8")), ["time_s has shape ()"]),
    "two groups": Bad("r.h5", h5(two_groups, **dict.fromkeys(COLUMNS)), ["a, b", "one recording"]),
    "MATLAB struct": Bad("r.mat", table(time_s={"a": {"b": TIME_S}}), ["time_s."]),
    "MATLAB array of structs": Bad("r.mat", table(time_s=STRUCT), ["time_s."]),
    "MATLAB cell": Bad("r.mat", table(time_s=OBJECTS), ["time_s is a MATLAB cell"]),
    "MATLAB char": Bad("r.mat", table(time_s="0 1 2"), ["time_s is a MATLAB char"]),
    "MATLAB sparse": Bad(
        "r.mat", table(time_s=scipy.sparse.csc_array(TIME_S[None])), ["time_s is a MATLAB sparse"]
    ),
    "MATLAB 7.3 object": Bad("r.mat", mat73_of("datetime"), ["time_s is a MATLAB datetime"]),
    "MATLAB 7.3 struct": Bad("r.mat", mat73_of("struct", "time_s/inner"), ["time_s."]),
    "not a number in WAV": Bad(
        "r.wav", lambda path: FORMATS["wav"][1](path, {"a": np.full(N, np.nan, np.float32)}),
        ["channel_0", "row 1"], {"speed_m_per_s": 0.05},
    ),
    # What is stated
    "no such channel": Bad(
        "r.csv", table(), ["'voltage_2V'", "the nearest is voltage_"], {"channels": ["voltage_2V"]}
    ),
    "channel twice": Bad("r.csv", table(), ["twice"], {"channels": ["voltage_0_V"] * 2}),
    "time as a channel": Bad("r.csv", table(), ["'time_s' cannot"], {"channels": ["time_s"]}),
    "a choice of none": Bad("r.csv", table(), ["'drop'", "refuse, allow"], {"missing": "drop"}),
    "a time's unit": Bad(
        "r.csv", table(time_s=None, t=TIME_S), ["min", "s, ms, us"], {"time_unit": "min"}
    ),
    "speed in words": Bad("r.csv", table(), ["'fast'", "number"], {"speed_m_per_s": "fast"}),
    "a sidecar of another suffix": Bad("r.csv", table(), ["'.txt'"], {"sidecar": "r.txt"}),
    "no such sidecar": Bad(
        "r.csv", table(), ["no such sidecar", "recording.sidecar"], {"sidecar": "r.s.yaml"}
    ),
    "a sidecar in Latin-1": Bad("r.csv", latin_sidecar, ["r.yaml", "UTF-8"]),
    "two sidecars": Bad("r.csv", two_sidecars, ["r.json, r.yaml", "recording.sidecar"]),
    "a sidecar in netCDF": Bad(
        "r.nc", h5(lambda file: file.attrs.__setitem__("sidecar", "{")), ["attribute sidecar"]
    ),
    "an element too few": Bad("r.csv", table(), ["lists 1", "the signal columns are"], FILMS),
}  # fmt: skip

# Sidecars: text -> words of the sentence
SIDECARS = {
    '{"gain": 0}': ["gain is 0", "above 0"],
    '{"gain": [1, 2, 3]}': ["gain lists 3", "2 signal columns"],
    '{"gain": [1, "x"]}': ["gain is [1, 'x']"],
    '{"gain": 1e999}': ["gain is inf"],
    '{"gain": NaN}': ["r.json", "NaN", "JSON"],
    '{"gain": 1': ["r.json", "JSON"],
    '{"gain": ' + "[" * 100_000: ["r.json", "JSON"],
    '{"gain": 1' + "0" * 400 + "}": ["gain is 1000"],
    '{"gain": 1, "gain": 2}': ["r.json", "gain"],
    '{"polarity": 2}': ["polarity is 2", "1 or -1"],
    '{"polarity": true}': ["polarity is true"],
    '{"polarty": 1}': ["polarty", "polarity"],
    '{"a\\u0007": 1}': ["'a\\x07'"],
    '{"channels": []}': ["channels is []"],
    '{"channels": [[1]]}': ["channels is [[1]]"],
    '{"time_unit": 5}': ["time_unit is 5"],
    '{"sensor": 3}': ["sensor is 3", "a mapping"],
    '{"sensor": {"depth_m": 0}}': ["sensor.depth_m is 0"],
    '{"sensor": {"elements": 3}}': ["sensor.elements is 3"],
    '{"sensor": {"elements": [{}, {"offset_m": "x"}]}}': ["elements[1].offset_m is 'x'"],
    '{"sensor": {"piezo_constants_C_per_N": {"d4": 5}}}': ["no key", "d1, d2, d3"],
    '{"contact_window_m": [2, 1]}': ["contact_window_m is [2, 1]", "the start below"],
    '{"contact_window_m": [null, 1]}': ["contact_window_m is [None, 1]"],
    "[1]": ["r.json", "[1]", "a mapping"],
    "": ["r.json", "is empty"],
    "1" * 5000: ["r.json", "JSON"],
}
YAML = {
    "a: [1,\nb: 2": ["sidecar's YAML"],
    "a: !!python/object/apply:os.getcwd []": ["sidecar's YAML"],
    "a: &x [1]\nb: [*x, *x]": ["aliases"],
    "gain: 1\ngain: 2": ["gain"],
    "--- {gain: 2}\n--- {gain: 3}": ["YAML"],
    "sensor: {elements: [{offset_m: 1_100}, {}]}": ["offset_m is '1_100'", "7.5e-4"],
}
BAD |= {f"{t[:40]}": Bad("r.csv", beside("r.json", t), words) for t, words in SIDECARS.items()}
BAD |= {t[:40]: Bad("r.csv", beside("r.yaml", t), words) for t, words in YAML.items()}

# Files that harm

MANY_NAMES = ",".join(f"column_{i}" for i in range(100_000))
NEVER: dict[str, Any] = {"shape": (9 * 10**7,), "dtype": "f8", "chunks": (MB,)}
HARMFUL: dict[str, Bad] = {
    # What is no regular file
    "folder": Bad("r.csv", Path.mkdir, ["a folder"]),
    "pipe": Bad("r.nc", os.mkfifo, ["a pipe"]),
    "endless device": Bad("r.csv", link_to("/dev/zero"), ["a device"]),
    "link loop": Bad("r.csv", link_to("r.csv"), ["cannot be opened", "symbolic links"]),
    "the process's memory": Bad("r.h5", link_to("/proc/self/mem"), ["is empty"]),
    "5 GB": Bad("r.csv", sparse(5 * 2**30, GOOD.encode()), ["above the limit of 4294967296"]),
    # Text
    "4 GB of zeros": Bad("r.csv", sparse(2**32 - 1, GOOD.encode()), [".csv"]),
    "100,000 columns": Bad("r.csv", text(MANY_NAMES, "\n"), ["the header exceeds"]),
    "1,001 columns": Bad("r.csv", text(MANY_NAMES[:11_900], "\n"), ["above the limit of 1000"]),
    "a name of 201": Bad("r.csv", text("x" * 201, ",time_s\n"), ["201 characters", "at most 200"]),
    "a quotation mark": Bad(
        "r.csv", later(lambda: text(HEADER, '0,"1,1\n', "1,1,1\n" * 900_000)),
        ["row 1 exceeds", "quotation"],
    ),
    "control character": Bad("r.csv", text("a\x07b,", GOOD), ["'a\\x07b'", "cannot be printed"]),
    # NumPy
    "npz of a terabyte": Bad("r.npz", npz({"time_s.npy": npy_of(2**37)}), ["time_s", "limit"]),
    "npz, more stated": Bad("r.npz", npz({"time_s.npy": npy_of(10**7, bytes(80))}), [".npz"]),
    "npz, less than nothing": Bad("r.npz", npz({"time_s.npy": npy_of(-5)}), [".npz"]),
    "npz that runs": Bad("r.npz", npz({"time_s.npy": npy(RUNNING)}), ["r.npz"]),
    "npz of 2,000": Bad("r.npz", npz({f"{i}.npy": b"" for i in range(2000)}), ["limit of 1000"]),
    "npz by LZMA": Bad(
        "r.npz", npz({"voltage_0_V.npy": npy_of(N, bytes(8 * N))}, zipfile.ZIP_LZMA),
        ["not a plain array"],
    ),
    "npz, twice": Bad(
        "r.npz", npz(dict.fromkeys(("a.npy", "a"), npy_of(1, bytes(8)))), ["'a' appears twice"]
    ),
    # HDF5
    "4e8 values": Bad("r.h5", dataset(shape=(4 * 10**8,), dtype="f8", chunks=(MB,)), ["limit"]),
    "values never written": Bad("r.h5", dataset(**NEVER), ["unpack to", "compression"]),
    "MATLAB values never written": Bad(
        "r.mat", dataset(shape=(9 * 10**7, 1), dtype="f8", chunks=(MB, 1)), ["unpack to"]
    ),
    "large chunk": Bad(
        "r.h5",
        dataset(shape=(N,), maxshape=(None,), dtype="f8", chunks=(5 * 10**8,), compression="gzip"),
        ["time_s has 12 values in chunks of 500000000"],
    ),
    "packed a millionfold": Bad("r.h5", without_time(bomb), ["time_s has chunks that may unpack"]),
    "foreign filter": Bad("r.h5", without_time(foreign_filter), ["time_s is packed by filter 307"]),
    "two filters": Bad(
        "r.h5", dataset(shape=(N,), dtype="f8", compression="gzip", scaleoffset=3), ["packed by"]
    ),
    "link to another file": Bad("r.nc", link(h5py.ExternalLink("p", "/x")), ["time_s is a link"]),
    "link to a name": Bad("r.h5", link(h5py.SoftLink("/voltage_0_V")), ["time_s is a link"]),
    "only links": Bad(
        "r.h5",
        h5(lambda f: f.__setitem__("scan", h5py.SoftLink("/")), **dict.fromkeys(COLUMNS)),
        ["links (scan) are not followed"],
    ),
    "values elsewhere": Bad(
        "r.nc", dataset(shape=(N,), dtype="f8", external=[("/etc/passwd", 0, 8 * N)]), ["another"]
    ),
    "values of another file": Bad("r.h5", virtual, ["time_s lies in another file"]),
    "enumeration": Bad(
        "r.h5", dataset(shape=(N,), dtype=h5py.enum_dtype({"a": 1}, "i4")),
        ["time_s holds values of an enumeration"],
    ),
    "lists": Bad("r.h5", dataset(shape=(N,), dtype=h5py.vlen_dtype("f8")), ["type object"]),
    "a broken name": Bad("r.h5", h5(lambda f: f.__setitem__(b"a\xff", 1.0)), ["'a\\udcff'"]),
    "a long name": Bad("r.h5", h5(lambda f: f.__setitem__("n" * 30_000, 1.0)), ["30000"]),
    "a long unit": Bad("r.h5", unit_of("x" * 60_000), ["the unit of column voltage_0_V is 60000"]),
    "a long attribute": Bad("r.h5", long_attribute, ["attribute", "1048584 bytes"]),
    "2,000 names of one dataset": Bad(
        "r.h5", h5(lambda f: [f.__setitem__(f"d{i}", f["voltage_0_V"]) for i in range(2000)]),
        ["limit of 1000"],
    ),
    "deep groups": Bad(
        "r.h5", h5(deep, **dict.fromkeys(COLUMNS)), ["links (none) are not followed"]
    ),
    "netCDF index of 4e8": Bad("r.nc", nc_index, ["n0", "400000000", "limit"]),
    # MATLAB
    "matlab of 2^31": Bad("r.mat", matlab(matlab_vector(2**31 - 1, b"")), ["limit"]),
    "matlab of nothing": Bad("r.mat", sparse(2**30, b"MATLAB".ljust(126) + b"IM"), [".mat"]),
    "matlab, 2,000": Bad(
        "r.mat",
        later(lambda: matlab(*(matlab_vector(1, bytes(8), f"x{i:05d}") for i in range(2000)))),
        ["limit of 1000"],
    ),
    # WAV
    "wav of no channels": Bad("r.wav", raw(wav(channels=0)), [".wav"]),
    "wav of 65,535": Bad("r.wav", raw(wav(65535, block=65535, bits=8)), ["65535 columns"]),
    "wav of a lie": Bad("r.wav", raw(wav(size=2**32 - 2)), [".wav"]),
    "wav of 1e9": Bad(
        "r.wav", sparse(10**9, wav(bits=8, block=1, size=999_999_900)), ["limit"]
    ),
    "wav of zeros before": Bad("r.wav", sparse(2**30, b"RIFF\xff\xff\xff\xffWAVE"), [".wav"]),
    "wav at no rate": Bad("r.wav", raw(wav(rate=0)), [".wav"]),
    # TDMS
    "tdms of 2^62": Bad("r.tdms", tdms(struct.pack("<LQ", 1, N), struct.pack("<LQ", 1, 2**62)), []),
    "tdms of 4e9 objects": Bad("r.tdms", sparse(2**30, tdms_start(2**32 - 1)), [".tdms"]),
    "tdms of 2e9 scales": Bad("r.tdms", tdms(NI_Number_Of_Scales=2**31 - 1), ["10 scales"]),
    "tdms without an end": Bad("r.tdms", sparse(2**30, b"TDSm"), []),
}  # fmt: skip
# Whose files take long to make.
LARGE: dict[str, Bad] = {
    "one line": Bad(
        "r.csv", later(lambda: text(HEADER, "1," * 30_000_000)), ["data row 1 exceeds"]
    ),
    "blank lines": Bad(
        "r.csv", later(lambda: text(HEADER, "\n" * 40_000_000, "1")), ["data row 1 has 1 cells"]
    ),
    "blank lines first": Bad(
        "r.csv", later(lambda: text("\n" * 40_000_000, GOOD)), ["the header exceeds"]
    ),
    "npz of zeros": Bad(
        "r.npz", later(lambda: npz({"time_s.npy": npy_of(2**27, bytes(2**28))})), ["limit"]
    ),
    "npz, header of 300 MB": Bad(
        "r.npz", later(lambda: npz({"voltage_0_V.npy": npy(" " * 300 * MB, version=2)})),
        ["not a plain array"],
    ),
    "matlab packed": Bad(
        "r.mat", later(lambda: matlab(packed(matlab_vector(10**8, bytes(200 * MB))))), [".mat"]
    ),
}  # fmt: skip
