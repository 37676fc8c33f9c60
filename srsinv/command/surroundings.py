"""What a command is run in: its streams, its current folder, and the variables that jax and
matplotlib read.

None of them is srsinv's own, and each can be unusable: a terminal of ASCII, a stream that is closed
or full, a folder that was removed, a variable that was set for another program.
"""

import ctypes
import errno
import io
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from ..errors import BadInput

# Figures are drawn without a display and by styles of our own: another program's choice of a
# backend, or a user's settings file, could only break them.
_DRAWING = {"MPLBACKEND": "Agg", "MATPLOTLIBRC": os.devnull}
_READ_BY_JAX = ("JAX_", "XLA_", "JAXTYPING_", "EQX_")  # and by what srsinv uses it with
# Switches that stop other programs of jax's at what is intended here, or forbid it.
_DEBUGGING = {
    "jax_check_tracer_leaks": False,
    "jax_debug_infs": False,  # an infinite noise stands for an offset that is not known
    "jax_debug_nans": False,  # NaN marks samples that are missing
    "jax_disable_jit": False,
    "jax_numpy_dtype_promotion": "standard",
    "jax_numpy_rank_promotion": "allow",
    "jax_transfer_guard": "allow",
}
# MiB that jax takes to start. With less, its libraries end the process before it can say why.
_LEAST = {"ulimit -v": 2560, "ulimit -d": 1024}
# What jax and Python's threads say where there is no memory.
_OUT_OF_MEMORY = ("RESOURCE_EXHAUSTED", "can't start new thread")
Loaded = TypeVar("Loaded")
# glibc's number for the most heaps of a process's threads, and how many are allowed: each keeps
# what it has freed, which with eight a core is a tenth of what a long recording takes. With one
# XLA compiles a quarter slower.
_ARENA_MAX, _HEAPS = -8, 2
_REASON = 200  # characters of another program's error


class _Unfailing(io.FileIO):
    """A file to which what cannot be written is lost."""

    def write(self, data: Any) -> int:
        """Write as to any file; say that all was written where it was not."""
        try:
            return super().write(data)
        except OSError:
            return len(data)


def settle_streams(are_own: bool) -> None:
    """Let standard output and error take any character, whatever their encoding, and give closed
    ones to the null device; where they `are_own`, of a whole process, errors that cannot be
    written are lost.

    A file opened later would otherwise get a closed stream's number, and what is printed with it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    if are_own and sys.stderr is not None:
        with suppress(OSError, ValueError):  # no file of the system's
            file, encoding = (
                _Unfailing(sys.stderr.fileno(), "w", closefd=False),
                sys.stderr.encoding,
            )
            sys.stderr = io.TextIOWrapper(file, encoding, line_buffering=True, write_through=True)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


@contextmanager
def printing(of: str = "what was asked for", remedy: str = "print it elsewhere") -> Iterator[None]:
    """Refuse where what is printed inside cannot be written, also by loggers: a full disk, or a
    pipe without a reader."""
    handle = logging.Handler.handleError
    logging.Handler.handleError = _raise_again
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        with suppress(OSError, ValueError):
            # Or Python tries again when it ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise BadInput(f"cannot print {of} ({error.strerror}); {remedy}") from error
    finally:
        logging.Handler.handleError = handle


def _raise_again(self: logging.Handler, record: logging.LogRecord) -> None:
    raise  # a handler calls this where it has caught an error


def check_memory() -> None:
    """Raise `BadInput` where a limit on this process's memory is too low to start."""
    from ..files import memory_limits

    for name, limit in memory_limits().items():
        if limit < _LEAST[name] * 2**20:
            raise BadInput(
                f"srsinv may use {limit // 2**20} MiB of memory here ({name}), and needs "
                f"{_LEAST[name]} MiB to start; allow more, as with {name} unlimited"
            )


def too_little_memory(error: BaseException) -> BadInput | None:
    """The refusal for an error of a process that a limit keeps from the memory it needs; None for
    any other error."""
    from ..files import memory_limits

    limits = memory_limits()
    is_load = isinstance(error, ImportError) and not isinstance(error, ModuleNotFoundError)
    is_full = isinstance(error, OSError) and error.errno == errno.ENOMEM
    is_said = any(words in str(error) for words in _OUT_OF_MEMORY)
    if not limits or not (is_load or is_full or is_said or isinstance(error, MemoryError)):
        return None
    allowed = " and ".join(f"{limit // 2**20} MiB ({name})" for name, limit in limits.items())
    remedies = " and ".join(f"{name} unlimited" for name in limits)
    return BadInput(
        f"srsinv may use {allowed} of memory here, which is too little "
        f"({type(error).__name__}); allow more, as with {remedies}"
    )


def settle_heaps() -> None:
    """Let the process's threads share a few heaps, where glibc provides them; before there are
    threads."""
    if "MALLOC_ARENA_MAX" not in os.environ:
        with suppress(AttributeError, OSError, TypeError):  # another library than glibc
            ctypes.CDLL(None).mallopt(_ARENA_MAX, _HEAPS)


def settle_drawing() -> None:
    """Let figures be drawn in the same way everywhere; before matplotlib is imported."""
    os.environ.update(_DRAWING)
    os.environ.pop("SOURCE_DATE_EPOCH", None)  # no figure has a date; what is no number ends numpy


def check_current_folder() -> None:
    """Raise `BadInput` where the current folder was removed, or may not be entered."""
    try:
        os.getcwd()
    except OSError as error:
        raise BadInput(
            f"the current folder cannot be used ({error.strerror}); go to another with cd FOLDER"
        ) from error


def started_with_jax(load: Callable[[], Loaded]) -> Loaded:
    """What `load` gives, which may import jax; jax is started where it does. Raises as
    [`start_jax`][] does."""
    try:
        loaded = load()
    except BadInput:
        raise
    except Exception:
        start_jax()  # by which it may have failed
        raise
    if "jax" in sys.modules:
        start_jax()
    return loaded


def start_jax() -> None:
    """Import jax, start it, and turn off its switches for debugging that the environment has on.

    Raises `BadInput` with the variables of the environment by which it cannot start.
    """
    given = [name for name in sorted(os.environ) if name.startswith(_READ_BY_JAX)]
    given = [name for name in given if (name, os.environ[name]) != ("JAX_ENABLE_X64", "true")]
    try:
        import jax

        jax.devices()
        for name in _DEBUGGING.keys() & {each.lower() for each in os.environ}:
            jax.config.update(name, _DEBUGGING[name])
        if given:  # some are read later, and that takes a second
            import equinox  # noqa: F401

            jax.jit(jax.numpy.negative)(0.0)
    except Exception as error:  # ValueError, RuntimeError or AssertionError, by the variable
        if not given or too_little_memory(error):
            raise
        said = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
        mentioned = [name for name in given if name in said or name.lower() in said]
        of_devices = [name for name in given if "PLATFORM" in name or "DEVICES" in name]
        named = mentioned or of_devices or given
        settings = " and ".join(f"{name}={os.environ[name]}" for name in named)
        device = ", as it finds no such device" if any("PLATFORM" in n for n in named) else ""
        raise BadInput(
            f"jax cannot start with {settings}{device} ({said[:_REASON]}); type unset "
            f"{' '.join(named)} and run it again"
        ) from error
