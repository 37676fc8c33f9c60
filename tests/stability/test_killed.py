"""A run that is killed, or whose disk fails, leaves whole files only, and the next one works."""

import contextlib
import json
import multiprocessing
import random
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import xarray
import yaml

from srsinv.recording import load
from tests.stability import killed

CONFIG = """\
defaults:
  - _self_
  - override hydra/job_logging: none
  - override hydra/hydra_logging: none
job: tests.stability.killed.job
value: 2.0
hydra:
  output_subdir: null
"""
KILLS = 10
PAGE = {
    "metrics.json", "result.nc", "report.html", "figures/signal.png", "notes.yaml",
    ".hydra/config.yaml", ".hydra/hydra.yaml", ".hydra/overrides.yaml",
}  # fmt: skip
PATIENCE_S = 60


@pytest.fixture(scope="module")
def fork():
    """A process from one that has imported all there is, to start each in no time."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.stability.killed", "srsinv.command.launch"])

    def start(work, *arguments):
        process = context.Process(target=work, args=arguments)
        process.start()
        return process

    return start


def ended(process) -> int | None:
    process.join(PATIENCE_S)
    return process.exitcode


def seen(folder: Path) -> set[str]:
    """Every file that is there, hidden or not."""
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def check_whole(path: Path) -> None:
    """Read the file to its end, as its kind is read."""
    kind, data = path.suffix, path.read_bytes()
    if kind == ".json":
        json.loads(data)
    elif kind == ".yaml":
        assert isinstance(yaml.safe_load(data), dict | list)
    elif kind == ".html":
        assert data.rstrip().endswith(b"</html>")
    elif kind == ".png":
        assert data.startswith(b"\x89PNG\r\n")
        assert data[-12:] == struct.pack(">I", 0) + b"IEND\xae\x42\x60\x82"
    elif kind == ".nc":
        with xarray.open_dataset(path, engine="h5netcdf") as found:
            found.load()
    else:
        raise AssertionError(f"a file of another kind: {path.name}")


def check_folder(folder: Path, wanted: set[str]) -> None:
    """Nothing, or all of a run."""
    found = seen(folder) if folder.exists() else set()
    assert not found or found >= wanted
    for name in found:
        check_whole(folder / name)


@pytest.fixture
def root(tmp_path):
    """The configuration of a quick job."""
    folder = tmp_path / "configs"
    folder.mkdir()
    (folder / "config.yaml").write_text(CONFIG, encoding="utf-8")
    return folder


def test_killed_at_any_moment(fork, root, tmp_path):
    """Nothing, or a whole run; the next one in the same place is whole, and leaves nothing else."""
    for name in ("first", "second"):  # the first one waits for the imports
        started = time.monotonic()
        assert ended(fork(killed.command, root, tmp_path / name)) == 0
        lasting = time.monotonic() - started
        assert seen(tmp_path / name) == PAGE
    moments = random.Random(0)
    folder = tmp_path / "here" / "run"
    for i in range(KILLS):
        process = fork(killed.command, root, folder)
        process.join(lasting * (i + moments.random()) / KILLS)
        process.kill()
        ended(process)
        check_folder(folder, PAGE)
    assert ended(fork(killed.command, root, folder)) == 0
    check_folder(folder, PAGE)
    assert [path.name for path in folder.parent.iterdir()] == ["run"]
    assert (folder / "metrics.json").read_bytes() == (
        tmp_path / "first" / "metrics.json"
    ).read_bytes()


# (writer, how many of its calls work)
BREAKS = [
    *(("text", after) for after in range(6)),
    ("netcdf", 0),
    ("figure", 0),
    ("rename", 0),
]


@pytest.mark.parametrize("how", ["raise", "exit"])
def test_page_is_whole_or_not_there(fork, tmp_path, how):
    """Every write of a page fails once, half done: no file of it is there; then it works."""
    folder = tmp_path / "run"
    for writer, after in BREAKS:
        process = fork(killed.breaking, "page", folder, 2.0, writer, after, how)
        # A name that cannot be changed at once is changed file by file.
        worked = writer == "rename" and how == "raise"
        assert ended(process) == (0 if worked else {"raise": 3, "exit": 9}[how]), writer
        assert seen(folder) == (PAGE if worked else set()), writer
    killed.page(folder, 3.0)
    check_folder(folder, PAGE)
    assert json.loads((folder / "metrics.json").read_bytes()) == {"value": 3.0}
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("how", ["raise", "exit"])
@pytest.mark.parametrize("after", [0, 3, len(PAGE) - 1])
def test_page_over_an_older_one(fork, tmp_path, how, after):
    """Files of an older page are replaced one by one, each whole, the metrics last."""
    folder = tmp_path / "run"
    killed.page(folder, 2.0)
    process = fork(killed.breaking, "page", folder, 3.0, "replace", after, how)
    assert ended(process) == {"raise": 3, "exit": 9}[how]
    check_folder(folder, PAGE)
    assert json.loads((folder / "metrics.json").read_bytes()) == {"value": 2.0}
    killed.page(folder, 3.0)
    assert json.loads((folder / "metrics.json").read_bytes()) == {"value": 3.0}
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("how", ["raise", "exit"])
@pytest.mark.parametrize("suffix", ["csv", "nc"])
def test_recording_is_whole(fork, tmp_path, suffix, how):
    """Every write of a recording over an older one fails once: one of both is read, whole, and
    what was left over goes with the next write."""
    path = tmp_path / f"made.{suffix}"
    killed.recording(path, 2.0)
    breaks = {"csv": [("text", 0), ("replace", 0), ("replace", 1)], "nc": [("netcdf", 0)]}[suffix]
    for writer, after in breaks:
        process = fork(killed.breaking, "recording", path, 3.0, writer, after, how)
        assert ended(process) == {"raise": 3, "exit": 9}[how], (writer, after)
        np.testing.assert_array_equal(load(path).signal, np.full((1, 10), 2.0))
    killed.recording(path, 3.0)
    np.testing.assert_array_equal(load(path).signal, np.full((1, 10), 3.0))
    wanted = {path.name, "made.json"} if suffix == "csv" else {path.name}
    assert {each.name for each in tmp_path.iterdir()} == wanted


def test_a_folder_that_cannot_be_staged_beside(tmp_path):
    """In a folder whose parent takes no more files the page is written as well."""
    folder = tmp_path / "closed" / "run"
    folder.mkdir(parents=True)
    folder.parent.chmod(0o555)
    with contextlib.ExitStack() as opened:
        opened.callback(folder.parent.chmod, 0o755)
        killed.page(folder, 2.0)
        assert {path.name for path in folder.iterdir()} == {
            "metrics.json", "result.nc", "report.html", ".hydra", "figures", "notes.yaml",
        }  # fmt: skip
    check_folder(folder, PAGE)
