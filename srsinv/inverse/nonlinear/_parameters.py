"""Conversion of parameters between a tree of arrays and a row of named numbers."""

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...errors import BadInput, check_name, refuse
from ...known import array_module, is_traced

Tree = Any
UNTRACED_BOUNDS = "The bounds of a fit have to be known: compute them outside jit, vmap and grad."


@dataclass(frozen=True)
class Layout:
    """Layout of a tree's numbers in a row: hashable, as it is part of a program.

    `free` and `linear` are indices into the row: those that are fitted, and of them those that
    enter the model linearly.
    """

    structure: Any
    shapes: tuple[tuple[int, ...], ...]
    leaves: tuple[str, ...]
    names: tuple[str, ...]
    free: tuple[int, ...]
    linear: tuple[int, ...]

    def filled(self, row: Float[Array, " all"], z: Float[Array, " m"]) -> Tree:
        """The tree whose numbers are `row`, the free ones of them `z`. What has none that is free
        does not depend on z for jax either, so that nothing is differentiated by it."""
        whole, free = row.at[np.asarray(self.free)].set(z), set(self.free)
        leaves, first = [], 0
        for shape in self.shapes:
            places = range(first, first + math.prod(shape))
            source = row if free.isdisjoint(places) else whole
            leaves.append(source[places.start : places.stop].reshape(shape))
            first = places.stop
        return jax.tree.unflatten(self.structure, leaves)

    def host_tree(self, row: np.ndarray) -> Tree:
        """The tree of `row` in numpy arrays; a scalar leaf becomes a float."""
        leaves, first = [], 0
        for shape in self.shapes:
            last = first + math.prod(shape)
            leaves.append(row[first:last].reshape(shape) if shape else float(row[first]))
            first = last
        return jax.tree.unflatten(self.structure, leaves)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        return tuple(self.names[i] for i in self.free)

    def indices(self, name: str, what: str) -> list[int]:
        """Indices in the row of a leaf (`"b"`) or of one of its numbers (`"b[1]"`)."""
        if name in self.names:
            return [self.names.index(name)]
        sizes = [int(np.prod(shape)) for shape in self.shapes]
        owners = [leaf for leaf, n in zip(self.leaves, sizes, strict=True) for _ in range(n)]
        places = [i for i, owner in enumerate(owners) if owner == name]
        if not places:
            check_name(what, name, self.leaves)
        return places

    def named(self, names: str | Iterable[str], what: str) -> set[int]:
        """Indices in the row of one name or several."""
        names = [names] if isinstance(names, str) else names
        return {i for name in names for i in self.indices(name, what)}

    def row_of(self, what: str, given: Tree, default: float) -> Any:
        """A number for each place: `given` is one number, a tree like the parameters, or a mapping
        by name with `default` elsewhere; None anywhere means the default."""
        row = np.full(len(self.names), default)
        if given is None:
            return row
        if isinstance(given, Mapping) and not self._is_like(given):
            for name, value in flat_mapping(given).items():
                where = self.indices(name, what)
                numbers = self._numbers(f"{what} of {name}", value, len(where), default)
                row = with_numbers(row, where, numbers)
            return row
        ends = (list, tuple, type(None)) if not self._is_like(given) else type(None)
        leaves = jax.tree.leaves(given, is_leaf=lambda x: isinstance(x, ends))
        if len(leaves) == 1 and np.ndim(leaves[0]) == 0:
            return self._numbers(what, leaves[0], len(self.names), default)
        refuse(
            len(leaves) != len(self.leaves),
            f"{what} holds {len(leaves)} values where {len(self.leaves)} parameters "
            f"({', '.join(self.leaves)}) are fitted: give one for each, or a mapping by name.",
        )
        parts = [
            self._numbers(f"{what} of {leaf}", value, int(np.prod(shape)), default)
            for leaf, shape, value in zip(self.leaves, self.shapes, leaves, strict=True)
        ]
        return array_module(parts).concatenate(parts)

    def _is_like(self, given: Tree) -> bool:
        try:
            return jax.tree.structure(given, is_leaf=lambda x: x is None) == self.structure
        except (TypeError, ValueError):
            return False

    def _numbers(self, what: str, value: Any, size: int, default: float) -> Any:
        remedy = f"{what} is {value!r}: give one number or {size} of them."
        numbers = real(default if value is None else value, remedy)
        refuse(numbers.size not in (1, size), remedy)
        return array_module(numbers).broadcast_to(numbers.ravel(), (size,))


def with_numbers(rows: Any, where: list[int], numbers: Any) -> Any:
    """The rows (..., all) with these numbers (..., len(where)) in their places."""
    if is_traced(rows, numbers):
        return jnp.asarray(rows).at[..., np.array(where, int)].set(numbers)
    rows[..., where] = numbers
    return rows


def on_host(value: Any) -> Any:
    """Numbers in the working precision, in numpy: a program takes them sooner than arrays that were
    put on the device one by one. What jax traces stays so."""
    return array_module(value).asarray(value, jax.dtypes.canonicalize_dtype(np.float64))


def real(value: Any, sentence: str) -> Any:
    """The value as an array of real numbers, or as jax traces it; else refused with the
    sentence."""
    if is_traced(value):
        made = jnp.asarray(value)
        refuse(jnp.iscomplexobj(made), sentence)
        return on_host(made)
    try:
        array = np.asarray(value)
        refuse(np.iscomplexobj(array), sentence)
        return array.astype(float)
    except (TypeError, ValueError) as error:
        raise BadInput(sentence) from error


def _are_names(given: Any) -> bool:
    if isinstance(given, str):
        return True
    listed = isinstance(given, Iterable) and not isinstance(given, Mapping)
    return listed and all(isinstance(name, str) for name in given)


def flat_mapping(given: Mapping, above: str = "") -> dict[str, Any]:
    """A nested mapping with the names joined by dots."""
    flat: dict[str, Any] = {}
    for key, value in given.items():
        name = f"{above}{key}"
        flat |= flat_mapping(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return flat


@dataclass(frozen=True)
class Parameters:
    """Parameters of a fit: layout, the row of first values, and a box for the free ones."""

    layout: Layout
    first: Any
    lower: np.ndarray
    upper: np.ndarray


def parameters(initial: Tree, bounds: Any, free: Any, linear: Collection[str]) -> Parameters:
    """Parameters from the user's arguments; raises `BadInput` where these disagree."""
    layout, first = _layout(initial)
    chosen = _free(layout, free)
    refuse(not _are_names(linear), f"linear is {linear!r}: give names of parameters.")
    named = layout.named(linear, "linear")
    layout = Layout(
        layout.structure, layout.shapes, layout.leaves, layout.names,
        chosen, tuple(i for i in chosen if i in named),
    )  # fmt: skip
    lower, upper = _bounds(layout, bounds)
    for i in chosen:
        name = layout.names[i]
        refuse(
            not lower[i] < upper[i],
            f"The bounds of {name} are [{lower[i]:g}, {upper[i]:g}]: give the lower one "
            "first, with room between them, or leave a known parameter out of free.",
        )
        refuse(
            i in layout.linear and bool(np.isfinite([lower[i], upper[i]]).any()),
            f"{name} has bounds but is named in linear, where bounds cannot be kept: "
            "leave out one of both.",
        )
        if is_traced(first):
            continue  # the search begins on the nearer bound
        refuse(
            i not in layout.linear and not lower[i] <= first[i] <= upper[i],
            f"The first value of {name} is {first[i]:g}, outside its bounds [{lower[i]:g}, "
            f"{upper[i]:g}]: start inside them.",
        )
    return Parameters(layout, first, lower[list(chosen)], upper[list(chosen)])


def _layout(initial: Tree) -> tuple[Layout, Any]:
    paths, structure = jax.tree_util.tree_flatten_with_path(initial)
    refuse(not paths, "There is no parameter to fit: initial is empty.")
    leaves, names, values = [], [], []
    for path, leaf in paths:
        name = ".".join(_key(part) for part in path)
        remedy = f"The first value of {name or 'b'} is {leaf!r}: give finite real numbers."
        value = real(leaf, remedy)
        refuse(not is_traced(value) and not np.isfinite(value).all(), remedy)
        leaves.append(name or "b")
        values.append(value)
        places = np.ndindex(value.shape)
        names += [f"{leaves[-1]}[{','.join(map(str, at))}]" if at else leaves[-1] for at in places]
    shapes = tuple(value.shape for value in values)
    everything = tuple(range(len(names)))
    layout = Layout(structure, shapes, tuple(leaves), tuple(names), everything, ())
    return layout, array_module(values).concatenate([value.ravel() for value in values])


def _key(part: Any) -> str:
    for attribute in ("key", "name", "idx"):
        if hasattr(part, attribute):
            return str(getattr(part, attribute))
    return str(part)


def _free(layout: Layout, free: Any) -> tuple[int, ...]:
    if free is None:
        return tuple(range(len(layout.names)))
    if _are_names(free):
        chosen = sorted(layout.named(free, "free"))
    else:
        chosen = np.flatnonzero(layout.row_of("free", free, 0.0)).tolist()
    refuse(not chosen, "Nothing is free to be fitted: name at least one parameter in free.")
    return tuple(chosen)


def _bounds(layout: Layout, bounds: Any) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(bounds, Mapping):
        pairs = flat_mapping(bounds)
        for name, pair in pairs.items():
            refuse(
                not isinstance(pair, list | tuple) or len(pair) != 2,
                f"The bounds of {name} are {pair!r}: give (lower, upper), None for no bound.",
            )
        lower = {name: pair[0] for name, pair in pairs.items()}
        upper = {name: pair[1] for name, pair in pairs.items()}
    else:
        refuse(
            bounds is not None and (not isinstance(bounds, list | tuple) or len(bounds) != 2),
            f"The bounds are {bounds!r}: give a mapping of names to (lower, upper), or two trees.",
        )
        lower, upper = bounds or (None, None)
    low = layout.row_of("The lower bound", lower, -np.inf)
    high = layout.row_of("The upper bound", upper, np.inf)
    refuse(is_traced(low, high), UNTRACED_BOUNDS)
    bad = np.isnan(low) | np.isnan(high)
    name = layout.names[bad.argmax()]
    refuse(bool(bad.any()), f"The bounds of {name} have nan: give a number, or None for none.")
    return low, high
