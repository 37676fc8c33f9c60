"""Memory of a process that compiles: compiled programs released before there are too many, and
rarer searches for garbage."""

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_MAPS = Path("/proc/self/maps")
# A configuration compiles programs of some 60 MB in 600 memory maps, and Linux gives a process
# 65530 maps, beyond which compiling crashes: a quarter of a gigabyte of them is cached.
MOST_MAPS = 4_000


# Objects made less those freed before a search for garbage, and searches before a deeper one.
RARE = (50_000, 20, 50)


@contextmanager
def rare_collections(is_whole_process: bool) -> Iterator[None]:
    """Search for garbage rarely inside: imports and tracing make many objects that live long, and
    searching them as often as by default takes a tenth of a run. Of a whole process nothing is
    left to do afterwards, and the search that the old rate would begin with is spared."""
    before = gc.get_threshold()
    gc.set_threshold(*RARE)
    try:
        yield
    finally:
        if not is_whole_process:
            gc.set_threshold(*before)


def release_programs(most_maps: int = MOST_MAPS) -> None:
    """Clear jax's compiled programs once this process has more than `most_maps` memory maps.

    Programs are compiled again where they are needed again. Where the system does not give the
    number of maps, nothing is released.
    """
    jax = sys.modules.get("jax")
    if jax is None or not _MAPS.exists() or _MAPS.read_bytes().count(b"\n") <= most_maps:
        return
    jax.clear_caches()
    gc.collect()
    # Free memory is fragmented, and glibc returns it to the system on request only.
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)
