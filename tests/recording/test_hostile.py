"""Files made to harm the reader: one sentence each, soon, in little memory, and never a crash."""

import functools
import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from srsinv.command.identity import identity
from srsinv.errors import BadInput
from srsinv.files import open_file, read_bytes
from srsinv.recording import load, load_profile
from srsinv.recording.inspection import inspect
from tests.recording.files import FORMATS, write, write_csv
from tests.recording.fuzz import PACKED, damaged
from tests.recording.hostile import CASES, SLOW
from tests.recording.test_bad_files import assert_one_sentence
from tests.tiers import quick

ROOT = Path(__file__).parents[2]
COPIES = 25  # of a good file, damaged
MOST_SECONDS, MOST_MB = 5.0, 500.0  # for reading a file twice, by `load` and by `inspect`
QUICK = [case for case in CASES if case not in SLOW]


def python(*arguments: object, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", "-m", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=timeout_s)


@functools.cache
def results(folder: Path, *cases: str) -> dict[str, dict]:
    done = python("tests.recording.hostile", folder, *cases)
    return {each["case"]: each for each in map(json.loads, done.stdout.splitlines())}


def check(case: str, reports: dict[str, dict]) -> None:
    assert case in reports, "the process that read it crashed or hung"
    name, _, words = CASES[case]
    said, inspected = reports[case]["said"]
    assert said != "read"
    assert_one_sentence(said, name if len(name) < 20 else "", *words)
    assert inspected == "read" or inspected.isprintable()
    assert reports[case]["s"] < MOST_SECONDS
    assert reports[case]["MB"] < MOST_MB


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("hostile")


@pytest.fixture(scope="module")
def large(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("large")


@pytest.mark.full
@pytest.mark.parametrize("case", QUICK)
def test_one_sentence_soon_and_in_little_memory(folder, case):
    check(case, results(folder, *QUICK))


@pytest.mark.claim
@pytest.mark.parametrize("case", SLOW)
def test_large_files_too(large, case):
    check(case, results(large, *SLOW))


# HDF5 that brings its library down or keeps it busy: seeds of damage that did so

DEADLY = {
    "crash": ("packed hdf5", 552, "cut short"),
    "endless loop": ("packed netcdf", 62, "takes longer"),
}


@pytest.mark.parametrize("case", quick(DEADLY, "crash"))
def test_a_file_that_kills_its_reader(tmp_path, case):
    """It is refused, the next file is read, and nothing is left running."""
    format, seed, said = DEADLY[case]
    name, make = PACKED[format]
    make(tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(damaged(whole, random.Random(seed)))
    with pytest.raises(BadInput) as caught:
        load(tmp_path / name)
    assert_one_sentence(caught.value, name, said)
    (tmp_path / name).write_bytes(whole)
    assert load(tmp_path / name).channels == ("voltage_0_V", "voltage_1_V")


@pytest.mark.full
def test_a_process_that_ends_leaves_no_reader_behind(tmp_path):
    path = write("hdf5", tmp_path)
    script = "import os, sys; from srsinv.recording import load, _apart; load(sys.argv[1]);"
    script += "print(_apart._SERVER._process.pid, flush=True); os._exit(0)"
    done = subprocess.run(
        [sys.executable, "-c", script, path], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for _ in range(100):
        if not is_running(int(done.stdout)):
            return
        time.sleep(0.05)
    raise AssertionError("the server outlives its caller")


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{process}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")


# Paths: what is given -> words of the sentence

PATHS = {
    "x" * 300 + ".csv": ["file name too long"],
    "folder/" * 2000 + "r.csv": ["file name too long"],
    "r\0.csv": ["recording.path is 'r\\x00.csv'", "printed"],
    "r\ud800.csv": ["recording.path is 'r\\ud800.csv'", "printed"],
    "r\n.csv": ["recording.path is 'r\\n.csv'", "printed"],
    "": ["recording.path is ''"],
    "~nobody-of-this-name/r.csv": ["there is no such user"],
    "r.csv/x.csv": ["no such file"],
    "R.csv": ["did you mean r.csv?"],
}


@pytest.mark.parametrize("read", [load, inspect])
@pytest.mark.parametrize("path", PATHS, ids=lambda path: ascii(path)[:20])
def test_paths(tmp_path, monkeypatch, path, read):
    write("csv", tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput) as caught:
        read(path)
    assert str(caught.value).isprintable()
    for word in PATHS[path]:
        assert word in str(caught.value)


def test_a_profile_is_named_by_its_own_key(tmp_path):
    with pytest.raises(BadInput, match=r"check scene\.surfaces\.skin\.path=\.\.\.") as caught:
        load_profile(tmp_path / "absent.csv", "scene.surfaces.skin.path")
    assert "recording" not in str(caught.value)


# A file that changes, and bytes as such


CHANGES = {
    "appended to": lambda path: path.write_bytes(path.read_bytes() + b"1"),
    "cut short": lambda path: os.truncate(path, 10),
    "written again": lambda path: os.utime(path, (1, 1)),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_file_that_changes_while_it_is_read(tmp_path, change):
    path = write("csv", tmp_path)

    def read() -> None:
        with open_file(path) as file:
            file.read(1)
            CHANGES[change](path)

    with pytest.raises(BadInput, match="changed while it was read"):
        read()


def test_all_bytes_of_a_sidecar(tmp_path):
    path = tmp_path / "r.json"
    path.write_bytes(b"{}" * 50)
    assert read_bytes(path, what="sidecar", most=100) == b"{}" * 50
    with pytest.raises(BadInput) as caught:
        read_bytes(path, what="sidecar", most=99)
    assert_one_sentence(caught.value, "r.json: the sidecar is 100 bytes long", "limit of 99")
    path.unlink()
    with pytest.raises(BadInput, match=r"no such sidecar: check recording\.sidecar"):
        read_bytes(path, what="sidecar", most=99)
    write_csv(tmp_path / "r.csv", {"time_s": range(9)})
    with pytest.raises(BadInput, match=r"no such sidecar: check recording\.calibration"):
        load(tmp_path / "r.csv", calibration=tmp_path / "rig.json")
    os.mkfifo(path)
    with pytest.raises(BadInput, match="a pipe where the sidecar is expected"):
        read_bytes(path, what="sidecar", most=99)


def test_too_little_memory_is_one_sentence(tmp_path, monkeypatch):
    def exhausted(*_, **__):
        raise MemoryError

    path = write("csv", tmp_path)
    monkeypatch.setattr("numpy.concatenate", exhausted)
    with pytest.raises(BadInput) as caught:
        load(path)
    size = path.stat().st_size
    assert_one_sentence(caught.value, f"r.csv: {size} bytes", "more memory", "shorter parts")


@pytest.mark.full
@pytest.mark.parametrize("gigabytes", [8, 4, 1])
def test_a_hard_limit_on_memory_is_kept(tmp_path, gigabytes):
    """As schedulers set it; a process without privileges cannot raise it, and need not."""
    path = write("hdf5", tmp_path)
    script = "import sys, resource; from srsinv.recording import load;"
    script += f"resource.setrlimit(resource.RLIMIT_AS, ({gigabytes} * 10**9,) * 2);"
    script += "print(load(sys.argv[1]).signal.shape[0])"
    command = [sys.executable, "-c", script, path]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "2\n"


# What a job is known by is found out before any reader looks at its files


@pytest.mark.parametrize("target", ["pipe", "/proc/kmsg", "/proc/version", "/dev/zero", "loop"])
def test_a_file_is_identified_without_being_waited_for(tmp_path, target):
    path = tmp_path / "r.csv"
    os.mkfifo(path) if target == "pipe" else path.symlink_to({"loop": path}.get(target, target))
    start = time.monotonic()
    assert identity({"recording": {"path": str(path)}}, None)
    assert time.monotonic() - start < 1.0


# Damaged bytes, in a process of its own, a file beside it untouched


@pytest.mark.full
def test_damaged_files_are_read_or_refused(tmp_path):
    formats = FORMATS | PACKED
    beside = tmp_path / "canary.csv"
    beside.write_text("alive")
    done = python("tests.recording.fuzz", tmp_path, 0, COPIES, *formats)
    assert done.returncode == 0, done.stdout[-200:] + done.stderr[-2000:]
    read = [line.partition(":")[0] for line in done.stdout.splitlines()]
    assert {format: read.count(format) for format in formats} == dict.fromkeys(formats, COPIES)
    assert "unprintable" not in done.stdout
    assert beside.read_text() == "alive"
    files = {name for name, _ in formats.values()}
    assert {path.name for path in tmp_path.iterdir()} == {"canary.csv", *files}


@pytest.mark.claim
@pytest.mark.parametrize("format", [*FORMATS, *PACKED])
def test_many_damaged_files_are_read_or_refused(tmp_path, format):
    done = python("tests.recording.fuzz", tmp_path, 1000, 1000, format, timeout_s=600.0)
    assert done.returncode == 0, done.stdout[-200:] + done.stderr[-2000:]
    assert "unprintable" not in done.stdout
