"""Exclusive access to a run's folder: one run at a time, and only over an earlier run."""

import errno
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from srsinv import lease
from srsinv.errors import BadInput, refuse

from ._manifest import check_ours, listed
from ._names import CONTENTS, LOCK, WORKSPACE, is_workspace, workspaces
from ._place import REMEDY, locate, writing
from ._workspace import Workspace

OUTPUTS = "outputs"  # default folder of runs, as OUTPUTS/NAME/TIME[_sweep/NUMBER]
_PATIENCE_S = 2.0  # for a lock: clearing up after another run takes milliseconds
_POLL_S = 0.05


def check(folder: Path) -> None:
    """Raise `BadInput` unless `folder` can be made or written to, and is empty or holds an earlier
    run of srsinv, or the remains of one that was killed."""
    place = locate(folder)
    with writing(folder):
        if place.exists() and not any(map(is_workspace, workspaces(place))):
            check_ours(place, listed(place) or {})


@contextmanager
def hold(folder: Path) -> Iterator[Workspace]:
    """Lock `folder`, which is created, against other runs until the end.

    The remains of killed runs in it, beside it or elsewhere under `outputs` are finished or undone
    first. Raises `BadInput` where another run is at work in it.
    """
    place = locate(folder)
    with writing(folder):
        _recover_stale(place)
        place.mkdir(parents=True, exist_ok=True)
        space, lock = _take_workspace(place)
    try:
        yield space
    finally:
        try:
            with writing(folder):
                for path in filter(is_workspace, workspaces(place)):
                    Workspace(place, path).recover()
                    with suppress(OSError):  # its lock is in it
                        path.rmdir()
        finally:
            _give_back(space.path, lock)


@contextmanager
def claim(folder: Path) -> Iterator[Workspace]:
    """[`hold`][] a folder that is empty or holds an earlier run, for `Workspace.replace`.

    Raises `BadInput` for a folder that holds anything else, and leaves that as it is.
    """
    with hold(folder) as space:
        with writing(folder):
            check_ours(space.folder, listed(space.folder) or {})
        yield space


def _take_workspace(place: Path) -> tuple[Workspace, BinaryIO]:
    """A workspace that is empty, and its lock."""
    taken = []
    beside, inside = workspaces(place)
    try:
        if not place.is_mount():
            try:
                taken.append((beside, _lock(beside, place)))
            except OSError:  # nothing can be made beside it, or the name is too long
                if is_workspace(beside):  # another user's
                    raise
        if not taken or inside.exists():
            taken.append((inside, _lock(inside, place)))
        for path, _ in taken:
            Workspace(place, path).recover()
    except BaseException:
        for path, lock in taken:
            _give_back(path, lock)
        raise
    for path, lock in taken[1:]:
        _give_back(path, lock)
    return Workspace(place, taken[0][0]), taken[0][1]


def _lock(space: Path, place: Path) -> BinaryIO:
    latest = time.monotonic() + _PATIENCE_S
    while True:
        space.mkdir(exist_ok=True)
        with suppress(FileNotFoundError):  # its owner has just removed it
            if space.is_symlink() or not {*os.listdir(space)} <= CONTENTS:
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(space))
            if (lock := lease.take(space / LOCK)) is not None:
                return lock
            refuse(
                time.monotonic() > latest,
                f"another run is writing to {place}; wait until it has ended, or {REMEDY}",
            )
            time.sleep(_POLL_S)


def _give_back(space: Path, lock: BinaryIO) -> None:
    with lock, suppress(OSError):
        (space / LOCK).unlink(missing_ok=True)
        space.rmdir()


def _recover_stale(place: Path) -> None:
    """Recover, where possible, the remains of killed runs beside a folder or under `outputs`."""
    roots = {above for above in (*place.parents, Path.cwd() / OUTPUTS) if above.name == OUTPUTS}
    name = f".?*{WORKSPACE}"
    stale = {
        path for root in roots for depth in range(3) for path in root.glob("*/" * depth + name)
    }
    _recover({*stale, *place.parent.glob(name)})


def recover(folder: Path) -> None:
    """Finish or undo, where possible, what killed runs were writing to folders inside `folder`."""
    _recover(folder.rglob(f".?*{WORKSPACE}"))


def _recover(spaces: Iterable[Path]) -> None:
    for path in sorted(spaces):
        folder = path.with_name(path.name[1 : -len(WORKSPACE)])
        with suppress(OSError, BadInput):
            if is_workspace(path) and (lock := lease.take(path / LOCK)) is not None:
                try:
                    Workspace(folder, path).recover()
                finally:
                    _give_back(path, lock)
