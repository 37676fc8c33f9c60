"""Progress messages on stderr, for stages of more than two seconds."""

import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")

_BAR = 20  # characters
_running: list[Callable[[], str]] = []  # how far the nested stages are: the innermost prints all


def say(sentence: str) -> None:
    """Print a sentence on standard error."""
    print(f"srsinv: {sentence}", file=sys.stderr, flush=True)


@contextmanager
def stage(name: str, *, delay_s: float = 2.0, refresh_s: float = 1.0) -> Iterator[None]:
    """Print `name` on standard error if the body runs for more than `delay_s` [s].

    On a terminal one line counts the seconds, every `refresh_s` [s], and goes away at the end;
    elsewhere `name ...` is printed once.
    """
    with _spoken(name, lambda taken_s: f"{taken_s:.0f} s", delay_s, refresh_s):
        yield


@contextmanager
def steps(
    name: str, items: Collection[Item], *, delay_s: float = 2.0, refresh_s: float = 1.0
) -> Iterator[Iterator[Item]]:
    """The items one after the other, as a [`stage`][] with a bar and the time left, which takes the
    items to come to last as long as those done."""
    done = 0

    def each() -> Iterator[Item]:
        nonlocal done
        for item in items:
            yield item
            done += 1

    def status(taken_s: float) -> str:
        filled = _BAR * done // len(items)
        left = f", about {taken_s / done * (len(items) - done):.0f} s left" if done else ""
        return f"[{'#' * filled}{'.' * (_BAR - filled)}] {done} of {len(items)}{left}"

    with _spoken(name, status, delay_s, refresh_s):
        yield each()


@contextmanager
def _spoken(
    name: str, status: Callable[[float], str], delay_s: float, refresh_s: float
) -> Iterator[None]:
    """Print `name` with its `status` after so many seconds while the body runs."""
    done, started_s = threading.Event(), time.monotonic()

    def line() -> str:
        return f"{name} ... {status(time.monotonic() - started_s)}"

    speaker = threading.Thread(
        target=_speak, args=(name, line, done, delay_s, refresh_s), daemon=True
    )
    _running.append(line)
    speaker.start()
    try:
        yield
    finally:
        done.set()
        speaker.join()
        _running.remove(line)


def _speak(
    name: str, line: Callable[[], str], done: threading.Event, delay_s: float, refresh_s: float
) -> None:
    stream = sys.stderr
    if done.wait(delay_s):
        return
    if not stream.isatty():
        print(f"{name} ...", file=stream, flush=True)
        return
    while True:
        if _running[-1] is line:
            stream.write(f"\r\033[K{'; '.join(each() for each in [*_running])}")
            stream.flush()
        if done.wait(refresh_s):
            break
    stream.write("\r\033[K")
    stream.flush()
