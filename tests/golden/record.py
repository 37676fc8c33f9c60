"""Records the golden data: `python -m tests.golden.record [--check] [--all] [FAMILY/CASE ...]`.

Only what has moved beyond its tolerance is written anew, so that a difference of the files shows
what a change did, and rounding never creeps. `--all` writes all of it, `--check` nothing: it prints
what has moved, and exits with 1 where anything has. Cases may hold wildcards, `forms/*`;
`refusals` and `options` stand for the two that are sentences and names.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import tests.conftest  # noqa: F401  the tests' own setting of XLA
from srsinv.command.programs import release_programs
from tests.golden import options, refusals
from tests.golden.compare import FOLDER, differences
from tests.golden.entries import Entries, read, write
from tests.golden.families import DATA, cases, entries, file

MOST_MAPS = 15_000


def chosen(patterns: Sequence[str]) -> Iterator[str]:
    """The cases that the patterns name; all without patterns."""
    return (
        case
        for case in cases()
        if not patterns or any(fnmatchcase(case, pattern) for pattern in patterns)
    )


def renewed(case: str, old: Entries, new: Entries) -> Entries:
    """`new`, but where it is within the tolerance of the old it stays as it was."""
    moved = {each.name.removeprefix(f"{case}/") for each in differences(case, old, new)}
    return {key: new[key] if key in moved else old.get(key, new[key]) for key in new}


def numbers(patterns: Sequence[str], check: bool, every: bool, data: Path = DATA) -> int:
    """Record or check the cases; how many quantities have moved."""
    moved = 0
    for case in chosen(patterns):
        old, new = read(file(case, data)), entries(case)
        moves = differences(case, old, new)
        moved += len(moves)
        rows = [f"  {each}" for each in moves] if old else []
        print(
            "\n".join([f"{case}: {len(moves)} moved" if old else f"{case}: new", *rows]), flush=True
        )
        if not check:
            write(file(case, data), new if every or not old else renewed(case, old, new))
        release_programs(MOST_MAPS)
    return moved


def sentences(check: bool) -> int:
    """Record or check the refusals; how many are other ones."""
    old = refusals.stored()
    new = refusals.now(old)
    moved = [
        (was, now)
        for part in refusals.PARTS
        for was, now in zip(old[part], new[part], strict=True)
        if was != now
    ]
    print("\n".join([f"refusals: {len(moved)} moved", *(f"  {a}\n  {b}" for a, b in moved)]))
    if not check:
        refusals.write(new)
    return len(moved)


def names(check: bool) -> int:
    """Record or check the options; whether they are other ones."""
    path = FOLDER / "options.yaml"
    new = options.text()
    moved = int(not path.is_file() or path.read_text(encoding="utf-8") != new)
    print(f"options: {moved} moved")
    if not check:
        path.write_text(new, encoding="utf-8")
    return moved


def main(argv: Sequence[str] | None = None) -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("patterns", nargs="*", help="FAMILY/CASE, with wildcards")
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--all", action="store_true", help="write what has not moved, too")
    parser.add_argument("--data", type=Path, default=DATA, help="a folder of other golden data")
    given: Any = parser.parse_args(argv)
    others = {"refusals": sentences, "options": names}
    patterns = [each for each in given.patterns if each not in others]
    moved = 0
    if patterns or not given.patterns:
        moved += numbers(patterns, given.check, given.all, given.data)
    for name, record in others.items() if given.data == DATA else ():
        if not given.patterns or name in given.patterns:
            moved += record(given.check)
    return int(given.check and moved > 0)


if __name__ == "__main__":
    sys.exit(main())
