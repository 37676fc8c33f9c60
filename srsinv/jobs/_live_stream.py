"""Live inversion of lines from standard input, to lines on standard output."""

import math
import os
import select
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from threading import Event

import numpy as np

from ..errors import BadInput, refuse
from ..inverse.live.live import Live, LiveCells
from ..progress import say, stopping
from ..recording.stream import HEAD_ROWS, RowFormat, Sample
from ._live_lines import HEADER, lines_of
from ._live_view import LiveView

NAME = "standard input"
READ_BYTES = 2**16
LONGEST_LINE = 2**16  # bytes: a longer one is no row
MOST_HEADING = 200  # lines without a number above the first row
POLL_S = 0.1  # how often a signal that ends the command is looked for
SAID = 20  # bad lines that are named; the others are counted


class LineSource:
    """Lines of a file descriptor as they arrive, until its end or until `stop` is set.

    `take` gives the lines that are there, waiting for at least one; none at the end.
    """

    def __init__(self, descriptor: int, stop: Event):
        self._descriptor, self._stop = descriptor, stop
        self._rest, self._is_at_end = b"", False

    def take(self) -> list[str]:
        """The next lines."""
        while not self._is_at_end:
            if not self._waits_for_data():
                self._is_at_end = True
                self._rest = b""  # half a line
                return []
            data = os.read(self._descriptor, READ_BYTES)
            self._is_at_end = not data
            *whole, self._rest = (self._rest + data).split(b"\n")
            if self._is_at_end and self._rest:
                whole.append(self._rest)
            if len(self._rest) > LONGEST_LINE:
                whole, self._rest = [*whole, self._rest[:LONGEST_LINE]], b""
            if whole:
                return [line.decode("utf-8-sig", "replace").rstrip("\r") for line in whole]
        return []

    def _waits_for_data(self) -> bool:
        """Wait for data; False where the command is to end."""
        while not self._stop.is_set():
            with suppress(ValueError, OSError):  # what no system can wait for is read at once
                if not select.select([self._descriptor], [], [], POLL_S)[0]:
                    continue
            return True
        return False


def stream(
    made: Callable[[RowFormat], Live],
    form: Callable[[list[str]], RowFormat],
    view: Callable[[str], LiveView] | None,
) -> None:
    """Read lines from standard input and print each finished cell, until the input ends, a signal
    ends the command, or nobody reads what is printed.

    - `form`: makes the format of rows from the first lines; `made`: the live inversion for it.
    - `view`: opens a window for signals of this unit; None: there is none.
    """
    with stopping() as stop, suppress(BrokenPipeError):
        source = LineSource(sys.stdin.fileno(), stop)
        head, lines = _head(source)
        rows = form([f"{line}\n" for line in head])
        live = made(rows)
        unit = rows.recording.signal_unit
        window = None if view is None else view(unit)
        _print(HEADER.format(unit=unit))
        samples = Samples(rows)
        for chunk in samples.chunks(lines[rows.heading_lines :], source):
            _print_cells(live.push(*chunk), window)
        _print_cells(live.finish(), window)
        samples.say_bad()
    _close_output()


class Samples:
    """The samples of lines, in chunks as they arrive. Bad lines are named on standard error."""

    def __init__(self, rows: RowFormat):
        self._rows, self._line, self._row = rows, rows.heading_lines, 0
        self._last: Sample | None = None
        self.bad = 0

    def chunks(
        self, first: list[str], source: LineSource
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]]:
        """Times, positions, signals (e, n) and speeds, None where there are none."""
        lines = first
        while lines:
            each = [sample for line in lines if (sample := self._sample(line)) is not None]
            if each:
                time_s, x_m, speed = (np.array([one[i] for one in each]) for i in range(3))
                signal = np.array([one.signal for one in each]).T
                yield time_s, x_m, signal, None if np.isnan(speed).any() else speed
            lines = source.take()

    def say_bad(self) -> None:
        """Say how many lines were skipped."""
        if self.bad:
            say(f"{self.bad} of {self._line - self._rows.heading_lines} lines were skipped.")

    def _sample(self, line: str) -> Sample | None:
        """The sample of the next line, with its position; None where it is none."""
        self._line += 1
        if not line.strip():
            return None
        self._row += 1
        try:
            sample = self._rows.sample(line, self._row - 1)
            last = self._last
            refuse(
                last is not None and sample.time_s <= last.time_s,
                "its time is not after the one before it.",
            )
            if math.isnan(sample.position_m):
                sample = sample._replace(position_m=self._travelled(sample))
        except BadInput as refusal:
            self.bad += 1
            if self.bad <= SAID:
                say(f"line {self._line} is skipped: {refusal}")
            return None
        self._last = sample
        return sample

    def _travelled(self, sample: Sample) -> float:
        """The position of a sample by its speed and those before it."""
        refuse(math.isnan(sample.speed_m_per_s), "its speed is missing.")
        last = self._last
        if last is None:
            return float(self._rows.recording.position_m[0])
        mean = (last.speed_m_per_s + sample.speed_m_per_s) / 2
        return last.position_m + mean * (sample.time_s - last.time_s)


def _head(source: LineSource) -> tuple[list[str], list[str]]:
    """The heading and the first rows, those of as many cells as most have; and all lines that were
    read."""
    lines: list[str] = []
    while sum(map(_is_row, lines)) < HEAD_ROWS:
        more = source.take()
        if not more or len(lines) > MOST_HEADING:
            break
        lines += more
    numbers = [i for i, line in enumerate(lines) if _is_row(line)][:HEAD_ROWS]
    refuse(
        not numbers,
        f"{NAME} has no rows of numbers: write the names of the columns, such as "
        "time_s,position_m,voltage_0_V, and a row for each sample below.",
    )
    cells = Counter(_cells(lines[i]) for i in numbers)
    (most, _), *_ = cells.most_common(1)
    rows = [lines[i] for i in numbers if _cells(lines[i]) == most]
    return [*lines[: numbers[0]], *rows], lines


def _cells(line: str) -> int:
    """A number that grows with the cells of a line, whatever their delimiter."""
    return sum(map(line.count, ",;\t"))


def _is_row(line: str) -> bool:
    cell = line.replace(";", ",").replace("\t", ",").partition(",")[0].strip().replace(",", ".")
    with suppress(ValueError):
        return math.isfinite(float(cell))
    return False


def _print_cells(cells: LiveCells, window: LiveView | None) -> None:
    """One line for each cell, each written at once."""
    if window is not None:
        window.show(cells)
    for line in lines_of(cells):
        _print(line)


def _print(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _close_output() -> None:
    """Let nothing more be written to a pipe that nobody reads."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
