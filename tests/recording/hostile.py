"""Files that ask for more than they hold, by name, and the process that tries to read them.

python -m tests.recording.hostile FOLDER CASE ... prints, for each case, what was said, the seconds
that it took and by how much the peak of the memory grew.
"""

import json
import os
import resource
import signal
import struct
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording._apart import IsolatedReader
from srsinv.recording.inspection import inspect
from tests.recording.files import COLUMNS, N, write_csv
from tests.recording.harmful import (
    GOOD,
    HEADER,
    MB,
    binary,
    bomb,
    dataset,
    deep,
    foreign_filter,
    h5,
    later,
    link_to,
    listening,
    matlab,
    matlab_vector,
    nc_index,
    npy,
    npy_of,
    npz,
    packed,
    sparse,
    tdms,
    tdms_start,
    text,
    unit_of,
    wav,
    without_time,
)

MANY = ",".join(f"column_{i}" for i in range(100_000))
LONG = "x" * 100_000
# name of the case: (the file's name, how it is made, words of the sentence)
CASES: dict[str, tuple[str, Callable[[Path], object], list[str]]] = {
    # What is no regular file
    "folder": ("r.csv", Path.mkdir, ["a folder"]),
    "pipe": ("r.csv", os.mkfifo, ["a pipe"]),
    "pipe, netCDF": ("r.nc", os.mkfifo, ["a pipe"]),
    "socket": ("r.csv", listening, ["a socket"]),
    "endless device": ("r.csv", link_to("/dev/zero"), ["a device"]),
    "terminal": ("r.wav", link_to("/dev/tty"), ["a device"]),
    "link loop": ("r.csv", link_to("r.csv"), ["cannot be opened", "symbolic links"]),
    "link to nothing": ("r.csv", link_to("absent.csv"), ["no such file"]),
    "kernel's messages": ("r.csv", link_to("/proc/kmsg"), []),
    "the process's memory": ("r.h5", link_to("/proc/self/mem"), ["is empty"]),
    "file of the system": ("r.csv", link_to("/proc/version"), ["is empty"]),
    "empty": ("r.csv", binary(b""), ["is empty"]),
    "5 GB": ("r.csv", sparse(5 * 2**30, GOOD.encode()), ["above the limit of 4294967296"]),
    "5 GB of HDF5": ("r.h5", sparse(5 * 2**30), ["above the limit of 4294967296"]),
    # Text
    "4 GB of zeros": ("r.csv", sparse(2**32 - 1, GOOD.encode()), [".csv"]),
    "one line": ("r.csv", later(lambda: text(HEADER, "1," * 30_000_000)), ["data row 1 is longer"]),
    "a header of 50 MB": ("r.csv", later(lambda: text("x" * 50_000_000)), ["the header is longer"]),
    "100,000 columns": ("r.csv", text(MANY, "\n"), ["the header is longer"]),
    "1,001 columns": ("r.csv", text(MANY[:11_900], "\n"), ["above the limit of 1000"]),
    "a name of 201": ("r.csv", text("x" * 201, ",time_s\n"), ["201 characters", "at most 200"]),
    "a quotation mark": (
        "r.csv",
        later(lambda: text(HEADER, '0,"1,1\n', "1,1,1\n" * 900_000)),
        ["row 1 is longer", "quotation"],
    ),
    "quoted line breaks": (
        "r.csv",
        later(lambda: text(HEADER, '"\n",' * 5_000_000)),
        ["data row 1 is longer"],
    ),
    "blank lines": (
        "r.csv",
        later(lambda: text(HEADER, "\n" * 40_000_000, "1")),
        ["data row 1 has 1 cells"],
    ),
    "blank lines first": (
        "r.csv",
        later(lambda: text("\n" * 40_000_000, GOOD)),
        ["the header is longer"],
    ),
    "control character": ("r.csv", text("a\x07b,", GOOD), ["'a\\x07b'", "cannot be printed"]),
    "half a character": ("r.csv", binary(b"\xed\xa0\x80," + GOOD.encode()), [".csv"]),
    "zero byte": ("r.csv", text(GOOD, "\0\n", GOOD), [".csv"]),
    # NumPy
    "npz of a terabyte": ("r.npz", npz({"time_s.npy": npy_of(2**37)}), ["time_s", "limit"]),
    "npz of zeros": (
        "r.npz",
        later(lambda: npz({"time_s.npy": npy_of(2**27, bytes(2**28))})),
        ["limit"],
    ),
    "npz, more stated": ("r.npz", npz({"time_s.npy": npy_of(10**7, bytes(80))}), [".npz"]),
    "npz, less than nothing": ("r.npz", npz({"time_s.npy": npy_of(-5)}), [".npz"]),
    "npz, header of 300 MB": (
        "r.npz",
        later(lambda: npz({"voltage_0_V.npy": npy(" " * 300 * MB, version=2)})),
        ["not a plain array"],
    ),
    "npz of 2,000": ("r.npz", npz({f"{i}.npy": b"" for i in range(2000)}), ["limit of 1000"]),
    "npz by LZMA": (
        "r.npz",
        npz({"voltage_0_V.npy": npy_of(N, bytes(8 * N))}, zipfile.ZIP_LZMA),
        ["not a plain array"],
    ),
    "npz, twice": (
        "r.npz", npz(dict.fromkeys(("a.npy", "a"), npy_of(1, bytes(8)))), ["'a' appears twice"]
    ),
    # HDF5
    "hdf5 of 4e8": ("r.h5", dataset(shape=(4 * 10**8,), dtype="f8", chunks=(MB,)), ["limit"]),
    "values never written": (
        "r.h5", dataset(shape=(9 * 10**7,), dtype="f8", chunks=(MB,)), ["unpacked", "compression"]
    ),
    "netCDF values never written": (
        "r.nc", dataset(shape=(9 * 10**7,), dtype="f8", chunks=(MB,)), ["unpacked"]
    ),
    "MATLAB values never written": (
        "r.mat", dataset(shape=(9 * 10**7, 1), dtype="f8", chunks=(MB, 1)), ["unpacked"]
    ),
    "one dataset by many names": (
        "r.h5",
        h5(lambda f: [f.__setitem__(f"d{i}", f["voltage_0_V"]) for i in range(2000)]),
        ["limit of 1000"],
    ),
    "large chunk": (
        "r.h5",
        dataset(shape=(N,), maxshape=(None,), dtype="f8", chunks=(5 * 10**8,), compression="gzip"),
        ["time_s has 12 values in chunks of 500000000"],
    ),
    "packed a millionfold": ("r.h5", without_time(bomb), ["time_s has chunks that may unpack"]),
    "foreign filter": ("r.h5", without_time(foreign_filter), ["time_s is packed by filter 307"]),
    "two filters": (
        "r.h5", dataset(shape=(N,), dtype="f8", compression="gzip", scaleoffset=3), ["packed by"]
    ),
    "link to another file": (
        "r.h5",
        without_time(lambda file: file.__setitem__("time_s", h5py.ExternalLink("o.h5", "/x"))),
        ["time_s is a link, which may lead to another file"],
    ),
    "link to a name": (
        "r.h5",
        without_time(lambda file: file.__setitem__("time_s", h5py.SoftLink("/voltage_0_V"))),
        ["time_s is a link"],
    ),
    "link to a pipe": (
        "r.nc",
        without_time(lambda file: file.__setitem__("time_s", h5py.ExternalLink("p", "/x"))),
        ["time_s is a link"],
    ),
    "only links": (
        "r.h5",
        h5(
            lambda file: file.__setitem__("scan", h5py.ExternalLink("o.h5", "/")),
            **dict.fromkeys(COLUMNS),
        ),
        ["links (scan) not followed"],
    ),
    "elsewhere": (
        "r.nc", dataset(shape=(N,), dtype="f8", external=[("/etc/passwd", 0, 8 * N)]), ["another"]
    ),
    "enumeration": (
        "r.h5",
        dataset(shape=(N,), dtype=h5py.enum_dtype({"a": 1}, "i4")),
        ["time_s holds values of an enumeration"],
    ),
    "compound": ("r.h5", dataset(shape=(N,), dtype=[("a", "f8"), ("b", "i4")]), ["values of type"]),
    "lists": ("r.h5", dataset(shape=(N,), dtype=h5py.vlen_dtype("f8")), ["type object"]),
    "references": ("r.h5", dataset(shape=(N,), dtype=h5py.ref_dtype), ["type object"]),
    "a long name": ("r.h5", h5(lambda f: f.__setitem__("n" * 30_000, 1.0)), ["30000 characters"]),
    "a name of control characters": ("r.h5", h5(lambda f: f.__setitem__("a\nb", 1.0)), ["'a\\nb'"]),
    "a broken name": ("r.h5", h5(lambda f: f.__setitem__(b"a\xff", 1.0)), ["'a\\udcff'"]),
    "a long unit": ("r.h5", unit_of(LONG[:60_000]), ["the unit of column voltage_0_V is 60000"]),
    "a unit of control characters": ("r.h5", unit_of("V\x1b[31m"), ["'V\\x1b[31m'"]),
    "2,000 datasets": (
        "r.h5", h5(lambda f: [f.__setitem__(f"d{i}", 1) for i in range(2000)]), ["limit of 1000"]
    ),
    "deep groups": ("r.h5", h5(deep, **dict.fromkeys(COLUMNS)), ["groups that hold any are none"]),
    "netCDF index of 4e8": ("r.nc", nc_index, ["n0", "400000000", "limit"]),
    "netCDF of 1e5 characters": ("r.nc", unit_of("u" * 201), ["201 characters"]),
    # MATLAB
    "matlab of 2^31": ("r.mat", matlab(matlab_vector(2**31 - 1, b"")), ["limit"]),
    "matlab packed": (
        "r.mat", later(lambda: matlab(packed(matlab_vector(10**8, bytes(200 * MB))))), [".mat"]
    ),
    "matlab of nothing": ("r.mat", sparse(2**30, b"MATLAB".ljust(126) + b"IM"), [".mat"]),
    "matlab, 2,000": (
        "r.mat",
        later(lambda: matlab(*(matlab_vector(1, bytes(8), f"x{i:05d}") for i in range(2000)))),
        ["limit of 1000"],
    ),
    # WAV
    "wav of no channels": ("r.wav", binary(wav(channels=0)), [".wav"]),
    "wav of 65,535": ("r.wav", binary(wav(65535, block=65535, bits=8)), ["65535 columns"]),
    "wav of a lie": ("r.wav", binary(wav(size=2**32 - 2)), [".wav"]),
    "wav of 1e9": ("r.wav", sparse(10**9, wav(bits=8, block=1, size=999_999_900)), ["limit"]),
    "wav of 4e9 parts": ("r.wav", sparse(2**30, b"RIFF" + b"\xff" * 4 + wav()[8:]), [".wav"]),
    "wav of zeros before": ("r.wav", sparse(2**30, b"RIFF\xff\xff\xff\xffWAVE"), [".wav"]),
    "wav at no rate": ("r.wav", binary(wav(rate=0)), [".wav"]),
    "wav of 65 bits": ("r.wav", binary(wav(bits=65)), [".wav"]),
    "wav of ADPCM": ("r.wav", binary(wav(kind=2)), [".wav"]),
    # TDMS
    "tdms of 2^62": (
        "r.tdms", tdms(struct.pack("<LQ", 1, N), struct.pack("<LQ", 1, 2**62)), []
    ),
    "tdms of 4e9 objects": ("r.tdms", sparse(2**30, tdms_start(2**32 - 1)), [".tdms"]),
    "tdms of 4e9 properties": (
        "r.tdms",
        sparse(2**30, tdms_start(1, struct.pack("<L1sLL", 1, b"/", 2**32 - 1, 2**32 - 1))),
        [".tdms"],
    ),
    "tdms of 2e9 scales": ("r.tdms", tdms(NI_Number_Of_Scales=2**31 - 1), ["more than 10 scales"]),
    "tdms of many scales": (
        "r.tdms", tdms(**{"NI_Scale[999999999]_Scale_Type": "Linear"}), ["more than 10 scales"]
    ),
    "tdms without an end": ("r.tdms", sparse(2**30, b"TDSm"), []),
}  # fmt: skip


def in_a_process(work: Callable[[], object]) -> int:
    """The status of a process that does this and ends, or that the alarm ends."""
    process = os.fork()
    if process == 0:
        signal.alarm(60)
        work()
        sys.stdout.flush()
        os._exit(0)
    return os.waitpid(process, 0)[1]


def read_twice(case: str, path: Path) -> None:
    """Load and inspect, and print what came of it."""
    known = {"speed_m_per_s": 1.0} if path.suffix == ".wav" else {}
    before, said, start = peak_MB(), [], time.perf_counter()
    for read in (load, inspect):
        try:
            read(path, **known)
            said.append("read")
        except BadInput as refusal:
            said.append(str(refusal))
    took_s = time.perf_counter() - start
    print(json.dumps({"case": case, "said": said, "s": took_s, "MB": peak_MB() - before}))


def peak_MB() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


# Those whose files take long to make.
SLOW = (
    "one line", "a header of 50 MB", "quoted line breaks", "blank lines", "blank lines first",
    "npz of zeros", "npz, header of 300 MB", "packed a millionfold", "matlab packed",
)  # fmt: skip


def main(folder: Path, cases: list[str]) -> None:
    # The limits hold by themselves, without the process that would take a crash upon itself.
    IsolatedReader.read = lambda self, file: self.read_here(file)
    write_csv(folder / "warm.csv", COLUMNS)
    load(folder / "warm.csv")
    for number, case in enumerate(cases):
        name, make, _ = CASES[case]
        (folder / str(number)).mkdir()
        path = folder / str(number) / name
        in_a_process(lambda make=make, path=path: make(path))
        in_a_process(lambda case=case, path=path: read_twice(case, path))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
