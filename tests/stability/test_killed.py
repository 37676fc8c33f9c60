"""A run that is killed, stopped, or whose disk fails, leaves one whole run or none, and the next
command clears up after it."""

import itertools
import json
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.run_folder import MANIFEST, claim, listed, strangers
from tests.stability import killed

PAGE = {*killed.PAGE, MANIFEST}
PATIENCE_S = 60
MOST_CHANGES = 100
ROOT = Path(__file__).parents[2]


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


@pytest.fixture
def root(tmp_path):
    """The configuration of a quick job."""
    return killed.make_root(tmp_path / "clone")


def ended(process) -> int | None:
    process.join(PATIENCE_S)
    return process.exitcode


def wait_for(path: Path, process) -> None:
    latest = time.monotonic() + PATIENCE_S
    while not path.exists():
        assert process.exitcode is None, "it ended before its time"
        assert time.monotonic() < latest
        time.sleep(0.005)


def files_in(folder: Path) -> set[str]:
    """Every file that is there, hidden or not."""
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def value(folder: Path) -> float | None:
    """What a folder's whole run measured; None where it holds nothing. All else fails."""
    present = files_in(folder) if folder.exists() else set()
    if not present:
        return None
    files = listed(folder)
    assert files is not None, present
    assert not list(strangers(folder, files))
    # One that is older than manifests lists what is there.
    assert present in (PAGE, {*files, MANIFEST}) or present == PAGE - {MANIFEST, "notes.yaml"}
    return json.loads((folder / "metrics.json").read_bytes())["value"]


def recovered(folder: Path) -> float | None:
    """The value after the next command has come by."""
    with claim(folder):
        pass
    return value(folder)


@pytest.mark.parametrize("kills", [6, pytest.param(40, marks=pytest.mark.claim)])
def test_killed_at_any_moment(fork, root, tmp_path, kills):
    """Over an earlier run: that one, or the new one, is there as a whole at every moment, or is
    brought back by the next command, even one that writes elsewhere."""
    here = tmp_path / "here"
    here.mkdir()
    folder = here / "outputs" / "mine" / "run"
    for first in (2.0, 3.0):  # the first one waits for the imports
        started = time.monotonic()
        arguments = [f"hydra.run.dir={folder}", f"value={first}"]
        assert ended(fork(killed.command, root, here, arguments)) == 0
        lasting = time.monotonic() - started
    moments, held = random.Random(kills), 3.0
    for i in range(kills):
        arguments = [f"hydra.run.dir={folder}", f"value={i + 4}"]
        process = fork(killed.command, root, here, arguments)
        process.join(lasting * (i + moments.random()) / kills)
        process.kill()
        ended(process)
        current = value(folder)
        if current is None:
            assert value(folder.with_name(f".{folder.name}.srsinv") / "old") == held
        assert current in (None, held, i + 4)
        with claim(here / "outputs" / "other"):
            assert [path.name for path in folder.parent.iterdir()] == ["run"]
        held = value(folder)
        assert held in (current, held)
        assert held is not None
    assert ended(fork(killed.command, root, here, [f"hydra.run.dir={folder}"])) == 0
    assert value(folder) == 2.0


# The common ones; all others are slow.
QUICK = {("page", "run", "exit"), ("page", "nothing", "raise"), ("page_here", "run", "exit")}
LAST_CHANGES = [
    pytest.param(*case, marks=() if case in QUICK else pytest.mark.claim)
    for case in itertools.product(
        ("page", "page_here"), ("nothing", "run", "older run"), ("raise", "exit")
    )
]


@pytest.mark.parametrize(("work", "before", "how"), LAST_CHANGES)
def test_every_change_on_the_disk_is_the_last(fork, tmp_path, work, before, how):
    """One process for each file written, renamed or removed, which gets no further: afterwards
    there is the earlier run or the new one, whole, once the next command has come by."""
    folder = tmp_path / "run"
    last, codes = 0, []
    while 0 not in codes:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        if before != "nothing":
            killed.page(folder, 2.0)
        if before == "older run":
            killed.older(folder)
        held = value(folder)
        codes.append(ended(fork(killed.breaking, work, folder, 3.0, last, how)))
        assert codes[-1] in (0, *{"raise": (3, 4), "exit": (9,)}[how]), last
        if work == "page" and folder.exists():
            assert value(folder) in (held, 3.0), last
        if how == "raise":
            assert os.listdir(tmp_path) == ["run"], last
        assert recovered(folder) in (held, 3.0), last
        assert os.listdir(tmp_path) == ["run"], last
        last += 1
        assert last < MOST_CHANGES
    assert last > len(PAGE)
    assert value(folder) == 3.0


SIZES = [0, 8, 20, *(pytest.param(size, marks=pytest.mark.claim) for size in (4, 12, 16))]  # kB


def sentence(words: Path) -> str:
    """The one line of a refusal."""
    (line,) = words.read_text(encoding="utf-8").splitlines()
    assert line.startswith("srsinv: ")
    return line


def check_full(root, tmp_path, here, run) -> None:
    """`run` ends with a sentence; nothing is there, or what was there before."""
    words = tmp_path / "words"
    for folder, held in ((here / "new" / "run", None), (here / "run", 2.0)):
        process = run([f"hydra.run.dir={folder}", "value=3.0"], words)
        assert ended(process) == 2
        assert "make room" in sentence(words)
        assert value(folder) == held
    assert [path.name for path in here.iterdir()] == ["run"]


@pytest.mark.parametrize("size", SIZES)
def test_files_that_may_not_grow(fork, root, tmp_path, size):
    here = tmp_path / "here"
    killed.page(here / "run", 2.0)
    bytes_ = 400 + 250 * size  # the smallest file has 6 bytes, the largest 7 kB
    check_full(root, tmp_path, here, lambda a, w: fork(killed.limited, root, here, a, w, bytes_))


@pytest.mark.parametrize("size", SIZES)
def test_a_full_disk(fork, root, tmp_path, size):
    """On a file system with room for the earlier run and some pages of 4 kB."""
    here = tmp_path / "here"
    here.mkdir()
    mounted = ["mount", "-t", "tmpfs", "-o", f"size={60 + size}k", "srsinv", str(here)]
    if subprocess.run(mounted, capture_output=True).returncode:
        pytest.skip("needs to be allowed to mount")
    try:
        killed.page(here / "run", 2.0)
        check_full(root, tmp_path, here, lambda a, w: fork(killed.command, root, here, a, w))
    finally:
        subprocess.run(["umount", str(here)], check=True)


@pytest.mark.parametrize("kind", ["tmpfs", pytest.param("bind", marks=pytest.mark.claim)])
def test_a_folder_that_is_mounted(fork, tmp_path, kind):
    """It cannot be renamed, so files are moved in, whichever change is the last."""
    (tmp_path / "source").mkdir()
    folder = tmp_path / "run"
    folder.mkdir()
    options = {"bind": ["--bind", tmp_path / "source"], "tmpfs": ["-t", "tmpfs", "srsinv"]}[kind]
    if subprocess.run(["mount", *options, folder], capture_output=True).returncode:
        pytest.skip("needs to be allowed to mount")
    try:
        killed.page(folder, 2.0)
        assert value(folder) == 2.0
        last, code = 0, None
        while code != 0 and last < MOST_CHANGES:
            held = value(folder)
            code = ended(fork(killed.breaking, "page", folder, last + 3.0, last, "exit"))
            assert recovered(folder) in (held, last + 3.0)
            assert sorted(os.listdir(tmp_path)) == ["run", "source"]
            last += 1
        assert value(folder) == last + 2.0
        assert len(PAGE) < last < MOST_CHANGES
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_folder_whose_parent_takes_no_files(fork):
    """Its workspace is inside, whichever change is the last."""
    with tempfile.TemporaryDirectory() as above:
        folder = Path(above) / "closed" / "run"
        folder.mkdir(parents=True)
        if os.getuid() == 0:
            os.chown(folder, killed.NOBODY, killed.NOBODY)
        Path(above).chmod(0o755)
        folder.parent.chmod(0o555)
        try:
            last, code = 0, None
            while code != 0 and last < MOST_CHANGES:
                at = (folder, last + 3.0, last, "exit")
                code = ended(fork(killed.breaking, "page_as_nobody", *at))
                assert ended(fork(killed.breaking, "page_as_nobody", *at[:2], 999, "exit")) == 0
                assert value(folder) == last + 3.0
                assert os.listdir(folder.parent) == ["run"]
                last += 1
            assert len(PAGE) < last < MOST_CHANGES
        finally:
            folder.parent.chmod(0o755)


def test_two_runs_in_one_folder(fork, root, tmp_path):
    """The later one is refused, before its job, and the earlier one is whole."""
    folder, words, gate = tmp_path / "run", tmp_path / "words", tmp_path / "gate"
    first = fork(killed.command, root, tmp_path, [f"hydra.run.dir={folder}", f"wait_for={gate}"])
    wait_for(gate.with_suffix(".begun"), first)
    for same in (folder, tmp_path / "clone" / ".." / "run"):
        second = fork(killed.command, root, tmp_path, [f"hydra.run.dir={same}"], words)
        assert ended(second) == 2
        assert f"another run is writing to {folder}; wait until it has ended" in sentence(words)
    gate.touch()
    assert ended(first) == 0
    assert value(folder) == 2.0


def test_many_runs_in_one_folder(fork, root, tmp_path):
    folder = tmp_path / "here" / "run"
    folder.parent.mkdir()
    runs = [
        fork(killed.command, root, tmp_path, [f"hydra.run.dir={folder}", f"value={i}"])
        for i in range(6)
    ]
    codes = [ended(run) for run in runs]
    assert set(codes) <= {0, 2}
    assert codes[value(folder)] == 0
    assert [path.name for path in folder.parent.iterdir()] == ["run"]


# How to be in a process namespace of one's own, where other processes have no number.
APART = ["unshare", "--pid", "--fork", "--kill-child"]
ALONE = [*APART, "--user", "--map-root-user"]


@pytest.mark.claim
@pytest.mark.parametrize("last", ["done", "killed"])
def test_two_process_namespaces(root, tmp_path, last):
    """What a live run has begun is left alone by another that cannot see its process."""
    apart = next((a for a in (APART, ALONE) if not subprocess.run([*a, "true"]).returncode), None)
    if apart is None:
        pytest.skip("needs to be allowed to unshare")
    program = "import sys; from tests.stability.killed import *; command(*map(Path, sys.argv[1:3]),"
    program += "sys.argv[3:])"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}

    def start(*arguments):
        line = [*apart, sys.executable, "-c", program, str(root), str(tmp_path), *arguments]
        return subprocess.Popen(line, env=environment, cwd=tmp_path)

    folder, gate = tmp_path / "outputs" / "one" / "run", tmp_path / "gate"
    first = start(f"hydra.run.dir={folder}", f"wait_for={gate}")
    latest = time.monotonic() + PATIENCE_S
    while not gate.with_suffix(".begun").exists():
        assert first.poll() is None
        assert time.monotonic() < latest
        time.sleep(0.01)
    assert start(f"hydra.run.dir={folder}").wait(PATIENCE_S) == 2
    assert start("hydra.run.dir=outputs/two/run").wait(PATIENCE_S) == 0
    assert folder.with_name(".run.srsinv").is_dir()
    if last == "killed":
        first.kill()
        first.wait(PATIENCE_S)
        folder.rmdir()
        assert start("hydra.run.dir=outputs/two/run").wait(PATIENCE_S) == 0
        assert list(folder.parent.iterdir()) == []
    else:
        gate.touch()
        assert first.wait(PATIENCE_S) == 0
        assert value(folder) == 2.0


STOPS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize("where", ["nothing", "run", "current", "sweep"])
@pytest.mark.parametrize("number", STOPS)
def test_stopped_by_a_signal(fork, root, tmp_path, number, where):
    """What was begun is gone, what was there before is as it was; a sweep's runs that are done
    stay."""
    here, words, gate = tmp_path / "here", tmp_path / "words", tmp_path / "gate"
    here.mkdir()
    folder = here if where == "current" else here / "a" / "run"
    if where in ("run", "current"):
        killed.page(folder, 2.0)
    held = value(folder)
    if where == "sweep":
        arguments = ["-m", f"hydra.sweep.dir={folder}", f"wait_for=null,{gate}"]
    else:
        arguments = [f"hydra.run.dir={folder}", f"wait_for={gate}", "value=3"]
    process = fork(killed.command, root, here, arguments, words)
    wait_for(gate.with_suffix(".begun"), process)
    os.kill(process.pid, number)
    assert ended(process) == STOPS[number]
    assert f"stopped by {number.name}" in sentence(words)
    if where == "sweep":
        assert sorted(os.listdir(folder)) == ["0", "multirun.yaml", "run.json"]
        assert value(folder / "0") == 2.0
        shutil.rmtree(folder / "0")
    else:
        assert value(folder) == held
    assert [path.name for path in tmp_path.glob("**/.*.srsinv")] == []
    assert where != "nothing" or list(here.iterdir()) == []


@pytest.mark.claim
@pytest.mark.parametrize("moment", range(12))
def test_the_real_command_is_stopped_at_any_moment(tmp_path, moment):
    """While it imports, composes, compiles, computes or draws."""
    line = [sys.executable, "-m", "srsinv", "method=[wiener]", "hydra.run.dir=a/run"]
    process = subprocess.Popen(
        line, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    time.sleep(0.6 + 0.6 * moment)
    number = list(STOPS)[moment % len(STOPS)]
    process.send_signal(number)
    stopped = time.monotonic()
    _, words = process.communicate(timeout=PATIENCE_S)
    assert time.monotonic() - stopped < 3
    if process.returncode == 0:
        return
    assert process.returncode == STOPS[number]
    *progress, last = words.splitlines()
    assert last.startswith("srsinv: stopped by")
    assert all(line.endswith(" ...") for line in progress), words
    assert os.listdir(tmp_path) == []


def test_what_was_abandoned_elsewhere_goes_with_any_run(fork, root, tmp_path):
    """At every depth under outputs, and beside the new run wherever that is."""
    folders = ["outputs/a/run", "outputs/b/sweep/run", "outputs/run", "mine/run", "elsewhere/run"]
    gates = [tmp_path / f"gate{i}" for i in range(len(folders))]
    runs = [
        fork(killed.command, root, tmp_path, [f"hydra.run.dir={folder}", f"wait_for={gate}"])
        for folder, gate in zip(folders, gates, strict=True)
    ]
    for gate, run in zip(gates, runs, strict=True):
        wait_for(gate.with_suffix(".begun"), run)
    for run in runs:
        run.kill()
        ended(run)
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.glob("**/.run.srsinv"))
    assert left == [
        "elsewhere/.run.srsinv", "mine/.run.srsinv", "outputs/.run.srsinv", "outputs/a/.run.srsinv",
        "outputs/b/sweep/.run.srsinv",
    ]  # fmt: skip
    assert ended(fork(killed.command, root, tmp_path, ["hydra.run.dir=mine/other"])) == 0
    left = [str(path.relative_to(tmp_path)) for path in tmp_path.glob("**/.*.srsinv")]
    assert left == ["elsewhere/.run.srsinv"]  # neither beside it nor under outputs


@pytest.mark.parametrize("how", ["raise", "exit"])
@pytest.mark.parametrize("suffix", ["csv", "nc"])
@pytest.mark.parametrize("held", [None, 2.0])
def test_recording_is_whole(fork, tmp_path, suffix, how, held):
    """Every change on the disk is the last: the recording is the earlier one or the new one, or not
    there, and what was left over goes with the next write."""
    path = tmp_path / f"made.{suffix}"
    last, code = 0, None
    while code != 0 and last < MOST_CHANGES:
        for left in tmp_path.iterdir():
            left.unlink()
        if held:
            killed.recording(path, held)
        code = ended(fork(killed.breaking, "recording", path, 3.0, last, how))
        try:
            written_signal = load(path).signal
        except BadInput:
            assert held is None
            assert not path.exists()
        else:
            assert (written_signal == written_signal[0, 0]).all()
            assert written_signal[0, 0] in (held, 3.0)
        if how == "raise":
            assert {each.suffix for each in tmp_path.iterdir()} <= {".csv", ".json", ".nc"}
        killed.recording(path, 4.0)
        np.testing.assert_array_equal(load(path).signal, np.full((1, 10), 4.0))
        wanted = {path.name, "made.json"} if suffix == "csv" else {path.name}
        assert {each.name for each in tmp_path.iterdir()} == wanted
        last += 1
    assert 2 < last < MOST_CHANGES


@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir, lambda path: path.symlink_to("nowhere")])
def test_a_lock_that_is_no_file_holds_nobody_up(tmp_path, make):
    """In the workspace of another folder, which a run would clear if it could be locked."""
    (tmp_path / ".other.srsinv").mkdir()
    make(tmp_path / ".other.srsinv/lock")
    killed.page(tmp_path / "run", 1.0)
    assert {path for path in PAGE if (tmp_path / "run" / path).is_file()} == PAGE
    assert not (tmp_path / "nowhere").exists()
