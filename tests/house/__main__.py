"""Where the Python files of the working tree break a rule of the house: `python -m tests.house`.

Each rule takes the files, and gives the places that break it.
"""

import ast
import re
import subprocess
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePosixPath

import yaml

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ("srsinv/", "experiments/", "benchmarks/")
RETIRED = yaml.safe_load((Path(__file__).parent / "names.yaml").read_text(encoding="utf-8"))

Files = Mapping[str, ast.Module]


def main() -> None:
    """Print what breaks each rule."""
    command = ("git", "-C", str(ROOT), "ls-files", "*.py")
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    files = {name: ast.parse((ROOT / name).read_text()) for name in names if (ROOT / name).exists()}
    for rule, broken in RULES.items():
        places = broken(files)
        print(f"{rule}: {len(places)}", *places, sep="\n  ")


def configured_signatures(files: Files) -> list[str]:
    """Functions with a parameter `cfg`, but for config.py and the `run` of jobs and experiments."""
    return [
        f"{name}:{node.lineno} {node.name}"
        for name, tree in files.items()
        if name.startswith(PACKAGE) and name != "srsinv/config.py"
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and "cfg" in {arg.arg for arg in (*node.args.args, *node.args.kwonlyargs)}
        and not (node.name == "run" and name.startswith(("srsinv/jobs/", "experiments/")))
    ]


def retired_names(files: Files) -> list[str]:
    """Identifiers with a retired word, or that are a retired name, once for each file; a test's
    name is a sentence."""
    places = {
        f"{name} {identifier}"
        for name, tree in files.items()
        for node in ast.walk(tree)
        for identifier in _bound(node)
        if not identifier.startswith("test_") and _is_retired(identifier)
    }
    return sorted(places)


def classes_defined_twice(files: Files) -> list[str]:
    """Names of more than one class."""
    places = defaultdict(list)
    for name, tree in files.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{name}:{node.lineno}")
    return [f"{name}: {', '.join(each)}" for name, each in sorted(places.items()) if len(each) > 1]


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


RULES: Mapping[str, Callable[[Files], list[str]]] = {
    "functions that see cfg": configured_signatures,
    "retired names": retired_names,
    "class names defined twice": classes_defined_twice,
    "private names across rooms": private_imports,
}


def _bound(node: ast.AST) -> tuple[str, ...]:
    """What a node defines or assigns."""
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
            return (name,)
        case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
            return (name,)
    return ()


def _is_retired(identifier: str) -> bool:
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", identifier)
    is_word = any(word.lower() in RETIRED["words"] for word in words)
    return is_word or identifier.lstrip("_") in RETIRED["names"]


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


if __name__ == "__main__":
    main()
