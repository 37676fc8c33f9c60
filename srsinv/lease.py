"""Leases: locks on files, held by a process and released by the system when it ends.

Unlike a process's number, a lock means the same in every container and, over NFS, on every host.
"""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from .errors import BadInput

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def take(path: Path) -> BinaryIO | None:
    """The file at `path`, made if it is not there, locked until it is closed; None where another
    holds it.

    The holder removes the file before closing it. Raises `BadInput` where the file system has no
    locks, `OSError` where the file cannot be opened.
    """
    while True:
        # A link there is not followed, nor a pipe waited for.
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        file = os.fdopen(os.open(path, flags, 0o666), "r+b", buffering=0)
        try:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                file.close()
                return None
            if not _lock(file, path):
                file.close()
                return None
            if _is_at(file, path):
                return file
        except BaseException:
            file.close()
            raise
        file.close()  # its last holder has removed it since it was opened


def _lock(file: BinaryIO, path: Path) -> bool:
    try:
        if fcntl is None:
            raise OSError(0, "this system has none")
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        raise BadInput(
            f"cannot lock a file in {path.parent} ({error.strerror}), without which two processes "
            "could mix what they write there: choose a folder on another file system."
        ) from error
    return True


def _is_at(file: BinaryIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
