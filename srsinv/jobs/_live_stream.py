"""Live inversion of lines from standard input, to lines on standard output."""

import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from queue import Empty, Queue
from threading import Event, Thread

import numpy as np

from ..errors import BadInput, refuse
from ..inverse.live.live import Live, LiveCells
from ..progress import say, stage, stopping
from ..recording.formats._heading import cells_of, heading_of
from ..recording.stream import RowFormat, Sample
from ._live_lines import HEADER, lines_of
from ._live_view import LiveView

NAME = "standard input"
HEAD_ROWS = 8  # of numbers, by which the columns are recognised
READ_BYTES, MOST_BLOCKS = 2**16, 2**10  # 64 MiB at most wait for the inversion
NEW_CLOCK = 3  # samples in order among themselves, before which a clock begins anew
LONGEST_LINE = 2**16  # bytes: a longer one is no row
MOST_HEADING = 200  # lines without a number above the first row
POLL_S = 0.1  # how often a signal that ends the command is looked for
SAID = 20  # bad lines that are named; the others are counted


class LineSource:
    """Lines of a file descriptor as they arrive, until its end or until `stop` is set.

    They are read at once, by a thread of its own: a serial port keeps few of them.
    """

    def __init__(self, descriptor: int, stop: Event):
        self._stop, self._rest = stop, b""
        self._blocks: Queue[bytes] = Queue(MOST_BLOCKS)
        self._is_at_end = False
        Thread(target=self._read, args=(descriptor,), daemon=True).start()

    @property
    def is_stopped(self) -> bool:
        """Whether a signal is to end the stream."""
        return self._stop.is_set()

    def take(self) -> list[str]:
        """The lines that are there, waiting for at least one; none at the end."""
        while not self._is_at_end and not self.is_stopped:
            try:
                block = self._blocks.get(timeout=POLL_S)
            except Empty:
                continue
            self._is_at_end = not block
            *lines, self._rest = (self._rest + block).split(b"\n")
            if self._rest and (self._is_at_end or len(self._rest) > LONGEST_LINE):
                lines, self._rest = [*lines, self._rest[:LONGEST_LINE]], b""
            if lines:
                return [line.decode("utf-8-sig", "replace").rstrip("\r") for line in lines]
        return []

    def _read(self, descriptor: int) -> None:
        """Read blocks of bytes, an empty one at the end."""
        block = b"-"
        while block:
            try:
                block = os.read(descriptor, READ_BYTES)
            except OSError:  # a terminal or a port that is gone
                block = b""
            self._blocks.put(block)


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
        with stage(f"waiting for lines on {NAME}"):
            head, lines = _head(source)
        if source.is_stopped:
            return
        rows = form([f"{line}\n" for line in head])
        live = made(rows)
        unit = rows.recording.signal_unit
        window = None if view is None else view(unit)
        _print(HEADER.format(unit=unit))
        samples = SampleStream(rows)
        for chunk in samples.chunks(lines[rows.heading_lines :], source):
            _print_cells(live.push(*chunk), window)
        _print_cells(live.finish(), window)
        samples.say_bad()
    _close_output()


class SampleStream:
    """The samples of lines, in chunks as they arrive. Bad lines are named on standard error."""

    def __init__(self, rows: RowFormat):
        self._rows, self._line, self._row = rows, rows.heading_lines, 0
        self._last: Sample | None = None
        self._late: list[Sample] = []  # in a row, whose times are not after the last
        self._shift_s = 0.0
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
            sample = self._in_order(self._rows.sample(line, self._row - 1))
            if math.isnan(sample.position_m):
                sample = sample._replace(position_m=self._travelled(sample))
        except BadInput as refusal:
            self.bad += 1
            if self.bad <= SAID:
                say(f"line {self._line} is skipped: {refusal}")
            return None
        self._last = sample
        return sample

    def _in_order(self, sample: Sample) -> Sample:
        """The sample, if its time is after the last. Where several in a row are not, but are in
        order among themselves, the clock has begun anew, or one time was wrong: it goes on."""
        shifted, last = sample._replace(time_s=sample.time_s + self._shift_s), self._last
        if last is None or shifted.time_s > last.time_s:
            self._late = []
            return shifted
        if self._late and sample.time_s <= self._late[-1].time_s:
            self._late = []
        self._late.append(sample)
        refuse(len(self._late) < NEW_CLOCK, "its time is not after the one before it.")
        step_s = sample.time_s - self._late[-2].time_s
        self._shift_s = last.time_s + step_s - sample.time_s
        self._late = []
        say(f"line {self._line}: the times begin anew, and are continued from the last one.")
        return sample._replace(time_s=last.time_s + step_s)

    def _travelled(self, sample: Sample) -> float:
        """The position of a sample by its speed and those before it."""
        refuse(math.isnan(sample.speed_m_per_s), "its speed is missing.")
        last = self._last
        if last is None:
            return float(self._rows.recording.position_m[0])
        mean = (last.speed_m_per_s + sample.speed_m_per_s) / 2
        return last.position_m + mean * (sample.time_s - last.time_s)


def _head(source: LineSource) -> tuple[list[str], list[str]]:
    """The heading and the first whole rows; and all lines that were read."""
    lines: list[str] = []
    while sum(map(_is_row, lines)) <= HEAD_ROWS:
        more = source.take()
        if not more or len(lines) > MOST_HEADING:
            break
        lines += more
    numbers = [i for i, line in enumerate(lines) if _is_row(line)]
    refuse(
        not numbers and not source.is_stopped,
        f"{NAME} has no rows of numbers: write the names of the columns, such as "
        "time_s,position_m,voltage_0_V, and a row for each sample below.",
    )
    delimiter = heading_of("\n".join(lines)).delimiter
    cells = [len(cells_of(lines[i], delimiter)) for i in numbers]
    most = max(cells, key=cells.count, default=0)
    rows = [lines[i] for i, count in zip(numbers, cells, strict=True) if count == most]
    # The first row may be the end of one, as where a port is opened within a line.
    rows = rows[1 : HEAD_ROWS + 1] if len(rows) > HEAD_ROWS // 2 else rows
    return [*lines[: numbers[0] if numbers else 0], *rows], lines


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
