"""What is run in a process of its own, and ends before its work is done."""

import contextlib
import json
import os
import resource
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from srsinv import atomic
from srsinv.__main__ import main
from srsinv.recording import Recording, save
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import WrittenSection
from srsinv.run_folder import RunRecord, claim

PAGE = (
    "metrics.json", "result.nc", "report.html", "figures/signal.png", "notes.yaml",
    ".hydra/config.yaml", ".hydra/hydra.yaml", ".hydra/overrides.yaml",
)  # fmt: skip
NOBODY = 65534
# What changes the disk, what of that a full one can refuse, and what puts a file in its place.
CHANGES = {
    "exit": ("mkdir", "rename", "link", "unlink", "rmdir", "chmod", "fsync"),
    "raise": ("mkdir", "rename", "link", "fsync"),
}
RENAMES = ("rename", "link", "_renameat2")

CONFIG = """\
defaults:
  - _self_
  - override hydra/job_logging: none
  - override hydra/hydra_logging: none
job: experiments.quick.run
value: 2.0
seed: 0
wait_for: null
hydra:
  output_subdir: null
  run: {dir: "outputs/${hydra.job.name}/${now:%H-%M-%S_%f}"}
  sweep: {dir: outputs/sweep, subdir: "${hydra.job.num}"}
"""
JOB = """\
from tests.stability import killed

def run(settings):
    return killed.job(settings)
"""


def make_root(folder: Path) -> Path:
    """A configuration folder, with a quick job beside it."""
    for path, text in (("configs/config.yaml", CONFIG), ("experiments/quick.py", JOB)):
        (folder / path).parent.mkdir(parents=True)
        (folder / path).write_text(text, encoding="utf-8")
    return folder / "configs"


def command(root: Path, here: Path, arguments: Sequence[str], words: Path | None = None) -> None:
    """The command in the folder `here`; what it says on standard error goes to the file `words`."""
    silent(words)
    os.chdir(here)
    os._exit(main([*arguments], root))


def limited(root: Path, here: Path, arguments: Sequence[str], words: Path, size: int) -> None:
    """The command, which may write no file of more than `size` bytes."""
    words.touch()
    silent(words)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    os.chdir(here)
    os._exit(main([*arguments], root))


def job(settings: Mapping[str, Any]) -> Result:
    """What the command runs: it says that it has begun, and waits to be let on."""
    if settings["wait_for"] is not None:
        begun = Path(settings["wait_for"])
        begun.with_suffix(".begun").touch()
        while not begun.exists():
            time.sleep(0.01)
    return outcome(settings["value"])


def page(folder: Path, value: float) -> None:
    """A run's folder, with every name that the command gives a file and next to nothing in them."""
    files = dict.fromkeys(PAGE, f"of {value}".encode())
    files["metrics.json"] = json.dumps({"value": value}).encode()
    with claim(folder) as workspace:
        workspace.replace(files, RunRecord("srsinv", 0))


def page_here(folder: Path, value: float) -> None:
    """The same in the current folder."""
    os.chdir(folder)
    page(Path("."), value)


def page_by_renames(folder: Path, value: float) -> None:
    """The same on a file system that cannot exchange names."""
    setattr(atomic, "_renameat2", lambda *_: False)  # noqa: B010
    page(folder, value)


def page_as_nobody(folder: Path, value: float) -> None:
    """The same by a user whom permissions bind."""
    if os.getuid() == 0:
        os.setgid(NOBODY)
        os.setuid(NOBODY)
    page(folder, value)


def recording(path: Path, value: float) -> None:
    """A recording of ten samples."""
    save(made(value), path)


WORK = {
    "page": page,
    "page_by_renames": page_by_renames,
    "page_here": page_here,
    "page_as_nobody": page_as_nobody,
    "recording": recording,
}


def breaking(work: str, where: Path, value: float, last: int, how: str) -> None:
    """`work`, which comes as far as its change number `last` on the disk: that one fails as on a
    full disk (`raise`), or the process is killed before it (`exit`).

    The exit code is 9 where it is killed, 3 failed, 4 done nevertheless.
    """

    def broken() -> None:
        if how == "exit":
            os._exit(9)
        raise OSError(28, "No space left on device")

    silent()
    interrupted(broken, last, CHANGES[how])
    try:
        WORK[work](where, value)
    except Exception:
        os._exit(3)
    os._exit(4)


def whole(work: str, where: Path, value: float, how: str, listed: Path) -> None:
    """`work`, with nothing in its way; its changes on the disk go to the file `listed`."""
    silent()
    done = interrupted(lambda: None, -1, CHANGES[how])
    with listed.open("w") as file:
        WORK[work](where, value)
        json.dump(done, file)
    os._exit(0)


def interrupted(
    intervene: Callable[[], Any], at: int, names: Sequence[str], put: Callable = setattr
) -> list[str]:
    """Call `intervene` before change number `at` on the disk, by functions that are `put` in the
    place of the real ones; a list that each change adds its name to."""
    done: list[str] = []

    def before(original, name):
        def call(*arguments, **settings):
            done.append(name)
            if len(done) - 1 == at:
                intervene()
            return original(*arguments, **settings)

        return call

    places = [(os, name) for name in names]
    # Names are exchanged by a call of the system that Python lacks.
    for module, name in (*places, (atomic, "_renameat2")):
        put(module, name, before(getattr(module, name), name))
    return done


def outcome(value: float) -> Result:
    """What a job gives."""
    data = dataset({"signal": ("x", np.full(8, value), "V"), **scalars({"value": value})}, {})

    def draw(_) -> Figure:
        figure = Figure(figsize=(2, 1))
        figure.add_subplot().plot([0, value])
        return figure

    words = "It is flat.\n\n{{ figure('signal', own.plots.draw, 'The signal.') }}"
    own = WrittenSection("Signal", words=words, plots={"draw": draw})
    return Result("A page", data, (own,), {"notes.yaml": "a: 1\n"})


def made(value: float) -> Recording:
    """A recording of one channel."""
    return Recording(
        signal=np.full((1, 10), value),
        time_s=np.arange(10) / 100,
        speed_m_per_s=np.full(10, 0.05),
        channels=("one",),
        sidecar={"description": "a test"},
    )


def silent(words: Path | None = None) -> None:
    """Nothing printed, or standard error in a file: what breaks here breaks on purpose."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # as a shell would start it
        signal.signal(number, signal.default_int_handler)
    with contextlib.suppress(OSError):
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 1)
        if words is not None:
            sink = os.open(words, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(sink, 2)
