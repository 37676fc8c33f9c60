"""Copies of Equinox's modules."""

from typing import Any, TypeVar

import equinox as eqx

Module = TypeVar("Module", bound=eqx.Module)


def with_fields(module: Module, **changed: Any) -> Module:
    """The same module with other values of these fields; its `__init__`, which may be a stranger's,
    is not called.

    Not by copy.copy: Equinox holds what it makes until an `__init__` ends.
    """
    made = object.__new__(type(module))
    vars(made).update(vars(module) | changed)
    return made
