"""An older commit against the tree on random scenes: `python -m tests.golden.differential COMMIT`.

Both run the same overrides, each in a process of its own with this interpreter, and the metrics and
variables of the commit are held against those of the tree within the golden data's tolerances.
Prints what differs, and exits with 1 where anything does. `--renamed OLD=NEW` maps a key that has
another name now.
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

import numpy as np
import xarray

import tests.conftest  # noqa: F401  the tests' own setting of XLA
from tests.golden import scenes
from tests.golden.cases import is_measured
from tests.golden.compare import differences
from tests.golden.entries import Entries, entry
from tests.jobs.run import ROOT

REFUSED = "metrics.refused"
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


def main(argv: Sequence[str] | None = None) -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("commit")
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--renamed", action="append", default=[], metavar="OLD=NEW")
    asked = parser.parse_args(argv)
    rng, sets = np.random.default_rng(asked.seed), {}
    for i in range(asked.scenes):
        structure = scenes.structure(rng)
        sets[str(i)] = f"{structure} {scenes.numbers(rng, structure)}".split()
    with TemporaryDirectory() as folder, worktree(asked.commit) as tree:
        before = ran(tree, Path(folder) / "before", sets)
        now = ran(ROOT, Path(folder) / "now", sets)
    names, differing = dict(each.split("=") for each in asked.renamed), 0
    for scene, overrides in sets.items():
        old = renamed(before[scene], names)
        # What only the tree has is new, and no difference; a refusal is one.
        new = {key: each for key, each in now[scene].items() if key in old or key == REFUSED}
        if moves := differences(f"scenes/{scene}", old, new):
            print(" ".join(overrides), *(f"  {each}" for each in moves), sep="\n")
        differing += len(moves)
    refused = sum(REFUSED in each for each in now.values())
    print(f"{asked.scenes} scenes, of which {refused} are refused: {differing} differences from "
          f"{asked.commit}")  # fmt: skip
    return int(differing > 0)


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


def renamed(entries: Entries, names: Mapping[str, str]) -> Entries:
    """The same entries, those that `names` maps by their new name."""
    parts = ((*key.partition("."), each) for key, each in entries.items())
    return {f"{kind}.{names.get(name, name)}": each for kind, _, name, each in parts}


def _read(folder: Path, name: str) -> Entries:
    metrics = json.loads((folder / f"{name}.json").read_text())
    entries = {f"metrics.{key}": entry(each) for key, each in metrics.items()}
    if (folder / f"{name}.nc").is_file():
        with xarray.open_dataset(folder / f"{name}.nc", engine="h5netcdf") as data:
            for key, each in data.variables.items():
                entries[f"variables.{key}"] = entry(each.values, each.attrs.get("units", "1"))
    return {key: each for key, each in entries.items() if not is_measured(key)}


if __name__ == "__main__":
    sys.exit(main())
