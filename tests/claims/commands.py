"""The command lines that README quotes (commands.yaml), and their numbers: `wall_s`, and `metrics`
as in metrics.json.

All take half an hour. Times are in the numbers: leave the machine alone.
"""

import json
import shlex
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import yaml

from srsinv.jobs.trials import Row
from tests.claims.study import Study, combinations
from tests.shared import SHARED

COMMANDS = Path(__file__).with_suffix(".yaml")


@cache
def commands() -> dict[str, str]:
    """What is typed, by name."""
    return yaml.safe_load(COMMANDS.read_text(encoding="utf-8"))


def run(command: str) -> Row:
    """One command, in a process of its own."""
    overrides = shlex.split(commands()[command].replace("{shared}", str(SHARED)))
    with tempfile.TemporaryDirectory() as folder:
        begun = time.monotonic()
        subprocess.run(
            [sys.executable, "-m", "srsinv", *overrides, f"hydra.run.dir={folder}/run"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        wall = time.monotonic() - begun
        metrics = json.loads(Path(folder, "run", "metrics.json").read_text(encoding="utf-8"))
    return {"wall_s": round(wall, 1), "metrics": metrics}


STUDY = Study(
    "commands",
    run,
    lambda: combinations(command=commands()),
    rests_on=lambda command: {"typed": commands()[command]},
    digits=None,
)
