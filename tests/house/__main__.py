"""Counts of what makes the house hard to enter, of the working tree or of a commit.

python -m tests.house [--list] [COMMIT...]
"""

import argparse

from rich.console import Console
from rich.table import Table

from .count import COUNTS, read_commit, read_tree


def main() -> None:
    """Print a column for each commit and one for the working tree."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commits", nargs="*")
    parser.add_argument("--list", action="store_true", help="each place, of the last column")
    given = parser.parse_args()
    houses = {commit: read_commit(commit) for commit in given.commits} | {"now": read_tree()}
    table = Table("count", *houses)
    places: dict[str, list[str]] = {}
    for name, count in COUNTS.items():
        columns = [count(files) for files in houses.values()]
        table.add_row(name, *(str(len(each)) for each in columns))
        places[name] = columns[-1]
    console = Console(width=140)
    console.print(table)
    for name in places if given.list else ():
        console.print(f"[bold]{name}[/]", *places[name], sep="\n  ", highlight=False)


if __name__ == "__main__":
    main()
