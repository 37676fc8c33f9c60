"""Contents of a run's folder: its manifest `run.json`, and files that no run wrote."""

import base64
import hashlib
import json
import os
import re
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from srsinv import __version__
from srsinv.errors import BadInput

from ._names import WORKSPACE, is_workspace

MANIFEST = "run.json"
# Runs of versions that wrote no manifest: the files that identify them (other programs have a
# .hydra and metrics, too), and those that they wrote.
_OLDER_SIGNS = (".hydra/config.yaml", "metrics.json", "result.nc", "report.html")
_OLDER_JOB = re.compile(rb"^job: (srsinv|experiments)\.", re.MULTILINE)
_OLDER_FILES = re.compile(
    r"metrics\.json|result\.nc|report\.html|figures/[^/]+\.png"
    r"|\.hydra/(config|overrides|hydra)\.yaml"
)
_KEYS = {"command", "files", "seed", "version"}
_OPTIONAL = {"configuration", "plugins"}
_MOST_BYTES = 2**24  # of a manifest: a hundred thousand files

Listing = Mapping[str, str]  # name within the folder, with slashes, to SHA-256


def listing(files: Mapping[str, bytes]) -> Listing:
    """The SHA-256 of each content, by name."""
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


def manifest(
    files: Listing,
    command: str,
    seed: Any,
    plugins: Listing | None = None,
    configuration: str | None = None,
) -> bytes:
    """The manifest of a run: the version, the command, the seed and every file's SHA-256, and where
    they are given those of `plugins` and the hash of its resolved `configuration`.

    The same files, command, seed, plugins and configuration give the same bytes.
    """
    whole = {"command": command, "files": files, "seed": seed, "version": __version__}
    more = {"plugins": plugins, "configuration": configuration}
    return _text(whole | {key: value for key, value in more.items() if value})


def listed(folder: Path) -> Listing | None:
    """The files that a run wrote to `folder`: as its manifest lists them or, of a run older than
    manifests, as they are there; None where no run of srsinv has been."""
    if (files := read(folder)) is not None:
        return files
    if not all(_is_file(folder / sign) for sign in _OLDER_SIGNS) or _exists(folder / MANIFEST):
        return None
    page = (folder / "report.html").read_bytes()
    if not _OLDER_JOB.search((folder / _OLDER_SIGNS[0]).read_bytes()) or b"srsinv" not in page:
        return None
    names = (
        name for name, _ in _walk(folder, {"figures", ".hydra"}) if _OLDER_FILES.fullmatch(name)
    )
    return {
        name: _sha256(folder / name)
        for name in names
        if _is_file(folder / name) and (not name.endswith(".png") or _shows(page, folder / name))
    }


def _shows(page: bytes, figure: Path) -> bool:
    """Whether a page holds this figure; another one in its folder is the user's."""
    return base64.b64encode(figure.read_bytes()) in page


def read(folder: Path) -> Listing | None:
    """The listing of the manifest in `folder`; None where there is none that srsinv wrote."""
    document = described(folder)
    return None if document is None else document["files"]


def described(folder: Path) -> dict[str, Any] | None:
    """The manifest in `folder`; None where there is none that srsinv wrote."""
    path = folder / MANIFEST
    if not _is_file(path) or path.stat().st_size > _MOST_BYTES:
        return None
    text = path.read_bytes()
    try:
        document = json.loads(text)
        keys = document.keys() - _OPTIONAL if isinstance(document, dict) else set()
        ours = keys == _KEYS and _text(document) == text
    except (ValueError, RecursionError):
        return None
    files = document["files"] if ours else None
    return document if isinstance(files, dict) and all(map(_is_name, files)) else None


def strangers(folder: Path, *listings: Listing) -> Iterator[str]:
    """Names of files in `folder` that were not written by the runs of these listings, changed files
    included, in order; a folder's name ends with a slash and stands for all in it."""
    names = {name for listing in listings for name in listing}
    folders = {str(above) for name in names for above in PurePosixPath(name).parents}
    if _exists(folder / MANIFEST) and read(folder) is None:
        yield MANIFEST  # first, as it is why nothing else is known
    for name, is_folder in _walk(folder, folders):
        if is_folder:
            if name not in folders:
                yield f"{name}/"
        elif name != MANIFEST and not any(has(folder, name, each.get(name)) for each in listings):
            yield name


def has(folder: Path, name: str, sha256: str | None) -> bool:
    """Whether `folder` has a regular file of this name and this SHA-256."""
    return sha256 is not None and _is_file(folder / name) and _sha256(folder / name) == sha256


def check_ours(folder: Path, *listings: Listing) -> None:
    """Raise `BadInput` for the first of the `strangers` in `folder`."""
    name = next(strangers(folder, *listings), None)
    if name is None:
        return
    known = any(name in listing for listing in listings)
    what = "which was changed since a run wrote it" if known else "which no run of srsinv wrote"
    raise BadInput(
        f"cannot write to {folder}: it holds {name}, {what}; choose another folder with "
        "hydra.run.dir=FOLDER (hydra.sweep.dir with -m), or move that file away"
    )


def _text(content: dict[str, Any]) -> bytes:
    return f"{json.dumps(content, sort_keys=True, indent=2)}\n".encode()


def _walk(folder: Path, entered: set[str], above: str = "") -> Iterator[tuple[str, bool]]:
    """Name, and whether it is a folder, of all in `folder` but its workspace; links are not
    followed, and only the folders `entered` are traversed."""
    with os.scandir(folder / above) as entries:
        children = sorted(entries, key=lambda entry: entry.name)
    for entry in children:
        name, is_folder = f"{above}{entry.name}", entry.is_dir(follow_symlinks=False)
        if name == WORKSPACE and is_workspace(folder / name):
            continue
        yield name, is_folder
        if is_folder and name in entered:
            yield from _walk(folder, entered, f"{name}/")


def _is_name(name: str) -> bool:
    """Whether a name stays within its folder."""
    parts = PurePosixPath(name).parts
    return name == "/".join(parts) != MANIFEST and ".." not in parts and "\0" not in name


def _exists(path: Path) -> bool:
    return os.path.lexists(path)


def _is_file(path: Path) -> bool:
    """Whether there is a regular file at `path` itself, not at the end of a link."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except (FileNotFoundError, NotADirectoryError):
        return False


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
