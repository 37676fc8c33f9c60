"""SIGINT (Ctrl-C), SIGTERM and SIGHUP end the command in good order, and a second one at once.

A job that reads a stream ends as at the stream's end (`progress.stopping`)."""

import atexit
import contextvars
import functools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn, TypeVar

from .. import progress

Value = TypeVar("Value")

_ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
_STACK_BYTES = 2**24  # compilers recurse; a thread's default may be 512 kB


class Stopped(BaseException):
    """Raised in the main thread by the first signal that ends the command."""

    def __init__(self, number: int):
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


def stoppable(main: Callable[..., int]) -> Callable[..., int]:
    """`main`, whose exit code is 130, 143 or 129 where a signal ended it, with one sentence on
    standard error; every context that was entered is left first."""

    @functools.wraps(main)
    def wrapped(*arguments: Any, **settings: Any) -> int:
        try:
            with _listening():
                code = main(*arguments, **settings)
        except Stopped as stopped:
            progress.end()
            print(
                f"srsinv: stopped by {stopped} before the end; what was begun is removed, and what "
                "was done before stays as it was",
                file=sys.stderr,
                flush=True,
            )
            if not arguments:  # the whole process, where compiled code may still be running
                sys.stdout.flush()
                os._exit(stopped.exit_code)
            return stopped.exit_code
        # Workers of joblib are stopped by the interpreter's own end alone, and would hold the
        # command's pipes open for minutes.
        if not arguments and not settings and "joblib" not in sys.modules:
            _end_process(code)
        return code

    return wrapped


def _end_process(code: int) -> NoReturn:
    """End the whole process, of which nothing is left to do. Python would first take apart every
    module and object, a third of a second after jax, xarray and matplotlib."""
    atexit._run_exitfuncs()
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def in_own_thread(work: Callable[[], Value]) -> Value:
    """Run `work` in a thread of its own, and return or raise as it does: a signal is then handled
    at once, though compiled code, which handles none, may be running for minutes."""
    if threading.current_thread() is not threading.main_thread():
        return work()
    done: Future[Value] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    before = threading.stack_size(_STACK_BYTES)
    try:
        thread = threading.Thread(target=contextvars.copy_context().run, args=(run,), daemon=True)
        thread.start()
    finally:
        threading.stack_size(before)
    return done.result()


def uninterrupted(work: Callable[[], None]) -> None:
    """Run `work`, which takes a moment: a signal that ends the command waits for its end."""
    with ThreadPoolExecutor(1) as pool:  # signals are handled in the main thread alone
        pool.submit(work).result()


@contextmanager
def _listening() -> Iterator[None]:
    """Signals that the process does not ignore (nohup, a job in the background) raise `Stopped`."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDING}
    handled = [n for n in _ENDING if before[n] not in (signal.SIG_IGN, None)]
    try:
        for number in handled:
            signal.signal(number, _stop)
        yield
    finally:
        for number in _ENDING:
            if before[number] is not None:
                signal.signal(number, before[number])


def _stop(number: int, frame: FrameType | None) -> None:
    for each in _ENDING:  # SIGTERM and SIGHUP often come together
        signal.signal(each, _end if each == signal.SIGINT else signal.SIG_IGN)
    if progress.stop():  # a job that ends in good order by itself
        return
    raise Stopped(number)


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(128 + number)
