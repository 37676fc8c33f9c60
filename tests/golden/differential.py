"""An older commit against the tree on random scenes: `python -m tests.golden.differential COMMIT`.

Both run the same overrides, each in a process of its own with this interpreter, and their metrics
and variables are held against each other within the golden data's tolerances. Prints what differs,
and exits with 1 where anything does. `--renamed OLD=NEW` maps a key that has another name now.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import xarray
from rich.console import Console
from rich.table import Table

import tests.conftest  # noqa: F401  the tests' own setting of XLA
from tests.golden import scenes
from tests.golden.compare import MISSING, Movement, differences
from tests.golden.entries import Entries, entry
from tests.golden.forms import is_time
from tests.jobs.run import ROOT

# What both trees run, which has to work with an old one: folder, and sets of overrides as JSON.
PROGRAM = """
import json, sys
from pathlib import Path
from hydra import compose, initialize_config_dir
from hydra.utils import get_method
from omegaconf import OmegaConf
from srsinv.__main__ import find_config_root

folder, root = Path(sys.argv[1]), str(find_config_root())
for name, overrides in json.load(sys.stdin).items():
    try:
        with initialize_config_dir(root, version_base="1.3"):
            cfg = compose("config", overrides)
        found = get_method(cfg.job)(OmegaConf.to_container(cfg, resolve=True))
        metrics = {key: getattr(each, "item", lambda each=each: each)()
                   for key, each in found.metrics.items()}
        found.dataset.to_netcdf(folder / f"{name}.nc", engine="h5netcdf", invalid_netcdf=True)
    except Exception as error:
        metrics = {"refused": f"{type(error).__name__}: {error}"}
    (folder / f"{name}.json").write_text(json.dumps(metrics))
    print(name, file=sys.stderr, flush=True)
"""


BEFORE, SHOWN = 20, 60  # characters of a word


@contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """A folder with the files of the commit."""
    with TemporaryDirectory() as name:
        folder = Path(name) / "tree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", folder, commit], check=True)
        try:
            yield folder
        finally:
            subprocess.run([*git, "remove", "--force", folder], check=True)


def ran(tree: Path, folder: Path, sets: Mapping[str, Sequence[str]]) -> dict[str, Entries]:
    """What the files in `tree` give of each set of overrides."""
    folder.mkdir()
    environment = os.environ | {"PYTHONPATH": str(tree)}
    command = [sys.executable, "-c", PROGRAM, str(folder)]
    subprocess.run(
        command, cwd=tree, env=environment, input=json.dumps(sets), text=True, check=True
    )
    return {name: _read(folder, name) for name in sets}


def _read(folder: Path, name: str) -> Entries:
    metrics = json.loads((folder / f"{name}.json").read_text())
    entries = {f"metrics.{key}": entry(each) for key, each in metrics.items()}
    if (folder / f"{name}.nc").is_file():
        with xarray.open_dataset(folder / f"{name}.nc", engine="h5netcdf") as data:
            for key, each in data.variables.items():
                entries[f"variables.{key}"] = entry(each.values, each.attrs.get("units", "1"))
    return {key: each for key, each in entries.items() if not is_time(key)}


def renamed(entries: Entries, given: Mapping[str, str]) -> Entries:
    """By the names that `given` has of them."""
    parts = ((*key.partition("."), each) for key, each in entries.items())
    return {f"{kind}.{given.get(name, name)}": each for kind, _, name, each in parts}


def compared(old: Entries, new: Entries, name: str, added: bool) -> list[Movement]:
    """What differs in a scene; what only the tree has counts where `added`."""
    moves = differences(f"scenes/{name}", old, new)
    return [each for each in moves if added or each.old != MISSING or "refused" in each.name]


def show(moves: Sequence[Movement], sets: Mapping[str, Sequence[str]]) -> None:
    """A table of what differs, and of its scenes what they are."""
    table = Table("quantity", "at", "old", "new", "times its tolerance")
    for each in moves:
        name = each.name.removeprefix("scenes/")
        table.add_row(name, each.where, *_words(each.old, each.new), f"{each.ratio:.3g}")
    console = Console(width=160)
    if moves:
        console.print(table)
    for name in sorted({each.name.split("/")[1] for each in moves}, key=int):
        print(f"{name}: {' '.join(sets[name])}")


def _words(old: Any, new: Any) -> list[str]:
    """Numbers with ten digits; of long words what differs, from a little before it on."""
    if not (isinstance(old, str) and isinstance(new, str)):
        return [f"{each:.10g}" if isinstance(each, float) else str(each) for each in (old, new)]
    same = [a == b for a, b in zip(old, new, strict=False)]
    start = max([*same, False].index(False) - BEFORE, 0)
    return [("..." if start else "") + each[start : start + SHOWN] for each in (old, new)]


def main(argv: Sequence[str] | None = None) -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("commit")
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--renamed", action="append", default=[], metavar="OLD=NEW")
    parser.add_argument("--added", action="store_true", help="show what only the tree has, too")
    given: Any = parser.parse_args(argv)
    rng, sets = np.random.default_rng(given.seed), {}
    for i in range(given.scenes):
        structure = scenes.structure(rng)
        sets[str(i)] = f"{structure} {scenes.numbers(rng, structure)}".split()
    mapped = dict(each.split("=") for each in given.renamed)
    with TemporaryDirectory() as name, worktree(given.commit) as tree:
        old = ran(tree, Path(name) / "old", sets)
        new = ran(ROOT, Path(name) / "new", sets)
    moves = [
        each
        for key in sets
        for each in compared(renamed(old[key], mapped), new[key], key, given.added)
    ]
    show(moves, sets)
    refused = sum("metrics.refused" in each for each in new.values())
    print(f"{given.scenes} scenes, of which {refused} are refused: {len(moves)} differences from "
          f"{given.commit}")  # fmt: skip
    return int(bool(moves))


if __name__ == "__main__":
    sys.exit(main())
