"""What a job is known by: its resolved configuration and the content of the files that it names."""

import hashlib
import json
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from ..errors import BadInput
from ..files import LARGEST_FILE, open_file, path_of
from ..run_folder import FAILURES, MANIFEST, runs_in
from .typed import refusing

_FILES = ("path", "sidecar", "calibration")  # keys whose values name files of data
_FOLDER = "folder"  # the key of a folder of runs
_PIECE = 2**20  # bytes that are read at once


def resolved(config: DictConfig) -> dict[str, Any]:
    """The settings of a composed configuration without Hydra's own, by their current names.

    Raises `BadInput` for a value that is missing or refers to nothing.
    """
    with refusing():
        settings = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    return cast(dict[str, Any], settings)


def identity(settings: Mapping[str, Any], config_dir: str | None) -> str:
    """The SHA-256 of what decides on a job's result: its resolved `settings`, the files of data
    that they name, with the sidecars beside these, and where they name a plugin all plugins of
    `config_dir`.

    A file that was changed under its name makes another job. The version of srsinv is not in it;
    `run.json` has it beside this hash.
    """
    plugins = ((path, LARGEST_FILE) for path in _plugins(settings, config_dir))
    paths = [*_data_files(settings), *plugins]
    files = {str(path): _sha256(path, most) for path, most in paths}
    whole = {"settings": settings, "files": files}
    return hashlib.sha256(json.dumps(whole, sort_keys=True, default=str).encode()).hexdigest()


def _data_files(settings: Mapping[str, Any]) -> Iterator[tuple[Path, int]]:
    """Paths of the files, and how long each may be."""
    for key, value in _leaves(settings):
        if key not in (*_FILES, _FOLDER) or not isinstance(value, str):
            continue
        try:
            path = path_of(value, key)
        except BadInput:  # the job will say what is wrong with it
            continue
        if key == _FOLDER:
            yield from ((run / MANIFEST, LARGEST_FILE) for run in runs_in(path))
            yield path / FAILURES, LARGEST_FILE
        if key == "path" and _is_data(path):
            from ..recording import MOST_OF_SIDECAR, SIDECAR_SUFFIXES

            beside = {path.with_suffix(suffix) for suffix in SIDECAR_SUFFIXES} - {path}
            yield from ((each, MOST_OF_SIDECAR) for each in sorted(filter(_is_data, beside)))
        if _is_data(path):
            yield path, LARGEST_FILE


def _plugins(settings: Mapping[str, Any], config_dir: str | None) -> list[Path]:
    """All of them, as any may import another one; none is run to see."""
    texts = (value for _, value in _leaves(settings) if isinstance(value, str))
    if config_dir is None or not any(text.startswith("plugins.") for text in texts):
        return []
    return sorted(Path(config_dir, "plugins").rglob("*.py"))


def _leaves(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of a tree of settings with the key that it stands under."""
    if isinstance(node, Mapping):
        for name, each in node.items():
            yield from _leaves(each, str(name))
    elif isinstance(node, list):
        for each in node:
            yield from _leaves(each, key)
    else:
        yield key, node


def _is_data(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return False


def _sha256(path: Path, most: int) -> str:
    digest = hashlib.sha256()
    try:
        with open_file(path, most=most) as file:
            while part := file.read(_PIECE):
                digest.update(part)
    except (BadInput, OSError):  # the job will say what is wrong with it
        return ""
    return digest.hexdigest()
