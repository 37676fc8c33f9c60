"""Memory that a call takes: how far the resident memory of the process rises."""

import ctypes
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Weighed(NamedTuple):
    """What a work gives, and the bytes by which resident memory rose at most meanwhile."""

    value: Any
    rise_bytes: float


def weighed(work: Callable[[], Any]) -> Weighed:
    """Call `work` once.

    The peak is that of the whole process, numpy and jax alike, over what it held before, to some
    0.1 MB: free memory is handed back first, as what is taken from it would not show. Linux counts
    the peak; elsewhere it is NaN.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
    try:
        _RESET.write_text("5", encoding="ascii")
        before = _bytes("VmRSS")
    except (OSError, TypeError):  # the system counts no peak
        before = None
    value = work()
    return Weighed(value, np.nan if before is None else max(_bytes("VmHWM") - before, 0.0))


def _bytes(name: str) -> float:
    """A quantity of the process's status; raises `TypeError` where it has none."""
    match: Any = re.search(rf"^{name}:\s+(\d+) kB", _STATUS.read_text(encoding="ascii"), re.M)
    return 1024.0 * int(match[1])
