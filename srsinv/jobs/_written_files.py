"""Files that a job writes where the user names them, beside those of the run's folder."""

import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import BadInput, refuse


class Target(NamedTuple):
    """A kind of file, `what`, that `key` of the configuration names: its suffixes, and whether a
    file that is there already `is_own`, written by an earlier `writer`."""

    key: str
    what: str
    writer: str
    suffixes: tuple[str, ...]
    is_own: Callable[[Path], bool]


def check_target(target: Target, given: Any) -> Path | None:
    """The file that is named, refused where it cannot be written there or would replace another
    file than an earlier one of its kind."""
    if given is None:
        return None
    path = Path(str(given)).expanduser()
    refuse(
        path.suffix.lower() not in target.suffixes,
        f"{target.key} is {path.name!r}: {target.what} ends in {' or '.join(target.suffixes)}: "
        "name it so.",
    )
    refuse(
        not path.parent.is_dir(),
        f"{target.key}: there is no folder {str(path.parent)!r}: make it first.",
    )
    refuse(
        os.path.lexists(path) and not (path.is_file() and target.is_own(path)),
        f"{path}: there is a file already that no {target.writer} wrote: choose another name, or "
        "move it away.",
    )
    return path


def write_whole(path: Path, content: bytes) -> None:
    """Write the file as a whole or not at all. Raises `BadInput` where it cannot be written."""
    scratch = path.with_name(f".{path.name}.{secrets.token_hex(4)}.srsinv")
    try:
        scratch.write_bytes(content)
        os.replace(scratch, path)
    except OSError as error:
        raise BadInput(
            f"{path}: the file cannot be written ({error.strerror or 'write error'}): give a path "
            "in a folder that can be written to and has room."
        ) from error
    finally:
        scratch.unlink(missing_ok=True)
