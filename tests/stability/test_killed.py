"""A run that is killed, stopped, or whose disk fails, leaves one whole run or none, and nothing on
which a later command acts."""

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

from srsinv.atomic import is_scratch, opened, scratch_folder
from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.run_folder import MANIFEST, check, described
from tests.stability import killed
from tests.tiers import hardest, rare

PAGE = {*killed.PAGE, MANIFEST}
PATIENCE_S = 60
SOME = 3
ALL = pytest.param(1000, marks=pytest.mark.claim)
ROOT = Path(__file__).parents[2]
# What the command imports as it goes.
IMPORTED = (
    "srsinv.command.launch", "srsinv.report.files", "srsinv.report.page", "srsinv.report.terminal",
    "hydra.main", "jax", "equinox", "h5netcdf.legacyapi",
)  # fmt: skip


@pytest.fixture(scope="module")
def fork():
    """A process from one that has imported all there is, to start each in no time."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.stability.killed", *IMPORTED])

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


def kill_points(fork, work, where, listed, how="exit", most=SOME) -> list[int]:
    """Some of the changes on the disk that `work` makes in the folder `where`, the first and the
    last among them: of those that put files in place so many, and as many of the others. They go
    through the file `listed`."""
    assert ended(fork(killed.whole, work, where, 3.0, how, listed)) == 0
    changes = json.loads(listed.read_text())
    listed.unlink()
    renames = [i for i, name in enumerate(changes) if name in killed.RENAMES]
    others = sorted(set(range(len(changes))) - set(renames))
    points = []
    for each in (renames, others):
        points += [each[round(i)] for i in np.linspace(0, len(each) - 1, min(most, len(each)))]
    return sorted(points)


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
    check(folder)
    assert present == PAGE
    assert described(folder) is not None
    return json.loads((folder / "metrics.json").read_bytes())["value"]


def remains(folder: Path) -> list[Path]:
    """What is in a folder besides the run's: names of what was being made alone."""
    left = [path for path in folder.iterdir() if path.name != "run"]
    assert all(path.name.startswith(".srsinv-") for path in left)
    return left


@pytest.mark.parametrize("kills", [4, pytest.param(40, marks=pytest.mark.claim)])
def test_killed_at_any_moment(fork, root, tmp_path, kills):
    """Over an earlier run: that one, or the new one, is there as a whole at every moment; what is
    left beside it stays until the user removes it, and is in nobody's way."""
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
        assert value(folder) in (held, i + 4)
        held = value(folder)
        remains(folder.parent)
    assert ended(fork(killed.command, root, here, [f"hydra.run.dir={folder}"])) == 0
    assert value(folder) == 2.0


WORK = {"page": True, "page_by_renames": True, "page_here": False}  # whether whole at all times
# The common ones; those that are in `make test-all` beside them, so that every two are met; all
# others.
QUICK = {("page", "run", "exit"), ("page", "nothing", "raise"), ("page_here", "run", "exit")}
SLOW = {
    ("page_by_renames", "run", "exit"), ("page_by_renames", "nothing", "raise"),
    ("page_here", "run", "raise"), ("page_here", "nothing", "exit"),
}  # fmt: skip
LAST_CHANGES = hardest(itertools.product(WORK, ("nothing", "run"), ("raise", "exit")), QUICK, SLOW)


@pytest.mark.parametrize("most", [SOME, ALL])
@pytest.mark.parametrize(("work", "before", "how"), LAST_CHANGES)
def test_a_change_on_the_disk_is_the_last(fork, tmp_path, work, before, how, most):
    """One process for each file written, renamed or removed, which gets no further: there is the
    earlier run or the new one, whole. In the current folder, whose files are put in one by one,
    those of both are known for a run's, which the next run replaces."""
    folder = tmp_path / "run"

    def begin():
        shutil.rmtree(tmp_path)
        folder.mkdir(parents=True)
        if before != "nothing":
            killed.page(folder, 2.0)

    begin()
    for last in kill_points(fork, work, folder, tmp_path / "changes", how, most):
        begin()
        held = value(folder)
        code = ended(fork(killed.breaking, work, folder, 3.0, last, how))
        assert code in {"raise": (3, 4), "exit": (9,)}[how], last
        if WORK[work] and folder.exists():
            assert value(folder) in (held, 3.0), last
        if how == "raise":
            assert remains(tmp_path) == [], last
        elif not folder.exists():  # killed between two renames
            assert work == "page_by_renames"
            assert held in map(value, remains(tmp_path)), last
        for path in folder.glob(".srsinv-*"):  # as the user is told to
            shutil.rmtree(path)
        killed.page(folder, 4.0)
        assert value(folder) == 4.0, last


def test_remains_are_named_until_the_user_removes_them(fork, root, tmp_path):
    """Those of a run that was killed, by a command line that removes them; not those of a run that
    is at work, nor another's file of such a name."""
    here, words = tmp_path / "here", tmp_path / "words"
    here.mkdir()
    (here / ".srsinv-mine").write_text("mine")
    assert ended(fork(killed.breaking, "page", here / "run", 3.0, 20, "exit")) == 9
    (left,) = (path for path in remains(here) if path.is_dir())
    with opened(here) as descriptor, scratch_folder({"a": b"b"}, descriptor) as at_work:
        words.touch()
        assert ended(fork(killed.command, root, here, ["hydra.run.dir=other"], words)) == 0
        assert at_work not in words.read_text()
        typed = words.read_text().partition("rm -r ")[2]
        subprocess.run(["sh", "-c", f"rm -r {typed}"], cwd=here, check=True)
        assert not left.exists()
        assert (here / at_work).is_dir()
    assert sorted(os.listdir(here)) == [".srsinv-mine", "other", "run"]


SIZES = [8, *(pytest.param(size, marks=pytest.mark.claim) for size in (0, 4, 12, 16, 20))]  # kB


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
        for last in kill_points(fork, "page", folder, tmp_path / "source" / "changes"):
            assert ended(fork(killed.breaking, "page", folder, 3.0, last, "exit")) == 9
            # As the user is told to; beside it, where it does not look like a mount.
            for path in (*folder.glob(".srsinv-*"), *tmp_path.glob(".srsinv-*")):
                shutil.rmtree(path)
            killed.page(folder, 2.0)
            assert value(folder) == 2.0
            assert sorted(os.listdir(tmp_path)) == ["run", "source"]
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
            work, listed = "page_as_nobody", Path(above) / "changes"
            for last in kill_points(fork, work, folder, listed):
                assert ended(fork(killed.breaking, work, folder, 3.0, last, "exit")) == 9
                for path in folder.glob(".srsinv-*"):
                    shutil.rmtree(path)
                assert ended(fork(killed.whole, work, folder, last + 4.0, "exit", listed)) == 0
                assert value(folder) == last + 4.0
                assert os.listdir(folder.parent) == ["run"]
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
        assert str(folder) in sentence(words)
    gate.touch()
    assert ended(first) == 0
    assert value(folder) == 2.0


def test_many_runs_in_one_folder(fork, root, tmp_path):
    folder = tmp_path / "here" / "run"
    folder.parent.mkdir()
    runs = [
        fork(killed.command, root, tmp_path, [f"hydra.run.dir={folder}", f"value={i}"])
        for i in range(4)
    ]
    codes = [ended(run) for run in runs]
    assert set(codes) <= {0, 2}
    assert codes[value(folder)] == 0
    assert [path.name for path in folder.parent.iterdir()] == ["run"]


STOPS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize(("number", "where"), [
    *((number, "run") for number in STOPS),
    *((signal.SIGTERM, where) for where in ("nothing", "current", "sweep")),
])  # fmt: skip
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
    assert [path.name for path in tmp_path.glob("**/.srsinv-*")] == []
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
    assert all(" ..." in line for line in progress), words
    assert os.listdir(tmp_path) == []


# In the other half every two are met.
REPEATED = {
    ("nc", "raise", None),
    ("nc", "exit", 2.0),
    ("csv", "raise", 2.0),
    ("csv", "exit", None),
}
RECORDINGS = rare(itertools.product(("csv", "nc"), ("raise", "exit"), (None, 2.0)), *REPEATED)


@pytest.mark.parametrize(("suffix", "how", "held"), RECORDINGS)
def test_recording_is_whole(fork, tmp_path, suffix, how, held):
    """Wherever its writing ends, the recording is the earlier one or the new one, or not there."""
    path = tmp_path / f"made.{suffix}"

    def begin():
        for left in tmp_path.iterdir():
            left.unlink()
        if held:
            killed.recording(path, held)

    begin()
    for last in kill_points(fork, "recording", path, tmp_path / "changes", how):
        begin()
        code = ended(fork(killed.breaking, "recording", path, 3.0, last, how))
        assert code in {"raise": (3, 4), "exit": (9,)}[how], last
        try:
            written_signal = load(path).signal
        except BadInput:
            assert held is None
            assert not path.exists()
        else:
            assert (written_signal == written_signal[0, 0]).all()
            assert written_signal[0, 0] in (held, 3.0)
        left = {name for name in os.listdir(tmp_path) if not name.startswith("made.")}
        assert all(map(is_scratch, left))
        assert how == "exit" or not left
        killed.recording(path, 4.0)
        np.testing.assert_array_equal(load(path).signal, np.full((1, 10), 4.0))
