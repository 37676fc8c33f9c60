"""Programs compiled once: `compiled` is `eqx.filter_jit`, and where the command keeps programs, one
that an earlier run has compiled is loaded without being traced again.

jax's own cache spares a later run what XLA does, not what Python does before it: tracing a fit's
search and writing it down for XLA takes seconds, and is needed to find it in that cache. So a
program is stored here by what it is made from, which is known without tracing: the function, the
shapes of the arrays and every other argument, the package's sources and the versions of the
libraries. What cannot be named so (a function made at run time, a class of a plugin, a program that
calls back to Python) is left to jax.
"""

import dataclasses
import enum
import functools
import hashlib
import os
import pickle
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any, TypeVar, cast

import equinox as eqx
import jax
import numpy as np
from jax.experimental import serialize_executable
from jax.experimental.compilation_cache import compilation_cache
from jax.extend.core import get_opaque_trace_state
from jax.tree_util import PyTreeDef, default_registry

from .atomic import write_whole
from .errors import BadInput
from .progress import stage

Function = TypeVar("Function", bound=Callable[..., Any])

SUFFIX = "-program"  # of the files
# What a program may be made of: sources that the folder's name stands for.
_NAMED = ("srsinv", "experiments", "jax", "jaxlib", "jaxtyping", "equinox", "optimistix", "lineax",
          "numpy", "builtins", "functools", "collections")  # fmt: skip
_LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))
_DIGEST = hashlib.sha256().digest_size


class _Unnamed(Exception):
    """An argument whose parts do not distinguish it from others."""


class _Array(int):
    """Where an array of the result stands, by its place among them."""


class _Store:
    """Programs in a folder, and those of them that this process has loaded."""

    def __init__(self, folder: Path):
        self._folder, self._version = folder, _version()
        self._outside = get_opaque_trace_state(convention="flax")
        self._loaded: dict[Any, Callable[..., Any] | None] = {}

    def is_outside(self) -> bool:
        """Whether jax is tracing nothing."""
        return get_opaque_trace_state(convention="flax") == self._outside

    def program(
        self, function: Callable[..., Any], leaves: list[Any], tree: Any, call: tuple[Any, Any]
    ) -> Callable[..., Any] | None:
        """The program of a call, which takes its arrays; None where it cannot be stored."""
        key = (
            function,
            tree,
            jax.config.x64_enabled,  # pyright: ignore[reportAttributeAccessIssue]
            # With its type: 1, 1.0 and True are equal, and make programs of their own.
            *(_kind(leaf) if eqx.is_array(leaf) else (type(leaf), leaf) for leaf in leaves),
        )
        try:
            hash(key)
        except TypeError:
            return None
        if key not in self._loaded:
            self._loaded[key] = self._found(function, leaves, tree, call)
        return self._loaded[key]

    def _found(
        self, function: Callable[..., Any], leaves: list[Any], tree: Any, call: tuple[Any, Any]
    ) -> Callable[..., Any] | None:
        try:
            name = _name(self._version, function, call)
        except _Unnamed:
            return None
        path = self._folder / f"{name}{SUFFIX}"
        # Absent, damaged, or refused by XLA: it is made again in its place.
        with suppress(OSError, ValueError, RuntimeError, zlib.error, pickle.UnpicklingError):
            return _program(*_read(path))
        with stage(f"compiling {_in_words(function)} (once, later runs reuse it)"):
            made = _made(function, leaves, tree)
        if made is None:
            return None
        _write(path, made)
        return _program(*made)


_open: list[_Store] = []
_COMPUTED = {  # in words, by the module; the first that fits
    "srsinv.inverse.nonlinear.": "the nonlinear fit",
    "srsinv.inverse.features.": "the model of the features",
    "srsinv.inverse.solved_contact.": "the contact of skin and surface",
    "srsinv.inverse.rig.": "the model of the rig",
    "srsinv.inverse.kernel.": "the measured kernel",
    "srsinv.inverse.": "the inversion",
    "srsinv.effects.": "the effects",
    "srsinv.forward.": "the sensor model",
    "srsinv.jobs.": "the simulation",
    "srsinv.grid.": "the sensor model",
    "srsinv.known.": "the sensor model",
}


@contextmanager
def stored(folder: Path) -> Iterator[None]:
    """Store what is compiled inside in a folder, which has to be the user's alone: what it holds is
    executed."""
    if jax.device_count() > 1 or jax.default_backend() != "cpu":
        yield  # another device's programs are not tried here
        return
    _open.append(_Store(folder))
    try:
        yield
    finally:
        _open.pop()


def compiled(function: Function) -> Function:
    """`function` as a compiled program, as by `eqx.filter_jit`: arrays are its inputs, and any
    other argument makes a program of its own."""
    jitted = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*arguments: Any, **settings: Any) -> Any:
        if not _open or not _open[-1].is_outside():
            return jitted(*arguments, **settings)
        leaves, tree = jax.tree.flatten((arguments, settings))
        program = _open[-1].program(function, leaves, tree, (arguments, settings))
        if program is None:
            return jitted(*arguments, **settings)
        return program(*(leaf for leaf in leaves if eqx.is_array(leaf)))

    return cast(Function, call)


def _in_words(function: Callable[..., Any]) -> str:
    """What a function computes, by the room that it stands in."""
    name = f"{function.__module__}."
    return next((words for room, words in _COMPUTED.items() if name.startswith(room)), "a function")


def _version() -> str:
    """What stands for everything but the arguments that a program is made from: the package's
    sources by their size and time, the libraries' versions, and what XLA is asked for."""
    packages = [sys.modules[name] for name in ("srsinv", "experiments") if name in sys.modules]
    folders = [folder for package in packages for folder in package.__path__]
    sources = sorted(
        (str(path), status.st_size, status.st_mtime_ns)
        for folder in folders
        for path in Path(folder).rglob("*.py")
        for status in [path.stat()]
    )
    libraries = [(name, version(name)) for name in _LIBRARIES]
    asked = sorted((k, v) for k, v in os.environ.items() if k.startswith(("XLA_", "JAX_")))
    said = repr((sources, libraries, asked, sys.version))
    return hashlib.sha256(said.encode()).hexdigest()[:16]


def _kind(array: Any) -> tuple[Any, ...]:
    return "array", array.shape, array.dtype, getattr(array, "weak_type", False)


def _made(function: Callable[..., Any], leaves: list[Any], tree: Any) -> tuple[bytes, bytes] | None:
    """A compiled program and the form of its result, both as bytes; None where it is not one that
    another process can run."""
    is_array = [eqx.is_array(leaf) for leaf in leaves]
    form: list[Any] = []

    def of(*arrays):
        given = iter(arrays)
        filled = [
            next(given) if each else leaf for each, leaf in zip(is_array, leaves, strict=True)
        ]
        arguments, settings = jax.tree.unflatten(tree, filled)
        result = function(*arguments, **settings)
        parts, shape = jax.tree.flatten(result)
        arrays = [part for part in parts if eqx.is_array(part)]
        places = iter(range(len(arrays)))
        parts = [_Array(next(places)) if eqx.is_array(part) else part for part in parts]
        form[:] = [jax.tree.unflatten(shape, parts)]
        return arrays

    of.__name__ = of.__qualname__ = function.__name__
    arrays = [leaf for leaf, each in zip(leaves, is_array, strict=True) if each]
    with _without_cache():
        made = jax.jit(of).lower(*arrays).compile()
    sizes = len(arrays), sum(isinstance(part, _Array) for part in jax.tree.leaves(form[0]))
    try:
        program, *_ = serialize_executable.serialize(made)
        return pickle.dumps((program, *sizes)), pickle.dumps(form[0])
    # What jax and pickle raise for what only this process has: a callback, constants, a closure.
    except (NotImplementedError, ValueError, TypeError, AttributeError, pickle.PicklingError):
        return None


@contextmanager
def _without_cache() -> Iterator[None]:
    """Without jax's own cache: what that has loaded lacks functions when it is stored again."""
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_compilation_cache_dir", None)
        compilation_cache.reset_cache()  # which settles once whether there is one
        yield
    finally:
        jax.config.update("jax_compilation_cache_dir", folder)
        compilation_cache.reset_cache()


@functools.cache
def _start_lapack() -> None:
    """Let jax find LAPACK, which it does when it writes down the first program that needs it, and
    crashes without."""
    jax.jit(jax.numpy.linalg.cholesky).lower(np.ones((1, 1)))


def _program(program: bytes, form: bytes) -> Callable[..., Any]:
    """The function of its arrays that a program is."""
    parts, tree = jax.tree.flatten(pickle.loads(form))
    executable, inputs, outputs = pickle.loads(program)
    if b"lapack_" in executable:  # a name of what it calls
        _start_lapack()
    run = serialize_executable.deserialize_and_load(
        executable, jax.tree.structure((inputs * (0,), {})), jax.tree.structure(outputs * [0])
    )

    def of(*arrays: Any) -> Any:
        made = run(*arrays)
        filled = [made[part] if isinstance(part, _Array) else part for part in parts]
        return jax.tree.unflatten(tree, filled)

    return of


def _name(of: str, function: Callable[..., Any], call: Any) -> str:
    """The name of a call's program, of everything that it is made of: `of` stands for sources and
    libraries. Raises `_Unnamed`."""
    words = [of, str(jax.config.x64_enabled)]  # pyright: ignore[reportAttributeAccessIssue]
    _spell(function, words)
    _spell(call, words)
    return hashlib.sha256("\0".join(words).encode()).hexdigest()


def _spell(value: Any, words: list[str], is_inside: bool = True) -> None:
    """Add the words that a value is told by. Arrays among the inputs (`is_inside`) are told by
    their kind, others by what they hold."""
    if eqx.is_array(value):
        kind = _kind(value)
        words.append(repr(kind if is_inside else (kind, np.asarray(value).tobytes())))
    elif isinstance(value, _PLAIN):
        words.append(f"{type(value).__name__} {value!r}")
    elif isinstance(value, type | FunctionType):
        words.append(_definition(value))
    elif isinstance(value, MethodType):
        words.append(_definition(value.__func__))
        _spell(value.__self__, words, is_inside=False)
    elif isinstance(value, np.dtype):
        words.append(repr(value))
    elif isinstance(value, enum.Enum):
        words.append(f"{_definition(type(value))} {value.name}")
    else:
        words.append(f"{_definition(type(value))} (")
        for part, is_input in _parts(value, is_inside):
            _spell(part, words, is_input)
        words.append(")")


def _parts(value: Any, is_inside: bool) -> Iterator[tuple[Any, bool]]:
    """What a value is made of, and whether arrays in it are inputs of the program."""
    is_module = isinstance(value, eqx.Module)
    inner = default_registry.flatten_one_level(value) if is_inside and not is_module else None
    if is_module:
        for each in dataclasses.fields(value):
            is_static = each.metadata.get("static", False)
            yield getattr(value, each.name), is_inside and not is_static
    elif inner is not None:
        children, form = inner
        yield from ((each, True) for each in children)
        yield form, False
    elif dataclasses.is_dataclass(value):
        yield from ((getattr(value, each.name), False) for each in dataclasses.fields(value))
    elif isinstance(value, tuple | list):
        yield from ((each, False) for each in value)
    elif isinstance(value, Mapping):
        yield from ((each, False) for item in value.items() for each in item)
    elif isinstance(value, set | frozenset):
        yield from ((each, False) for each in sorted(value, key=repr))
    elif isinstance(value, functools.partial):
        yield from ((each, False) for each in (value.func, value.args, value.keywords))
    elif isinstance(value, PyTreeDef) and "CustomNode" not in str(value):
        yield str(value), False
    else:
        raise _Unnamed(repr(type(value)))


def _definition(value: Any) -> str:
    """The name by which a class or a function of known sources is found again."""
    module, name = value.__module__, value.__qualname__
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    found = getattr(found, "__wrapped__", found) if found is not value else found
    if found is not value or module.partition(".")[0] not in _NAMED:
        raise _Unnamed(f"{module}.{name}")
    return f"{module}.{name}"


def _read(path: Path) -> tuple[bytes, bytes]:
    whole = path.read_bytes()
    digest, rest = whole[:_DIGEST], whole[_DIGEST:]
    if hashlib.sha256(rest).digest() != digest:
        raise ValueError(f"{path.name} was cut short or changed")
    os.utime(path)  # which the least recently used are found by
    program, form = pickle.loads(zlib.decompress(rest))
    return program, form


def _write(path: Path, made: tuple[bytes, bytes]) -> None:
    rest = zlib.compress(pickle.dumps(made), 1)
    with suppress(BadInput):  # a full disk, or another process that does the same
        write_whole(path, hashlib.sha256(rest).digest() + rest, is_own=lambda _: True)
