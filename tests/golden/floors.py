"""How far golden data move by themselves: `python -m tests.golden.floors [--setting NAME] [CASE]`.

Cases are computed anew under the settings below, by a process of its own for each, and held against
the golden data, which are of the tests' own setting. floors.json has each case's largest movement,
and the quantities that move by more than NOTED; tolerances.yaml is made from it, and test_golden.py
sees that every tolerance is well above its floor.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tests.conftest  # noqa: F401  the tests' own setting of XLA
from tests.golden.compare import FOLDER, Tolerance, movements
from tests.golden.entries import read
from tests.golden.families import file
from tests.golden.record import chosen
from tests.jobs.run import ROOT

FILE = FOLDER / "floors.json"
# What the tests' own setting gives once more, XLA's default, and that of an older processor.
SETTINGS = {"again": None, "optimised": "", "no_avx": "--xla_cpu_max_isa=SSE4_2"}
NOTED = 1e-10
OF_STDERR = " of stderr"


def recorded(folder: Path, flags: str | None, patterns: Sequence[str]) -> None:
    """Record the cases in `folder` under these flags of XLA; None for the tests' own."""
    own = os.environ if flags is None else os.environ | {"XLA_FLAGS": flags}
    command = [sys.executable, "-m", "tests.golden.record", "--all", "--data", str(folder)]
    subprocess.run([*command, *patterns], cwd=ROOT, env=own, check=True, stdout=subprocess.DEVNULL)


def floor(case: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, float]:
    """How far each quantity has moved, relative; where it has a standard error, in those too."""
    relative = {each.name: each.ratio for each in movements(case, old, new, Tolerance(1.0))}
    by_error = {
        each.name: each.ratio
        for each in movements(case, old, new, Tolerance(0.0, 1.0))
        if f"{each.name.removeprefix(case + '/')}_stderr" in old
    }
    return relative | {f"{name}{OF_STDERR}": each for name, each in by_error.items()}


def measure(setting: str, patterns: Sequence[str]) -> None:
    """Record the cases under one setting, and add what it moves to the file."""
    with TemporaryDirectory() as name:
        recorded(Path(name), SETTINGS[setting], patterns)
        note(setting, {case: read(file(case, Path(name))) for case in chosen(patterns)})


def note(setting: str, fresh: Mapping[str, Mapping[str, Any]]) -> None:
    """Add to the file how far the entries of these cases lie from the golden ones."""
    content: dict[str, dict[str, Any]] = {"cases": {}, "quantities": {}}
    if FILE.is_file():
        content = json.loads(FILE.read_text(encoding="utf-8"))
    quantities = content["quantities"]
    for case, new in fresh.items():
        floors = floor(case, read(file(case)), new)
        largest = max((v for k, v in floors.items() if not k.endswith(OF_STDERR)), default=0.0)
        content["cases"].setdefault(case, {})[setting] = _short(largest)
        for quantity, each in floors.items():
            quantities.setdefault(quantity, {}).pop(setting, None)
            if each > NOTED:
                quantities[quantity][setting] = _short(each)
    content["quantities"] = {name: each for name, each in quantities.items() if each}
    _write(content)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and write the file anew."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("patterns", nargs="*", help="FAMILY/CASE, with wildcards; default all")
    parser.add_argument("--setting", action="append", choices=SETTINGS, help="default all")
    given: Any = parser.parse_args(argv)
    for setting in given.setting or SETTINGS:
        measure(setting, given.patterns or ["*"])


def _write(content: Mapping[str, Mapping[str, Any]]) -> None:
    parts = []
    for part, rows in content.items():
        lines = [f"  {json.dumps(name)}: {json.dumps(rows[name])}" for name in sorted(rows)]
        parts.append(f' "{part}": {{\n' + ",\n".join(lines) + "\n }")
    FILE.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")


def _short(value: float) -> float:
    return float(f"{value:.1e}")  # infinite for what is no number


if __name__ == "__main__":
    main()
