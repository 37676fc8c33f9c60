"""`srsinv rerun=FOLDER`: an earlier run again, by the command line that its `run.json` records.

What a folder says is data. Its command goes the way of a typed one, through the same checks.
Settings of Hydra and a folder of plugins, which could run code, come from the typed command alone.
"""

import os
import shlex
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from ..errors import BadInput, echo, printable, refuse
from ..run_folder import MANIFEST, described, named

_KEY = "rerun="
_PLACES = ("hydra.run.dir=", "hydra.sweep.dir=")


def replayed(flags: Namespace) -> tuple[Namespace, str | None]:
    """The flags of a typed command; of one with `rerun=FOLDER` those of the run in that folder, or
    in the folder of that `run.json`, and what that run is known by.

    Raises `BadInput` for a folder without a run, for anything typed beside that is no place, and
    for a recorded command that is none of srsinv's, or that used plugins which are not named anew.
    """
    asked = [word for word in flags.overrides if word.startswith(_KEY)]
    if not asked:
        return flags, None
    places = [word for word in flags.overrides if word.startswith(_PLACES)]
    beside = [word for word in flags.overrides if word not in places]
    beside.remove(asked[0])
    beside += ["-m"] * flags.multirun
    refuse(
        bool(beside),
        f"{_KEY}FOLDER repeats a run unchanged, and {echo((beside or [''])[0])} would change it: "
        "leave it out. Only the new run's folder can be given, as hydra.run.dir=FOLDER.",
    )
    folder = _folder(asked[0].removeprefix(_KEY))
    for place in places:
        refuse(
            Path(os.path.realpath(place.partition("=")[2])) == folder,
            f"{place} is the folder of the run that is repeated: give another one.",
        )
    document = _recorded(folder)
    command, config_dir, is_sweep, overrides = _parts(document, folder)
    _check_config_dir(config_dir, flags.config_dir, folder)
    print(f"srsinv: repeating {printable(command)}", file=sys.stderr)
    changed = {"overrides": [*overrides, *places], "multirun": is_sweep}
    known_by = document.get("configuration")
    return Namespace(**vars(flags) | changed), known_by if isinstance(known_by, str) else None


def note_change(known_by: str | None, recorded: str | None) -> None:
    """Say on standard error that a repeated run differs from the one that is recorded, None where
    none is."""
    if recorded is not None and known_by != recorded:
        print(
            "srsinv: a default, a file of data or a plugin has changed since the run was made, so "
            "that results may differ",
            file=sys.stderr,
        )


def _folder(given: str) -> Path:
    try:
        path = Path(os.path.realpath(os.path.expanduser(given)))
        return path.parent if path.name == MANIFEST and not path.is_dir() else path
    except ValueError as error:  # characters that no path has
        raise BadInput(f"rerun is {echo(given)}: give the folder of a run.") from error


def _recorded(folder: Path) -> dict[str, Any]:
    document = described(folder)
    if document is None:
        raise BadInput(
            f"{named(folder)} holds no {MANIFEST} that a run of srsinv wrote: give the folder of a "
            "run, which is the last line that a run prints."
        )
    return document


def _parts(document: dict[str, Any], folder: Path) -> tuple[str, str | None, bool, list[str]]:
    """The recorded command, its folder of plugins, whether it is a sweep, and its overrides."""
    command = document["command"]
    try:
        program, *words = shlex.split(command)
    except (AttributeError, TypeError, ValueError):
        program, words = "", []
    config_dir = None
    if words[:1] == ["--config-dir"] and len(words) > 1:
        config_dir, words = words[1], words[2:]
    is_sweep = words[:1] == ["-m"]
    words = words[is_sweep:]
    foreign = [word for word in words if word.startswith("-") or _is_of_hydra(word)]
    refuse(
        program != "srsinv" or bool(foreign),
        f"{named(folder)} records the command {echo(command)}, as no run of srsinv does: type that "
        "command yourself, if it is the one you want.",
    )
    return command, config_dir, is_sweep, words


def _is_of_hydra(word: str) -> bool:
    return word.lstrip("+~").startswith(("hydra.", "hydra/", "hydra=", "hydra@", _KEY))


def _check_config_dir(recorded: str | None, typed: str | None, folder: Path) -> None:
    """Refuse plugins that the user has not named, and a folder of options that the run had not."""
    refuse(
        recorded is not None and typed is None,
        f"The run was made with the options and plugins of {echo(recorded)}: if you trust the "
        f"folder, type srsinv --config-dir {shlex.quote(str(recorded))} "
        f"{_KEY}{shlex.quote(str(folder))}.",
    )
    refuse(
        recorded is None and typed is not None,
        "The run was made without --config-dir: leave it out.",
    )
