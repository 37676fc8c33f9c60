"""One run or a sweep through Hydra, in folders that stay unchanged where no job is done."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

from hydra.core.plugins import Plugins
from hydra.core.utils import run_job
from hydra.types import HydraContext
from omegaconf import DictConfig, OmegaConf

from ..errors import BadInput, refuse
from ..run_folder import (
    MANIFEST,
    check,
    hold,
    listed,
    listing,
    locate,
    manifest,
    strangers,
    writing,
)

DONE, FAULT, REFUSED = 0, 1, 2
_RECORD = "multirun.yaml"  # of a sweep, by Hydra's sweepers


def run(context: HydraContext, task: Callable[[DictConfig], int], config: DictConfig) -> int:
    """One run; its exit code. Raises `BadInput` for a folder that cannot be used."""
    folder = Path(config.hydra.run.dir)
    check(folder)
    with _no_empty_folders(folder), writing(folder):
        return run_job(
            hydra_context=context,
            task_function=task,
            config=config,
            job_dir_key="hydra.run.dir",
            job_subdir_key=None,
        ).return_value


def sweep(
    context: HydraContext,
    task: Callable[[DictConfig], int],
    config: DictConfig,
    command: str,
    written: set[Path],
) -> int:
    """A sweep; its exit code. Every job runs, whatever the outcome of earlier ones; a fault
    outranks a refusal. `command` as typed, `written` the folders written so far.

    Raises `BadInput` for a folder that cannot be used.
    """
    folder = Path(config.hydra.sweep.dir)
    inside = cast(dict[str, Any], OmegaConf.to_container(config.hydra.sweep))["subdir"]  # as typed
    refuse(
        os.path.normpath(str(inside)) == ".",
        f"hydra.sweep.subdir is {inside!r}, the sweep's own folder; leave it out, and each run has "
        "one by its number",
    )
    _check_sweep(folder)
    sweeper = Plugins.instance().instantiate_sweeper(
        config=config, hydra_context=context, task_function=task
    )
    codes: list[int] = []
    with (
        _no_empty_folders(folder, inside=True),
        writing(folder),
        hold(folder) as space,
        _recorded(space.folder, config, command, lambda: DONE in codes or bool(written)),
    ):
        batches = sweeper.sweep([*config.hydra.overrides.task])
        codes += [job.return_value for batch in batches for job in batch]
    if DONE in codes:
        print(folder.absolute(), flush=True)
    return next((code for code in (FAULT, REFUSED) if code in codes), DONE if codes else FAULT)


def _check_sweep(folder: Path) -> None:
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
        return files if set(files) == {_RECORD} else None
    record = place / _RECORD
    if record.is_symlink() or not record.is_file():
        return None
    # Sweeps older than manifests: Hydra's record beside a run.
    text = record.read_bytes()
    runs = (path for path in place.iterdir() if path.is_dir() and listed(path) is not None)
    return listing({_RECORD: text}) if text.startswith(b"hydra:\n") and any(runs) else None


@contextmanager
def _recorded(
    place: Path, config: DictConfig, command: str, is_done: Callable[[], bool]
) -> Iterator[None]:
    """A manifest for the record that the sweeper writes; both are put back as they were unless a
    job `is_done`."""
    paths = [place / _RECORD, place / MANIFEST]
    before = [path.read_bytes() if path.is_file() else None for path in paths]
    record = listing({_RECORD: OmegaConf.to_yaml(config).encode()})
    try:
        # In this order the manifest never disagrees with the record, whenever this ends.
        paths[0].unlink(missing_ok=True)
        paths[1].write_bytes(manifest(record, command, config.get("seed")))
        yield
    finally:
        if not is_done():
            for path, data in zip(paths, before, strict=True):
                if data is not None:
                    path.write_bytes(data)
                else:
                    path.unlink(missing_ok=True)


@contextmanager
def _no_empty_folders(folder: Path, inside: bool = False) -> Iterator[None]:
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
