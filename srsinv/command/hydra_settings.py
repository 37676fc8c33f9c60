"""What of Hydra's own configuration may name code to run, and may not.

Hydra makes its launcher, sweeper, callbacks and loggers from whatever class a configuration names.
srsinv takes the launchers and sweepers below, by an exact list, and no callbacks and no loggers:
there is nothing that they would be for.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from ..errors import refuse, shown

_PLUGINS = "hydra_plugins"
ALLOWED = {
    "launcher": (
        "hydra._internal.core_plugins.basic_launcher.BasicLauncher",
        f"{_PLUGINS}.hydra_joblib_launcher.joblib_launcher.JoblibLauncher",
        f"{_PLUGINS}.hydra_submitit_launcher.submitit_launcher.LocalLauncher",
        f"{_PLUGINS}.hydra_submitit_launcher.submitit_launcher.SlurmLauncher",
    ),
    "sweeper": ("hydra._internal.core_plugins.basic_sweeper.BasicSweeper",),
}


def check_search_path(overrides: Sequence[Override]) -> None:
    """Refuse a search path typed by hand: a package on it would be imported."""
    for override in overrides:
        refuse(
            override.key_or_group == "hydra.searchpath",
            "hydra.searchpath is not for srsinv: add a folder of your own options with "
            "--config-dir FOLDER.",
        )


def check_hydra_settings(config: DictConfig) -> None:
    """Refuse a composed configuration in which Hydra would make what is not in the list."""
    settings: Any = OmegaConf.to_container(config.hydra, resolve=False)
    for part, allowed in ALLOWED.items():
        target, *inner = _targets(settings.get(part)) or (None,)
        refuse(
            target not in allowed or bool(inner),
            f"hydra.{part} would make {shown(inner[0] if inner else target)}: leave it out, or "
            f"choose one of {', '.join(name.rpartition('.')[2] for name in allowed)}.",
        )
    refuse(
        bool(settings.get("callbacks")),
        "hydra.callbacks names code to run, which srsinv does not take: leave it out.",
    )
    for part in ("job_logging", "hydra_logging"):
        refuse(
            bool((settings.get(part) or {}).get("root")),
            f"hydra.{part} sets up loggers, and srsinv logs nothing: leave it as it is.",
        )
    refuse(
        settings.get("output_subdir") is not None,
        "hydra.output_subdir is not for srsinv, which writes .hydra together with its results: "
        "leave it out.",
    )


def _targets(node: Any) -> list[Any]:
    """Every `_target_` in a part of a configuration, its own first."""

    def inside(value: Any) -> Iterator[Any]:
        if isinstance(value, dict):
            if "_target_" in value:
                yield value["_target_"]
            for each in value.values():
                yield from inside(each)
        elif isinstance(value, list):
            for each in value:
                yield from inside(each)

    return list(inside(node))
