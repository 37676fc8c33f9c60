"""Location of a run's folder, and refusals where it cannot be written to."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from srsinv.errors import BadInput, echo, refuse

REMEDY = "choose another with hydra.run.dir=FOLDER (hydra.sweep.dir with -m)"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_LONGEST = 200  # characters of a path that is shown as it is


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn an `OSError` inside (a full disk, a name too long) into `BadInput`."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or type(error).__name__
        remedy = f"make room there or {REMEDY}" if error.errno in _FULL else REMEDY
        raise BadInput(f"cannot write to {named(folder)} ({reason}); {remedy}") from error


def locate(folder: Path) -> Path:
    """`folder` without links. Raises `BadInput` where it cannot be made or written to, and where a
    link that somebody may have put there leads to a folder that holds anything."""
    with writing(folder):
        try:
            str(folder).encode()
            place = existing = Path(os.path.realpath(folder))
        except ValueError as error:
            raise BadInput(
                f"cannot write to {named(folder)}, which is not a valid file name; {REMEDY}"
            ) from error
        while not _exists(existing):
            existing = existing.parent
        for part in place.relative_to(existing).parts:
            _exists(existing / part)  # or its name is too long
    refuse(
        place != existing and folder.is_symlink(),
        f"cannot write to {named(folder)}, which is a broken link; {REMEDY}",
    )
    refuse(
        not (existing.is_dir() and os.access(existing, os.R_OK | os.W_OK | os.X_OK)),
        f"cannot write to {named(folder)}: {named(existing)} is not a folder that can be written "
        f"to; {REMEDY}",
    )
    refuse(
        place == existing and _has_link(folder.absolute()) and any(place.iterdir()),
        f"cannot write to {named(folder)}: a link in it leads to {named(place)}, which is not "
        "empty; name that folder itself, or another, with hydra.run.dir=FOLDER (hydra.sweep.dir "
        "with -m)",
    )
    return place


def _has_link(path: Path) -> bool:
    """Whether a path goes through a link in a folder that the user can write to: not the system's
    own."""
    return any(
        each.is_symlink() and os.access(each.parent, os.W_OK) for each in (path, *path.parents)
    )


def _exists(path: Path) -> bool:
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def named(path: Path | str) -> str:
    """A path for a sentence."""
    text = str(path)
    return text if text.isprintable() and len(text) <= _LONGEST else echo(text)
