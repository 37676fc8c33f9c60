"""Folders of runs and sweeps, which stay unchanged where no job is done."""

import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from hydra.core.utils import run_job
from hydra.types import HydraContext
from omegaconf import DictConfig

from ..atomic import opened
from ..errors import BadInput, printable
from ..run_folder import (
    FAILURES,
    GATHERED,
    MANIFEST,
    RunFolder,
    check,
    described_in,
    left_by_killed,
    locate,
    named,
    strangers,
    writing,
)
from .outcome import Outcome

RECORD = "multirun.yaml"  # of a sweep, as Hydra's sweepers write it
# What a sweep writes to its folder itself, beside the runs'.
OF_SWEEPS = {RECORD, FAILURES, *GATHERED}
_MOST_NAMED = 5  # folders that killed runs have left


def run(context: HydraContext, task: Callable[[DictConfig], Outcome], config: DictConfig) -> int:
    """One run; its exit code. Raises `BadInput` for a folder that cannot be used."""
    folder = Path(config.hydra.run.dir)
    check(folder)
    hint_at_remains(folder)
    with no_empty_folders(folder), writing(folder):
        return run_job(
            hydra_context=context,
            task_function=task,
            config=config,
            job_dir_key="hydra.run.dir",
            job_subdir_key=None,
        ).return_value.code


def check_sweep(folder: Path) -> None:
    """Raise `BadInput` unless the folder can be written to and is empty or an earlier sweep's, in
    which folders are for the runs to check."""
    place = locate(folder)
    name = None
    with writing(folder), suppress(FileNotFoundError), opened(place) as descriptor:
        known = described_in(descriptor)
        is_sweep = known is not None and RECORD in known["files"] and {*known["files"]} <= OF_SWEEPS
        names = (each for each in strangers(descriptor) if not (is_sweep and each.endswith("/")))
        name = next(names, None if is_sweep or known is None else MANIFEST)
    if name is not None:
        raise BadInput(
            f"cannot sweep into {named(folder)}: it holds {named(name)}, which no sweep of "
            "srsinv wrote or which was changed since; choose another folder with "
            "hydra.sweep.dir=FOLDER, or move that file away"
        )


def hint_at_remains(folder: Path) -> None:
    """Print on standard error what killed runs have left at a folder, and how to remove it."""
    left = left_by_killed(folder)
    if left:
        names = " ".join(_typed(str(path)) for path in left[:_MOST_NAMED])
        print(
            f"srsinv: {len(left)} unfinished by runs that were killed; to remove: rm -r {names}",
            file=sys.stderr,
        )


def _typed(path: str) -> str:
    """A path as it may be typed in a shell, without characters that steer a terminal."""
    return shlex.quote(path) if path.isprintable() else f"$'{printable(path)}'"


@contextmanager
def marked(
    held: RunFolder, put: Callable[[Mapping[str, bytes]], None], has_results: Callable[[], bool]
) -> Iterator[None]:
    """`put` the record of a sweep into its folder where that is new: the same command then goes on
    there, however this one ends. Without results it is taken out at the end."""
    is_new = described_in(held.descriptor) is None
    if is_new:
        put({})
    try:
        yield
    finally:
        if is_new and not has_results():
            held.clear()


@contextmanager
def no_empty_folders(folder: Path) -> Iterator[Callable[[Path], None]]:
    """Remove the folders made for `folder`, and for the paths that what is yielded is called with,
    that are still empty at the end."""
    absent: set[Path] = set()

    def watch(path: Path) -> None:
        whole = path.absolute()
        absent.update(each for each in (whole, *whole.parents) if not os.path.lexists(each))

    watch(folder)
    try:
        yield watch
    finally:
        for path in sorted(absent, reverse=True):
            with suppress(OSError):  # it is not empty, or was never made
                path.rmdir()
