"""A file of rows that accuracy_cost has measured: one line of JSON each, written as it is measured,
so that another call goes on where one has ended, however that ended."""

import errno
import hashlib
import json
import math
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from .. import __version__
from ..atomic import write_whole
from ..errors import BadInput, printable, refuse
from ..files import path_of, read_bytes
from ._cost_trials import CostTrial, Row

_KEY = "accuracy_cost.rows"
MOST_BYTES = 2**26  # of a file: some hundred thousand rows
_IDENTITY, _ROW = "identity", "row"
_START = f'{{"{_IDENTITY}": "'.encode()  # of every line


class RowFile:
    """Rows by the identity of their trials; a path of None holds none and keeps none.

    `rests_on`: the settings that every row depends on; with the version and the trial's own they
    make its identity, so that one file may hold rows of several configurations. Raises `BadInput`
    for a file that cannot be read or written, or that is no such file. What a line holds is taken
    as numbers and words alone.
    """

    def __init__(self, path: str | None, rests_on: Mapping[str, Any]):
        self._path = None if path is None else path_of(path, _KEY)
        self._rests_on = rests_on
        self._rows = {} if self._path is None else dict(_read(self._path))

    def row(self, trial: CostTrial) -> Row | None:
        """The row of a trial that was measured before; None of any other."""
        row = self._rows.get(self._identity(trial))
        return None if row is None else {**row, **trial.place}

    def add(self, trial: CostTrial, row: Row) -> None:
        """Write a row, so that it is on the disk when this returns."""
        if self._path is None:
            return
        # JSON has no number for what is not finite.
        rest = {
            name: each if isinstance(each, str) or math.isfinite(each) else None
            for name, each in row.items()
            if name not in trial.place
        }
        content = {_IDENTITY: self._identity(trial), "key": trial.key, _ROW: rest}
        line = f"{json.dumps(content, allow_nan=False, sort_keys=True)}\n".encode()
        if not os.path.lexists(self._path):
            write_whole(self._path, line)
            return
        with _appended(self._path) as file:
            file.seek(-1, os.SEEK_END)
            # A killed run may have left a row without its end.
            file.write(line if file.read(1) == b"\n" else b"\n" + line)
            file.flush()
            os.fsync(file.fileno())

    def _identity(self, trial: CostTrial) -> str:
        whole = [__version__, self._rests_on, dict(trial.rests_on), trial.place]
        text = json.dumps(whole, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()


def _read(path: Path) -> Iterator[tuple[str, Row]]:
    """Identities and rows, but not of rows that killed runs have left unfinished; none where there
    is no file yet."""
    if not os.path.lexists(path):
        refuse(
            not os.access(path.parent, os.W_OK | os.X_OK),
            f"{_KEY}: {path}: there is no folder of its own to write it to: make that first.",
        )
        return
    with _appended(path):
        content = read_bytes(path, what="file of rows", key=_KEY, most=MOST_BYTES)
    for number, line in enumerate(content.removesuffix(b"\n").split(b"\n"), 1):
        if not _is_cut(line):
            yield _parsed(path, number, line)


def _is_cut(line: bytes) -> bool:
    """Whether a line is the beginning of a row alone."""
    try:
        json.loads(line)
        return False
    except (ValueError, RecursionError):
        return line.startswith(_START) or (bool(line) and _START.startswith(line))


@contextmanager
def _appended(path: Path) -> Iterator[BinaryIO]:
    """The file of rows, to read it and add to its end.

    Raises `BadInput` for a link, for what is no plain file, for one that has other names, under
    which it may be somebody else's, and for one that does not begin with a row.
    """
    flags = os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        with open(os.open(path, flags), "r+b") as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
                raise OSError(errno.EINVAL, "this is no plain file of one name")
            # It comes with its first row, so that this one is whole.
            _parsed(path, 1, file.readline(MOST_BYTES))
            yield file
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise BadInput(
            f"{_KEY}: {path}: {reason}: name a file that can be read and written."
        ) from error


def _parsed(path: Path, number: int, line: bytes) -> tuple[str, Row]:
    """Identity and row of a line."""
    try:
        content = json.loads(line)
        identity, failure = content[_IDENTITY], content[_ROW].pop("failure")
        numbers = {
            name: math.nan if each is None else float(each) for name, each in content[_ROW].items()
        }
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise BadInput(_no_row(path, number)) from error
    is_row = isinstance(identity, str) and isinstance(failure, str) and "trial_s" in numbers
    refuse(not is_row, _no_row(path, number))
    return identity, {**numbers, "failure": printable(failure)}


def _no_row(path: Path, number: int) -> str:
    return (
        f"{_KEY}: line {number} of {path} is no row of accuracy_cost: name another "
        "file, or delete that line."
    )
