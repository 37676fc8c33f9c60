"""Changes on the disk that are made as a whole or not at all, and touch nothing else.

A folder is held by its descriptor, and every name is looked up within one, never through a link:
whatever somebody puts in the way between a check and its use, a change happens in the folder that
was checked or fails. A new file or folder is made under a name that nobody can guess, which no
later run acts on, and comes to its place by one rename.
"""

import ctypes
import errno
import fcntl
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path, PurePosixPath

from .errors import BadInput

SCRATCH = ".srsinv-"  # beginning of the names of what is being made
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
# A folder on the way to another need not be readable, only searchable.
_ON_THE_WAY = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_MOST_BYTES = 2**28  # of a file that is replaced: nothing that is written as one comes near
_NO_REPLACE, _EXCHANGE = 1, 2  # flags of renameat2, from Linux's headers
# What renameat2 answers where the system or the file system does not know it, or a flag.
_UNKNOWN = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)


def open_folder(path: str | os.PathLike[str], within: int | None = None, make: bool = False) -> int:
    """A descriptor of the folder at `path`, each part of which is looked up in the one before and
    is no link; `within` another folder, or from the root. Missing parts are made where `make`.

    Raises `OSError`.
    """
    parts = [part for part in PurePosixPath(path).parts if part != "/"]
    here = os.open("/" if within is None else ".", _ON_THE_WAY if parts else _FOLDER, dir_fd=within)
    for number, part in enumerate(parts, 1):
        try:
            if make:
                with suppress(FileExistsError):
                    os.mkdir(part, dir_fd=here)
            following = os.open(part, _ON_THE_WAY if number < len(parts) else _FOLDER, dir_fd=here)
        finally:
            os.close(here)
        here = following
    return here


@contextmanager
def opened(
    path: str | os.PathLike[str], within: int | None = None, make: bool = False
) -> Iterator[int]:
    """[`open_folder`][], closed at the end."""
    descriptor = open_folder(path, within, make)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def plain_file(name: str, folder: int) -> Iterator[BufferedReader | None]:
    """The regular file `name` (with slashes) in a folder; None where there is none, or a link, a
    pipe or a device in its place, which are not opened."""
    path = PurePosixPath(name)
    descriptor = None
    with suppress(OSError, ValueError), opened(path.parent, folder) as inside:
        if stat.S_ISREG(os.stat(path.name, dir_fd=inside, follow_symlinks=False).st_mode):
            descriptor = os.open(path.name, _READ, dir_fd=inside)
    if descriptor is None:
        yield None
        return
    with os.fdopen(descriptor, "rb") as file:
        yield file if stat.S_ISREG(os.fstat(descriptor).st_mode) else None


def write_new(name: str, data: bytes, folder: int) -> None:
    """Write a file `name` (with slashes) that is not there yet, with its folders."""
    path = PurePosixPath(name)
    with (
        opened(path.parent, folder, make=True) as inside,
        os.fdopen(os.open(path.name, _NEW, 0o666, dir_fd=inside), "wb") as file,
    ):
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def scratch_folder(files: Mapping[str, bytes], within: int) -> Iterator[str]:
    """The name of a new folder that holds `files`, closed to others. What is left of it at the end
    is removed."""
    name = scratch_name()
    os.mkdir(name, 0o700, dir_fd=within)
    try:
        folder = open_folder(name, within)
    except OSError:
        os.rmdir(name, dir_fd=within)
        raise
    own = os.fstat(folder)
    with suppress(OSError):  # says that somebody is at work in it, where there are locks
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    try:
        for each, data in files.items():
            write_new(each, data, folder)
        for path in {PurePosixPath(each).parent for each in files}:
            with opened(path, folder) as inside:
                _sync(inside)
        yield name
    finally:
        with suppress(OSError):  # it was moved away, and another may have its name now
            if os.path.samestat(own, os.stat(name, dir_fd=within, follow_symlinks=False)):
                remove_files(files, folder)
                os.rmdir(name, dir_fd=within)
        os.close(folder)


def scratch_name() -> str:
    """A name for what is being made."""
    return f"{SCRATCH}{secrets.token_hex(8)}"


def is_scratch(name: str) -> bool:
    """Whether a name looks like one of what is being made."""
    return re.fullmatch(re.escape(SCRATCH) + "[0-9a-f]{16}", name) is not None


def remove(name: str, files: Iterable[str], within: int) -> None:
    """Remove the folder `name` with these files. Raises `OSError` where anything else is in it,
    which stays."""
    with opened(name, within) as folder:
        remove_files(files, folder)
    os.rmdir(name, dir_fd=within)


def remove_files(names: Iterable[str], folder: int) -> None:
    """Remove these files (names with slashes) where they are in a folder, and the folders in it
    that they leave empty."""
    paths = [PurePosixPath(name) for name in names]
    for path in paths:
        with suppress(FileNotFoundError), opened(path.parent, folder) as inside:
            os.unlink(path.name, dir_fd=inside)
    above = {parent for path in paths for parent in path.parents if parent.name}
    for path in sorted(above, key=lambda each: -len(each.parts)):
        with suppress(OSError), opened(path.parent, folder) as inside:
            os.rmdir(path.name, dir_fd=inside)


def exchange(one: str, other: str, folder: int) -> bool:
    """Exchange two names in a folder; False where the file system cannot."""
    return _renameat2(folder, one, folder, other, _EXCHANGE)


def write_whole(path: Path, content: bytes, is_own: Callable[[bytes], bool] | None = None) -> None:
    """Write a file as a whole or not at all, in place of none or of one that `is_own` by its
    content.

    Raises `BadInput` where there is another file, and where it cannot be written.
    """
    may_go = is_own or (lambda _: False)

    def holds_own(name: str, folder: int) -> bool:
        with plain_file(name, folder) as file:
            return file is not None and may_go(file.read(_MOST_BYTES)) and not file.read(1)

    with writing(path), opened(os.path.realpath(path.parent)) as folder:
        scratch = scratch_name()
        try:
            write_new(scratch, content, folder)
            put(scratch, folder, path.name, folder, holds_own)
        finally:
            with suppress(FileNotFoundError):
                os.unlink(scratch, dir_fd=folder)
            _sync(folder)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an `OSError` inside into `BadInput` for the file at `path`."""
    try:
        yield
    except FileExistsError as error:
        raise BadInput(
            f"{path}: another file has this name: choose another name, or move that file away."
        ) from error
    except OSError as error:
        raise BadInput(
            f"{path}: the file cannot be written ({error.strerror or 'write error'}): "
            "give a path in an existing, writable folder with free space."
        ) from error


def put(old: str, source: int, new: str, folder: int, is_own: Callable[[str, int], bool]) -> None:
    """Give the file `old` of the folder `source` the name `new` in `folder`, in place of none or of
    a file that `is_own`, which is asked with a name and the folder it is in. What was there is then
    `old`, or gone.

    Raises `FileExistsError` where there is another file, also one that has come there meanwhile.
    """
    if _put_where_none_is(old, source, new, folder):
        return
    _check_own(new, folder, is_own)
    if not _renameat2(source, old, folder, new, _EXCHANGE):
        os.rename(old, new, src_dir_fd=source, dst_dir_fd=folder)
        return
    try:
        _check_own(old, source, is_own)  # nothing came between
    except FileExistsError:
        _renameat2(source, old, folder, new, _EXCHANGE)
        raise


def _put_where_none_is(old: str, source: int, new: str, folder: int) -> bool:
    """Whether a file could be given a name that no other has."""
    try:
        if not _renameat2(source, old, folder, new, _NO_REPLACE):
            os.link(old, new, src_dir_fd=source, dst_dir_fd=folder, follow_symlinks=False)
    except FileExistsError:
        return False
    return True


def _check_own(name: str, folder: int, is_own: Callable[[str, int], bool]) -> None:
    if not is_own(name, folder):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), name)


def _sync(folder: int) -> None:
    """Put the names of a folder on the disk, where its file system can."""
    with suppress(OSError):
        os.fsync(folder)


def _renameat2(old_folder: int, old: str, new_folder: int, new: str, flags: int) -> bool:
    """Rename by Linux's call; False where there is none, or none with these flags."""
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        return False
    if call(old_folder, os.fsencode(old), new_folder, os.fsencode(new), flags) == 0:
        return True
    number = ctypes.get_errno()
    if number in _UNKNOWN:
        return False
    raise OSError(number, os.strerror(number), new)
