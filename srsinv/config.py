"""Construction of objects from the configuration: allowed classes, found by name and checked before
use.

A node `{_target_: package.module.Class, key: value, ...}` stands for an object. The class has to
lie in an allowed namespace, to be found there under the very name that it was defined with, and to
derive from the base of the slot that the node stands in; nodes inside, in mappings and in lists,
follow the same rule. The checked class itself is called: hydra's own `instantiate`, which would
look the name up a second time and takes any callable, is not used.

Nothing here imports jax: a base is imported when a node of its kind is made.
"""

import hashlib
import importlib
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from .aliases import CLASSES, current_name
from .errors import BadInput, mapping, refuse, shown, whole

Config = Mapping[str, Any]
PRECISIONS = ("float64", "float32")

# The base of each kind of part, by configuration group or by the name of the slot; resolved when a
# part of the kind is made, as most import jax.
KINDS: Mapping[str, Sequence[str]] = {
    "amplifier": ("srsinv.forward.amplifier.Amplifier",),
    "effects": ("srsinv.effects.Effect",),
    "feature": (
        "srsinv.forward.feature.Feature",
        "srsinv.forward.surface_feature.SurfaceFeature",
    ),
    "film": ("srsinv.forward.film.LineEffect",),
    "filter": ("srsinv.forward.filter.Filter",),
    "friction": ("srsinv.forward.traction.FrictionStep",),
    "method": ("srsinv.inverse.method.Method",),
    "noise": ("srsinv.forward.noise.Noise",),
    "operator": ("srsinv.grid.Operator",),
    "pressure": ("srsinv.forward.traction.Pressure",),
    "prior": ("srsinv.inverse.prior.Prior",),
    "rough": ("srsinv.forward.surface.Rough",),
    "rule": ("srsinv.inverse.rule.Rule",),
    "scan": ("srsinv.forward.scan.ConstantSpeed",),
    "scene": ("srsinv.forward.scene.Scene",),
    "half_space": ("srsinv.forward.skin.HalfSpace",),
    "skin": ("srsinv.forward.skin.Skin",),
    "solver": ("srsinv.inverse.nonlinear.Solver",),
    "spectrum": ("srsinv.inverse.wiener.TractionSpectrum",),
    "speed_profile": ("srsinv.forward.speed_profile.SpeedProfile",),
    "surface": ("srsinv.forward.surface.Shape",),
    "surface_feature": ("srsinv.forward.surface_feature.SurfaceFeature",),
    "traction_feature": ("srsinv.forward.feature.Feature",),
}
# The kind of what stands under a key of another part, alone or in a list or mapping of several.
PARTS: Mapping[str, str] = {
    "filter": "filter",
    "frictions": "friction",
    "p": "spectrum",
    "pressures": "pressure",
    "prior": "prior",
    "profile": "speed_profile",
    "q": "spectrum",
    "rule": "rule",
    "skin": "skin",
    "surfaces": "surface",
}
_TARGET = "_target_"
_DEEPEST = 20  # parts, lists and mappings within each other
_PLUGINS = "plugins/*.py in the folder of --config-dir"
_JOB = re.compile(r"(srsinv\.jobs|experiments|plugins)\..+\.run")


def make(node: Any, name: str, kind: str) -> Any:
    """The object of `kind` (a key of `KINDS`) that a node stands for; refusals call it `name`.

    Raises `BadInput` for a node that names no class of the kind, or keys that the class does not
    take, and values that the class itself refuses.
    """
    check(node, name, kind)
    return _made(node)


def check(node: Any, name: str, kind: str) -> None:
    """Refuse a node that [`make`][] could not make, and likewise the nodes inside."""
    made = class_of(node, name, kind)
    _check_keys(made, node, name)
    for key, value in node.items():
        if key != _TARGET:
            _check_inside(value, f"{name}.{key}", PARTS.get(key))


def class_of(node: Any, name: str, kind: str) -> type:
    """The class that a node's `_target_` names. Raises `BadInput` where it is not of `kind`."""
    target = mapping(name, node).get(_TARGET)
    made = _definition(target)
    refuse(
        not inspect.isclass(made),
        f"{name}.{_TARGET} is {shown(target)}, which is no class of srsinv, of the experiments or "
        f"of {_PLUGINS}: name one as package.module.Class, where it is defined.",
    )
    assert isinstance(made, type)
    bases = tuple(map(base_of, KINDS[kind]))
    refuse(
        not issubclass(made, bases),
        f"{name}.{_TARGET} is {shown(target)}, which cannot stand there: name a class that derives "
        f"from {' or '.join(f'srsinv.kinds.{base.__name__}' for base in bases)}.",
    )
    return made


def _check_keys(made: type, node: Mapping[str, Any], name: str) -> None:
    """Refuse keys that a class does not take, or lacks; none of hydra's beside `_target_`."""
    parameters = inspect.signature(made).parameters
    known = {key: each for key, each in parameters.items() if each.kind is not each.VAR_KEYWORD}
    takes_any = len(known) < len(parameters)
    keys = [key for key in node if key != _TARGET]
    listed = ", ".join(parameters) or "nothing"
    unknown = [key for key in keys if key not in known and (not takes_any or _is_private(key))]
    refuse(
        bool(unknown),
        f"{name} has no key {unknown and shown(unknown[0])}: {made.__name__} takes {listed}.",
    )
    needed = {key for key, each in known.items() if each.default is each.empty}
    missing = sorted(needed - set(keys))
    refuse(
        bool(missing),
        f"{name} lacks {missing and missing[0]!r}: {made.__name__} takes {listed}.",
    )


def _check_inside(value: Any, name: str, kind: str | None, depth: int = 1) -> None:
    """Refuse nodes where no part is expected, and keys that begin with an underscore."""
    refuse(depth > _DEEPEST, f"{name} lies more than {_DEEPEST} levels deep: give it flatter.")
    if isinstance(value, list | tuple):
        for index, each in enumerate(value):
            _check_inside(each, f"{name}[{index}]", kind, depth + 1)
    elif isinstance(value, Mapping) and kind is not None and _TARGET in value:
        check(value, name, kind)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            refuse(
                _is_private(key),
                f"{name} has the key {shown(key)}, and no part is made there: leave it out.",
            )
            _check_inside(each, f"{name}.{key}", kind, depth + 1)


def _is_private(key: Any) -> bool:
    """Whether a key is reserved for hydra, or is no name."""
    return not isinstance(key, str) or key.startswith("_")


def _made(value: Any) -> Any:
    """A checked value with the objects that its nodes stand for."""
    if isinstance(value, list | tuple):
        return [_made(each) for each in value]
    if not isinstance(value, Mapping):
        return value
    parts = {key: _made(each) for key, each in value.items() if key != _TARGET}
    return _definition(value[_TARGET])(**parts) if _TARGET in value else parts


def base_of(name: str) -> type:
    """The class that a dotted name of `KINDS` stands for."""
    module, _, base = name.rpartition(".")
    return getattr(importlib.import_module(module), base)


def load_job(name: Any, root: Path) -> FunctionType:
    """The function `run` of a module in `srsinv.jobs`, in the experiments beside the configuration
    folder `root`, or among the plugins, that `job` names. Raises `BadInput` for anything else."""
    import_experiments(root)
    is_job = isinstance(name, str) and _JOB.fullmatch(name)
    job = _definition(name) if is_job else None
    if not isinstance(job, FunctionType):
        raise BadInput(
            f"job is {shown(name)}, which is no function run of a module in srsinv.jobs or in the "
            "experiments: leave it as the experiment has it."
        )
    return job


def import_experiments(root: Path) -> None:
    """Make the folder `experiments` beside the configuration folder importable under that name,
    and nothing else beside it."""
    _open_namespace("experiments", root.resolve().parent / "experiments")


def open_plugins(config_dir: str | None) -> None:
    """Let targets name classes of `config_dir`/plugins/*.py as plugins.FILE.Class.

    A file is run when a configuration names it, as the module plugins.FILE: nothing of the folder
    is importable under another name, so that none can take the place of a library.
    """
    _open_namespace("plugins", Path(config_dir or os.devnull).resolve() / "plugins")


def plugin_files() -> dict[str, str]:
    """SHA-256 of every plugin that was loaded, by its file's name."""
    modules = [m for name, m in sorted(sys.modules.items()) if name.startswith("plugins.")]
    paths = [Path(module.__file__) for module in modules if module.__file__]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


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


def _definition(target: Any) -> Any:
    """What is defined as `target` in a module of `srsinv`, of the experiments or of the plugins,
    else None.

    Modules are looked up below these packages only, and what a module has merely imported does not
    count: the name has to be the one under which the thing was defined. Raises `BadInput` for a
    plugin that cannot be run.
    """
    if not isinstance(target, str) or not target.isascii():
        return None
    target = current_name(target, CLASSES)
    parts = target.split(".")
    if not all(part.isidentifier() for part in parts) or parts[0] not in _namespaces():
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
    except Exception as error:  # a user's own code may raise anything
        raise BadInput(
            f"{path.replace('.', '/')}.py cannot be run: {type(error).__name__}: {error}. Mend it, "
            "or leave out what names it."
        ) from error


def _namespaces() -> tuple[str, ...]:
    optional = ("experiments", "plugins")
    return ("srsinv", *(name for name in optional if name in sys.modules))


def _is_module(package: ModuleType, path: str) -> bool:
    return hasattr(package, "__path__") and importlib.util.find_spec(path) is not None


def check_early(cfg: Config) -> None:
    """Refuse, before any heavy import, scalars that are invalid in every job, and a recording whose
    file, sidecar or stated facts cannot be read."""
    if "seed" in cfg:
        seed(cfg)
    if "precision" in cfg:
        precision_name(cfg)
    recording = cfg.get("recording")
    if isinstance(recording, Mapping) and recording.get("path") is not None:
        refuse(
            set(recording) == {"path"},  # as recording=none has it
            "recording.path names a file, and this job reads none: give one that does, such as "
            "experiment=inspect_recording, invert_recording or fit_recording.",
        )
        from .recording import check_settings

        check_settings(recording)


def select_effects(cfg: Config, names: Collection[str]) -> Config:
    """The configuration with these of its effects."""
    named = mapping("effects", cfg.get("effects") or {})
    return {**cfg, "effects": {name: node for name, node in named.items() if name in names}}


def merged(cfg: Config, changes: Config) -> dict[str, Any]:
    """`cfg` with `changes` in depth; what names a class of its own replaces what was there."""
    whole = dict(cfg)
    for key, value in changes.items():
        old, inside = whole.get(key), isinstance(value, Mapping) and _TARGET not in value
        whole[key] = merged(old, value) if inside and isinstance(old, Mapping) else value
    return whole


def seed(cfg: Config) -> int:
    """Seed of all random numbers."""
    return whole("seed", cfg["seed"], "a whole number from 0 to 2147483647", least=0)


def precision_name(cfg: Config) -> str:
    """The word for the working precision."""
    name = cfg["precision"]
    refuse(name not in PRECISIONS, f"precision is {shown(name)}: give float64 or float32.")
    return name
