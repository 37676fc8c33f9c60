"""What a job returns: its data, what they show in one line, and the sections of its page."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from string import Formatter
from typing import Any

import numpy as np
import xarray

from .section import Section
from .text import unit_of

METRIC = "metric"  # attribute of a variable: the pattern of its names in metrics.json
Scalar = float | int | str | bool | None


@dataclass(frozen=True)
class Result:
    """The result of one job. The page, the printed summary and `metrics.json` are views of it.

    - `title`: one line that states the result.
    - `dataset`: every stage and every number, with `units` on each variable; written to
      `result.nc`. Variables with the attribute `metric` are those of `metrics.json`.
    - `sections`: of the page, in order; those without a heading come first, and are printed.
    - `files`: further files by name, as text or bytes.
    - `data_name`, `page_name`: names of the files of the dataset and of the page.
    """

    title: str
    dataset: xarray.Dataset
    sections: tuple[Section, ...] = ()
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    data_name: str = "result.nc"
    page_name: str = "report.html"

    @property
    def metrics(self) -> dict[str, Scalar]:
        """The numbers of `metrics.json`, in SI units; flat."""
        return metrics(self.dataset)

    def with_sections(self, more: tuple[Section, ...]) -> "Result":
        """The same result with further sections at the end of its page."""
        return replace(self, sections=(*self.sections, *more))

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
      labels of its coordinates in lower case, `{component!s}` with them as they are.
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
        # A name may come from a file, and hold what would be a field of the pattern.
        name: ((), np.nan if value is None else value, unit_of(name), _as_it_is(name))
        for name, value in named.items()
    }


def _as_it_is(name: str) -> str:
    return name.replace("{", "{{").replace("}", "}}")


def metrics(data: xarray.Dataset) -> dict[str, Scalar]:
    """The variables of a dataset that are marked as metrics, element by element; None for what is
    no number."""
    marked = (each for each in data.variables.values() if METRIC in each.attrs)
    return dict(itertools.chain.from_iterable(_elements(data, each) for each in marked))


def metric_units(data: xarray.Dataset) -> dict[str, str]:
    """The units of a dataset's metrics, by their names."""
    return {
        name: str(each.attrs["units"])
        for each in data.variables.values()
        if METRIC in each.attrs
        for name, _ in _elements(data, each)
    }


def _elements(data: xarray.Dataset, variable: xarray.Variable) -> Iterator[tuple[str, Scalar]]:
    pattern = str(variable.attrs[METRIC])
    fields = (name for _, name, _, _ in Formatter().parse(pattern) if name)
    labels = {name: (data[name].dims, data[name].values) for name in fields}
    values = variable.values
    for at in np.ndindex(values.shape):
        place = dict(zip(variable.dims, at, strict=True))
        words = {
            name: _Label(own[tuple(place[dim] for dim in dims)].item())
            for name, (dims, own) in labels.items()
        }
        yield pattern.format(**words), _scalar(values[at])


class _Label:
    """A coordinate's label in the name of a metric: `{name}` as a key, `{name!s}` as it is."""

    def __init__(self, label: Any):
        self.text = label if isinstance(label, str) else f"{label:g}"

    def __format__(self, spec: str) -> str:
        return key_of(self.text)

    def __str__(self) -> str:
        return self.text


def key_of(label: str) -> str:
    """A label as a part of a metric's name."""
    return label.lower().replace(", ", "_").replace(" ", "_")


def _scalar(value: Any) -> Scalar:
    own = value.item() if hasattr(value, "item") else value
    return None if isinstance(own, float) and np.isnan(own) else own
