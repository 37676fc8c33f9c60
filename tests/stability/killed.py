"""What is run in a process of its own, and ends before its work is done."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv.__main__ import main
from srsinv.recording import Recording, save
from srsinv.report.outcome import Outcome, Section, Table
from srsinv.report.page import write

RECORD = ("config.yaml", "overrides.yaml", "hydra.yaml")
# (class or module, its method): what puts bytes or a name on the disk.
WRITERS = {
    "text": (Path, "write_text"),
    "netcdf": (xarray.Dataset, "to_netcdf"),
    "figure": (Figure, "savefig"),
    "rename": (os, "rename"),
    "replace": (os, "replace"),
}


def command(root: Path, folder: Path) -> None:
    """One run of the command with the configuration in `root`, quietly."""
    silent()
    os._exit(main([f"hydra.run.dir={folder}"], root))


def job(settings: Mapping[str, Any]) -> Outcome:
    """What the command runs."""
    return outcome(settings["value"])


def page(folder: Path, value: float) -> None:
    """A page with every kind of file."""
    write(outcome(value), folder, dict.fromkeys(RECORD, "a: 1\n"))


def recording(path: Path, value: float) -> None:
    """A recording of ten samples."""
    save(made(value), path)


def breaking(work: str, where: Path, value: float, writer: str, after: int, how: str) -> None:
    """`work`, whose writer fails at the call after so many: as the disk does (`raise`), or with the
    whole process (`exit`), when half of the bytes are written."""
    silent()
    owner, name = WRITERS[writer]
    original, calls = getattr(owner, name), []

    def broken(self, *arguments, **settings):
        calls.append(self)
        if len(calls) <= after:
            return original(self, *arguments, **settings)
        target = Path(self) if writer == "text" else Path(arguments[0]) if arguments else None
        if writer in ("text", "netcdf", "figure") and target is not None:
            target.write_bytes(b"half of what was to be wr")
        if how == "exit":
            os._exit(9)
        raise OSError(28, "No space left on device")

    setattr(owner, name, broken)
    try:
        WORK[work](where, value)
    except Exception:
        os._exit(3)
    os._exit(0)


WORK = {"page": page, "recording": recording}


def outcome(value: float) -> Outcome:
    """What a job gives."""
    dataset = xarray.Dataset({"signal": ("x", np.full(8, value), {"units": "V"})})

    def draw() -> Figure:
        figure = Figure(figsize=(2, 1))
        figure.add_subplot().plot([0, value])
        return figure

    table = Table(("what", "value"), (("signal", value),))
    section = Section("Signal", ("It is flat.",), {"signal": draw}, {"signal": "The signal."})
    return Outcome("A page", {"value": value}, dataset, (section,), table, {"notes.yaml": "a: 1\n"})


def made(value: float) -> Recording:
    """A recording of one channel."""
    return Recording(
        signal=np.full((1, 10), value),
        time_s=np.arange(10) / 100,
        speed_m_per_s=np.full(10, 0.05),
        channels=("one",),
        sidecar={"value": value},
    )


def silent() -> None:
    """Nothing printed: what breaks here breaks on purpose."""
    with contextlib.suppress(OSError):
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 1)
        os.dup2(sink, 2)
