"""Datasets with units, and the metrics among their variables."""

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray

from .text import unit_of

# Of a metric's pattern: a brace as such, or a field with the label as a key or, with !s, as it is.
_PART = re.compile(r"\{\{|\}\}|\{(\w+)(!s)?\}")
METRIC = "metric"  # attribute of a variable: the pattern of its names in metrics.json
Scalar = float | int | str | bool | None


def dataset(
    variables: Mapping[str, tuple[Any, ...]],
    coordinates: Mapping[str, tuple[Any, ...]],
    **attributes: Any,
) -> xarray.Dataset:
    """A dataset whose variables all have units.

    - `variables`: (dims, values, units) by name, and as a fourth the pattern of the variable's
      metrics where it has any: `"error_{component}_{estimator}"` makes one of each element, with
      the labels of its coordinates in lower case, `{component!s}` with them as they are.
    - `coordinates`: (values, units) by dimension, or (dims, values, units) of further labels.
    """
    return xarray.Dataset(
        {name: _variable(*each) for name, each in variables.items()},
        {
            name: _variable(*(each if len(each) == 3 else (name, *each)))
            for name, each in coordinates.items()
        },
        attributes,
    )


def _variable(dims: Any, values: Any, units: str, metric: str | None = None) -> xarray.Variable:
    attributes = {"units": units} | ({} if metric is None else {METRIC: metric})
    return xarray.Variable(dims, np.asarray(values), attributes)


def scalars(named: Mapping[str, Scalar]) -> dict[str, tuple[Any, ...]]:
    """Variables of [`dataset`][] for single numbers, words and truths, each a metric of its own
    name; the unit is the one at the name's end. None becomes NaN."""
    return {
        name: ((), np.nan if value is None else value, unit_of(name), as_pattern(name))
        for name, value in named.items()
    }


def as_pattern(name: str) -> str:
    """The pattern of a metric of this very name, which may come from a file and hold braces."""
    return name.replace("{", "{{").replace("}", "}}")


def metrics(data: xarray.Dataset) -> dict[str, Scalar]:
    """The variables of a dataset that are marked as metrics, element by element; None for what is
    no number."""
    marked = (each for each in data.variables.values() if METRIC in each.attrs)
    return dict(itertools.chain.from_iterable(_elements(data, each) for each in marked))


def units_of_metrics(patterns: Mapping[str, str], names: Iterable[str]) -> dict[str, str]:
    """The units of those metrics of these names that belong to a pattern, given the units by the
    pattern; of several patterns that fit a name, those of the one that fixes most of it."""
    pieces = [
        (_PART.sub(_literal, pattern).split("\0"), unit) for pattern, unit in patterns.items()
    ]
    pieces.sort(key=lambda each: -sum(map(len, each[0])))
    fits = ((name, next((u for each, u in pieces if _fits(name, each)), None)) for name in names)
    return {name: unit for name, unit in fits if unit is not None}


def _fits(name: str, pieces: list[str]) -> bool:
    """Whether a name is these pieces with a label of a character or more between any two."""
    first, *inner = pieces
    if not inner:
        return name == first
    *inner, last = inner
    at = len(first)
    for piece in inner:
        found = name.find(piece, at + 1)
        if found < 0:
            return False
        at = found + len(piece)
    return name.startswith(first) and name.endswith(last) and len(name) - len(last) > at


def _elements(data: xarray.Dataset, variable: xarray.Variable) -> Iterator[tuple[str, Scalar]]:
    pattern = str(variable.attrs[METRIC])
    fields = {each[1] for each in _PART.finditer(pattern) if each[1]}
    labels = {name: (data[name].dims, data[name].values) for name in fields}
    values = variable.values
    for at in np.ndindex(values.shape):
        place = dict(zip(variable.dims, at, strict=True))
        words = {
            name: _text(own[tuple(place[dim] for dim in dims)].item())
            for name, (dims, own) in labels.items()
        }
        yield (
            _PART.sub(lambda part, words=words: _literal(part, words), pattern),
            _scalar(values[at]),
        )


def _literal(part: re.Match[str], words: Mapping[str, str] | None = None) -> str:
    """A part of a pattern: a brace, or a field's label, "\0" where there are no `words`.

    This is no format string of Python's, which would do whatever a file asks for.
    """
    if not part[1]:
        return part[0][0]
    if words is None:
        return "\0"
    return words[part[1]] if part[2] else key_of(words[part[1]])


def _text(label: Any) -> str:
    return label if isinstance(label, str) else f"{label:g}"


def key_of(label: str) -> str:
    """A label as a part of a metric's name."""
    return label.lower().replace(", ", "_").replace(" ", "_")


def _scalar(value: Any) -> Scalar:
    own = value.item() if hasattr(value, "item") else value
    return None if isinstance(own, float) and np.isnan(own) else own


def metrics_json(metrics: Mapping[str, Scalar]) -> str:
    """`metrics` as JSON with sorted keys; None and numbers that are not finite become null."""
    values = {
        key: None if isinstance(each, float) and not math.isfinite(each) else each
        for key, each in metrics.items()
    }
    return json.dumps(values, sort_keys=True, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
