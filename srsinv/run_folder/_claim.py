"""Exclusive access to a run's folder, and replacement of an earlier run in it as a whole."""

import errno
import fcntl
import itertools
import os
import stat
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from srsinv.atomic import (
    exchange,
    is_scratch,
    open_folder,
    opened,
    put,
    remove,
    remove_files,
    scratch_folder,
    scratch_name,
)
from srsinv.errors import BadInput, refuse

from ._manifest import (
    MANIFEST,
    RunRecord,
    check_known,
    check_ours,
    holds,
    listing,
    listings,
    manifest,
    names_of_run,
    own_manifest,
)
from ._place import REMEDY, locate, named, writing

_FIRST = "first"  # in a folder of what is put in one by one: the manifest until all are
_LOOKED_AT = 10_000  # entries of a folder among which those that killed runs left are looked for


@dataclass(frozen=True)
class RunFolder:
    """A folder that is locked against other runs.

    - `place`: its path, without links.
    - `descriptor`: of the folder that stood there when it was locked.
    """

    place: Path
    descriptor: int

    def replace(self, files: Mapping[str, bytes], run: RunRecord) -> None:
        """Replace all files of an earlier run by `files` (contents by name, with slashes) and their
        manifest.

        The current folder, one that is mounted and one beside which nothing can be made get the
        files one by one. Raises `BadInput` where they cannot be written, and where the folder has
        files that no run wrote.
        """
        with writing(self.place):
            if not self._swap({**files, MANIFEST: manifest(listing(files), run)}):
                check_ours(self.descriptor, self.place)
                self.put_in(files, run)

    def put_in(self, files: Mapping[str, bytes], run: RunRecord) -> None:
        """Put files into the folder one by one, in place of those that its manifest lists, and
        their manifest, as `replace` does.

        All are written beside first. A manifest that lists what is coming and what is replaced
        stands there until the last is in, so that the next run knows both for ours. Raises
        `BadInput` where a file of one of these names is none that a run wrote.
        """
        known = listings(self.descriptor)
        before: dict[str, str] = {}
        for each in reversed(known):
            before |= each
        coming = listing(files)
        both = {MANIFEST: manifest(coming, run), _FIRST: manifest(coming, run, before)}
        ours = {name: {each[name] for each in known if name in each} for name in (*files, *before)}
        ours[MANIFEST] = {*listing(both).values(), *own_manifest(self.descriptor)}
        for name in (*files, MANIFEST):
            check_known(name, ours[name], self.descriptor, self.place)
        refuse(
            not _is_at(self.descriptor, self.place),
            f"{named(self.place)} was replaced during the run; {REMEDY}",
        )
        with (
            writing(self.place),
            scratch_folder({**files, **both}, self.descriptor) as scratch,
            opened(scratch, self.descriptor) as source,
        ):
            self._move(source, _FIRST, MANIFEST, ours[MANIFEST])
            for name in files:
                self._move(source, name, name, ours[name])
            gone = before.keys() - files.keys()
            remove_files([n for n in gone if holds(self.descriptor, n, ours[n])], self.descriptor)
            self._move(source, MANIFEST, MANIFEST, ours[MANIFEST])

    def clear(self) -> None:
        """Remove the files that the folder's manifest lists, and the manifest."""
        with writing(self.place):
            remove_files(names_of_run(self.descriptor), self.descriptor)

    def _move(self, source: int, old: str, new: str, replaced: Collection[str]) -> None:
        """Move a file from the folder `source` into this one, in place of none or of one of the
        SHA-256 `replaced`."""
        old_path, new_path = Path(old), Path(new)
        with (
            opened(old_path.parent, source) as here,
            opened(new_path.parent, self.descriptor, make=True) as there,
        ):
            put(old_path.name, here, new_path.name, there, lambda n, f: holds(f, n, replaced))

    def _swap(self, files: Mapping[str, bytes]) -> bool:
        """Replace the folder as a whole; False where it cannot be renamed."""
        here, above = Path(os.path.realpath(".")), self.place.parent
        can_be_renamed = not (self.place in (here, *here.parents) or self.place.is_mount())
        if not (can_be_renamed and os.access(above, os.R_OK | os.W_OK | os.X_OK)):
            return False
        with (
            opened(above) as parent,
            scratch_folder(files, parent) as new,
            opened(new, parent) as folder,
        ):
            os.chmod(folder, stat.S_IMODE(os.fstat(self.descriptor).st_mode))
            try:
                old = _put_in_place(new, self.place.name, parent)
            except OSError:  # a mount that does not look like one, or another user's folder
                return False
            if old is not None:
                self._discard(old, new, parent)
        return True

    def _discard(self, old: str, new: str, parent: int) -> None:
        """Remove the earlier run, which is now called `old`, or put it back where it holds a file
        that no run wrote: none can be added any more."""
        with opened(old, parent) as folder:
            try:
                check_ours(folder, self.place)
            except BadInput:
                if old != new:
                    os.rename(self.place.name, new, src_dir_fd=parent, dst_dir_fd=parent)
                    os.rename(old, self.place.name, src_dir_fd=parent, dst_dir_fd=parent)
                else:
                    exchange(old, self.place.name, parent)
                raise
            names = names_of_run(folder)
        with suppress(OSError):  # something came in, and stays
            remove(old, names, parent)


def _put_in_place(new: str, name: str, parent: int) -> str | None:
    """Give the folder `new` the name `name`; the name of the one that had it, if that holds
    anything."""
    try:
        os.rename(new, name, src_dir_fd=parent, dst_dir_fd=parent)  # over nothing or an empty one
        return None
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
    if exchange(new, name, parent):
        return new
    old = scratch_name()
    os.rename(name, old, src_dir_fd=parent, dst_dir_fd=parent)
    try:
        os.rename(new, name, src_dir_fd=parent, dst_dir_fd=parent)
    except OSError:
        os.rename(old, name, src_dir_fd=parent, dst_dir_fd=parent)
        raise
    return old


def check(folder: Path) -> None:
    """Raise `BadInput` unless `folder` can be made or written to, and is empty or holds an earlier
    run of srsinv."""
    place = locate(folder)
    with writing(folder), suppress(FileNotFoundError), opened(place) as descriptor:
        check_ours(descriptor, place)


@contextmanager
def hold(folder: Path) -> Iterator[RunFolder]:
    """Lock `folder`, which is made, against other runs until the end.

    Raises `BadInput` where another run is at work in it.
    """
    place = locate(folder)
    with writing(folder):
        descriptor = _locked(place)
    try:
        yield RunFolder(place, descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def claim(folder: Path) -> Iterator[RunFolder]:
    """[`hold`][] a folder that is empty or holds an earlier run, for `RunFolder.replace`.

    Raises `BadInput` for a folder that holds anything else, and leaves that as it is.
    """
    with hold(folder) as held:
        with writing(folder):
            check_ours(held.descriptor, held.place)
        yield held


def _locked(place: Path) -> int:
    """A descriptor of the folder at `place`, with a lock that the process's end releases."""
    while True:
        descriptor = open_folder(place, make=True)
        try:
            with suppress(OSError):  # without locks the last one to end stays, as a whole
                _lock(descriptor, place)
            if _is_at(descriptor, place):
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # another run has replaced it since it was opened


def _lock(descriptor: int, place: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BadInput(
            f"another run is writing to {named(place)}; wait until it has ended, or {REMEDY}"
        ) from error


def _is_at(descriptor: int, place: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), place.lstat())
    except FileNotFoundError:
        return False


def left_by_killed(folder: Path) -> list[Path]:
    """What killed runs have left of the user's beside a folder and in it."""
    return sorted(path for each in (folder.parent, folder) for path in _left_in(each))


def _left_in(folder: Path) -> Iterator[Path]:
    with suppress(OSError), opened(os.path.realpath(folder)) as descriptor:
        with os.scandir(descriptor) as entries:
            names = [each.name for each in itertools.islice(entries, _LOOKED_AT)]
        for name in filter(is_scratch, names):
            with suppress(OSError), opened(name, descriptor) as left:
                if os.fstat(left).st_uid == os.geteuid():
                    fcntl.flock(left, fcntl.LOCK_EX | fcntl.LOCK_NB)  # or its run is at work
                    yield folder / name
