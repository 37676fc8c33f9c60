"""Records the golden data: `python -m tests.golden.record [--check] [--all] [FAMILY/NAME ...]`.

Only what has moved beyond its tolerance is written anew, so that a difference of the files shows
what a change did, and rounding never creeps. `--all` writes all of it, `--check` nothing: it prints
what has moved, and exits with 1 where anything has. Cases may hold wildcards, `forms/*`;
`refusals` stands for the sentences of refusals. Without a case everything is meant.
"""

import argparse
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase

import tests.conftest  # noqa: F401  the tests' own setting of XLA
from srsinv.command.programs import release_programs
from tests.golden import refusals
from tests.golden.cases import cases, entries, file
from tests.golden.compare import differences
from tests.golden.entries import Entries, read, write

MOST_MAPS = 15_000


def main(argv: Sequence[str] | None = None) -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("patterns", nargs="*", help="FAMILY/NAME, with wildcards, or refusals")
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--all", action="store_true", help="write what has not moved, too")
    asked = parser.parse_args(argv)
    patterns, moved = asked.patterns or ["*"], 0
    for case in cases():
        if any(fnmatchcase(case, pattern) for pattern in patterns):
            moved += numbers(case, asked.check, asked.all)
            release_programs(MOST_MAPS)
    if any(fnmatchcase("refusals", pattern) for pattern in patterns):
        moved += sentences(asked.check)
    return int(asked.check and moved > 0)


def numbers(case: str, check: bool, every: bool) -> int:
    """Record or check a case; how many quantities have moved."""
    old, new = read(file(case)), entries(case)
    moves = differences(case, old, new) if old else []
    rows = (f"  {each}" for each in moves)
    print(f"{case}: {len(moves)} moved" if old else f"{case}: new", *rows, sep="\n", flush=True)
    if not check:
        write(file(case), new if every else renewed(case, old, new))
    return len(moves) if old else len(new)


def renewed(case: str, old: Entries, new: Entries) -> Entries:
    """`new`, but where it is within the tolerance of the old it stays as it was."""
    moved = {each.name.removeprefix(f"{case}/") for each in differences(case, old, new)}
    return {key: new[key] if key in moved else old.get(key, new[key]) for key in new}


def sentences(check: bool) -> int:
    """Record or check the refusals; how many are other ones."""
    old = refusals.stored()
    new = refusals.now(old)
    moved = refusals.changed(old, new)
    print(f"refusals: {len(moved)} moved", *(f"  {was}\n  {now}" for was, now in moved), sep="\n")
    if not check:
        refusals.write(new)
    return len(moved)


if __name__ == "__main__":
    sys.exit(main())
