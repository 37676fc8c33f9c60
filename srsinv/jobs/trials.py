"""Trials: one thing to compute each, with its time and its score, and the rows that they become.

A row is kept by the identity of its trial, in memory and, where a path is given, in a file: a line
of JSON, written as soon as it is measured. So nothing is measured twice, and another call goes on
where one has ended, however that ended.
"""

import errno
import hashlib
import json
import math
import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import jax
import numpy as np

from ..atomic import write_whole
from ..errors import BadInput, is_number, printable, refuse
from ..files import path_of, read_bytes
from ..memory import weighed
from ..progress import steps
from ..timing import timed

MOST_S = 2.0  # a trial's further calls, after which no more of them begin
MOST_BYTES = 2**26  # of a file: some hundred thousand rows
_IDENTITY, _LABELS, _ROW = "identity", "labels", "row"
_START = f'{{"{_IDENTITY}": "'.encode()  # of every line

Row = dict[str, Any]
Work = Callable[[], Any]


@dataclass(frozen=True)
class Trial:
    """One thing to compute.

    - `labels`: where its row stands: numbers and words by their names, which are part of the row.
    - `prepare`: gives the work, whose time is measured. `score`: what the row says of the value
      that the work gives: numbers and words by their names, lists and mappings of these.
    - `count`: answers of one call, each of which has its part of the time.
    - `rests_on`: what else decides on its row.
    """

    labels: Mapping[str, Any]
    prepare: Callable[[], Work]
    score: Callable[[Any], Mapping[str, Any]]
    count: int = 1
    rests_on: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """Its labels in a row."""
        return ", ".join(map(str, self.labels.values()))


@dataclass(frozen=True)
class TrialTiming:
    """How trials are timed.

    - `repeats`: further calls, after a second one whose memory is measured; 0: one call is all.
    - `is_fresh`: whether the first call compiles all of its programs anew, but for a trial whose
      label `is_peer` holds.
    - `failures`: errors that end a trial with a row that says so, and that the next one follows.
    """

    repeats: int = 0
    is_fresh: bool = False
    failures: tuple[type[Exception], ...] = ()

    def measured(self, trial: Trial) -> Row:
        """The row of a trial: its score, seconds of the first call and quartiles of further ones,
        memory; of a failure the reason. `trial_s` is what all of it took, `prepare_s` what came
        before the first call."""
        start = time.perf_counter()
        try:
            row = self._measured(trial)
        except self.failures as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            row = {"failure": str(error) if isinstance(error, BadInput) else text}
        return {**trial.labels, **row, "trial_s": time.perf_counter() - start}

    def _measured(self, trial: Trial) -> Row:
        start = time.perf_counter()
        work = trial.prepare()
        prepare_s = time.perf_counter() - start
        if self.is_fresh and not trial.labels.get("is_peer"):
            jax.clear_caches()
        first = timed(work, 0)
        row = {"first_call_s": first.first_s / trial.count, "prepare_s": prepare_s}
        if self.repeats:
            second, memory = weighed(lambda: timed(work, 0).first_s)
            times = (second,)
            if second < MOST_S:  # the call that was weighed is slower: it counts where it is alone
                more = timed(work, self.repeats - 1, MOST_S)
                times = more.first_s, *more.further_s
            lower, median, upper = np.quantile(times, (0.25, 0.5, 0.75)) / trial.count
            row |= {"steady_call_s": float(median), "lower_call_s": float(lower),
                    "upper_call_s": float(upper), "memory_bytes": memory}  # fmt: skip
        return {**trial.score(first.value), **row}


class TrialRows:
    """The rows of trials by what decides on them.

    `path` of their file, given by the setting `key`; `rests_on`: what all rows depend on, so that
    one file may hold those of several settings. Raises `BadInput` for a file that cannot be read or
    written, or that holds no rows. What a line holds is taken as numbers and words alone.
    """

    def __init__(
        self,
        timing: TrialTiming | None = None,
        path: str | None = None,
        key: str = "rows",
        rests_on: Mapping[str, Any] | None = None,
    ):
        self._timing, self._rests_on = timing or TrialTiming(), rests_on or {}
        self._file = None if path is None else _RowFile(path_of(path, key), key)
        self._rows: dict[str, Row] = {} if self._file is None else dict(self._file.read())

    def known(self, trial: Trial) -> Row | None:
        """The row of a trial that was measured before; None of any other."""
        row = self._rows.get(self._identity(trial))
        return None if row is None else {**row, **trial.labels}

    def of(self, trial: Trial) -> Row:
        """The row of a trial, measured where it is not known."""
        row = self.known(trial)
        return self.anew(trial) if row is None else row

    def anew(self, trial: Trial) -> Row:
        """The row of a trial, measured now, and on the disk when this returns."""
        row = self._timing.measured(trial)
        own = {name: each for name, each in row.items() if name not in trial.labels}
        identity = self._identity(trial)
        if self._file is not None:
            self._file.add(identity, trial.labels, own)
        self._rows[identity] = own
        return row

    def of_all(self, trials: Iterable[Trial], what: str) -> list[Row]:
        """The rows of trials, one after the other; `what` this is, for who waits."""
        with steps(what, list(trials)) as each:
            return [self.of(trial) for trial in each]

    def keep(self, trials: Iterable[Trial]) -> None:
        """Drop all rows but those of `trials`, and put them in their order, in the file too."""
        labels = {self._identity(trial): trial.labels for trial in trials}
        if self._file is not None:
            self._rows |= self._file.read()  # another process may have added to it
        self._rows = {each: self._rows[each] for each in labels if each in self._rows}
        if self._file is not None and self._rows:
            lines = [_line(each, labels[each], row) for each, row in self._rows.items()]
            self._file.replace(b"".join(lines))

    def _identity(self, trial: Trial) -> str:
        whole = [self._rests_on, dict(trial.rests_on), dict(trial.labels)]
        text = json.dumps(whole, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()


class _RowFile:
    """A file of rows, one line of JSON each."""

    def __init__(self, path: Path, key: str):
        self._path, self._key = path, key

    def read(self) -> Iterator[tuple[str, Row]]:
        """Identities and rows, but not of rows that killed runs have left unfinished; none where
        there is no file yet."""
        path = self._path
        if not os.path.lexists(path):
            refuse(
                not os.access(path.parent, os.W_OK | os.X_OK),
                f"{self._key}: {path}: the folder to write it to does not exist: create it first.",
            )
            return
        with self._appended():
            content = read_bytes(path, what="file of rows", key=self._key, most=MOST_BYTES)
        for number, line in enumerate(content.removesuffix(b"\n").split(b"\n"), 1):
            if not _is_cut(line):
                yield self._parsed(number, line)

    def add(self, identity: str, labels: Mapping[str, Any], row: Row) -> None:
        """Write a row, so that it is on the disk when this returns."""
        line = _line(identity, labels, row)
        if not os.path.lexists(self._path):
            write_whole(self._path, line)
            return
        with self._appended() as file:
            file.seek(-1, os.SEEK_END)
            # A killed run may have left a row without its end.
            file.write(line if file.read(1) == b"\n" else b"\n" + line)
            file.flush()
            os.fsync(file.fileno())

    def replace(self, content: bytes) -> None:
        """Put these lines in place of all that the file has."""

        def is_own(before: bytes) -> bool:
            return bool(self._parsed(1, before.split(b"\n", 1)[0]))

        write_whole(self._path, content, is_own)

    @contextmanager
    def _appended(self) -> Iterator[BinaryIO]:
        """The file, to read it and add to its end.

        Raises `BadInput` for a link, for what is no plain file, for one that has other names, under
        which it may be somebody else's, and for one that does not begin with a row.
        """
        flags = os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            with open(os.open(self._path, flags), "r+b") as file:
                found = os.fstat(file.fileno())
                if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
                    raise OSError(errno.EINVAL, "this is not a regular file with one name")
                # It comes with its first row, so that this one is whole.
                self._parsed(1, file.readline(MOST_BYTES))
                yield file
        except OSError as error:
            reason = error.strerror or type(error).__name__
            raise BadInput(
                f"{self._key}: {self._path}: {reason}: name a file that can be read and written."
            ) from error

    def _parsed(self, number: int, line: bytes) -> tuple[str, Row]:
        """Identity and row of a line."""
        try:
            content = json.loads(line)
            identity, row = content[_IDENTITY], content[_ROW]
            times = [row["trial_s"], *(row[name] for name in row if name.endswith("_s"))]
            are_numbers = all(each is None or is_number(each) for each in times)
            if not isinstance(identity, str) or not are_numbers:
                raise ValueError("no row")
            row = _read(row)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise BadInput(
                f"{self._key}: line {number} of {self._path} is not a row of trials: name "
                "another file, or delete that line."
            ) from error
        return identity, row


def _line(identity: str, labels: Mapping[str, Any], row: Row) -> bytes:
    """A row as a line of a file."""
    content = {_IDENTITY: identity, _LABELS: dict(labels), _ROW: _finite(row)}
    return f"{json.dumps(content, allow_nan=False)}\n".encode()


def _is_cut(line: bytes) -> bool:
    """Whether a line is the beginning of a row alone."""
    try:
        json.loads(line)
        return False
    except (ValueError, RecursionError):
        return line.startswith(_START) or (bool(line) and _START.startswith(line))


def _finite(value: Any) -> Any:
    """A value for JSON, which has no number for what is not finite."""
    if isinstance(value, Mapping):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _read(value: Any) -> Any:
    """A value of a file: numbers are floats, not finite where they were not written, and words such
    as a terminal may print."""
    if isinstance(value, dict):
        return {printable(name): _read(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_read(each) for each in value]
    if value is None:
        return math.nan
    return printable(value) if isinstance(value, str) else value
