"""Files that cannot be used, in every format: each gets one sentence, never anything else."""

import json
import os
import struct
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from srsinv.errors import BadInput
from srsinv.recording import _apart, load
from srsinv.recording.inspection import inspect
from tests.jobs.run import command
from tests.recording.files import (
    COLUMNS,
    FORMATS,
    SIGNAL,
    TIME_S,
    WITHOUT_TIMES,
    N,
    columns,
    with_value,
    write,
    write_h5,
    write_mat,
)
from tests.tiers import quick

BINARY = tuple(format for format in FORMATS if format != "csv")
# Those that hold any columns.
TABLES = tuple(format for format in FORMATS if format not in WITHOUT_TIMES)
NOT_NETCDF = ("npz", "hdf5", "mat", "mat73")
ARRAYS = (*NOT_NETCDF, "netcdf")
SPEED = {"speed_m_per_s": 0.05}


def known(format):
    """What has to be stated beside a good file: WAV and FLAC know their signals and the rate."""
    return SPEED if format in WITHOUT_TIMES else {}


def assert_clear_message(error):
    """One line that says what is wrong and, after the last colon, the remedy."""
    message = str(error)
    assert message.isprintable()
    assert len(message.split(": ")) >= 3
    for internal in ("Traceback", "Error", "Exception", "0x", "<class"):
        assert internal not in message


def assert_one_sentence(error, *words):
    assert_clear_message(error)
    message = str(error)
    assert message.endswith(("...", ".", "?", ")"))
    assert ". " not in message.replace("... ", "")
    for word in words:
        assert word in message


def assert_refused(path, words, **stated):
    with pytest.raises(BadInput) as caught:
        load(path, **stated)
    assert_one_sentence(caught.value, path.name, *words)


# What each format holds: name of the damage -> (columns, words of the sentence, formats)
ROW = 4
STUCK = np.where(np.arange(N) == ROW, TIME_S[ROW - 1], TIME_S)
BACK = np.where(np.arange(N) == ROW, TIME_S[1], TIME_S)
CONTENT = {
    "NaN in time": (with_value("time_s", ROW, np.nan), ["time_s", "row 5", "nan"], TABLES),
    "NaN in speed": (with_value("speed_m_per_s", 0, np.nan), ["speed_m_per_s", "row 1"], TABLES),
    "NaN in a signal": (
        with_value("voltage_1_V", ROW, np.nan),
        ["voltage_1_V", "row 5", "recording.missing=allow"],
        TABLES,
    ),
    "infinite signal": (with_value("voltage_0_V", 2, -np.inf), ["voltage_0_V", "row 3"], TABLES),
    "infinite time": (with_value("time_s", N - 1, np.inf), ["time_s", "row 12"], TABLES),
    "time goes back": (columns(time_s=BACK), ["row 5", "increase", "reorder"], TABLES),
    "time repeats": (columns(time_s=STUCK), ["row 5", "increase", "drop"], TABLES),
    "position not finite": (
        columns(speed_m_per_s=None, position_m=np.where(TIME_S > 0.005, np.nan, TIME_S)),
        ["position_m", "row 7"],
        TABLES,
    ),
    "no time": (columns(time_s=None), ["time_s", "recording.sample_rate_hz"], TABLES),
    "bare time": (
        columns(time_s=None, time=TIME_S),
        ["'time'", "recording.time_unit"],
        TABLES,
    ),
    "no speed": (columns(speed_m_per_s=None), ["speed", "recording.speed_m_per_s"], TABLES),
    "no samples": ({name: values[:0] for name, values in COLUMNS.items()}, [], TABLES),
    "one sample": ({name: v[:1] for name, v in COLUMNS.items()}, ["1 where at least 3"], TABLES),
    "two samples": ({name: v[:2] for name, v in COLUMNS.items()}, ["2 where at least 3"], TABLES),
    "no signals": (
        columns(voltage_0_V=None, voltage_1_V=None),
        ["voltage_0_V", "recording.channels"],
        TABLES,
    ),
    "signals of another unit": (
        columns(voltage_0_V=None, voltage_1_V=None, voltage_0_kV=TIME_S),
        ["voltage_0_kV", "recording.channels"],
        ("csv", *ARRAYS),
    ),
    "time longer": (
        columns(time_s=np.arange(N + 1) / 1000),
        ["time_s 13", "same number"],
        (*ARRAYS, "tdms"),
    ),
    "a signal shorter": (
        columns(voltage_1_V=SIGNAL[1, :-2]),
        ["voltage_1_V 10", "same number"],
        (*ARRAYS, "tdms"),
    ),
    "2-D signal": (columns(voltage_0_V=SIGNAL), ["voltage_0_V has shape", "1-D"], ARRAYS),
    "3-D time": (columns(time_s=TIME_S.reshape(2, 2, 3)), ["time_s has shape", "1-D"], ARRAYS),
    "complex signal": (columns(voltage_0_V=SIGNAL[0] + 1j), ["voltage_0_V", "1-D"], NOT_NETCDF),
    "words in a signal": (
        columns(voltage_0_V=np.array(["one"] * N)),
        ["voltage_0_V", "real numbers"],
        ("npz", "mat"),
    ),
    "truth values in a signal": (
        columns(voltage_0_V=SIGNAL[0] > 0),
        ["voltage_0_V", "real numbers"],
        ("npz", "hdf5", "mat", "tdms"),
    ),
    "objects in a signal": (
        columns(voltage_0_V=np.array([1.0, {"a": 1}] * 6, dtype=object)),
        ["voltage_0_V", "real numbers"],
        ("npz", "mat"),
    ),
}
CASES = [
    pytest.param(format, table, words, id=f"{format}: {name}")
    for name, (table, words, formats) in CONTENT.items()
    for format in formats
]


@pytest.mark.parametrize(("format", "table", "words"), CASES)
def test_content(tmp_path, format, table, words):
    assert_refused(write(format, tmp_path, table), words)


WAV = {
    "no speed": (None, {}, ["no speed", "recording.speed_m_per_s"]),
    "two samples": ({"left": np.zeros(2, np.int16)}, SPEED, ["2 where at least 3"]),
    "not a number": ({"left": np.full(N, np.nan, np.float32)}, SPEED, ["channel_0", "row 1"]),
    "no such channel": (None, SPEED | {"channels": ["channel_2"]}, ["'channel_2'", "nearest"]),
}


@pytest.mark.parametrize(("table", "stated", "words"), WAV.values(), ids=WAV)
def test_wav_content(tmp_path, table, stated, words):
    assert_refused(write("wav", tmp_path, table), words, **stated)


# Bytes of the wrong kind

TEXT = "time_s,speed_m_per_s,voltage_0_V\n0,1,1\n1,1,1\n2,1,1\n"
POSING = {
    "empty": b"",
    "a line break": b"\n",
    "text": TEXT.encode(),
    "JSON": b'{"time_s": [0, 1, 2]}',
    "zeros": bytes(4096),
    "noise": np.random.default_rng(3).bytes(4096),
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 4,
    "a pickle": b"\x80\x04\x95\x1a\x00\x00\x00\x00\x00\x00\x00\x8c\x08builtins\x94\x8c\x04eval",
    "UTF-16 text": TEXT.encode("utf-16"),
}


FOREIGN_CONTENT = [
    (name, kind)
    for kind in POSING
    for name in dict.fromkeys(name for name, _ in FORMATS.values())
    if (name, kind) not in (("r.csv", "text"), ("r.csv", "UTF-16 text"))  # which it should be
]


@pytest.mark.parametrize(("name", "kind"), FOREIGN_CONTENT)
def test_bytes_of_another_kind(tmp_path, name, kind):
    (tmp_path / name).write_bytes(POSING[kind])
    assert_refused(tmp_path / name, [], **SPEED)


# netCDF and MATLAB 7.3 are HDF5, and may be read as such.
HDF5 = ("hdf5", "netcdf", "mat73")
MISLABELLED = [
    (format, name)
    for format in FORMATS
    for name in dict.fromkeys(name for name, _ in FORMATS.values())
    if FORMATS[format][0] != name
    and not (format in HDF5 and name in [FORMATS[other][0] for other in HDF5])
]


@pytest.mark.parametrize(("format", "name"), MISLABELLED)
def test_suffix_of_another_format(tmp_path, format, name):
    path = write(format, tmp_path).rename(tmp_path / name)
    assert_refused(path, ["suffix"], **SPEED)


@pytest.mark.parametrize("fraction", [0.02, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("format", BINARY)
def test_cut_short(tmp_path, format, fraction):
    path = write(format, tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(fraction * len(whole))])
    assert_refused(path, ["write it again"], **known(format))


@pytest.mark.parametrize("name", dict.fromkeys(name for name, _ in FORMATS.values()))
def test_a_folder_in_place_of_the_file(tmp_path, name):
    (tmp_path / name).mkdir()
    assert_refused(tmp_path / name, ["a folder", "recording.path"])


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is unreadable for root")
@pytest.mark.parametrize("format", FORMATS)
def test_an_unreadable_file(tmp_path, format):
    path = write(format, tmp_path)
    path.chmod(0)
    assert_refused(path, ["permissions"], **known(format))


# Files that ask for more than they hold, or for something to be run


def npz_of(header: bytes):
    """An archive with one array that has this header, and no values."""

    def make(path):
        padded = header.ljust(118 - len(header) % 64 + len(header)) + b"\n"
        array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("time_s.npy", array)
            archive.writestr("speed_m_per_s.npy", array)

    return make


def huge_npz(path):
    """A terabyte of zeros, as its header has it."""
    npz_of(b"{'descr': '<f8', 'fortran_order': False, 'shape': (137438953472,), }")(path)


def running_npz(path):
    npz_of(b"{'descr': __import__('os').getcwd(), 'fortran_order': False, 'shape': (1,), }")(path)


def hdf5_of(**dataset):
    def make(path):
        write_h5(path, columns(time_s=None))
        with h5py.File(path, "a") as file:
            file.create_dataset("time_s", **dataset)

    return make


def hdf5_virtual(path):
    write_h5(path, columns(time_s=None))
    write_h5(path.with_name("other.h5"), COLUMNS)
    layout = h5py.VirtualLayout((N,), "f8")
    layout[:] = h5py.VirtualSource(path.with_name("other.h5"), "time_s", (N,))
    with h5py.File(path, "a") as file:
        file.create_virtual_dataset("time_s", layout)


def mat_of(**changes):
    return lambda path: write_mat(path, columns(**changes))


def mat_huge(path):
    """A sparse promise: one variable of 2^31 - 1 rows, none of them there."""
    write_mat(path, {"time_s": TIME_S})
    whole = path.read_bytes()
    offset = whole.index(struct.pack("<ii", N, 1))
    path.write_bytes(whole[:offset] + struct.pack("<ii", 2**31 - 1, 1) + whole[offset + 8 :])


def mat73_of(kind):
    def make(path):
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in COLUMNS.items():
                file[name] = values[None]
            file["time_s"].attrs["MATLAB_class"] = np.bytes_(kind)

    return make


def mat73_struct(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns(time_s=None).items():
            file[name] = values[None]
        file["time_s/inner"] = TIME_S[None]


STRUCT = np.array([(1.0, 2.0)], dtype=[("a", "f8"), ("b", "f8")])
CELL = np.array([TIME_S, "x"], dtype=object)
SPECIAL = {
    "npz of a terabyte": ("r.npz", huge_npz, ["time_s", "limit"]),
    "npz that runs": ("r.npz", running_npz, ["voltage_0_V"]),
    "npz of nothing": (
        "r.npz",
        lambda path: zipfile.ZipFile(path, "w").close(),
        ["no column in the file"],
    ),
    "hdf5 of a terabyte": (
        "r.h5",
        hdf5_of(shape=(2**37,), dtype="f8", chunks=(2**20,)),
        ["time_s", "limit"],
    ),
    "hdf5 elsewhere": (
        "r.h5",
        hdf5_of(shape=(N,), dtype="f8", external=[("/etc/hostname", 0, 8 * N)]),
        ["time_s lies in another file"],
    ),
    "hdf5 virtual": ("r.h5", hdf5_virtual, ["time_s lies in another file"]),
    "hdf5 of nothing": ("r.h5", hdf5_of(data=h5py.Empty("f8")), ["time_s has shape ()"]),
    "hdf5 of words": ("r.h5", hdf5_of(data=["a"] * N), ["time_s", "real numbers"]),
    "mat of 2^31 rows": ("r.mat", mat_huge, []),
    "mat struct": ("r.mat", mat_of(time_s=STRUCT), ["time_s."]),
    "mat nested struct": ("r.mat", mat_of(time_s={"a": {"b": TIME_S}}), ["time_s."]),
    "mat cell": ("r.mat", mat_of(time_s=CELL), ["time_s is a MATLAB cell"]),
    "mat char": ("r.mat", mat_of(time_s="0 1 2"), ["time_s is a MATLAB char"]),
    "mat sparse": (
        "r.mat",
        mat_of(time_s=scipy.sparse.csc_array(TIME_S[None])),
        ["time_s is a MATLAB sparse"],
    ),
    "mat73 char": ("r.mat", mat73_of("char"), ["time_s is a MATLAB char"]),
    "mat73 object": ("r.mat", mat73_of("datetime"), ["time_s is a MATLAB datetime"]),
    "mat73 struct": ("r.mat", mat73_struct, ["time_s."]),
}


@pytest.mark.parametrize("case", SPECIAL)
def test_more_than_it_holds(tmp_path, case):
    name, make, words = SPECIAL[case]
    make(tmp_path / name)
    assert_refused(tmp_path / name, words)


@pytest.mark.parametrize(
    ("format", "package"), [("tdms", "nptdms"), ("parquet", "pyarrow"), ("flac", "soundfile")]
)
def test_without_the_package_of_a_format(tmp_path, monkeypatch, format, package):
    path = write(format, tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    # In this process: the one that isolates it has its own packages.
    monkeypatch.setattr(_apart, "sys", SimpleNamespace(executable=""))
    assert_refused(path, [f"pip install srsinv[{format}]"], **known(format))


# Sidecars: text -> words of the sentence

SIDECARS = {
    '{"gain": 0}': ["gain is 0", "above 0"],
    '{"gain": -2}': ["gain is -2", "above 0"],
    '{"gain": "ten"}': ["gain is 'ten'"],
    '{"gain": [1, 2, 3]}': ["gain lists 3", "2 signal columns"],
    '{"gain": [1, "x"]}': ["gain is [1, 'x']"],
    '{"gain": {"a": 1}}': ["gain is {'a': 1}"],
    '{"polarity": 2}': ["polarity is 2", "1 or -1"],
    '{"polarity": "up"}': ["polarity is 'up'"],
    '{"polarity": true}': ["polarity is true"],
    '{"polarity": [1]}': ["polarity lists 1"],
    '{"speed_m_per_s": "fast"}': ["speed_m_per_s is 'fast'"],
    '{"speed_m_per_s": [1]}': ["speed_m_per_s is [1]"],
    '{"sample_rate_hz": -1}': ["sample_rate_hz is -1", "above 0"],
    '{"sample_rate_hz": 0}': ["sample_rate_hz is 0"],
    '{"sample_rate_hz": "1 kHz"}': ["sample_rate_hz is '1 kHz'"],
    '{"sample_rate_hz": 1e999}': ["sample_rate_hz is inf"],
    '{"scan_start_m": {}}': ["scan_start_m is {}"],
    '{"channels": 3}': ["channels is 3", "column names"],
    '{"channels": []}': ["channels is []"],
    '{"channels": ["voltage_2_V"]}': ["'voltage_2_V'", "nearest"],
    '{"channels": ["voltage_0_V", "voltage_0_V"]}': ["named twice"],
    '{"channels": ["time_s"]}': ["'time_s' cannot name"],
    '{"channels": [[1]]}': ["channels is [[1]]"],
    '{"time_unit": 5}': ["time_unit is 5"],
    '{"signal_unit": ["V"]}': ["signal_unit is ['V']"],
    '{"sensor": 3}': ["sensor is 3", "a mapping"],
    '{"sensor": []}': ["sensor is []"],
    '{"sensor": {"depth_m": 0}}': ["sensor.depth_m is 0"],
    '{"sensor": {"depth_m": "deep"}}': ["sensor.depth_m is 'deep'"],
    '{"sensor": {"depth_m": [1]}}': ["sensor.depth_m is [1]"],
    '{"sensor": {"depth_m": true}}': ["sensor.depth_m is true"],
    '{"sensor": {"elements": 3}}': ["sensor.elements is 3"],
    '{"sensor": {"elements": []}}': ["lists 0", "2 signal columns"],
    '{"sensor": {"elements": [{}]}}': ["lists 1", "2 signal columns"],
    '{"sensor": {"elements": [{}, {"offset_m": "x"}]}}': ["elements[1].offset_m is 'x'"],
    '{"sensor": {"piezo_constants_C_per_N": 5}}': ["piezo_constants_C_per_N is 5"],
    '{"sensor": {"piezo_constants_C_per_N": {"d4": 5}}}': ["no key", "d1, d2, d3"],
    '{"skin": "soft"}': ["skin is 'soft'"],
    '{"feature": [1]}': ["feature is [1]"],
    '{"nominal_pressure_Pa": "20 kPa"}': ["nominal_pressure_Pa is '20 kPa'"],
    '{"contact_window_m": [1]}': ["contact_window_m is [1]"],
    '{"contact_window_m": [2, 1]}': ["contact_window_m is [2, 1]", "the start below"],
    '{"contact_window_m": "all"}': ["contact_window_m is 'all'"],
    '{"gain": NaN}': ["r.json", "NaN", "JSON"],
    '{"gain": 1': ["r.json", "JSON"],
    "[]": ["r.json", "a mapping"],
    "null": ["r.json", "a mapping"],
    "gain: 2": ["r.json", "JSON"],
    "": ["r.json", "is empty"],
    "1" * 5000: ["r.json", "JSON"],
    '{"speed_m_per_s": 1' + "0" * 400 + "}": ["speed_m_per_s is 1000"],
}


@pytest.mark.parametrize("text", SIDECARS, ids=lambda text: text[:40])
def test_sidecar(tmp_path, text):
    write("csv", tmp_path)
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(BadInput) as caught:
        load(tmp_path / "r.csv")
    assert_one_sentence(caught.value, "r.", *SIDECARS[text])


# Anything at all: it loads, or it is refused in one sentence, and so does a look at it

FUZZ = settings(
    derandomize=True,
    max_examples=100,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def read_or_refused(path, **stated):
    for read in (load, inspect):
        try:
            read(path, **stated)
        except BadInput as refusal:
            assert_clear_message(refusal)  # it may quote anything


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """The bytes of a good file of each format."""
    folder = tmp_path_factory.mktemp("good")
    return {format: write(format, folder).read_bytes() for format in FORMATS}


@pytest.mark.parametrize("format", quick([f for f in FORMATS if f not in HDF5], "csv"))
@given(data=st.data())
@FUZZ
def test_damaged_bytes(tmp_path, good, format, data):
    damaged = bytearray(good[format])
    at = st.integers(0, len(damaged) - 1)
    for place in data.draw(st.lists(at, max_size=6)):
        damaged[place] = data.draw(st.integers(0, 255))
    length = data.draw(st.one_of(st.just(len(damaged)), at))
    path = tmp_path / FORMATS[format][0]
    path.write_bytes(damaged[:length])
    read_or_refused(path, **known(format))


@pytest.mark.full
@pytest.mark.parametrize("name", dict.fromkeys(name for name, _ in FORMATS.values()))
@given(content=st.binary(max_size=400))
@settings(FUZZ, max_examples=30)
def test_random_bytes(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    read_or_refused(tmp_path / name, **SPEED)


@given(text=st.text(alphabet="time_svolag0123456789.,;\n\t#-+einf\"' ", max_size=200))
@FUZZ
def test_random_text(tmp_path, text):
    (tmp_path / "r.csv").write_text(text)
    read_or_refused(tmp_path / "r.csv", **SPEED)


KEYS = st.sampled_from(
    ["sensor", "depth_m", "elements", "gain", "polarity", "channels", "speed_m_per_s", "skin",
     "sample_rate_hz", "contact_window_m", "time_unit", "signal_unit", "scan_start_m", "offset_m",
     "piezo_constants_C_per_N", "feature", "nominal_pressure_Pa"]
) | st.text(max_size=3)  # fmt: skip
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda part: st.lists(part, max_size=3) | st.dictionaries(KEYS, part, max_size=4),
    max_leaves=6,
)


@pytest.mark.full
@given(sidecar=st.dictionaries(KEYS, VALUES, max_size=5))
@FUZZ
def test_random_sidecars(tmp_path, sidecar):
    write("csv", tmp_path)
    (tmp_path / "r.json").write_text(json.dumps(sidecar))
    read_or_refused(tmp_path / "r.csv")


@pytest.mark.full
@given(text=st.text(alphabet="gaindepth_m:[]{}&*!-'\"#\n 0123.", max_size=80))
@FUZZ
def test_random_yaml(tmp_path, text):
    write("csv", tmp_path)
    (tmp_path / "r.yaml").write_text(text)
    read_or_refused(tmp_path / "r.csv")


# The command: exit code 2, one line on standard error, nothing left behind

COMMANDS = {
    "NaN in time": ("csv", with_value("time_s", ROW, np.nan), (), "time_s, data row 5"),
    "lengths": ("npz", columns(time_s=TIME_S[1:]), (), "time_s 11"),
    "time goes back": ("hdf5", columns(time_s=BACK), (), "data row 5"),
    "no signals": ("netcdf", {"time_s": TIME_S}, (), "recording.channels"),
    "2-D": ("mat", columns(time_s=SIGNAL), (), "time_s has shape"),
    "two samples": ("mat73", {n: v[:2] for n, v in COLUMNS.items()}, (), "too few samples: 2"),
    "no speed": ("wav", None, (), "no speed"),
    "wrong channel": ("tdms", COLUMNS, ("recording.channels=[volts]",), "no column 'volts'"),
    "gain 0": ("csv", COLUMNS, ("recording.gain=0",), "gain is 0"),
    "polarity 3": ("csv", COLUMNS, ("recording.polarity=3",), "polarity is 3"),
}


@pytest.mark.full
@pytest.mark.parametrize("case", COMMANDS)
def test_command(tmp_path, monkeypatch, capsys, case):
    format, table, stated, words = COMMANDS[case]
    monkeypatch.chdir(tmp_path)
    path = write(format, tmp_path, table)
    before = sorted(tmp_path.rglob("*"))
    overrides = ("experiment=invert_recording", f"recording.path={path.name}", *stated)
    assert command("run", *overrides) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"srsinv: {path.name}: ")
    assert captured.err.count("\n") == 1
    assert words in captured.err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "words"),
    [("absent.csv", "no such file"), ("r.txt", "no column holds a number"), ("r.xlsx", "'.xlsx'")],
)
def test_command_to_inspect(tmp_path, monkeypatch, capsys, name, words):
    monkeypatch.chdir(tmp_path)
    for other in ("r.txt", "r.xlsx"):
        Path(other).write_text("a,b\nx,y\n")
    assert command("run", "experiment=inspect_recording", f"recording.path={name}") == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert words in captured.err
    assert sorted(os.listdir(tmp_path)) == ["r.txt", "r.xlsx"]
