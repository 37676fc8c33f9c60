"""Paths of any kind, files that change, readers that crash, and limits of the system."""

import os
import random
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from srsinv.atomic import write_whole
from srsinv.command.identity import identity
from srsinv.errors import BadInput
from srsinv.files import open_file, read_bytes, read_json
from srsinv.recording import _apart, load, load_profile, save
from srsinv.recording.flat_columns import load_columns
from srsinv.recording.inspection import inspect
from tests.recording.files import write, write_csv
from tests.recording.fuzz import PACKED, damaged
from tests.recording.test_bad_files import ROOT, SPEED, check_refusal, known
from tests.refusals import refused
from tests.tiers import quick

# HDF5 that brings its library down or keeps it busy: seeds of damage that did so

DEADLY = {
    "crash": ("packed hdf5", 552, "cut short"),
    "endless loop": ("packed netcdf", 62, "takes longer"),
}


@pytest.mark.parametrize("case", quick(DEADLY, "crash"))
def test_a_file_that_kills_its_reader(tmp_path, case):
    """It is refused, and the next file is read."""
    format, seed, said = DEADLY[case]
    name, make = PACKED[format]
    path = tmp_path / f"r{Path(name).suffix}"
    make(path)
    whole = path.read_bytes()
    path.write_bytes(damaged(whole, random.Random(seed)))
    check_refusal(path, said)
    path.write_bytes(whole)
    assert load(path).channels == ("voltage_0_V", "voltage_1_V")


# why the process ended, and by which status (None: it never began)
NO_PROCESS = {
    "cannot be started": None,
    "was killed": signal.SIGKILL,
    "takes longer than a file of this size may": signal.SIGXCPU,
}


@pytest.mark.full
@pytest.mark.parametrize("says", NO_PROCESS)
def test_a_process_that_ends_for_no_fault_of_the_file(tmp_path, monkeypatch, says):
    """The remedy is another than to write the file again as it is, and the next file is read."""
    path, ended = write("hdf5", tmp_path), NO_PROCESS[says]
    _apart._SERVER.stop()
    with monkeypatch.context() as broken:
        if ended is None:
            broken.setattr(_apart.sys, "executable", "/nonexistent/python")
        else:
            broken.setattr(_apart, "_table", lambda answer: None)
            broken.setattr(_apart._Server, "_ended", lambda self: int(ended))
        refused(lambda: load(path), says)
        assert load(write("npz", tmp_path)).signal.size
    _apart._SERVER.stop()
    assert load(path).signal.size


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


@pytest.mark.full
def test_a_hard_limit_on_memory_is_respected(tmp_path):
    """As schedulers set it; a process without privileges cannot raise it, and need not."""
    path = write("hdf5", tmp_path)
    script = "import sys, resource; from srsinv.recording import load;"
    script += "resource.setrlimit(resource.RLIMIT_AS, (10**9,) * 2);"
    script += "print(load(sys.argv[1]).signal.shape[0])"
    command = [sys.executable, "-c", script, path]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "2\n"


def test_too_little_memory_is_one_sentence(tmp_path, monkeypatch):
    def exhausted(*_, **__):
        raise MemoryError

    path = write("csv", tmp_path)
    monkeypatch.setattr("numpy.concatenate", exhausted)
    check_refusal(path, f"{path.stat().st_size} bytes", "more memory", "shorter parts")


@pytest.mark.parametrize(
    ("format", "package"), [("tdms", "nptdms"), ("parquet", "pyarrow"), ("flac", "soundfile")]
)
def test_without_the_package_of_a_format(tmp_path, monkeypatch, format, package):
    """The extra that is named has it, and what was saved in another format is the same."""
    path = write(format, tmp_path)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, package, None)
        # In this process: the one that isolates it has its own packages.
        without.setattr(_apart, "sys", SimpleNamespace(executable=""))
        said = refused(lambda: load(path, **known(format)), "r.")
    extra = re.search(r"pip install srsinv\[(\w+)\]", said)
    assert extra
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert [p for p in project["optional-dependencies"][extra[1]] if p.startswith(package)]
    got = load(path, **SPEED)
    save(got, tmp_path / "again.csv")
    np.testing.assert_array_equal(load(tmp_path / "again.csv").signal, got.signal)


# Paths: what is given -> words of the sentence

PATHS = {
    "x" * 300 + ".csv": ["file name too long"],
    "r\0.csv": ["recording.path is 'r\\x00.csv'", "printed"],
    "r\ud800.csv": ["recording.path is 'r\\ud800.csv'", "printed"],
    "": ["recording.path is ''"],
    "~nobody-of-this-name/r.csv": ["there is no such user"],
    "r.csv/x.csv": ["no such file"],
    "R.csv": ["did you mean r.csv?"],
}


@pytest.mark.parametrize("path", PATHS, ids=lambda path: ascii(path)[:20])
def test_paths(tmp_path, monkeypatch, path):
    write("csv", tmp_path)
    monkeypatch.chdir(tmp_path)
    for read in (load, inspect):
        with pytest.raises(BadInput) as caught:
            read(path)
        assert str(caught.value).isprintable()
        for word in PATHS[path]:
            assert word in str(caught.value)


def test_files_beside_a_recording_are_named_by_their_own_keys(tmp_path):
    said = refused(lambda: load_profile(tmp_path / "absent.csv", "scene.surfaces.skin.path"))
    assert "scene.surfaces.skin.path" in said
    assert "recording." not in said
    write_csv(tmp_path / "p.csv", {"x": range(5), "height_um": range(5)})
    refused(lambda: load_profile(tmp_path / "p.csv"), "position_m")
    names = ["position_m", "height_um"]
    refused(lambda: load_columns(tmp_path / "p.csv", names, "rig.path", "a file"), "rig.path")
    write_csv(tmp_path / "p.csv", {"position_m": range(5), "height_um": range(5)})
    columns = load_columns(tmp_path / "p.csv", names, "rig.path", "a file")
    np.testing.assert_allclose(columns["height_um"], range(5))
    profile = load_profile(tmp_path / "p.csv")
    np.testing.assert_allclose(profile["profile_m"], 1e-6 * np.arange(5))
    write_csv(tmp_path / "r.csv", {"time_s": range(9)})
    refused(lambda: load(tmp_path / "r.csv", calibration=tmp_path / "rig.json"), "calibration")


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
    refused(lambda: read_bytes(path, what="sidecar", most=99), "r.json", "100 bytes", "99")
    path.unlink()
    refused(lambda: read_bytes(path, what="sidecar", most=99), "recording.sidecar")
    os.mkfifo(path)
    refused(lambda: read_bytes(path, what="sidecar", most=99), "a pipe where the sidecar")
    path.unlink()
    if os.path.exists("/sys/kernel/mm"):  # whose files state more than they have
        path.symlink_to("/sys/devices/system/cpu/online")
        refused(lambda: read_bytes(path, what="sidecar", most=10**6), "copy it to a regular file")


def test_json_of_srsinv_itself(tmp_path):
    path, where = tmp_path / "metrics.json", {"what": "file", "key": "gather.folder", "most": 1000}
    path.write_text('{"a": 1}')
    assert read_json(path, **where) == {"a": 1}
    path.write_text('{"a": 1, "a": 2}')
    with pytest.raises(BadInput, match="repeat the command"):
        read_json(path, **where)


# What a job is known by is found out before any reader looks at its files


@pytest.mark.parametrize("target", ["pipe", "/proc/kmsg", "/dev/zero", "loop"])
def test_a_file_is_identified_without_being_waited_for(tmp_path, target):
    path = tmp_path / "r.csv"
    os.mkfifo(path) if target == "pipe" else path.symlink_to({"loop": path}.get(target, target))
    start = time.monotonic()
    assert identity({"recording": {"path": str(path)}}, None)
    assert time.monotonic() - start < 1.0


def test_another_file_in_the_way_is_left_alone(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("mine")
    with pytest.raises(BadInput, match="another file"):
        write_whole(path, b"new")
    path.rename(tmp_path / "mine.csv")
    write_whole(path, b"new")
    assert (path.read_bytes(), (tmp_path / "mine.csv").read_text()) == (b"new", "mine")
