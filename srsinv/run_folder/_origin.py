"""The origin of a run: its date, the versions that it was made with, and the commit of a clone."""

import platform
import re
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from srsinv import __version__

_COMMIT = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")
_REF = re.compile(r"refs/[\w./+@-]+")
_MOST_BYTES = 2**22  # of a file of git's: packed-refs of tens of thousands of branches
_LIBRARIES = ("jax", "jaxlib", "numpy")
_CLONE = Path(__file__).resolve().parents[2]


def origin() -> dict[str, Any]:
    """The entries of a manifest on the origin of its run: `date` in UTC, `versions` by
    name, and `commit`, None where the package is in no clone of its repository. What cannot be read
    is None: no run fails for it."""
    versions = {"srsinv": __version__, "python": platform.python_version()}
    return {
        "commit": commit_of(_CLONE),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions | {name: _version(name) for name in _LIBRARIES},
    }


def _version(name: str) -> str | None:
    """A library's version, None where what was installed cannot be read any more."""
    try:
        return version(name)
    except (PackageNotFoundError, OSError):
        return None


def commit_of(clone: Path) -> str | None:
    """The commit that is checked out in a clone of srsinv, None where there is none.

    Git's files are read, and nothing of the repository is run. Changes that are not committed do
    not show.
    """
    if 'name = "srsinv"' not in _read(clone / "pyproject.toml"):
        return None  # another project's, into which the package was installed
    git = clone / ".git"
    if git.is_file():  # of a further work tree
        git = clone / _read(git).removeprefix("gitdir:").strip()
    head = _read(git / "HEAD").strip()
    if not head.startswith("ref:"):
        return head if _COMMIT.fullmatch(head) else None
    ref = head.removeprefix("ref:").strip()
    if not _REF.fullmatch(ref) or ".." in ref:
        return None
    common = git / (_read(git / "commondir").strip() or ".")
    packed = re.search(rf"^(\w+) {re.escape(ref)}$", _read(common / "packed-refs"), re.MULTILINE)
    found = _read(git / ref) or _read(common / ref) or (packed[1] if packed else "")
    return found.strip() if _COMMIT.fullmatch(found.strip()) else None


def _read(path: Path) -> str:
    """A file's text; empty where it cannot be read, or is too long."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            return file.read(_MOST_BYTES).decode("utf-8", "replace")
    except (OSError, ValueError):
        return ""
