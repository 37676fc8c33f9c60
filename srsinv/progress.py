"""Progress messages on stderr, for stages of more than two seconds.

On a terminal each stage has a line of its own with a bar and the time that is left, as far as
these are known, which go away at its end. Elsewhere a line says what has begun, and one every ten
seconds how far it is.
"""

import sys
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress

Item = TypeVar("Item")

_lock = threading.Lock()  # of what follows
_stopping: list[threading.Event] = []  # of bodies that end themselves
_running: list["_Stage"] = []  # the nested stages that are shown, the innermost last
_bars: list["Progress"] = []  # their lines on a terminal, one at most


def say(sentence: str) -> None:
    """Print a sentence on standard error."""
    print(f"srsinv: {sentence}", file=sys.stderr, flush=True)


@contextmanager
def stopping() -> Iterator[threading.Event]:
    """An event that a signal to end the command sets while the body runs: the body ends itself."""
    event = threading.Event()
    _stopping.append(event)
    try:
        yield event
    finally:
        _stopping.remove(event)


def stop() -> bool:
    """Set the events of all bodies that end themselves; whether there is one."""
    for event in _stopping:
        event.set()
    return bool(_stopping)


@contextmanager
def stage(name: str, *, delay_s: float = 2.0, every_s: float = 10.0) -> Iterator[None]:
    """Say `name` on standard error if the body runs for more than `delay_s` [s], and where that is
    no terminal how long it has taken `every_s` [s]."""
    with _shown(_Stage(name), delay_s, every_s):
        yield


@contextmanager
def steps(
    name: str, items: Collection[Item], *, delay_s: float = 2.0, every_s: float = 10.0
) -> Iterator[Iterator[Item]]:
    """The items one after the other, as a [`stage`][] that says how many are done, and the time
    left, which takes the items to come to last as long as those done."""
    own = _Stage(name, len(items))

    def each() -> Iterator[Item]:
        for item in items:
            yield item
            own.advance()

    with _shown(own, delay_s, every_s):
        yield each()


class _Stage:
    """A stage of `total` steps, None where their number is not known."""

    def __init__(self, name: str, total: int | None = None):
        self.name, self._total, self._done = name, total, 0
        self._began_s, self._bar = time.monotonic(), None

    def advance(self) -> None:
        """One more step is done."""
        self._done += 1
        with _lock:
            if self._bar is not None and _bars:
                _bars[0].update(self._bar, completed=self._done)

    def show(self) -> None:
        """Give it a line on the terminal."""
        if not _bars:
            _bars.append(_started())
        self._bar = _bars[0].add_task(
            self.name, total=self._total, completed=self._done, status=self.status
        )

    def hide(self) -> None:
        """Take its line from the terminal."""
        if self._bar is not None and _bars:
            _bars[0].remove_task(self._bar)
            if not _bars[0].tasks:
                _bars.pop().stop()

    def status(self) -> str:
        """How far it is, in words."""
        taken_s = time.monotonic() - self._began_s
        if self._total is None:
            return f"{taken_s:.0f} s"
        to_come = self._total - self._done
        left = f", about {taken_s / self._done * to_come:.0f} s left" if self._done else ""
        return f"{self._done} of {self._total}{left}"


def _started() -> "Progress":
    """The lines on the terminal, none so far."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    class StatusColumn(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(task.fields["status"]())

    columns = TextColumn("{task.description}", markup=False), BarColumn(20), StatusColumn()
    bars = Progress(*columns, console=Console(file=sys.stderr), transient=True,
                    redirect_stdout=False, redirect_stderr=False)  # fmt: skip
    bars.start()
    return bars


def end() -> None:
    """Take all lines from the terminal, where stages are left as they are."""
    with _lock:
        while _bars:
            _bars.pop().stop()


@contextmanager
def _shown(own: _Stage, delay_s: float, every_s: float) -> Iterator[None]:
    """Show a stage after so many seconds while the body runs."""
    done = threading.Event()
    speaker = threading.Thread(target=_speak, args=(own, done, delay_s, every_s), daemon=True)
    speaker.start()
    try:
        yield
    finally:
        done.set()
        speaker.join()


def _speak(own: _Stage, done: threading.Event, delay_s: float, every_s: float) -> None:
    if done.wait(delay_s):
        return
    is_terminal = sys.stderr.isatty()
    with _lock:
        _running.append(own)
        if is_terminal:
            own.show()
        else:
            print(f"{own.name} ...", file=sys.stderr, flush=True)
    while not done.wait(None if is_terminal else every_s):
        with _lock:
            if _running[-1] is own:
                each = (f"{one.name} ... {one.status()}" for one in _running)
                print("; ".join(each), file=sys.stderr, flush=True)
    with _lock:
        _running.remove(own)
        if is_terminal:
            own.hide()
