"""Templates of sections to blocks: paragraphs, tables, and figures, drawn when they are asked
for."""

import functools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np
import xarray

from ..errors import BadInput
from ..numerics import BAND_90
from . import text
from .data import metrics
from .section import Section

if TYPE_CHECKING:  # which takes a third of a second
    from matplotlib.figure import Figure

_HELD = re.compile(r"\s*\x00(\d+)\x00\s*")
_PARAGRAPHS = re.compile(r"\n\s*\n")


@dataclass(frozen=True)
class Paragraph:
    """One paragraph; a list item where `is_item`."""

    text: str
    is_item: bool = False


@dataclass(frozen=True)
class Drawing:
    """A figure: `name` of its file without the ending, its caption, a sentence, what draws it, and
    the Python that does for a result's file, empty where that is not all it takes."""

    name: str
    caption: str
    draw: Callable[[], "Figure"]
    python: str = ""


@dataclass(frozen=True)
class Table:
    """Rows under column headings; cells are strings or numbers."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    caption: str = ""


Block = Paragraph | Drawing | Table


def blocks(section: Section, data: xarray.Dataset) -> tuple[Block, ...]:
    """The section's template filled in."""
    held: list[Block] = []

    def hold(block: Block) -> str:
        held.append(block)
        return _Place(f"\n\n\x00{len(held) - 1}\x00\n\n")

    def figure(
        stem: str, draw: Callable[..., "Figure"], caption: str, /, of: Any = None, **settings: Any
    ) -> str:
        drawn = functools.partial(draw, data if of is None else of, **settings)
        python = _python(stem, draw, settings) if of is None else ""
        return hold(Drawing(stem, caption, drawn, python))

    def table(columns: Mapping[str, Any], caption: str = "") -> str:
        cells = [np.ravel(each).tolist() for each in columns.values()]
        count = max(map(len, cells), default=0)
        filled = [each * count if len(each) == 1 else each for each in cells]
        return hold(Table(tuple(columns), tuple(zip(*filled, strict=True)), caption))

    def rows(named: Mapping[str, Any]) -> str:
        known = {
            k: v for k, v in named.items() if not (v is None or isinstance(v, jinja2.Undefined))
        }
        return table({"item": list(known), "value": list(known.values())})

    data_names = {"ds": data, "m": metrics(data), "facts": _Facts(data.attrs), "own": section}
    # Of a user's own words, names that `plot` does not have are refused while they are filled in.
    figures = _plot() if _is_plugin(section) else _Plots()
    drawn = {"plot": figures, "figure": figure, "table": table, "rows": rows, "np": np}
    try:
        filled = _environment().from_string(section.words).render(**data_names, **drawn)
    except jinja2.TemplateError as error:
        kind = type(section)
        if not _is_plugin(section):
            raise
        raise BadInput(
            f"The words of {kind.__module__}.{kind.__qualname__} cannot be filled in "
            f"({error.message}): correct them."
        ) from error
    return tuple(_split(filled, held))


def summary(sections: Sequence[Section], data: xarray.Dataset) -> tuple[Block, ...]:
    """What stands above a page's contents and is printed: the sections without a heading."""
    first = [each for each in sections if not each.heading and each.is_met(data)]
    every = (block for each in first for block in blocks(each, data))
    return tuple(block for block in every if not isinstance(block, Drawing))


def answers(data: xarray.Dataset) -> dict[str, tuple[str, str]]:
    """The quality of each answer in a dataset and the reasons for it, by the answer's name, which
    is empty where there is but one; none of a study over many cases."""
    if "quality" not in data or "reasons" not in data:
        return {}
    quality, reasons = data["quality"], data["reasons"]
    # Of many answers of a method, the first is the one that the reasons are of.
    quality = quality.isel({dim: 0 for dim in quality.dims if dim not in reasons.dims})
    if not quality.ndim:
        return {"": (str(quality.item()), str(reasons.item()))}
    if quality.ndim > 1:  # a study's, which has them in a table
        return {}
    names = (str(name) for name in data[quality.dims[0]].values)
    return {
        name: (str(q), str(r))
        for name, q, r in zip(names, quality.values, reasons.values, strict=True)
    }


def no_answer(quality: str) -> str:
    """The words before the reasons of an answer that failed."""
    return "these numbers are no answer. " if quality == "failed" else ""


def _is_plugin(section: Section) -> bool:
    return type(section).__module__.startswith("plugins.")


class _Plots:
    """`srsinv.plot` in a template: drawing begins when a figure is asked for."""

    def __getattr__(self, name: str) -> "_Plot":
        return _Plot(name)


@dataclass(frozen=True)
class _Plot:
    """A function or class of `srsinv.plot`."""

    name: str

    def __call__(self, *values: Any, **settings: Any) -> Any:
        return getattr(_plot(), self.name)(*values, **settings)


def _plot() -> ModuleType:
    from . import plot  # and matplotlib

    return plot


def _python(stem: str, draw: Any, settings: Mapping[str, Any]) -> str:
    """The Python that draws a figure from a result's file; empty where it is no single call."""
    is_plain = all(isinstance(each, str | int | float | bool) for each in settings.values())
    if not isinstance(draw, _Plot) or not is_plain:
        return ""
    given = "".join(f", {name}={each!r}" for name, each in settings.items())
    opened = 'xarray.open_dataset("result.nc")'
    return f'srsinv.plot.{draw.name}({opened}{given}).savefig("{stem}.png")'


class _Place(str):
    """Where a figure or a table stands in the words."""


def _without_places(value: Any) -> Any:
    """What a template inserts; text that comes from a file cannot stand for a figure."""
    is_text = isinstance(value, str) and not isinstance(value, _Place)
    return value.replace("\x00", "") if is_text else value


class _Facts(dict[str, Any]):
    """Attributes of a dataset; None for those that it does not have."""

    def __missing__(self, key: str) -> None:
        return None


def _split(filled: str, held: list[Block]) -> Iterator[Block]:
    for part in _PARAGRAPHS.split(filled):
        if match := _HELD.fullmatch(part):
            yield held[int(match[1])]
        elif words := " ".join(part.split()):
            yield Paragraph(words.removeprefix("- "), words.startswith("- "))


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        finalize=_without_places,
    )
    environment.filters |= FILTERS
    return environment


def _each(write: Callable[..., Any]) -> Callable[..., Any]:
    """`write` for a number, or for every number of an array."""

    def filtered(values: Any, *settings: Any) -> Any:
        array = np.asarray(values)
        if not array.ndim:
            return write(array.item(), *settings)
        return np.array([write(each.item(), *settings) for each in array.ravel()], object)

    return filtered


def _percent(value: Any, digits: int = 3) -> str:
    return "–" if _is_unknown(value) else f"{text.significant(100 * float(value), digits)} %"


def _quantities(values: Any, units: Any = "1", digits: int = 3, like: Any = None) -> Any:
    """Values of SI `units` with the unit in which the largest of them reads best; where there are
    units of each row, with the one that rows of the same unit share as far as they read well
    (`text.units_for_rows`). `like`: values beside them in a table, whose units these take."""
    array, like = np.asarray(values, float), values if like is None else like
    if not isinstance(units, str) and np.ndim(units):
        scales = text.units_for_rows(_flat(like), map(str, np.ravel(np.asarray(units))))
    else:
        scales = [text.best_unit(units, np.asarray(like, float))] * array.size
    written = [
        "–" if _is_unknown(value)
        else f"{text.significant(factor * value, digits)}{text.suffix(unit)}"
        for value, (factor, unit) in zip(_flat(array), scales, strict=True)
    ]  # fmt: skip
    return np.array(written, object) if array.ndim else written[0]


def _flat(values: Any) -> list[float]:
    return np.ravel(np.asarray(values, float)).tolist()


def _digits(value: Any, digits: int = 3) -> str:
    return "–" if _is_unknown(value) else text.significant(float(value), digits)


def _is_unknown(value: Any) -> bool:
    return value is None or not np.isfinite(value)


def _with_error(values: Any, stderrs: Any, units: Any = "1") -> Any:
    """Each value with its standard error; rows of the same unit share its prefix as far as they
    read well."""
    return _row_by_row(text.quantity_with_error, values, stderrs, units)


def _interval(values: Any, stderrs: Any, units: Any, half: float = BAND_90) -> Any:
    """The central 90 % of each value's normal distribution, in the units of `_with_error`."""
    return _row_by_row(
        lambda value, stderr, unit, scale: text.interval(value, half * stderr, unit, scale),
        values,
        stderrs,
        units,
    )


def _between(lows: Any, highs: Any, units: Any) -> Any:
    """Each interval, in the units in which its larger end reads well: the other may be 0."""
    ends = np.array(np.broadcast_arrays(lows, highs), float)
    larger = np.abs(np.where(np.isfinite(ends), ends, 0.0)).max(0)
    return _row_by_row(text.between, lows, highs, units, larger)


def _row_by_row(
    write: Callable[..., str], values: Any, stderrs: Any, units: Any, like: Any = None
) -> Any:
    """`like`: what the units are chosen for; None: the values."""
    columns = np.broadcast_arrays(*map(np.asarray, (values, stderrs, units)))
    v, s, u = (np.ravel(each).tolist() for each in columns)
    scales = text.units_for_rows(map(float, v if like is None else _flat(like)), map(str, u))
    rows = zip(map(float, v), map(float, s), map(str, u), scales, strict=True)
    written = [write(*row) for row in rows]
    return np.array(written, object) if columns[0].ndim else written[0]


FILTERS: dict[str, Callable[..., Any]] = {
    "between": _between,
    "digits": _each(_digits),
    "class_in_words": text.class_in_words,
    "facts_in_words": text.facts_in_words,
    "heading": _each(text.heading),
    "in_words": text.in_words,
    "interval": _interval,
    "listed": text.listed,
    "noise_in_words": text.noise_in_words,
    "parameter": _each(text.without_unit),
    "percent": _each(_percent),
    "quantity": _quantities,
    "sized": _each(text.sized),
    "spoken": _each(text.spoken),
    "value": _each(text.format_value),
    "with_error": _with_error,
}
