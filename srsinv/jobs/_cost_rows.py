"""A file of rows that accuracy_cost has measured: one line of JSON each, written as it is measured,
so that another call goes on where one has ended, however that ended."""

import errno
import hashlib
import json
import math
import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import BadInput, refuse
from ..files import path_of, read_bytes
from ._cost_trials import CostTrial, Row

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
        self._path = None if path is None else path_of(path, "accuracy_cost.rows")
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
        rest = {name: _known(each) for name, each in row.items() if name not in trial.place}
        content = {_IDENTITY: self._identity(trial), "key": trial.key, _ROW: rest}
        line = json.dumps(content, allow_nan=False, sort_keys=True)
        try:
            with open(_appended(self._path), "r+b") as file:
                size = os.fstat(file.fileno()).st_size
                file.seek(max(size - 1, 0))
                # A killed run may have left a row without its end.
                start = "" if file.read(1) in (b"", b"\n") else "\n"
                file.write(f"{start}{line}\n".encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise _unusable(self._path, error) from error

    def _identity(self, trial: CostTrial) -> str:
        whole = [__version__, self._rests_on, dict(trial.rests_on), trial.place]
        text = json.dumps(whole, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()


def _read(path: Path) -> Iterator[tuple[str, Row]]:
    """Identities and rows, but not of rows that killed runs have left unfinished."""
    try:
        os.close(_appended(path))
        if path.stat().st_size == 0:
            return
    except OSError as error:
        raise _unusable(path, error) from error
    content = read_bytes(path, what="file of rows", key="accuracy_cost.rows", most=MOST_BYTES)
    for number, line in enumerate(content.removesuffix(b"\n").split(b"\n"), 1):
        if not _is_cut(line):
            yield _parsed(path, number, line)


def _is_cut(line: bytes) -> bool:
    """Whether a line is the beginning of a row alone."""
    try:
        json.loads(line)
        return False
    except (ValueError, RecursionError):
        return line.startswith(_START) or _START.startswith(line)


def _appended(path: Path) -> int:
    """A descriptor of the file, made where there is none, to read it and add to its end. Raises
    `OSError` for a link and for what is no plain file."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(path, flags, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "this is no plain file", str(path))
    return descriptor


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
    return identity, {**numbers, "failure": failure}


def _known(value: Any) -> Any:
    """A number that JSON has, else None."""
    return value if isinstance(value, str) or math.isfinite(value) else None


def _no_row(path: Path, number: int) -> str:
    return (
        f"accuracy_cost.rows: line {number} of {path} is no row of accuracy_cost: name another "
        "file, or delete that line."
    )


def _unusable(path: Path, error: OSError) -> BadInput:
    reason = error.strerror or type(error).__name__
    return BadInput(
        f"accuracy_cost.rows: {path}: {reason}: name a file that can be read and written."
    )
