"""Contents of a run's folder: its manifest `run.json`, and files that no run wrote.

A manifest that is found decides on one thing: whether all files of a folder are as a run wrote
them, so that a new run may take their place. Files are looked up within the folder, never through a
link.
"""

import hashlib
import itertools
import json
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from srsinv import __version__
from srsinv.atomic import SCRATCH, is_scratch, opened, plain_file
from srsinv.errors import BadInput, refuse

from ._origin import origin
from ._place import REMEDY, named

MANIFEST = "run.json"
METRICS_FILE = "metrics.json"
MOST_OF_METRICS = 2**22  # bytes of a run's: tens of thousands
# In a sweep's folder: what its runs gave, and why others failed.
GATHERED = ("sweep.nc", "sweep.html")
FAILURES = "failures.json"
_KEYS = {"command", "files", "seed", "version"}
_OPTIONAL = {"commit", "configuration", "date", "plugins", "replaces", "versions"}
_MOST_BYTES = 2**20  # of a manifest: ten thousand files
_MOST_OF_MANIFESTS = 2**24  # of all in a sweep's folder: ten thousand runs
# Of all files of a run together: seconds of reading, however many names one huge file has.
_MOST_READ = 2**32

_MOST_ENTRIES = 10**6  # of all folders in a sweep's
_DEEPEST = 16  # folders within folders: ours go to two

Listing = Mapping[str, str]  # name within the folder, with slashes, to SHA-256


def listing(files: Mapping[str, bytes]) -> Listing:
    """The SHA-256 of each content, by name."""
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


@dataclass(frozen=True)
class RunRecord:
    """What a manifest has of a run beside its files.

    - `command`, `seed`: as typed.
    - `plugins`: the SHA-256 of each; `configuration`: the hash of the resolved one; None: of none.
    - `origin`: its date, versions and commit.
    """

    command: str
    seed: Any
    plugins: Listing | None = None
    configuration: str | None = None
    origin: Mapping[str, Any] = field(default_factory=origin)


def manifest(files: Listing, run: RunRecord, replaces: Listing | None = None) -> bytes:
    """The manifest of a run: the version, every file's SHA-256 and the record. While files are put
    in one by one, `replaces` lists those that were there before.

    The same arguments give the same bytes.
    """
    whole = {"command": run.command, "files": files, "seed": run.seed, "version": __version__}
    whole |= run.origin
    more = {
        "plugins": run.plugins or None, "configuration": run.configuration, "replaces": replaces
    }  # fmt: skip
    return _text(whole | {key: value for key, value in more.items() if value is not None})


def described(folder: Path) -> dict[str, Any] | None:
    """The manifest of the whole run in a folder; None where there is none that srsinv wrote."""
    return _whole(_manifest_text(folder))


def described_runs(folder: Path) -> Iterator[tuple[Path, dict[str, Any] | None]]:
    """The folders of [`runs_in`][], each with what [`described`][] says of it. Raises `BadInput`
    where all manifests together are longer than those of any sweep."""
    left = _MOST_OF_MANIFESTS
    for place in runs_in(folder):
        text = _manifest_text(place)
        left -= len(text)
        refuse(
            left < 0,
            f"{named(folder)}: its {MANIFEST} files have more than {_MOST_OF_MANIFESTS} "
            "bytes together: give the folder of one sweep.",
        )
        yield place, _whole(text)


def _whole(text: bytes) -> dict[str, Any] | None:
    document = _parsed(text)
    return None if document is None or "replaces" in document else document


def _manifest_text(folder: Path) -> bytes:
    try:
        with opened(_unlinked(folder)) as descriptor:
            return _text_in(descriptor)
    except (OSError, ValueError):
        return b""


def _unlinked(folder: Path) -> Path:
    """The path of a folder, which may be reached through a link but be none."""
    return Path(os.path.realpath(folder.parent), folder.name)


def runs_in(folder: Path) -> list[Path]:
    """The folders in `folder`, and itself, that have a manifest, in order; links are not followed,
    and what killed runs have left is passed over. Raises `BadInput` where there are too many."""
    found, stack, seen = [], [(folder, 0)], 0
    while stack:
        place, depth = stack.pop()
        with suppress(OSError), os.scandir(place) as entries:  # or not one of the user's own
            for entry in entries:
                seen += 1
                refuse(
                    seen > _MOST_ENTRIES,
                    f"{named(folder)} has more than {_MOST_ENTRIES} files: give the folder of one "
                    "sweep.",
                )
                if entry.name == MANIFEST:
                    found.append(place)
                is_deeper = depth < _DEEPEST and entry.is_dir(follow_symlinks=False)
                if is_deeper and not is_scratch(entry.name):
                    stack.append((place / entry.name, depth + 1))
    return sorted(found)


def described_in(folder: int) -> dict[str, Any] | None:
    """The manifest in a folder; None where there is none that srsinv wrote. With `replaces` in it,
    not all its files have been put in."""
    return _parsed(_text_in(folder))


def _text_in(folder: int) -> bytes:
    """The manifest in a folder, a byte more than may be of one that is longer."""
    with plain_file(MANIFEST, folder) as file:
        return b"" if file is None else file.read(_MOST_BYTES + 1)


def _parsed(text: bytes) -> dict[str, Any] | None:
    try:
        document = json.loads(text) if len(text) <= _MOST_BYTES else None
        is_ours = (
            isinstance(document, dict)
            and document.keys() - _OPTIONAL == _KEYS
            and _text(document) == text
            and _is_sound(document)
        )
    except (ValueError, RecursionError):
        return None
    return document if is_ours else None


def listings(folder: int) -> tuple[Listing, ...]:
    """The files that runs wrote to a folder, as its manifest lists them: those of the run, and
    those before where it was stopped while it put them in one by one."""
    document = described_in(folder) or {}
    return tuple(document[key] for key in ("files", "replaces") if key in document)


def names_of_run(folder: int) -> set[str]:
    """The names of all that runs wrote to a folder, the manifest's too."""
    return {MANIFEST, *itertools.chain(*listings(folder))}


def has(folder: Path, name: str, sha256: str | None, most: int) -> bool:
    """Whether a folder has a regular file of this name, with this SHA-256 and of at most `most`
    bytes."""
    with opened(_unlinked(folder)) as descriptor:
        return sha256 is not None and holds(descriptor, name, {sha256}, most)


def holds(folder: int, name: str, contents: Collection[str], most: int = _MOST_READ) -> bool:
    """Whether a folder has a regular file of this name, with one of these SHA-256 and of at most
    `most` bytes."""
    return _sha256(folder, name, most)[0] in contents


def own_manifest(folder: int) -> set[str]:
    """The SHA-256 of the manifest in a folder, where srsinv wrote it."""
    document = described_in(folder)
    return set() if document is None else {*listing({MANIFEST: _text(document)}).values()}


def strangers(folder: int) -> Iterator[str]:
    """Names of files in a folder that no run wrote, changed files included, in order; a folder's
    name ends with a slash and stands for all in it."""
    known, left = listings(folder), _MOST_READ
    names = {name for listing in known for name in listing}
    folders = {str(above) for name in names for above in PurePosixPath(name).parents}
    if not known and _exists(MANIFEST, folder):
        yield MANIFEST  # first, as it is why nothing else is known
    for name, is_folder in _walk(folder, folders):
        if is_folder:
            if name not in folders:
                yield f"{name}/"
        elif name != MANIFEST:
            sha256, size = _sha256(folder, name, left) if name in names else (None, 0)
            left -= size
            if sha256 is None or all(each.get(name) != sha256 for each in known):
                yield name


def check_ours(folder: int, place: Path) -> None:
    """Raise `BadInput` for the first of the `strangers` in a folder, which stands at `place`."""
    found = next(strangers(folder), None)
    if found is not None:
        raise BadInput(_refusal(found, folder, place))


def check_known(name: str, contents: Collection[str], folder: int, place: Path) -> None:
    """Raise `BadInput` unless a folder, which stands at `place`, has no file of this name or one of
    these SHA-256."""
    if _exists(name, folder) and not holds(folder, name, contents):
        raise BadInput(_refusal(name, folder, place))


def _refusal(name: str, folder: int, place: Path) -> str:
    what = "which no run of srsinv wrote"
    if any(name in listing for listing in listings(folder)):
        what = "which was changed since a run wrote it"
    elif name.startswith(SCRATCH):
        what = "which a run that was killed left there"
    return (
        f"cannot write to {named(place)}: it holds {named(name)}, {what}; {REMEDY}, or move that "
        "away"
    )


def _text(content: Mapping[str, Any]) -> bytes:
    return f"{json.dumps(content, sort_keys=True, indent=2)}\n".encode()


def _is_sound(document: dict[str, Any]) -> bool:
    """Whether what a manifest lists are names within its folder."""
    both = (document["files"], document.get("replaces", {}))
    if not all(isinstance(each, dict) for each in both):
        return False
    names = [name for each in both for name in each]
    try:
        os.fsencode("".join(names))
    except UnicodeError:
        return False
    return all(map(_is_name, names))


def _is_name(name: str) -> bool:
    """Whether a name stays within its folder, and a file can have it."""
    parts = name.split("/")
    is_inside = name != MANIFEST and not {"", ".", ".."} & {*parts}
    return is_inside and len(parts) <= _DEEPEST and "\0" not in name


def _exists(name: str, folder: int) -> bool:
    try:
        os.stat(name, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


def _walk(folder: int, entered: set[str], above: str = "") -> Iterator[tuple[str, bool]]:
    """Name, and whether it is a folder, of all in a folder; links are not followed, and only the
    folders `entered` are traversed."""
    with os.scandir(folder) as entries:
        children = sorted((each.name, each.is_dir(follow_symlinks=False)) for each in entries)
    for child, is_folder in children:
        yield f"{above}{child}", is_folder
        if is_folder and f"{above}{child}" in entered:
            with opened(child, folder) as inside:
                yield from _walk(inside, entered, f"{above}{child}/")


def _sha256(folder: int, name: str, most: int) -> tuple[str | None, int]:
    """The SHA-256 of a regular file and its size; None where there is none, or of more than `most`
    bytes."""
    with plain_file(name, folder) as file:
        size = 0 if file is None else os.fstat(file.fileno()).st_size
        if file is None or size > most:
            return None, 0
        return hashlib.file_digest(file, "sha256").hexdigest(), size
