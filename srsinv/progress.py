"""Progress messages on stderr, for stages of more than two seconds."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_running: list[object] = []  # nested stages: only the innermost prints


@contextmanager
def stage(name: str, *, delay_s: float = 2.0, refresh_s: float = 1.0) -> Iterator[None]:
    """Print `name` on standard error if the body runs for more than `delay_s` [s].

    On a terminal one line counts the seconds, every `refresh_s` [s], and goes away at the end;
    elsewhere `name ...` is printed once.
    """
    done = threading.Event()
    token = object()
    speaker = threading.Thread(
        target=_speak, args=(name, token, done, delay_s, refresh_s), daemon=True
    )
    _running.append(token)
    speaker.start()
    try:
        yield
    finally:
        done.set()
        speaker.join()
        _running.remove(token)


def _speak(
    name: str, token: object, done: threading.Event, delay_s: float, refresh_s: float
) -> None:
    started_s = time.monotonic()
    stream = sys.stderr
    if done.wait(delay_s):
        return
    if not stream.isatty():
        print(f"{name} ...", file=stream, flush=True)
        return
    while True:
        if _running[-1] is token:
            elapsed_s = time.monotonic() - started_s
            stream.write(f"\r\033[K{name} ... {elapsed_s:.0f} s")
            stream.flush()
        if done.wait(refresh_s):
            break
    stream.write("\r\033[K")
    stream.flush()
