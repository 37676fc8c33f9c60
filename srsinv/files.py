"""Opening of files that somebody else may have made, whatever they hold, under limits.

Only regular files are opened, never waited for; the reads of a library's parser are bounded, so
that no header, however wrong, costs more than the file's own size. In a folder of somebody else no
link is followed.
"""

import io
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from srsinv.atomic import opened
from srsinv.errors import BadInput, echo, nearest_name, refuse

LARGEST_FILE = 2**32  # bytes: 1e8 numbers written to 17 digits, and half as much again
_LONGEST = 200  # characters of a path that is shown as it is
# Opening never waits for a writer, and never makes a terminal the process's own.
_READ = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
_SHOWN = 60  # characters of a name within a sentence
COMPARED = 60  # characters of each of two names that are looked at for a similar one
_NEIGHBOURS = 1_000  # files of a folder that are compared for a similar name
# Characters that control, separate lines or turn the way of writing, and halves of characters:
# nothing that can be printed.
_BROKEN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def is_broken(text: str) -> bool:
    """Whether a name or a path holds characters that no page and no terminal can show."""
    return bool(_BROKEN.search(text))


def quoted(name: str) -> str:
    """A name as it is, or in quotes where it could be misread; a long one cut short."""
    name = name if len(name) <= _SHOWN else f"{name[:_SHOWN]}…"
    return name if name == name.strip() and name.isprintable() else ascii(name)


def path_of(value: Any, key: str) -> Path:
    """The path that `value`, given by configuration key `key`, names; `~` is the user's folder.

    Raises `BadInput` for values that are no path or not printable.
    """
    refuse(
        not isinstance(value, str | os.PathLike) or isinstance(os.fspath(value), bytes),
        f"{key} is {echo(value)}: give the name of a file.",
    )
    text = os.fspath(value)
    refuse(
        not text or is_broken(text),
        f"{key} is {_ascii(text)}: give the name of a file, in characters that can be printed.",
    )
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise BadInput(f"{key} is {_ascii(text)}: there is no such user: give a path.") from error


class DataFile(io.BufferedReader):
    """A regular file that is read to the size it had when it was opened, and no further.

    `limit` bounds what a parser may ask for, where it trusts the file's own headers.
    """

    def __init__(self, descriptor: int, path: Path):
        super().__init__(io.FileIO(descriptor))
        self.path = path
        self.size = os.fstat(descriptor).st_size
        self._reads_left: int | None = None
        self._most_bytes = LARGEST_FILE

    def limit(self, *, reads: int | None = None, most_bytes: int = LARGEST_FILE) -> None:
        """Limit further reads in number (None: unlimited) and each to `most_bytes`."""
        self._reads_left, self._most_bytes = reads, most_bytes

    def read(self, size: int | None = -1, /) -> bytes:
        """Read as from any file; raises `ValueError` beyond a limit."""
        left = max(self.size - self.tell(), 0)
        size = left if size is None or size < 0 else min(size, left)
        self._count(size)
        return super().read(size)

    def readinto(self, buffer: Any, /) -> int:
        """Read as from any file; raises `ValueError` beyond a limit."""
        self._count(0)
        return super().readinto(buffer)

    def is_at_end(self) -> bool:
        """Whether nothing follows, whatever size the file states."""
        return not super().read(1)

    def _count(self, size: int) -> None:
        if size > self._most_bytes:
            raise ValueError("asks for too much at once")
        if self._reads_left is not None:
            self._reads_left -= 1
            if self._reads_left < 0:
                raise ValueError("asks for too many small parts")


@contextmanager
def open_file(
    path: Path,
    *,
    what: str = "file",
    key: str = "recording.path",
    most: int = LARGEST_FILE,
    below: Path | None = None,
) -> Iterator[DataFile]:
    """The file at `path`, which a refusal calls `what` and configuration key `key` names.

    Of a path `below` a folder no part after that folder may be a link. Raises `BadInput` for a path
    that is absent, no regular file, unreadable, empty or larger than `most` bytes, and at the end
    for a file that changed while it was read.
    """
    with DataFile(_opened(path, what, key, below), path) as file:
        before = os.fstat(file.fileno())
        name = quoted(path.name)
        refuse(before.st_size == 0, f"{name}: the {what} is empty: record or copy it again.")
        refuse(
            before.st_size > most,
            f"{name}: the {what} is {before.st_size} bytes long, above the limit of {most}: write "
            "it again, or in shorter parts.",
        )
        yield file
        after = os.fstat(file.fileno())
        refuse(
            (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns),
            f"{name}: the {what} changed while it was read: try again once it is written.",
        )


def read_bytes(
    path: Path, *, what: str, most: int, key: str | None = None, below: Path | None = None
) -> bytes:
    """All bytes of the file at `path`, which a refusal calls `what` ("sidecar").

    Raises `BadInput` as [`open_file`][] does for the file that `key` names; None: `recording.` and
    `what`.
    """
    key = key or f"recording.{what}"
    with (
        within_memory(path),
        open_file(path, what=what, key=key, most=most, below=below) as file,
    ):
        content = file.read()
        refuse(
            len(content) != file.size or not file.is_at_end(),
            f"{quoted(path.name)}: the {what} has fewer bytes than the system reports: "
            "copy it to a regular file.",
        )
        return content


def read_json(path: Path, *, what: str, most: int, key: str, below: Path | None = None) -> Any:
    """What a file holds as JSON, read as by [`read_bytes`][] and [`parse_json`][]."""
    content = read_bytes(path, what=what, most=most, key=key, below=below)
    try:
        return parse_json(content.decode())
    except (ValueError, RecursionError) as error:
        reason = str(error)
        if isinstance(error, UnicodeDecodeError):
            reason = "not UTF-8"
        elif isinstance(error, RecursionError):
            reason = "nested too deeply"
        raise BadInput(
            f"{_path_text(path)}: the {what} is not JSON as srsinv writes it ({reason}): "
            "repeat the command that wrote it."
        ) from error


def parse_json(text: str) -> Any:
    """What a text holds as JSON. Raises `ValueError` for a key that stands twice and for what is no
    number, which Python takes, and `RecursionError` for text that is nested too deeply."""
    return json.loads(text, parse_constant=_no_constant, object_pairs_hook=mapping_of)


def _no_constant(constant: str):
    raise ValueError(f"{constant} is not a JSON number")


def mapping_of(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """The pairs as a mapping. Raises `ValueError` for a key that stands twice."""
    mapping: dict[str, Any] = {}
    for key, value in pairs:
        if key in mapping:
            raise ValueError(f"the key {echo(key)} stands twice")
        mapping[key] = value
    return mapping


@contextmanager
def within_memory(path: Path) -> Iterator[None]:
    """Refuse what takes more memory than there is, with the file's size and the limit."""
    try:
        yield
    except MemoryError as error:
        size = path.stat().st_size
        limits = " and ".join(f"{name} is {most // 1024}" for name, most in memory_limits().items())
        more = f", or allow more ({limits})" if limits else ""
        raise BadInput(
            f"{quoted(path.name)}: reading its {size} bytes needs more memory than there "
            f"is: write it again in shorter parts{more}."
        ) from error


def memory_limits() -> dict[str, int]:
    """The limits on this process's memory, in bytes, by the command of the shell that sets them."""
    try:
        import resource  # which not every system has
    except ImportError:
        return {}
    kinds = {"ulimit -v": resource.RLIMIT_AS, "ulimit -d": resource.RLIMIT_DATA}
    soft = {name: resource.getrlimit(kind)[0] for name, kind in kinds.items()}
    return {name: most for name, most in soft.items() if most != resource.RLIM_INFINITY}


def _opened(path: Path, what: str, key: str, below: Path | None) -> int:
    """A descriptor of the regular file at `path`.

    Checked before it is opened, as opening a pipe or a device has effects; and again by its
    descriptor, as the name may have been given to another file in between.
    """
    try:
        if below is None:
            _check_kind(os.stat(path).st_mode, path, what, key)
            descriptor = os.open(path, _READ)
        else:
            descriptor = _opened_below(path, what, key, below)
    except BadInput:
        raise
    except (FileNotFoundError, NotADirectoryError) as error:
        raise BadInput(_no_such_file(path, what, key)) from error
    except PermissionError as error:
        raise BadInput(
            f"{_path_text(path)}: the {what} cannot be read without permission: change "
            "its permissions."
        ) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a valid path"
        raise BadInput(
            f"{_path_text(path)}: the {what} cannot be opened ({reason.lower()}): check {key}=..."
        ) from error
    try:
        _check_kind(os.fstat(descriptor).st_mode, path, what, key)
    except BadInput:
        os.close(descriptor)
        raise
    return descriptor


def _opened_below(path: Path, what: str, key: str, folder: Path) -> int:
    """A descriptor of the file at `path` without following a link below `folder`, each of the
    folders between opened by its own descriptor, so that none can be exchanged meanwhile."""
    inside = path.relative_to(folder)
    if ".." in inside.parts:
        raise ValueError("leads out of its folder")
    with opened(Path(os.path.realpath(folder), inside.parent)) as above:
        mode = os.stat(inside.name, dir_fd=above, follow_symlinks=False).st_mode
        _check_kind(mode, path, what, key)
        return os.open(inside.name, _READ | os.O_NOFOLLOW, dir_fd=above)


def _check_kind(mode: int, path: Path, what: str, key: str) -> None:
    if not stat.S_ISREG(mode):
        kinds = {
            stat.S_IFDIR: "a folder",
            stat.S_IFLNK: "a link",
            stat.S_IFIFO: "a pipe",
            stat.S_IFSOCK: "a socket",
        }
        kind = kinds.get(stat.S_IFMT(mode), "a device")
        raise BadInput(
            f"{_path_text(path)}: this is {kind} where the {what} is expected: name a regular "
            f"file by {key}=..."
        )


def _no_such_file(path: Path, what: str, key: str) -> str:
    try:
        with os.scandir(path.parent) as entries:
            names = [each.name for each in islice(entries, _NEIGHBOURS) if each.is_file()]
    except OSError:
        names = []
    alike = [name for name in names if Path(name).suffix.lower() == path.suffix.lower()]
    near = nearest_name(path.name, alike, compared=COMPARED)
    hint = f"did you mean {quoted(near)}?" if near else f"check {key}=..."
    return f"{_path_text(path)}: there is no such {what}: {hint}"


def _path_text(path: Path) -> str:
    """A path as it is, its end alone where it is long."""
    text = str(path)
    text = text if len(text) <= _LONGEST else f"…{text[-_SHOWN:]}"
    return text if text.isprintable() else ascii(text)


def _ascii(text: str) -> str:
    return ascii(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")
