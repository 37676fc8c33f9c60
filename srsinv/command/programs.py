"""Compiled programs, let go of before they are too many."""

import ctypes
import gc
import sys
from pathlib import Path

_MAPS = Path("/proc/self/maps")
# A configuration compiles programs of some 60 MB in 600 memory maps, and Linux gives a process
# 65530 maps, beyond which compiling crashes: a quarter of a gigabyte of them is kept.
MOST_MAPS = 4_000


def release_programs(most_maps: int = MOST_MAPS) -> None:
    """Forget what jax has compiled once this process maps more than `most_maps` pieces of memory.

    Programs are compiled again where they are needed again. Where the system does not tell the
    number of maps, nothing is let go of.
    """
    jax = sys.modules.get("jax")
    if jax is None or not _MAPS.exists() or _MAPS.read_bytes().count(b"\n") <= most_maps:
        return
    jax.clear_caches()
    gc.collect()
    # What is free lies scattered among what is not, and glibc gives it back only when asked to.
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)
