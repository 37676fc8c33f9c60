"""Makes each mutation (all, or those whose names match NAME, which may hold wildcards) in a copy of
the tree, and runs the test files that are expected to notice it up to the first failure. With
--tier all tests of a tier are run, for every mutation: hours. What is found goes to
tests/claims/results/mutations.json.
"""

import argparse
import fnmatch
import shlex
import sys
import tempfile
import time
from pathlib import Path

from . import results
from .run import DIED, TIERS, Copy
from .table import Mutation, mutations


def main() -> int:
    """The exit code: 1 where a mutation that was run is noticed by no test."""
    asked = _asked()
    table, recorded = mutations(), results.read()
    names = [n for n in table if any(fnmatch.fnmatch(n, pattern) for pattern in asked.names)]
    if not names:
        sys.exit(f"No mutation is called {' or '.join(asked.names)}: --list shows all.")
    if asked.list:
        for each in (table[name] for name in names):
            tier = recorded.get(each.name, {}).get("tier") or "-"
            print(f"{each.name:28}{each.kind:10}{tier:6}{each.symbol}: {each.guards}")
        return 0
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        copy = Copy(Path(folder), asked.pytest)
        for name in names:
            recorded[name] = _result(copy, table[name], asked.tier, recorded.get(name))
            results.write(recorded, table)
        _check_unmutated(copy, [test for name in names for test in recorded[name]["noticed_by"]])
    missed = [n for n in names if not recorded[n]["tier"] and not table[n].equivalent]
    print(f"{len(names)} mutations; noticed by no test: {', '.join(missed) or 'none'}.")
    return bool(missed)


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m tests.mutations", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--tier", choices=TIERS)
    parser.add_argument(
        "--list",
        action="store_true",
        help="print the table and run nothing",
    )
    parser.add_argument("--pytest", default="", help="further arguments of pytest, in one string")
    asked = parser.parse_args()
    asked.names, asked.pytest = asked.names or ["*"], shlex.split(asked.pytest)
    return asked


def _result(
    copy: Copy, mutation: Mutation, tier: str | None, before: results.Result | None
) -> results.Result:
    begun = time.monotonic()
    if tier is None:
        known = before["noticed_by"] if before else []
        noticed_in, tests = copy.first_failure(mutation, known)
    else:
        noticed_in, tests = copy.failures(mutation, tier)
    took = f"{time.monotonic() - begun:.0f} s"
    print(f"{mutation.name:28}{noticed_in or '-':6}{took:>6}  {', '.join(tests)}", flush=True)
    return results.result(mutation, noticed_in, tests)


def _check_unmutated(copy: Copy, tests: list[str]) -> None:
    """A test that fails without a mutation notices none."""
    failing = copy.failures_unmutated(sorted({test for test in tests if test != DIED}))
    if failing:
        sys.exit(f"Without any mutation fails too: {', '.join(failing)}: mend it, and run again.")


if __name__ == "__main__":
    sys.exit(main())
