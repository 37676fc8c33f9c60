"""Mutations: small wrong edits of the package, each of which a test has to notice.

They are data, in a YAML file for each room of `srsinv` beside this one. A mutation names a symbol,
MODULE:QUALIFIED.NAME of a function, a class, a method or a constant, and a fragment of Python
within it. Both are looked up in the syntax tree, so that an entry survives what moves within a
file, and a change of spacing, line breaks or comments.
"""

import ast
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
RESULTS = ROOT / "tests" / "claims" / "results" / "mutations.json"


class Stale(Exception):
    """A mutation that does not fit the package any more."""


@dataclass(frozen=True)
class Mutation:
    """One wrong edit.

    - `old`, `new`: an expression or a statement that stands in `symbol` exactly once, and what
      takes its place.
    - `guards`: what is lost with it; `tests`: the files in which a test is expected to notice.
    """

    name: str
    symbol: str
    old: str
    new: str
    guards: str
    tests: tuple[str, ...]

    @property
    def path(self) -> Path:
        """The module's file, relative to the root."""
        module = Path(*self.symbol.partition(":")[0].split("."))
        return module / "__init__.py" if (ROOT / module).is_dir() else module.with_suffix(".py")

    @property
    def edit(self) -> dict[str, str]:
        """What a result is a result of."""
        return {"symbol": self.symbol, "old": self.old, "new": self.new}

    def applied(self) -> str:
        """The module's text with the edit; raises `Stale` where it cannot be made."""
        for file in (self.path, *map(Path, self.tests)):
            if not (ROOT / file).is_file():
                raise Stale(f"Mutation {self.name}: there is no file {file}.")
        lines, tree = _parsed(ROOT / self.path)
        matches = _equal(self._symbol_in(tree), _fragment(self.old))
        if len(matches) != 1:
            raise Stale(
                f"Mutation {self.name}: {self.old!r} stands {len(matches)} times in {self.symbol}, "
                "where it has to stand once."
            )
        begin, end = _span(lines, matches[0])
        text = b"".join(lines)
        new = f"({self.new})" if isinstance(matches[0], ast.expr) else self.new
        mutated = (text[:begin] + new.encode() + text[end:]).decode()
        if ast.dump(ast.parse(mutated)) == ast.dump(tree):
            raise Stale(f"Mutation {self.name}: {self.new!r} changes nothing.")
        return mutated

    def _symbol_in(self, tree: ast.AST) -> ast.AST:
        node, _, qualified = tree, *self.symbol.partition(":")[1:]
        for name in qualified.split("."):
            named = [each for each in getattr(node, "body", ()) if name in _names(each)]
            if len(named) != 1:
                raise Stale(
                    f"Mutation {self.name}: {self.path} has {len(named)} times {name!r} of "
                    f"{qualified!r}, where one is expected."
                )
            node = named[0]
        return node


def mutations() -> dict[str, Mutation]:
    """The whole table, by name."""
    table: dict[str, Mutation] = {}
    for path in sorted(FOLDER.glob("*.yaml")):
        # Every scalar as text: a fragment such as -3e-11 is Python, not YAML.
        for entry in yaml.load(path.read_text(), Loader=yaml.BaseLoader):
            mutation = Mutation(**entry | {"tests": tuple(entry["tests"])})
            if mutation.name in table:
                raise Stale(f"Mutation {mutation.name} of {path.name}: the name stands twice.")
            table[mutation.name] = mutation
    return table


def read_results() -> dict[str, dict[str, Any]]:
    """What was found of each mutation, by name: the edit, the tier and the test that noticed it,
    None where none did."""
    return json.loads(RESULTS.read_text()) if RESULTS.exists() else {}


def write_results(results: Mapping[str, Mapping[str, Any]]) -> None:
    """Write them, sorted by name."""
    RESULTS.write_text(json.dumps(results, indent=1, sort_keys=True) + "\n")


def is_current(result: Mapping[str, Any] | None, mutation: Mutation) -> bool:
    """Whether a result is one of this very edit."""
    return result is not None and mutation.edit.items() <= result.items()


@cache
def _parsed(path: Path) -> tuple[list[bytes], ast.Module]:
    text = path.read_bytes()
    return text.splitlines(keepends=True), ast.parse(text)


def _names(statement: ast.AST) -> set[str]:
    """What a statement defines or assigns."""
    match statement:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            return {name}
        case ast.Assign(targets=targets):
            parts = (part for target in targets for part in ast.walk(target))
            return {part.id for part in parts if isinstance(part, ast.Name)}
        case ast.AnnAssign(target=ast.Name(id=name)):
            return {name}
    return set()


def _fragment(text: str) -> ast.AST:
    (statement,) = ast.parse(text).body
    return statement.value if isinstance(statement, ast.Expr) else statement


def _equal(symbol: ast.AST, wanted: ast.AST) -> list[ast.expr | ast.stmt]:
    """The nodes of `symbol` that are `wanted`, wherever they stand."""
    dump = ast.dump(wanted)
    alike = (each for each in ast.walk(symbol) if type(each) is type(wanted))
    return [
        each for each in alike if isinstance(each, ast.expr | ast.stmt) and ast.dump(each) == dump
    ]


def _span(lines: list[bytes], node: ast.expr | ast.stmt) -> tuple[int, int]:
    """Where a node begins and ends, in bytes; columns of the syntax tree are bytes too."""
    before = [0]
    for line in lines:
        before.append(before[-1] + len(line))
    # Only the ends of nodes made by hand are None.
    last, column = node.end_lineno or 0, node.end_col_offset or 0
    return before[node.lineno - 1] + node.col_offset, before[last - 1] + column
