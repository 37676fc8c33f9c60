"""Decisions that are reused while what they rest on is the same, to the last bit."""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

NUMBERS = (np.ndarray, np.generic, jax.Array, bool, int, float, complex)
Decided = TypeVar("Decided")


def content_key(tree: Any) -> Hashable | None:
    """What tells a tree of parts from any other: its structure with all that is static, and type,
    shape and bytes of every number, under the working precision.

    None where something is neither an array nor a number, or is static and has no hash, as what
    can change has none: nothing is known to be the same then.
    """
    leaves, structure = jax.tree.flatten(tree)
    if not all(isinstance(leaf, NUMBERS) for leaf in leaves):
        return None
    try:
        _hash_static(structure)
        arrays = [np.asarray(leaf) for leaf in leaves]
    except TypeError:  # not hashable, traced, or a key of random numbers
        return None
    kinds = tuple((type(leaf), a.dtype, a.shape) for leaf, a in zip(leaves, arrays, strict=True))
    content = hashlib.blake2b(b"".join(a.tobytes() for a in arrays), digest_size=32)
    return jnp.result_type(float), structure, kinds, content.digest()


def _hash_static(structure: Any) -> None:
    """Raise `TypeError` for static data without a hash, which the structure's own passes over."""
    hash(structure.node_data())
    for child in structure.children():
        _hash_static(child)


class Memory(Generic[Decided]):
    """The `most` results that were asked for last, by their keys."""

    def __init__(self, most: int):
        self._most = most
        self._held: OrderedDict[Hashable, Decided] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable | None, decide: Callable[[], Decided]) -> Decided:
        """The result of this key, or what `decide` gives, which is held; never where the key is
        None."""
        if key is None:
            return decide()
        with self._lock:
            if key in self._held:
                self._held.move_to_end(key)
                return self._held[key]
        decided = decide()
        with self._lock:
            self._held[key] = decided
            if len(self._held) > self._most:
                self._held.popitem(last=False)
        return decided

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._held.clear()
