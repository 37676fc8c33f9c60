"""Any file at all: a recording, or a refusal in one sentence that names what is wrong.

Nothing else comes out: no other exception, no warning (which fails a test), no file, no process.
"""

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording.inspection import inspect
from tests.recording.bad import BAD, GOOD, HARMFUL, LARGE, Bad
from tests.recording.files import (
    COLUMNS,
    FORMATS,
    TIME_S,
    WITHOUT_TIMES,
    N,
    columns,
    with_value,
    write,
    write_wav,
)
from tests.recording.fuzz import PACKED

ROOT = Path(__file__).parents[2]
BINARY = tuple(format for format in FORMATS if format != "csv")
TABLES = tuple(format for format in FORMATS if format not in WITHOUT_TIMES)
SPEED = {"speed_m_per_s": 0.05}
NAMES = tuple(dict.fromkeys(name for name, _ in FORMATS.values()))
MOST_CHARACTERS = 700


def known(format: str) -> dict[str, float]:
    """What has to be stated beside a good file: WAV and FLAC know their signals and the rate."""
    return SPEED if format in WITHOUT_TIMES else {}


def check_sentence(said: str, *words: str) -> None:
    """One line: the file, what is wrong with these words, and after the last colon the remedy."""
    assert said.isprintable()
    assert len(said.split(": ")) >= 3, said
    assert len(said) < MOST_CHARACTERS + (0 if words else 10**4), said
    for internal in ("Traceback", "Error", "Exception", "0x", "<class"):
        assert internal not in said
    assert [word for word in words if word not in said] == [], said


def check_refusal(path: Path, *words: str, **stated) -> None:
    """A file is refused by these words, and its folder is left as it was."""
    before = {each: each.lstat().st_mtime_ns for each in path.parent.iterdir()}
    with pytest.raises(BadInput) as caught:
        load(path, **stated)
    said = str(caught.value)
    check_sentence(said, "r.", *words)
    assert said.endswith(("...", ".", "?", ")"))
    assert ". " not in said.replace("... ", "")
    assert {each: each.lstat().st_mtime_ns for each in path.parent.iterdir()} == before


# By name


@pytest.mark.parametrize("case", BAD)
def test_a_mistake_is_named(tmp_path, case):
    bad: Bad = BAD[case]
    path = tmp_path / bad.file
    bad.make(path)
    stated = {key: tmp_path / v if key == "sidecar" else v for key, v in bad.known.items()}
    check_refusal(path, *bad.words, **stated)


BACK = np.where(np.arange(N) == 4, TIME_S[1], TIME_S)
IN_EVERY_FORMAT = {
    "NaN in a signal": (
        with_value("voltage_1_V", 4, np.nan), ["voltage_1_V", "row 5", "recording.missing=allow"]
    ),
    "time goes back": (columns(time_s=BACK), ["row 5", "does not come after"]),
    "no speed": (columns(speed_m_per_s=None), ["recording.speed_m_per_s"]),
    "two samples": ({name: v[:2] for name, v in COLUMNS.items()}, ["2 samples", "at least 3"]),
    "no samples": ({name: values[:0] for name, values in COLUMNS.items()}, []),
}  # fmt: skip


@pytest.mark.parametrize("format", TABLES)
def test_mistakes_of_every_format(tmp_path, format):
    for table, words in IN_EVERY_FORMAT.values():
        check_refusal(write(format, tmp_path, table), *words)


@pytest.mark.parametrize("format", WITHOUT_TIMES)
def test_mistakes_of_sound_files(tmp_path, format):
    check_refusal(write(format, tmp_path), "recording.speed_m_per_s")
    write_wav(tmp_path / "r.wav", {"left": np.zeros(2, np.int16)})
    check_refusal(tmp_path / "r.wav", "2 samples", **SPEED)


# Bytes of the wrong kind

POSING = {
    "a line break": b"\n",
    "text": GOOD.encode(),
    "zeros": bytes(4096),
    "noise": np.random.default_rng(3).bytes(4096),
    "a pickle": b"\x80\x04\x95\x1a\x00\x00\x00\x00\x00\x00\x00\x8c\x08builtins\x94\x8c\x04eval",
}


@pytest.mark.parametrize("name", NAMES)
def test_bytes_of_another_kind(tmp_path, name):
    for kind, content in POSING.items():
        if (name, kind) != ("r.csv", "text"):  # which it should be
            (tmp_path / name).write_bytes(content)
            check_refusal(tmp_path / name, **SPEED)


# netCDF and MATLAB 7.3 are HDF5, and may be read as such.
HDF5 = ("hdf5", "netcdf", "mat73")


@pytest.mark.parametrize("format", FORMATS)
def test_suffix_of_another_format(tmp_path, format):
    alike = [FORMATS[other][0] for other in (HDF5 if format in HDF5 else (format,))]
    good = write(format, tmp_path).read_bytes()
    for name in NAMES:
        if name not in alike:
            (tmp_path / name).write_bytes(good)
            check_refusal(tmp_path / name, "suffix", **SPEED)


@pytest.mark.parametrize("format", BINARY)
def test_cut_short(tmp_path, format):
    path = write(format, tmp_path)
    whole = path.read_bytes()
    for fraction in (0.02, 0.5, 0.9):
        path.write_bytes(whole[: int(fraction * len(whole))])
        check_refusal(path, "write it again", **known(format))


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is unreadable for root")
def test_an_unreadable_file(tmp_path):
    path = write("csv", tmp_path)
    path.chmod(0)
    check_refusal(path, "permissions")


# Anything at all

FUZZ = settings(
    derandomize=True,
    max_examples=40,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def read_or_refused(path: Path, **stated) -> None:
    for read in (load, inspect):
        try:
            read(path, **stated)
        except BadInput as refusal:
            check_sentence(str(refusal))  # it may quote anything


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
YAML = st.text(alphabet="gaindepth_m:[]{}&*!-'\"#\n 0123.", max_size=80)


@pytest.mark.full
@given(facts=st.dictionaries(KEYS, VALUES, max_size=5), text=YAML)
@FUZZ
def test_random_sidecars(tmp_path, facts, text):
    path = write("csv", tmp_path)
    for suffix, content in (("json", json.dumps(facts)), ("yaml", text)):
        path.with_suffix(f".{suffix}").write_text(content)
        read_or_refused(path)
        path.with_suffix(f".{suffix}").unlink()


# Files that harm, in a process of their own: refused soon and in little memory


def python(*arguments: object, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", "-m", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=timeout_s)


MOST_SECONDS, MOST_MB = 5.0, 500.0  # for reading a file twice, by `load` and by `inspect`


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("harmful")


@functools.cache
def reports(folder: Path, *cases: str) -> dict[str, dict]:
    done = python("tests.recording.reading", folder, *cases)
    return {each["case"]: each for each in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize(
    "case",
    [
        *(pytest.param(case, marks=pytest.mark.full) for case in HARMFUL),
        *(pytest.param(case, marks=pytest.mark.claim) for case in LARGE),
    ],
)
def test_a_harmful_file_is_refused_soon_and_in_little_memory(folder, case):
    bad = (HARMFUL | LARGE)[case]
    every = reports(folder, *(HARMFUL if case in HARMFUL else LARGE))
    assert case in every, "the process that read it crashed or hung"
    said, inspected = every[case]["said"]
    check_sentence(said, bad.file, *bad.words)
    assert inspected == "read" or inspected.isprintable()
    assert every[case]["s"] < MOST_SECONDS
    assert every[case]["MB"] < MOST_MB


@pytest.mark.full
@pytest.mark.parametrize("copies", [6, pytest.param(1000, marks=pytest.mark.claim)])
def test_damaged_files_are_read_or_refused(tmp_path, copies):
    """In a process of its own; a file beside them is left alone."""
    formats = FORMATS | PACKED
    beside = tmp_path / "canary.csv"
    beside.write_text("alive")
    done = python("tests.recording.fuzz", tmp_path, copies, copies, *formats, timeout_s=9000.0)
    assert done.returncode == 0, done.stdout[-200:] + done.stderr[-2000:]
    read = [line.partition(":")[0] for line in done.stdout.splitlines()]
    assert {format: read.count(format) for format in formats} == dict.fromkeys(formats, copies)
    assert "unprintable" not in done.stdout
    assert beside.read_text() == "alive"
    files = {name for name, _ in formats.values()}
    assert {path.name for path in tmp_path.iterdir()} == {"canary.csv", *files}
