"""Refusals of invalid input, each of one sentence."""

import difflib
import math
from collections.abc import Collection, Iterable, Mapping
from numbers import Real
from typing import Any, TypeGuard, TypeVar

LARGEST = 1e18  # no quantity here comes near, and float32 still holds its square
Kind = TypeVar("Kind")
_SHOWN = 80  # characters of a wrong value


class BadInput(ValueError):
    """An input that cannot be used.

    Its text is a sentence that names the value, what is allowed and what to type instead, in
    [`printable`][] characters. The command prints it and exits with code 2.
    """

    def __init__(self, sentence: str = ""):
        super().__init__(printable(sentence))


def printable(text: str) -> str:
    """Text that somebody else may have written, for a terminal or a page: characters that steer
    either, or that are halves, as their escapes."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def refuse(condition: bool, sentence: str) -> None:
    """Raise [`BadInput`][] with `sentence` when `condition` holds.

    Only for concrete values before any computing: a traced value has no truth value.
    """
    if condition:
        raise BadInput(sentence)


def number(
    name: str,
    value: Any,
    wanted: str = "a number",
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    below: float = math.inf,
) -> Any:
    """`value`, which is refused unless it is one finite number within the bounds.

    `above` and `below` are themselves out of bounds, `least` and `most` are not; `wanted` describes
    the valid values. A value that jax traces is not known yet: it becomes NaN where it turns out to
    be beyond the bounds, and its gradient with it, and keeps its value and gradient within.
    """
    if hasattr(value, "aval"):
        from jax.core import Tracer  # loaded already where a jax array is given, and slow to load

        if isinstance(value, Tracer):
            return _nan_outside(value, above, least, most, below)
    scalar = value.item() if getattr(value, "ndim", None) == 0 else value
    fits = is_number(scalar) and above < scalar < below and least <= scalar <= most
    if not fits or abs(scalar) > LARGEST:  # thousands are checked, and few sentences needed
        up_to = f", up to {LARGEST:g}" if fits else ""
        raise BadInput(f"{name} is {echo(scalar)}: give {wanted}{up_to}.")
    return value


def _nan_outside(value: Any, above: float, least: float, most: float, below: float) -> Any:
    """A traced value, NaN beyond the bounds."""
    import jax.numpy as jnp

    if (above, least, most, below) == (-math.inf, -math.inf, math.inf, math.inf):
        return value
    fits = (above < value) & (value < below) & (least <= value) & (value <= most)
    # A factor: chosen by `where` between the value and NaN, a gradient beyond would be 0.
    return value * jnp.where(fits, 1.0, jnp.nan)


def whole(name: str, value: Any, wanted: str, *, least: int, most: int = 2**31 - 1) -> int:
    """`value`, which is refused unless it is one whole number from `least` to `most`."""
    fits = is_number(value) and float(value).is_integer() and least <= value <= most
    refuse(not fits, f"{name} is {echo(value)}: give {wanted}.")
    return int(value)


def numbers(name: str, values: Any, wanted: str, **bounds: float) -> list[float]:
    """`values`, refused unless they are a list of one or more numbers within the bounds of
    [`number`][], each once."""
    listed = isinstance(values, list | tuple) and len(values) > 0
    refuse(not listed, f"{name} is {echo(values)}: give a list of {wanted}.")
    each = [float(number(f"{name}[{i}]", v, wanted, **bounds)) for i, v in enumerate(values)]
    refuse(len(set(each)) < len(each), f"{name} is {echo(values)}: give each number once.")
    return each


def number_range(name: str, ends: Any, wanted: str, **bounds: float) -> tuple[float, float]:
    """`ends`, which are refused unless they are two numbers within the bounds, and increase."""
    listed = isinstance(ends, list | tuple) and len(ends) == 2
    refuse(not listed, f"{name} is {echo(ends)}: give [least, greatest], {wanted}.")
    low, high = (float(number(f"{name}[{i}]", v, wanted, **bounds)) for i, v in enumerate(ends))
    refuse(high <= low, f"{name} is {echo(ends)}: give [least, greatest] in increasing order.")
    return low, high


def choice(name: str, value: Any, options: Collection[str]) -> str:
    """`value`, which is refused unless it is one of `options`."""
    fits = isinstance(value, str) and value in options
    refuse(not fits, f"{name} is {echo(value)}: give one of {', '.join(options)}.")
    return value


def check_name(key: str, name: Any, options: Collection[str]) -> None:
    """Refuse a name that `key` gives unless it is one of `options`, of which the sentence has the
    [`nearest`][] one."""
    refuse(
        name not in options,
        f"{key} names {echo(name)}: {nearest(name, options)}choose from {', '.join(options)}.",
    )


def nearest(name: Any, options: Collection[str]) -> str:
    """The words for the option that is nearest to a wrong name; none where no one is near."""
    near = nearest_name(name, options)
    return f"the nearest is {near}; " if near else ""


def nearest_name(
    name: Any, options: Iterable[str], cutoff: float = 0.6, compared: int | None = None
) -> str | None:
    """The one of `options` that is most like a wrong name, or None where none is.

    Of names from outside only the first `compared` characters count, as the time it takes is the
    product of their lengths.
    """
    beginnings = {each[:compared]: each for each in reversed(list(options))}
    near = difflib.get_close_matches(str(name)[:compared], beginnings, 1, cutoff)
    return beginnings[near[0]] if near else None


def of_kind(name: str, value: Any, kind: type[Kind], wanted: str) -> Kind:
    """`value`, which is refused unless it derives from the base `kind`."""
    if not isinstance(value, kind):
        raise BadInput(f"{name} is {echo(value)}: give {wanted}.")
    return value


def all_of_kind(name: str, values: Any, kind: type[Kind], wanted: str) -> tuple[Kind, ...]:
    """`values`, a list or tuple, refused unless each derives from the base `kind`."""
    if not isinstance(values, list | tuple):
        raise BadInput(f"{name} is {echo(values)}: give a list of {wanted}.")
    return tuple(
        of_kind(f"{name}[{at}]", each, kind, f"one of {wanted}") for at, each in enumerate(values)
    )


def mapping(name: str, value: Any, wanted: str = "a mapping of its keys") -> Mapping[str, Any]:
    """`value`, which is refused unless it is a mapping."""
    if not isinstance(value, Mapping):
        raise BadInput(f"{name} is {echo(value)}: give {wanted}.")
    return value


def is_number(value: Any) -> TypeGuard[float]:
    """Whether `value` is one finite number, as float64 can hold it."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def echo(value: Any) -> str:
    """An invalid value as in the configuration, cut short."""
    word = value is None or isinstance(value, bool)
    try:
        text = {None: "null", True: "true", False: "false"}[value] if word else repr(value)
        text = text if isinstance(value, str) else " ".join(text.split())
    except (ValueError, RecursionError):  # a number of thousands of digits, or very deep nesting
        return f"a {type(value).__name__} too long to show"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
