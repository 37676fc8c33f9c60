"""Files that a job writes where the user names them, beside those of the run's folder."""

import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ..atomic import write_whole, writing
from ..errors import refuse
from ..files import LARGEST_FILE, path_of, read_bytes


class Target(NamedTuple):
    """A kind of file, `what`, that `key` of the configuration names: its suffixes, and whether a
    file that is there already `is_own`, as an earlier `writer` wrote it."""

    key: str
    what: str
    writer: str
    suffixes: tuple[str, ...]
    is_own: Callable[[Path], bool]


@dataclass(frozen=True)
class WrittenFile:
    """A place for a file, and what an earlier one of its kind holds there."""

    path: Path
    earlier: bytes | None

    def write(self, content: bytes) -> None:
        """Write the file as a whole. Raises `BadInput` where it cannot be written, and where
        another one has come there since."""
        write_whole(self.path, content, lambda held: held == self.earlier)


def check_target(target: Target, given: Any) -> WrittenFile | None:
    """The file that is named, refused where it cannot be written there or would replace another
    file than an earlier one of its kind."""
    if given is None:
        return None
    path = path_of(given, target.key)
    refuse(
        path.suffix.lower() not in target.suffixes,
        f"{target.key} is {path.name!r}: give a name that ends in "
        f"{' or '.join(target.suffixes)} for {target.what}.",
    )
    refuse(
        not os.path.isdir(path.parent),
        f"{target.key}: there is no folder {str(path.parent)!r}: create it first.",
    )
    with writing(path):
        try:
            is_plain = stat.S_ISREG(path.lstat().st_mode)
        except FileNotFoundError:
            return WrittenFile(path, None)
    earlier = None
    if is_plain and path.stat().st_size:
        earlier = read_bytes(path, what=target.what, key=target.key, most=LARGEST_FILE)
    refuse(
        earlier is None or not target.is_own(path),
        f"{path}: the file exists, and is not as a {target.writer} wrote it: choose "
        "another name, or move it away.",
    )
    return WrittenFile(path, earlier)
