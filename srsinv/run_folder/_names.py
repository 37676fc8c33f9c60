"""Names of a run's workspace and of its contents."""

import os
from pathlib import Path

WORKSPACE = ".srsinv"  # inside the run's folder; beside it, the end of the name
LOCK, NEW, OLD, TRASH = "lock", "new", "old", "trash"
CONTENTS = {LOCK, NEW, OLD, TRASH}
# In a sweep's folder: what its runs gave, and why others failed.
GATHERED = ("sweep.nc", "sweep.html")
FAILURES = "failures.json"


def workspaces(place: Path) -> tuple[Path, Path]:
    """Possible workspaces of a folder: beside it or, failing that, inside."""
    return place.parent / f".{place.name}{WORKSPACE}", place / WORKSPACE


def is_workspace(path: Path) -> bool:
    """Whether `path` is a folder with nothing in it but the contents of a workspace."""
    try:
        return not path.is_symlink() and {*os.listdir(path)} <= CONTENTS
    except OSError:
        return False


def is_empty(folder: Path) -> bool:
    """Whether there is no such folder, or nothing in it but a workspace."""
    return not folder.exists() or all(
        path.name == WORKSPACE and is_workspace(path) for path in folder.iterdir()
    )
