"""What is known is computed by numpy, at once: a program of jax takes longer to compile than to run
once, and every length makes one of its own. What jax traces, and what lies on another device, is
left to jax.
"""

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import get_opaque_trace_state

from .compiled import compiled

Numbers = jax.Array | np.ndarray
Tree = TypeVar("Tree")
Function = TypeVar("Function", bound=Callable[..., Any])


def in_numpy(tree: Tree) -> Tree:
    """The same with numpy's arrays in place of jax's."""
    return jax.tree.map(
        lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf, tree
    )


def in_jax(tree: Tree) -> Tree:
    """The same with jax's arrays in place of numpy's."""
    # By jnp.asarray each shape would be compiled.
    return jax.tree.map(
        lambda leaf: jax.device_put(leaf) if isinstance(leaf, np.ndarray | np.generic) else leaf,
        tree,
    )


def is_traced(*trees: Any) -> bool:
    """Whether jax traces any of the arrays, so that their values are not known."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def is_outside_traces() -> bool:
    """Whether jax is tracing nothing."""
    return get_opaque_trace_state(convention="flax") == _top_level()


@functools.cache
def _top_level() -> Any:
    """What jax has for its trace outside of all of them: that of a thread that has just begun."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(get_opaque_trace_state, convention="flax").result()


def outside_traces() -> AbstractContextManager[None]:
    """Where what is known is computed at once, though jax traces what is around it."""
    return nullcontext() if is_outside_traces() else jax.ensure_compile_time_eval()


def array_module(*trees: Any) -> Any:
    """jax.numpy where jax traces any of the arrays, else numpy."""
    return jnp if is_traced(*trees) else np


def as_number(value: Any) -> Any:
    """An array of one number as Python's, or as jax traces it."""
    return value if is_traced(value) else float(value)


def by_numpy(function: Function) -> Function:
    """`function(..., xp=jnp)`, which computes by `xp`, as a function of its other arguments: by
    numpy where they are known, else a compiled program. It gives numpy's arrays where it is given
    no other, else jax's."""
    program = compiled(function)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        leaves = jax.tree.leaves(arguments)
        if is_traced(leaves) or jax.default_backend() != "cpu":
            return program(*arguments)
        made = function(*in_numpy(arguments), xp=np)
        is_of_numpy = any(isinstance(leaf, np.ndarray | np.generic) for leaf in leaves)
        is_of_jax = any(isinstance(leaf, jax.Array) for leaf in leaves)
        return made if is_of_numpy and not is_of_jax else in_jax(made)

    return cast(Function, call)


def namespace(*values: Any) -> Any:
    """numpy where all arrays are numpy's, else jax.numpy."""
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(values)) else np
