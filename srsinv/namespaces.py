"""Namespaces in which the configuration may name classes: `srsinv`, the `experiments` of a clone
and the `plugins` of a user's folder.

Modules are looked up below these packages only, and loaded when they are named.
"""

import hashlib
import importlib
import importlib.util
import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import yaml

from .errors import BadInput, echo

_JOB = re.compile(r"(srsinv\.jobs|experiments|plugins)\..+\.run")


def import_experiments(root: Path) -> None:
    """Make the folders `experiments` and `benchmarks` beside the configuration folder importable
    under these names, and nothing else beside it."""
    for name in ("experiments", "benchmarks"):
        _open_namespace(name, root.resolve().parent / name)


def benchmark(name: str) -> ModuleType | None:
    """The module `name` of a clone's benchmarks; None where there are none, as in a wheel."""
    return importlib.import_module(f"benchmarks.{name}") if "benchmarks" in sys.modules else None


def open_plugins(config_dir: str | None) -> None:
    """Let targets name classes of `config_dir`/plugins/*.py as plugins.FILE.Class.

    A file is run when a configuration names it, as the module plugins.FILE: nothing of the folder
    is importable under another name, so that none can take the place of a library.
    """
    _open_namespace("plugins", Path(config_dir or os.devnull).resolve() / "plugins")


def plugin_option(group: str, settings: Mapping[str, Any]) -> tuple[Path, str | None]:
    """The user's folder whose plugin `settings` names, and the option of a `group` there that has
    these settings, or None where it has no such option."""
    folder = Path(sys.modules["plugins"].__path__[0]).parent
    for path in sorted(Path(folder, group).glob("*.yaml")):
        if yaml.safe_load(path.read_bytes()) == settings:
            return folder, path.stem
    return folder, None


def plugin_files(settings: Any) -> dict[str, str]:
    """SHA-256, by its path in the folder of plugins, of every plugin that a configuration names, or
    that one of these imports."""
    loaded = {
        name: module
        for name, module in sys.modules.items()
        if name.startswith("plugins.") and getattr(module, "__file__", None)
    }
    modules: set[str] = set()
    waiting = list(_texts(settings))
    while waiting:
        word = waiting.pop()
        for name in {n for n in loaded if f"{word}.".startswith(f"{n}.")} - modules:
            modules.add(name)
            waiting += map(_origin, vars(loaded[name]).values())
    files = {}
    for name in sorted(modules):
        path = Path(str(loaded[name].__file__))
        inside = path.relative_to(sys.modules["plugins"].__path__[0]).as_posix()
        files[inside] = hashlib.sha256(path.read_bytes()).hexdigest()
    return files


def fault_in_plugin(error: BaseException) -> BadInput | None:
    """What a plugin raised, as a refusal that says where; None for what none has raised."""
    at, reached = error.__traceback__, None
    while at is not None:
        if str(at.tb_frame.f_globals.get("__name__")).startswith("plugins."):
            reached = at
        at = at.tb_next
    if reached is None:
        return None
    name = reached.tb_frame.f_globals["__name__"].replace(".", "/")
    said = f": {error}" if str(error) else ""
    return BadInput(
        f"{name}.py raises {type(error).__name__} at line {reached.tb_lineno}{said}. "
        "Correct it, or leave out the option that names it."
    )


def _texts(node: Any) -> Iterator[str]:
    """Every text in a configuration."""
    if isinstance(node, str):
        yield node
    elif isinstance(node, Mapping | list):
        for each in node.values() if isinstance(node, Mapping) else node:
            yield from _texts(each)


def _origin(value: Any) -> str:
    """The module that a value is, or where it was defined."""
    name = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    return str(name)


def _open_namespace(name: str, folder: Path) -> None:
    """Make a folder importable under `name`, in place of another one that was before."""
    loaded = sys.modules.get(name)
    if loaded is not None and str(folder) in list(loaded.__path__):
        return
    for each in [each for each in sys.modules if each.partition(".")[0] == name]:
        del sys.modules[each]
    if folder.is_dir():
        package = ModuleType(name, f"The {name} of a clone or a user.")
        package.__path__ = [str(folder)]
        package.__spec__ = importlib.util.spec_from_loader(name, None, is_package=True)
        sys.modules[name] = package


def definition(target: Any) -> Any:
    """What is defined as `target` in a module of `srsinv`, of the experiments or of the plugins,
    else None.

    Modules are looked up below these packages only, and what a module has merely imported does not
    count: the name has to be the one under which the thing was defined. Raises `BadInput` for a
    plugin that cannot be run.
    """
    if not isinstance(target, str) or not target.isascii():
        return None
    parts = target.split(".")
    packages = ["srsinv", *(name for name in ("experiments", "plugins") if name in sys.modules)]
    if not all(part.isidentifier() for part in parts) or parts[0] not in packages:
        return None
    definition: Any = sys.modules[parts[0]]
    for index, part in enumerate(parts[1:], 2):
        path = ".".join(parts[:index])
        if isinstance(definition, ModuleType) and _is_module(definition, path):
            definition = _imported(path)
        elif isinstance(definition, ModuleType | type):
            definition = vars(definition).get(part)
        else:
            return None
    own = (getattr(definition, "__module__", None), getattr(definition, "__qualname__", None))
    return definition if ".".join(map(str, own)) == target else None


def _imported(path: str) -> ModuleType:
    if not path.startswith("plugins."):
        return importlib.import_module(path)
    try:
        return importlib.import_module(path)
    except (Exception, SystemExit) as error:  # a user's own code may raise anything
        raise BadInput(
            f"{path.replace('.', '/')}.py cannot be run: {type(error).__name__}: {error}. "
            "Correct it, or leave out the option that names it."
        ) from error


def _is_module(package: ModuleType, path: str) -> bool:
    # Of what a module has merely imported, the name is another one.
    is_package = hasattr(package, "__path__") and package.__name__ == path.rpartition(".")[0]
    return is_package and importlib.util.find_spec(path) is not None


def load_job(name: Any, root: Path) -> FunctionType:
    """The function `run` of a module in `srsinv.jobs`, in the experiments beside the configuration
    folder `root`, or among the plugins, that `job` names. Raises `BadInput` for anything else."""
    import_experiments(root)
    is_job = isinstance(name, str) and _JOB.fullmatch(name)
    job = definition(name) if is_job else None
    if not isinstance(job, FunctionType):
        raise BadInput(
            f"job is {echo(name)}, which is not the function run of a module in "
            "srsinv.jobs or experiments: leave job out."
        )
    return job
