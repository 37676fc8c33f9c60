"""Objects from nodes of the configuration: allowed classes, found by name and checked before use.

A node `{_target_: package.module.Class, key: value, ...}` stands for an object. The class has to
lie in an allowed namespace, to be found there under the very name that it was defined with, and to
derive from the base of the slot that the node stands in; nodes inside, in mappings and in lists,
follow the same rule. The checked class itself is called: hydra's own `instantiate`, which would
look the name up a second time and takes any callable, is not used.

Nothing here imports jax: a base is imported when a node of its kind is made.
"""

import importlib
import inspect
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from .errors import BadInput, echo, mapping, refuse
from .namespaces import definition

# The base of each kind of part, by configuration group or by the name of the slot; resolved when a
# part of the kind is made, as most import jax.
KINDS: Mapping[str, Sequence[str]] = {
    "amplifier": ("srsinv.forward.amplifier.Amplifier",),
    "constraint": ("srsinv.inverse.line.constraint.Constraint",),
    "effects": ("srsinv.effects.Effect",),
    "envelope": ("srsinv.forward.envelope.Envelope",),
    "feature": (
        "srsinv.forward.feature.Feature",
        "srsinv.forward.surface_feature.SurfaceFeature",
    ),
    "film": ("srsinv.forward.film.LineEffect",),
    "filter": ("srsinv.forward.filter.Filter",),
    "friction": ("srsinv.forward.traction.FrictionStep",),
    "linear_map": ("srsinv.grid.Operator",),  # from Python alone
    "method": ("srsinv.inverse.method.Method",),
    "noise": ("srsinv.forward.noise.Noise",),
    "operator": ("srsinv.inverse.kernel.operator_model.OperatorModel",),
    "pressure": ("srsinv.forward.traction.Pressure",),
    "prior": ("srsinv.inverse.line.prior.Prior",),
    "reader": ("srsinv.recording.reader.Reader",),
    "rough": ("srsinv.forward.surface.Rough",),
    "rule": ("srsinv.inverse.line.rule.Rule",),
    "scan": ("srsinv.forward.scan.ConstantSpeed",),
    "scene": ("srsinv.forward.scene.Scene",),
    "half_space": ("srsinv.forward.skin.HalfSpace",),
    "section": ("srsinv.report.section.Section",),
    "skin": ("srsinv.forward.skin.Skin",),
    "solver": ("srsinv.inverse.nonlinear.Solver",),
    "spectrum": ("srsinv.inverse.wiener.TractionSpectrum",),
    "speed_profile": ("srsinv.forward.speed_profile.SpeedProfile",),
    "surface": ("srsinv.forward.shape.Shape",),
    "surface_feature": ("srsinv.forward.surface_feature.SurfaceFeature",),
    "traction_feature": ("srsinv.forward.feature.Feature",),
}
# The kind of what stands under a key of another part, alone or in a list or mapping of several.
PARTS: Mapping[str, str] = {
    "constraint": "constraint",
    "envelope": "envelope",
    "filter": "filter",
    "frictions": "friction",
    "line_effect": "film",
    "method": "method",
    "p": "spectrum",
    "pressures": "pressure",
    "prior": "prior",
    "q": "spectrum",
    "rule": "rule",
    "skin": "skin",
    "speed_profile": "speed_profile",
    "surfaces": "surface",
}
TARGET = "_target_"
_DEEPEST = 20  # parts, lists and mappings within each other
_PLUGINS = "plugins/*.py in the folder of --config-dir"


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
        if key != TARGET:
            _check_inside(value, f"{name}.{key}", PARTS.get(key))


def class_of(node: Any, name: str, kind: str) -> type:
    """The class that a node's `_target_` names. Raises `BadInput` where it is not of `kind`."""
    target = mapping(name, node).get(TARGET)
    made = definition(target)
    refuse(
        not inspect.isclass(made),
        f"{name}.{TARGET} is {echo(target)}, which is not a class of srsinv, "
        f"experiments or {_PLUGINS}: give {_public(target) or 'package.module.Class'}.",
    )
    assert isinstance(made, type)
    bases = tuple(map(base_of, KINDS[kind]))
    refuse(
        not issubclass(made, bases),
        f"{name}.{TARGET} is {echo(target)}, which cannot be used here: give a "
        "subclass of "
        f"{' or '.join(f'srsinv.kinds.{base.__name__}' for base in bases)}.",
    )
    kinds = ("__abstractmethods__", "__abstractvars__", "__abstractclassvars__")
    undefined = ", ".join(sorted(name for kind in kinds for name in getattr(made, kind, ())))
    refuse(
        bool(undefined),
        f"{name}.{TARGET} is {echo(target)}, which does not define {undefined}: give "
        "a subclass that does.",
    )
    return made


def _public(target: Any) -> str | None:
    """Where the class is defined that has this public name in `srsinv` or `srsinv.kinds`."""
    package, _, name = str(target).rpartition(".")
    if package not in ("srsinv", "srsinv.kinds"):
        return None
    public = getattr(importlib.import_module(package), name, None)
    return f"{public.__module__}.{name}" if inspect.isclass(public) else None


def _check_keys(made: type, node: Mapping[str, Any], name: str) -> None:
    """Refuse keys that a class does not take, or lacks; none of hydra's beside `_target_`."""
    parameters = _parameters(made)
    known = {key: each for key, each in parameters.items() if each.kind is not each.VAR_KEYWORD}
    takes_any = len(known) < len(parameters)
    keys = [key for key in node if key != TARGET]
    listed = ", ".join(parameters) or "nothing"
    unknown = [key for key in keys if key not in known and (not takes_any or _is_private(key))]
    refuse(
        bool(unknown),
        f"{name} has no key {unknown and echo(unknown[0])}: {made.__name__} takes {listed}.",
    )
    needed = {key for key, each in known.items() if each.default is each.empty}
    missing = sorted(needed - set(keys))
    refuse(
        bool(missing),
        f"{name} lacks {missing and missing[0]!r}: {made.__name__} takes {listed}.",
    )


@lru_cache(maxsize=256)  # reading a signature takes half as long as making an effect
def _parameters(made: type) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(made).parameters


def _check_inside(value: Any, name: str, kind: str | None, depth: int = 1) -> None:
    """Refuse nodes where no part is expected, and keys that begin with an underscore."""
    refuse(
        depth > _DEEPEST, f"{name} is nested more than {_DEEPEST} levels deep: use fewer levels."
    )
    if isinstance(value, list | tuple):
        for index, each in enumerate(value):
            _check_inside(each, f"{name}[{index}]", kind, depth + 1)
    elif isinstance(value, Mapping) and kind is not None and TARGET in value:
        check(value, name, kind)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            refuse(
                _is_private(key),
                f"{name} has the key {echo(key)}, which is not allowed there: leave it out.",
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
    parts = {key: _made(each) for key, each in value.items() if key != TARGET}
    return _called(definition(value[TARGET]), parts) if TARGET in value else parts


def _called(made: type, parts: Mapping[str, Any]) -> Any:
    """An object of a class. Raises `BadInput` for whatever a user's own class raises."""
    try:
        return made(**parts)
    except Exception as error:
        if isinstance(error, BadInput) or not made.__module__.startswith("plugins."):
            raise
        raise BadInput(
            f"{made.__module__}.{made.__qualname__} fails with these settings: "
            f"{type(error).__name__}: {error}. Correct them or the class."
        ) from error


def base_of(name: str) -> type:
    """The class that a dotted name of `KINDS` stands for."""
    module, _, base = name.rpartition(".")
    return getattr(importlib.import_module(module), base)
