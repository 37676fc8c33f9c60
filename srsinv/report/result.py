"""What a job returns: its data, what they show in one line, and the sections of its page."""

import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray

from .section import Section

METRIC = "metric"  # attribute of a variable: the pattern of its names in metrics.json
_LABEL = re.compile(r"{(\w+)(!s)?}")  # of a pattern: a coordinate's label, with !s as it is
# The unit at the end of a metric's name, the longest first.
_UNITS = {
    "_N_per_m": "N/m", "_m_per_s": "m/s", "_rad": "rad", "_deg": "deg", "_dB": "dB", "_Hz": "Hz",
    "_hz": "Hz", "_Pa": "Pa", "_V": "V", "_m": "m", "_s": "s",
}  # fmt: skip
Scalar = float | int | str | bool | None


@dataclass(frozen=True)
class Result:
    """The result of one job. The page, the printed summary and `metrics.json` are views of it.

    - `title`: one line that states the result.
    - `dataset`: every stage and every number, with `units` on each variable; written to
      `result.nc`. Variables with the attribute `metric` are those of `metrics.json`.
    - `sections`: of the page, in order; those without a heading come first, and are printed.
    - `files`: the text of further files, by name.
    """

    title: str
    dataset: xarray.Dataset
    sections: tuple[Section, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def metrics(self) -> dict[str, Scalar]:
        """The numbers of `metrics.json`, in SI units; flat."""
        return metrics(self.dataset)

    def _repr_html_(self) -> str:
        from .page import page

        return page(self)


def dataset(
    variables: Mapping[str, tuple[Any, ...]],
    coordinates: Mapping[str, tuple[Any, ...]],
    **attributes: Any,
) -> xarray.Dataset:
    """A dataset whose variables all have units.

    - `variables`: (dims, values, units) by name, and as a fourth the pattern of the variable's
      metrics where it has any: `"error_{component}_{method}"` makes one of each element, with the
      labels of its coordinates in lower case; `{component!s}` takes a label as it is.
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
    name; the unit is the one at the name's end. None is no number."""
    return {
        name: ((), np.nan if value is None else value, unit_of(name), name)
        for name, value in named.items()
    }


def unit_of(name: str) -> str:
    """The SI unit at the end of a quantity's name: `height_m`, `height_m_stderr`."""
    stem = name.removesuffix("_stderr")
    return next((unit for end, unit in _UNITS.items() if stem.endswith(end)), "1")


def metrics(data: xarray.Dataset) -> dict[str, Scalar]:
    """The variables of a dataset that are marked as metrics, element by element; None for numbers
    that are not finite."""
    marked = (each for each in data.variables.values() if METRIC in each.attrs)
    return dict(itertools.chain.from_iterable(_elements(data, each) for each in marked))


def _elements(data: xarray.Dataset, variable: xarray.Variable) -> Iterator[tuple[str, Scalar]]:
    pattern = str(variable.attrs[METRIC])
    labels = {
        name: data[name]
        for name, _ in _LABEL.findall(pattern)
        if name in data.coords and set(data[name].dims) <= set(variable.dims)
    }
    values = variable.values
    for at in np.ndindex(values.shape):
        place = dict(zip(variable.dims, at, strict=True))
        own = {
            name: each.isel({dim: place[dim] for dim in each.dims}).item()
            for name, each in labels.items()
        }

        def word(match: re.Match[str], own: Mapping[str, Any] = own) -> str:
            if match[1] not in own:
                return match[0]
            return str(own[match[1]]) if match[2] else key_of(own[match[1]])

        yield _LABEL.sub(word, pattern), _scalar(values[at])


def key_of(label: Any) -> str:
    """A label as a part of a metric's name."""
    return (
        str(label if isinstance(label, str) else f"{label:g}")
        .lower()
        .replace(", ", "_")
        .replace(" ", "_")
    )


def _scalar(value: Any) -> Scalar:
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and not np.isfinite(plain) else plain
