"""Compiled programs in the user's cache folder, from one run of the command to the next.

jax reads and writes them. It executes what it reads: the folder has to be the user's own and closed
to others. An entry that cannot be read is compiled again, and no trouble here ends a run.
"""

import hashlib
import os
import platform
import re
import stat
import sys
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from ..errors import echo, refuse

MOST_BYTES = 2**28  # some 10,000 programs; a run has about 50, of 25 kB each
_LEFT = 0.75  # of these bytes, after the least recently used are removed
# Lines of /proc/cpuinfo that decide what is compiled: instructions, and what it is tuned to.
_PROCESSOR = ("vendor", "cpu family", "cpu part", "model", "flags", "feat")
_TROUBLE = re.compile("Error (reading|writing) persistent compilation cache entry")


@contextmanager
def compilation_cache(wanted: bool, most_bytes: int = MOST_BYTES) -> Iterator[None]:
    """Keep what jax compiles inside for later runs, where that is `wanted` and the user has not set
    up a cache of jax's own.

    Where the folder is not safe or cannot be made, one sentence on standard error says so, and
    nothing is cached. Raises `BadInput` where `wanted` is no bool.
    """
    refuse(
        not isinstance(wanted, bool),
        f"compilation_cache is {echo(wanted)}: give true or false.",
    )
    folder = _usable_folder() if wanted else None
    with nullcontext() if folder is None else _caching(folder, most_bytes):
        yield


def _usable_folder() -> Path | None:
    """The folder of compiled programs; None where nothing is compiled, where jax has one already,
    or, with the reason printed, where there can be none."""
    jax = sys.modules.get("jax")  # what compiles has imported it
    if jax is None or jax.config.jax_compilation_cache_dir:  # pyright: ignore[reportAttributeAccessIssue]
        return None
    try:
        return _folder()
    except OSError as error:
        print(
            f"srsinv: compiled programs are not cached: {error.filename}: {error.strerror}; mend "
            "that, set XDG_CACHE_HOME to another folder, or give compilation_cache=false",
            file=sys.stderr,
        )
        return None


@contextmanager
def _caching(folder: Path, most_bytes: int) -> Iterator[None]:
    import jax
    from jax.experimental.compilation_cache import compilation_cache as cache

    from ..compiled import stored

    settings = {
        "jax_compilation_cache_dir": str(folder),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    known = set(os.listdir(folder))
    troubles: list[str] = []
    _configure(jax, settings)
    try:
        with _collected(troubles), stored(folder):
            yield
    finally:
        _configure(jax, before)
        cache.reset_cache()
        with suppress(OSError):  # another process may be doing the same
            if troubles:
                _remove_unreadable(folder)
            if not known.issuperset(os.listdir(folder)):
                _shrink(folder.parent, most_bytes)


def _configure(jax: Any, settings: dict[str, Any]) -> None:
    for name, value in settings.items():
        jax.config.update(name, value)


def _folder() -> Path:
    """The folder of this machine's programs, made where it is missing. Raises `OSError` where it
    cannot be made or is not the user's alone."""
    base = _user_cache()
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = base / "srsinv"
    for each in (folder, folder / machine_kind()):
        with suppress(FileExistsError):
            each.mkdir(mode=0o700)
        _check_private(each)
    return folder / machine_kind()


def _user_cache() -> Path:
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):
        return Path(given)
    inside = "~/Library/Caches" if sys.platform == "darwin" else "~/.cache"
    path = os.path.expanduser(inside)
    if path == inside:
        raise FileNotFoundError(0, "there is no home folder", inside)
    return Path(path)


def machine_kind() -> str:
    """Name of the kind of processor: programs compiled for another may crash on this one, where
    machines share a folder. What jax's flags change, it keeps apart itself."""
    told = {platform.node()}  # where the system does not list what processors can do
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
        told = {line for line in lines if line.lower().startswith(_PROCESSOR)}
    number = hashlib.sha256("".join(sorted(told)).encode()).hexdigest()[:8]
    return f"{platform.machine() or 'machine'}-{number}"


def _check_private(folder: Path) -> None:
    status = folder.lstat()
    fault = ""
    if not stat.S_ISDIR(status.st_mode):
        fault = "this is a link or a file, not a folder"
    elif hasattr(os, "geteuid") and status.st_uid != os.geteuid():
        fault = "this folder belongs to another user"
    elif hasattr(os, "geteuid") and status.st_mode & 0o077:
        fault = "this folder is open to other users (chmod 700 closes it)"
    elif not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
        fault = "this folder cannot be read and written"
    if fault:
        raise PermissionError(0, fault, str(folder))


@contextmanager
def _collected(troubles: list[str]) -> Iterator[None]:
    """Add jax's warnings of entries that could not be read or written to `troubles` in place of
    printing them; other warnings are shown as before."""
    with warnings.catch_warnings():
        warnings.filterwarnings("always", message=_TROUBLE.pattern)
        show = warnings.showwarning

        def collect(message: Warning | str, *where: Any, **more: Any) -> None:
            if _TROUBLE.match(str(message)):
                troubles.append(str(message))
            else:
                show(message, *where, **more)

        warnings.showwarning = collect
        yield


def _remove_unreadable(folder: Path) -> None:
    """Remove the entries that were cut short or changed, which jax would not write again."""
    for path in folder.glob("*-cache"):
        try:
            zlib.decompress(path.read_bytes())
        except (OSError, zlib.error):
            path.unlink(missing_ok=True)


def _shrink(folder: Path, most_bytes: int) -> None:
    """Remove the least recently used entries where there are more than `most_bytes` of them."""
    from ..compiled import SUFFIX

    every = (path for ending in ("-cache", SUFFIX) for path in folder.rglob(f"*{ending}"))
    entries = [(path, path.stat()) for path in every]
    size = sum(status.st_size for _, status in entries)
    if size <= most_bytes:
        return
    # Some file systems do not note when a file was read; when it was written is a lower bound.
    for path, status in sorted(entries, key=lambda each: max(each[1].st_atime, each[1].st_mtime)):
        if size <= _LEFT * most_bytes:
            return
        path.unlink(missing_ok=True)
        size -= status.st_size
