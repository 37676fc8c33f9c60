"""The bases of all kinds of parts that a configuration may name, public under one roof.

Derive from one, in the package or in a file of your own, and name the class by `_target_` in a YAML
file of the kind's group: docs/extend.md has an example of each.
"""

from .config import KINDS, base_of

_BASES = {name.rpartition(".")[2]: name for names in KINDS.values() for name in names}
__all__ = sorted(_BASES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> type:
    if name in _BASES:  # when it is asked for, as most import jax
        return base_of(_BASES[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
