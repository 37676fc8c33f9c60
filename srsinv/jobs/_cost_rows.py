"""A file of rows that accuracy_cost has measured: one line of JSON each, written as it is measured,
so that another call goes on where one has ended, however that ended."""

import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import BadInput, refuse
from ._cost_trials import CostTrial, Row

MOST_BYTES = 2**26  # of a file: some hundred thousand rows
_IDENTITY, _ROW = "identity", "row"


class RowFile:
    """Rows by the identity of their trials; a path of None holds none and keeps none.

    `rests_on`: the settings that every row depends on; with the version and the trial's own they
    make its identity, so that one file may hold rows of several configurations. Raises `BadInput`
    for a file that cannot be read or written, or that is no such file. What a line holds is taken
    as numbers and words alone.
    """

    def __init__(self, path: str | None, rests_on: Mapping[str, Any]):
        self._path = None if path is None else Path(path)
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
            with self._path.open("ab") as file:
                file.write(f"{line}\n".encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise _unusable(self._path, error) from error

    def _identity(self, trial: CostTrial) -> str:
        whole = [__version__, self._rests_on, dict(trial.rests_on), trial.place]
        text = json.dumps(whole, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()


def _read(path: Path) -> Iterator[tuple[str, Row]]:
    """Identities and rows; a last line that a killed run has left unfinished is cut off."""
    try:
        path.touch()
        size = path.stat().st_size
        refuse(
            size > MOST_BYTES,
            f"accuracy_cost.rows: {path} has {size} bytes, more than rows of accuracy_cost ever "
            "take: name another file.",
        )
        content = path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        rows = [_parsed(path, n, line) for n, line in enumerate(whole.split(b"\n")[:-1], 1)]
        if len(whole) < len(content):
            refuse(not content[len(whole) :].startswith(b"{"), _no_row(path, len(rows) + 1))
            os.truncate(path, len(whole))
    except OSError as error:
        raise _unusable(path, error) from error
    yield from rows


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
