"""Workspaces: preparation of a run's files, and replacement of an earlier run's."""

import errno
import os
import shutil
import stat
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from srsinv.errors import BadInput

from ._manifest import MANIFEST, check_ours, listed, listing, manifest, read
from ._names import NEW, OLD, TRASH, WORKSPACE, is_empty
from ._place import writing


@dataclass(frozen=True)
class Workspace:
    """Workspace of a run's files before they are moved to its folder.

    - `folder`: the run's, without links.
    - `path`: the workspace's own, beside the folder or inside.
    """

    folder: Path
    path: Path

    def replace(
        self,
        files: Mapping[str, bytes],
        command: str,
        seed: Any,
        plugins: Mapping[str, str] | None = None,
        configuration: str | None = None,
    ) -> None:
        """Replace all files of an earlier run by `files` (contents by name, with slashes) and their
        manifest, which has the SHA-256 of `plugins` and of the resolved `configuration`, too.

        Raises `BadInput` where they cannot be written, and where the folder has files that no run
        wrote.
        """
        record = manifest(listing(files), command, seed, plugins, configuration)
        with writing(self.folder):
            for name, data in {**files, MANIFEST: record}.items():
                path = self.path / NEW / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
            if self.folder.exists():
                (self.path / NEW).chmod(stat.S_IMODE(self.folder.stat().st_mode))
            if not self._swap():
                self._move_in()

    def recover(self) -> None:
        """Undo or finish the replacement by a run that ended early, and empty the workspace.

        Raises `BadInput` where files that no run wrote are in the way.
        """
        new, old = self.path / NEW, self.path / OLD
        if old.is_dir():
            if is_empty(self.folder):
                self._put_back()
            else:
                check_ours(self.folder, read(self.folder) or {})
                check_ours(old, listed(old) or {})
        elif self._is_begun():
            self._move_in()
        else:
            self._remove_empty(read(new) or {})  # made for files that have not come
        for path in (old, new):
            self._discard(path)

    def _swap(self) -> bool:
        """Replace the folder as a whole; False where it cannot be renamed."""
        here, old = Path.cwd(), self.path / OLD
        if self.path.parent == self.folder or self.folder in (here, *here.parents):
            return False
        try:
            if not is_empty(self.folder):
                os.rename(self.folder, old)
                # After the rename no further file can be added.
                check_ours(old, listed(old) or {})
            os.rename(self.path / NEW, self.folder)
        except OSError:
            self._put_back()
            return False
        except BadInput:
            self._put_back()
            raise
        self._discard(old)
        return True

    def _put_back(self) -> None:
        if (old := self.path / OLD).is_dir():
            os.rename(old, self.folder)

    def _move_in(self) -> None:
        """Replace the folder's files one by one; called again, it goes on where it was."""
        new, present = self.path / NEW, listed(self.folder) or {}
        coming = read(new) or {}
        check_ours(self.folder, present, coming)
        if present and not (self.folder / MANIFEST).exists():
            # A run older than manifests gets one, which identifies it when half of it is replaced.
            self._write_whole(self.folder / MANIFEST, manifest(present, "", None))
        names = [*(name for name in coming if (new / name).exists()), MANIFEST]
        for name in names:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        try:
            for name in names[:-1]:
                os.replace(new / name, self.folder / name)
        except OSError as error:
            if error.errno != errno.EXDEV or self.path.parent == self.folder:
                raise
            return self._move_inside(names)._move_in()
        for name in present.keys() - coming.keys():
            (self.folder / name).unlink(missing_ok=True)
        self._remove_empty(present)
        os.replace(new / MANIFEST, self.folder / MANIFEST)

    def _move_inside(self, names: list[str]) -> "Workspace":
        """The same workspace inside the folder, for a mount that was not recognised as one."""
        inside = Workspace(self.folder, self.folder / WORKSPACE)
        for name in names:
            target = inside.path / NEW / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.path / NEW / name, target)
        return inside

    def _remove_empty(self, names: Iterable[str]) -> None:
        for parent in {(self.folder / name).parent for name in names} - {self.folder}:
            with suppress(OSError):  # it is not empty
                parent.rmdir()

    def _write_whole(self, path: Path, data: bytes) -> None:
        (self.path / TRASH).mkdir(exist_ok=True)
        (self.path / TRASH / path.name).write_bytes(data)
        os.replace(self.path / TRASH / path.name, path)

    def _is_begun(self) -> bool:
        """Whether some of the run's files have been moved to the folder one by one, but not all."""
        coming = read(self.path / NEW)
        return coming is not None and not all((self.path / NEW / name).exists() for name in coming)

    def _discard(self, path: Path) -> None:
        """Delete a folder of the workspace, renamed to trash first in case it is interrupted."""
        trash = self.path / TRASH
        shutil.rmtree(trash, ignore_errors=True)
        with suppress(OSError):  # there is none, or no room for another name
            os.rename(path, trash)
        for each in (trash, path):
            shutil.rmtree(each, ignore_errors=True)
