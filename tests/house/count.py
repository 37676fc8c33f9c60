"""What is counted: each count takes the files of a house and gives the places."""

import ast
import re
import subprocess
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path, PurePosixPath

import yaml

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("srsinv/", "experiments/", "benchmarks/", "tests/")
PACKAGE = ("srsinv/", "experiments/", "benchmarks/")
RETIRED = yaml.safe_load((Path(__file__).parent / "names.yaml").read_text(encoding="utf-8"))
# The bases of parts that a configuration may name, whatever module they are in.
KINDS = (
    "Amplifier", "Effect", "Feature", "SurfaceFeature", "FrictionStep", "Method", "Wiener",
    "Tikhonov", "Noise", "Pressure", "Rough", "Rule", "Prior", "ConstantSpeed", "Motion", "Scene",
    "Skin", "HalfSpace", "Solver", "TractionSpectrum", "Shape", "Film", "LineEffect", "Filter",
    "SpeedProfile", "Operator",
)  # fmt: skip
_DEPTH = re.compile(r"PER_DEPTH|IN_A_DEPTH|MARGIN|per_depth")

Files = Mapping[str, ast.Module]


def read_tree() -> Files:
    """The Python files of the working tree that git knows."""
    names = _git("ls-files", "*.py").split()
    return {name: ast.parse((ROOT / name).read_text()) for name in names if (ROOT / name).is_file()}


def read_commit(commit: str) -> Files:
    """Those of a commit."""
    names = _git("ls-tree", "-r", "--name-only", commit).split()
    wanted = [name for name in names if name.endswith(".py") and name.startswith(ROOMS)]
    return {name: ast.parse(_git("show", f"{commit}:{name}")) for name in wanted}


def configured_signatures(files: Files) -> list[str]:
    """Functions with a parameter `cfg`, but for config.py and the `run` of jobs and experiments."""
    return [
        f"{name}:{node.lineno} {node.name}"
        for name, node in _functions(files, PACKAGE)
        if "cfg" in {arg.arg for arg in (*node.args.args, *node.args.kwonlyargs)}
        and name != "srsinv/config.py"
        and not (node.name == "run" and name.startswith(("srsinv/jobs/", "experiments/")))
    ]


def retired_names(files: Files) -> list[str]:
    """Identifiers with a retired word, or that are a retired name, once for each file; a test's
    name is a sentence."""
    places = set()
    for name, tree in files.items():
        for node in ast.walk(tree):
            for identifier in _bound(node):
                if not identifier.startswith("test_") and _is_retired(identifier):
                    places.add(f"{name} {identifier}")
    return sorted(places)


def classes_defined_twice(files: Files) -> list[str]:
    """Names of more than one class."""
    places = defaultdict(list)
    for name, tree in files.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{name}:{node.lineno}")
    return [f"{name}: {', '.join(each)}" for name, each in sorted(places.items()) if len(each) > 1]


def checks_of_kinds(files: Files) -> list[str]:
    """`isinstance` and `issubclass` with a class of a kind: what another's class would not be."""
    kinds = _derived(files)
    return [
        f"{name}:{node.lineno} {ast.unparse(node)}"
        for name, tree in files.items()
        if name.startswith(PACKAGE) and name != "srsinv/targets.py"
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ("isinstance", "issubclass")
        and kinds & {each.id for each in ast.walk(node.args[1]) if isinstance(each, ast.Name)}
    ]


def private_imports(files: Files) -> list[str]:
    """Names and modules that begin with an underscore, imported from another folder."""
    return [
        f"{name}:{node.lineno} {source}"
        for name, tree in files.items()
        if name.startswith(PACKAGE)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for source in _private(name, node)
    ]


def depth_in_cells(files: Files) -> list[str]:
    """Modules in which a depth becomes the width of cells, or of samples, by a number."""
    return sorted(
        name
        for name, tree in files.items()
        if name.startswith(PACKAGE) and any(map(_is_depth_in_cells, ast.walk(tree)))
    )


COUNTS: Mapping[str, Callable[[Files], list[str]]] = {
    "signatures with cfg": configured_signatures,
    "retired names": retired_names,
    "class names defined twice": classes_defined_twice,
    "isinstance on kinds": checks_of_kinds,
    "private names across rooms": private_imports,
    "modules in which depth becomes cells": depth_in_cells,
}


def _functions(files: Files, rooms: tuple[str, ...]) -> Iterator[tuple[str, ast.FunctionDef]]:
    for name, tree in files.items():
        if name.startswith(rooms):
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef):
                    yield name, node


def _bound(node: ast.AST) -> tuple[str, ...]:
    """What a node defines or assigns."""
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
            return (name,)
        case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
            return (name,)
    return ()


@cache
def _is_retired(identifier: str) -> bool:
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", identifier)
    is_word = any(word.lower() in RETIRED["words"] for word in words)
    return is_word or identifier.lstrip("_") in RETIRED["names"]


def _derived(files: Files) -> set[str]:
    """The kinds and all classes below them, by name."""
    bases = {
        node.name: {base.id for base in node.bases if isinstance(base, ast.Name)}
        for tree in files.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    kinds: set[str] = set(KINDS)
    before: set[str] = set()
    while kinds != before:
        before = set(kinds)
        kinds |= {name for name, above in bases.items() if above & kinds}
    return kinds


def _private(name: str, node: ast.ImportFrom) -> Iterator[str]:
    """What an import takes that is private to a folder above which the file `name` lies, or to a
    module of another room."""
    here = PurePosixPath(name).parent.parts
    module = tuple((node.module or "").split(".")) if node.module else ()
    whole = (*here[: len(here) - node.level + 1], *module) if node.level else module
    if whole[:1] != ("srsinv",):
        return
    inner = [at for at, part in enumerate(whole) if _is_private(part)]
    if inner and here[: inner[0]] != whole[: inner[0]]:
        yield ".".join(whole)
    elif whole[:2] != here[:2]:
        yield from (f"{'.'.join(whole)}.{each.name}" for each in node.names
                    if _is_private(each.name))  # fmt: skip


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _is_depth_in_cells(node: ast.AST) -> bool:
    """A product or a quotient with a number of cells, samples or margins in a depth."""
    if not isinstance(node, ast.BinOp) or not isinstance(node.op, ast.Mult | ast.Div):
        return False
    names = [each.id for each in ast.walk(node) if isinstance(each, ast.Name)]
    return any(map(_DEPTH.search, names)) and any("depth" in each for each in _names(node))


def _names(node: ast.AST) -> set[str]:
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name)} | {
        each.attr for each in ast.walk(node) if isinstance(each, ast.Attribute)
    }


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout
