"""Makes mutations (all, or those whose names match NAME, which may hold wildcards) in a copy of the
tree, each by itself, and runs the test files that are expected to notice it up to the first
failure. What is found goes to tests/claims/results/mutations.json. With --check no test is run.

Exit codes: 0; 1 where no test notices a mutation; 2 where the table does not fit the package, or
the results are not those of the table.
"""

import argparse
import fnmatch
import sys
import tempfile
import time
from collections.abc import Collection
from pathlib import Path

from .run import DIED, TIERS, Copy
from .table import Mutation, Stale, is_current, mutations, read_results, write_results


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser("python -m tests.mutations", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", default=["*"])
    parser.add_argument("--check", action="store_true", help="run no tests: is anything stale?")
    asked = parser.parse_args()
    try:
        table = mutations()
        for mutation in table.values():
            mutation.applied()
        if not asked.check:
            run([n for n in table if any(fnmatch.fnmatch(n, p) for p in asked.names)], table)
        return check_results(table)
    except Stale as stale:
        print(f"{stale} Bring the entry up to date, or delete it with what it guarded.")
        return 2


def run(names: Collection[str], table: dict[str, Mutation]) -> None:
    """Run these mutations, and record what is found."""
    results = {name: each for name, each in read_results().items() if name in table}
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        copy = Copy(Path(folder))
        for name in names:
            begun = time.monotonic()
            tier, test = copy.noticed(table[name], results.get(name, {}).get("noticed_by"))
            print(f"{name:28}{tier or '-':6}{time.monotonic() - begun:4.0f} s  {test}", flush=True)
            results[name] = table[name].edit | {"tier": tier, "noticed_by": test}
            write_results(results)
        # A test that fails without a mutation notices none.
        noticing = {results[name]["noticed_by"] for name in names} - {None, DIED}
        for tier in TIERS:
            if failed := copy.failed(sorted(noticing), tier):
                raise Stale(f"Without any mutation fails too: {failed[0]}.")


def check_results(table: dict[str, Mutation]) -> int:
    """Whether the results are those of the table, and every mutation is noticed: the exit code."""
    results = read_results()
    stale = {name for name in table if not is_current(results.get(name), table[name])}
    if stale := sorted(stale | (results.keys() - table.keys())):
        print(f"No results of today's edit: run python -m tests.mutations {' '.join(stale)}")
        return 2
    missed = [name for name in table if not results[name]["noticed_by"]]
    print(f"{len(table)} mutations, noticed by no test: {', '.join(missed) or 'none'}.")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
