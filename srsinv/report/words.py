"""Templates of sections to blocks: paragraphs, tables, and figures drawn from the dataset."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import jinja2
import numpy as np
import xarray
from matplotlib.figure import Figure

from . import plot, text
from .result import Result, metrics
from .section import Section

_HELD = re.compile(r"\s*\x00(\d+)\x00\s*")
_PARAGRAPHS = re.compile(r"\n\s*\n")


@dataclass(frozen=True)
class Paragraph:
    """One paragraph; a list item where `is_item`."""

    text: str
    is_item: bool = False


@dataclass(frozen=True)
class Drawing:
    """A figure: `name` of its file without the ending, and its caption, a sentence."""

    name: str
    figure: Figure
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows under column headings; cells are strings or numbers."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    caption: str = ""


Block = Paragraph | Drawing | Table


def blocks(section: Section, data: xarray.Dataset, draws: bool = True) -> tuple[Block, ...]:
    """The section's template filled in; without `draws` no figure is drawn, and none is there."""
    held: list[Block] = []

    def hold(block: Block) -> str:
        held.append(block)
        return f"\n\n\x00{len(held) - 1}\x00\n\n"

    def figure(
        stem: str, draw: Callable[..., Figure], caption: str, /, of: Any = None, **settings: Any
    ) -> str:
        if not draws:
            return ""
        return hold(Drawing(stem, draw(data if of is None else of, **settings), caption))

    def table(columns: Mapping[str, Any], caption: str = "") -> str:
        return hold(_table(columns, caption))

    def rows(named: Mapping[str, Any]) -> str:
        known = {
            k: v for k, v in named.items() if not (v is None or isinstance(v, jinja2.Undefined))
        }
        return table({"what": list(known), "value": list(known.values())})

    words = _environment().from_string(section.words)
    filled = words.render(
        ds=data, m=metrics(data), facts=_Facts(data.attrs), own=section, plot=plot, figure=figure,
        table=table, rows=rows, np=np,
    )  # fmt: skip
    return tuple(_split(filled, held))


def summary(result: Result) -> tuple[Block, ...]:
    """What stands above a page's contents and is printed: the sections without a heading."""
    first = [each for each in result.sections if not each.heading and each.is_met(result.dataset)]
    return tuple(block for each in first for block in blocks(each, result.dataset, draws=False))


def answers(data: xarray.Dataset) -> dict[str, tuple[str, str]]:
    """The quality of each answer in a dataset and the reasons for it, by the answer's name; empty
    where there is but one."""
    if "quality" not in data or data["quality"].ndim > 1:
        return {}
    quality, reasons = data["quality"], data["reasons"]
    if not quality.ndim:
        return {"": (str(quality.item()), str(reasons.item()))}
    names = (str(name) for name in data[quality.dims[0]].values)
    return {
        name: (str(q), str(r))
        for name, q, r in zip(names, quality.values, reasons.values, strict=True)
    }


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


def _table(columns: Mapping[str, Any], caption: str) -> Table:
    cells = [np.ravel(each).tolist() for each in columns.values()]
    count = max(map(len, cells), default=0)
    filled = [each * count if len(each) == 1 else each for each in cells]
    return Table(tuple(columns), tuple(zip(*filled, strict=True)), caption)


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
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


def _percent(value: float | None, digits: int = 3) -> str:
    return "–" if _is_unknown(value) else f"{text.significant(100 * value, digits)} %"


def _quantities(values: Any, units: Any = "1", digits: int = 3) -> Any:
    """Values of SI `units`, one for all or one for each, with the unit in which the largest of
    them reads best."""
    array, every = np.asarray(values, float), np.asarray(units, str)
    if every.ndim:
        written = np.empty(array.shape, object)
        for unit in np.unique(every):
            written[every == unit] = _quantities(array[every == unit], str(unit), digits)
        return written
    factor, unit = text.best_unit(str(units), array)
    unit = "" if unit == "1" else f" {unit}"

    def write(value: float) -> str:
        return "–" if _is_unknown(value) else f"{text.significant(factor * value, digits)}{unit}"

    return _each(write)(array)


def _digits(value: float | None, digits: int = 3) -> str:
    return "–" if _is_unknown(value) else text.significant(value, digits)


def _is_unknown(value: Any) -> bool:
    return value is None or not np.isfinite(value)


def _spoken(name: Any) -> str:
    return str(name).replace("_", " ")


FILTERS: dict[str, Callable[..., Any]] = {
    "digits": _each(_digits),
    "listed": text.listed,
    "percent": _each(_percent),
    "quantity": _quantities,
    "spoken": _each(_spoken),
    "value": _each(text.format_value),
}
