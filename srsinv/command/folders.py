"""Folders of runs and sweeps, which stay unchanged where no job is done."""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hydra.core.utils import run_job
from hydra.types import HydraContext
from omegaconf import DictConfig, OmegaConf

from ..errors import BadInput
from ..run_folder import (
    FAILURES,
    GATHERED,
    MANIFEST,
    NEW,
    Workspace,
    check,
    listed,
    listing,
    locate,
    manifest,
    strangers,
    writing,
)
from .outcome import Outcome

_RECORD = "multirun.yaml"  # of a sweep, as Hydra's sweepers write it
# What a sweep writes to its folder itself, beside the runs'.
OF_SWEEPS = {_RECORD, FAILURES, *GATHERED}


def run(context: HydraContext, task: Callable[[DictConfig], Outcome], config: DictConfig) -> int:
    """One run; its exit code. Raises `BadInput` for a folder that cannot be used."""
    folder = Path(config.hydra.run.dir)
    check(folder)
    with no_empty_folders(folder), writing(folder):
        return run_job(
            hydra_context=context,
            task_function=task,
            config=config,
            job_dir_key="hydra.run.dir",
            job_subdir_key=None,
        ).return_value.code


def check_sweep(folder: Path) -> None:
    """Raise `BadInput` unless the folder can be written to and is empty or an earlier sweep's, in
    which folders are for the runs to check."""
    place = locate(folder)
    with writing(folder):
        ours = _earlier_sweep(place) if place.exists() else {}
        names = strangers(place, ours or {}) if place.exists() else ()
        name = next((name for name in names if ours is None or not name.endswith("/")), None)
    if name is not None:
        raise BadInput(
            f"cannot sweep into {folder}: it holds {name}, which no sweep of srsinv wrote or which "
            "was changed since; choose another folder with hydra.sweep.dir=FOLDER, or move that "
            "file away"
        )


def _earlier_sweep(place: Path) -> Any:
    """The files that an earlier sweep wrote to its folder itself, as a manifest lists them; None
    where there was none."""
    files = listed(place)
    if files is not None:
        return files if _RECORD in files and set(files) <= OF_SWEEPS else None
    record = place / _RECORD
    if record.is_symlink() or not record.is_file():
        return None
    # Sweeps older than manifests: Hydra's record beside a run.
    text = record.read_bytes()
    runs = (path for path in place.iterdir() if path.is_dir() and listed(path) is not None)
    return listing({_RECORD: text}) if text.startswith(b"hydra:\n") and any(runs) else None


@contextmanager
def recorded(
    space: Workspace, config: DictConfig, command: str, is_done: Callable[[], bool]
) -> Iterator[Callable[[Mapping[str, bytes]], None]]:
    """Hydra's record of a sweep in its folder, with a manifest, and a function that puts what was
    gathered beside it; all are as they were before unless a job `is_done`."""
    place = space.folder
    record = {_RECORD: OmegaConf.to_yaml(config).encode()}
    typed: Any = OmegaConf.to_container(config, resolve=False)  # a seed may be of each job's own

    def put(files: Mapping[str, bytes]) -> None:
        # In this order the manifest never disagrees with the files, whenever this ends.
        for name in OF_SWEEPS:
            (place / name).unlink(missing_ok=True)
        (place / MANIFEST).write_bytes(manifest(listing(files), command, typed.get("seed")))
        (space.path / NEW).mkdir(exist_ok=True)
        for name, data in files.items():
            (space.path / NEW / name).write_bytes(data)
            os.replace(space.path / NEW / name, place / name)

    paths = [place / name for name in (*OF_SWEEPS, MANIFEST)]
    before = {path: path.read_bytes() for path in paths if path.is_file()}
    try:
        put(record)
        yield lambda files: put(record | dict(files))
    finally:
        if not is_done():
            for path in paths:
                path.unlink(missing_ok=True)
            for path, data in before.items():
                path.write_bytes(data)


@contextmanager
def no_empty_folders(folder: Path, inside: bool = False) -> Iterator[None]:
    """Remove the folders made for `folder`, and `inside` it, that are still empty at the end."""
    folder = folder.absolute()

    def folders() -> Iterator[Path]:
        if inside:
            yield from sorted((path for path in folder.rglob("*") if path.is_dir()), reverse=True)
        yield from (path for path in (folder, *folder.parents) if path.is_dir())

    before = set(folders())
    try:
        yield
    finally:
        for path in folders():
            if path not in before:
                with suppress(OSError):  # it is not empty
                    path.rmdir()
