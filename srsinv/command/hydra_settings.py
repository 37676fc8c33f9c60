"""Checks of Hydra's own configuration, which can name code to run.

Hydra makes its launcher, sweeper, callbacks and loggers from whatever class a configuration names.
srsinv takes the launchers and sweepers below, by an exact list, no callbacks, and of the settings
of loggers those that set up none: Hydra makes whatever a `()` or a `class` in any other names.
"""

import importlib.util
from collections.abc import Iterator, Sequence
from typing import Any

from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from ..errors import echo, refuse

_PLUGINS = "hydra_plugins"
NO_LOGGERS = {"version": 1, "root": None, "disable_existing_loggers": False}
ALLOWED = {
    "launcher": (
        "hydra._internal.core_plugins.basic_launcher.BasicLauncher",
        f"{_PLUGINS}.hydra_joblib_launcher.joblib_launcher.JoblibLauncher",
        f"{_PLUGINS}.hydra_submitit_launcher.submitit_launcher.LocalLauncher",
        f"{_PLUGINS}.hydra_submitit_launcher.submitit_launcher.SlurmLauncher",
    ),
    "sweeper": ("hydra._internal.core_plugins.basic_sweeper.BasicSweeper",),
}
# Options of hydra/launcher that an extra brings: its package's module, and the extra.
EXTRAS = {
    **dict.fromkeys(("joblib", "parallel"), ("hydra_joblib_launcher", "parallel")),
    **dict.fromkeys(
        ("submitit_local", "submitit_slurm", "slurm"), ("hydra_submitit_launcher", "slurm")
    ),
}


# Settings refused as typed, as Hydra acts on them, or fails, while it composes.
NOT_TYPED = {
    "hydra.searchpath": "add a folder of your own options with --config-dir FOLDER",
    "hydra.job.env_set": "set variables in the shell instead",
    "hydra.job.env_copy": "set variables in the shell instead",
    "hydra.sweeper.params": "give the values to sweep over as -m key=a,b",
}


def check_typed(overrides: Sequence[Override]) -> None:
    """Refuse Hydra's settings that srsinv does not support, before anything is composed."""
    for override in overrides:
        if override.key_or_group == "hydra/launcher":
            _check_installed(override.value())
        for key in _keys(override.key_or_group, override.value()):
            for refused, remedy in NOT_TYPED.items():
                refuse(
                    key == refused or key.startswith(f"{refused}."),
                    f"srsinv does not use {refused}: {remedy}.",
                )


def _check_installed(launcher: Any) -> None:
    if str(launcher) not in EXTRAS:
        return
    module, extra = EXTRAS[str(launcher)]
    try:
        is_installed = importlib.util.find_spec(f"{_PLUGINS}.{module}") is not None
    except ModuleNotFoundError:  # no package of Hydra's plugins at all
        is_installed = False
    refuse(
        not is_installed,
        f"hydra/launcher={launcher} needs the package {module.replace('_', '-')}: install it by "
        f'pip install "srsinv[{extra}]".',
    )


def _keys(key: str, value: Any) -> Iterator[str]:
    """A key and those inside its value."""
    yield key
    if isinstance(value, dict):
        for name, each in value.items():
            yield from _keys(f"{key}.{name}", each)


def check_hydra_settings(config: DictConfig) -> None:
    """Refuse a composed configuration in which Hydra would create objects not in the list."""
    settings: Any = OmegaConf.to_container(config.hydra, resolve=False)
    for part, allowed in ALLOWED.items():
        # As Hydra resolves it: an interpolation may stand for a part that names a class.
        node = config.hydra.get(part)
        node = OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node
        target, *inner = [*_targets(node)] or [None]
        refuse(
            target not in allowed or bool(inner),
            f"hydra.{part} names {echo(inner[0] if inner else target)}, which srsinv does "
            "not run: leave it out, or choose one of "
            f"{', '.join(name.rpartition('.')[2] for name in allowed)}.",
        )
    refuse(
        bool(settings.get("callbacks")),
        "srsinv does not run code that hydra.callbacks names: leave it out.",
    )
    for part in ("job_logging", "hydra_logging"):
        refuse(
            settings.get(part) != NO_LOGGERS,
            f"hydra.{part} sets up loggers, which srsinv does not use: leave it out.",
        )
    job, sweeper = settings.get("job") or {}, settings.get("sweeper") or {}
    refuse(
        bool(job.get("env_set") or job.get("env_copy") or sweeper.get("params")),
        "srsinv does not use hydra.job.env_set, hydra.job.env_copy and "
        "hydra.sweeper.params: leave them out.",
    )
    batch = sweeper.get("max_batch_size")
    refuse(
        batch is not None and not (isinstance(batch, int) and batch >= 1),
        f"hydra.sweeper.max_batch_size is {echo(batch)}: give a whole number from 1, or null.",
    )
    paths = settings.get("searchpath") or []
    refuse(
        not isinstance(paths, list) or not all(str(path).startswith("file://") for path in paths),
        f"hydra.searchpath is {echo(paths)}: add a folder of your own options with --config-dir "
        "FOLDER.",
    )
    refuse(
        settings.get("output_subdir") is not None,
        "srsinv does not use hydra.output_subdir, as it writes .hydra with its "
        "results: leave it out.",
    )


def _targets(node: Any) -> Iterator[Any]:
    """Every `_target_` in a part of a configuration, its own first."""
    if isinstance(node, dict) and "_target_" in node:
        yield node["_target_"]
    inside = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    for each in inside:
        yield from _targets(each)
