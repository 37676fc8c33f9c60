"""Runs the command lines that README quotes, and keeps their numbers.

    python -m tests.claims.commands [NAME ...]

runs those of commands.yaml that results/commands.json does not hold (half an hour for all), or
those that are named anew, one at a time. Times are in the numbers: leave the machine alone.
"""

import json
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml

from tests.shared import SHARED

COMMANDS = Path(__file__).with_suffix(".yaml")
RESULTS = Path(__file__).parent / "results" / "commands.json"


def commands() -> dict[str, str]:
    """What is typed, by name."""
    return yaml.safe_load(COMMANDS.read_text(encoding="utf-8"))


def results() -> dict[str, dict[str, Any]]:
    """By name: `typed`, `wall_s`, and `metrics` as in metrics.json."""
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}


def run(typed: str) -> dict[str, Any]:
    """One command, in a process of its own."""
    overrides = shlex.split(typed.replace("{shared}", str(SHARED)))
    with tempfile.TemporaryDirectory() as folder:
        begun = time.monotonic()
        subprocess.run(
            [sys.executable, "-m", "srsinv", *overrides, f"hydra.run.dir={folder}/run"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        wall = time.monotonic() - begun
        metrics = json.loads(Path(folder, "run", "metrics.json").read_text(encoding="utf-8"))
    return {"typed": typed, "wall_s": round(wall, 1), "metrics": metrics}


def main(names: list[str]) -> None:
    """Those named, or all that are new or have changed; written after each."""
    table, held = commands(), results()
    unknown = sorted(set(names) - set(table))
    if unknown:
        raise SystemExit(f"{COMMANDS.name} has no command {', '.join(unknown)}.")
    changed = [n for n in table if n not in held or held[n]["typed"] != table[n]]
    for name in names or changed:
        held[name] = run(table[name])
        ordered = {each: held[each] for each in table if each in held}
        RESULTS.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
        print(f"{name:28}{held[name]['wall_s']:8.1f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
