"""Outcome of a job: numbers, arrays and the parts of its page. Nothing is written here."""

from collections.abc import Callable
from dataclasses import dataclass, field

import xarray
from matplotlib.figure import Figure


@dataclass(frozen=True)
class Table:
    """Rows under column headings, as printed and as shown on the page.

    Cells are strings or numbers; numbers are shown to three or four significant digits, by one
    formatter for the terminal and the page alike. `notes` are sentences below the table.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str | float | int, ...], ...]
    caption: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Section:
    """One part of the page: a heading, paragraphs, figures drawn on demand, tables.

    `figures` maps a file stem (`traction` becomes `figures/traction.png`) to a function that draws
    it, so that a job used for its numbers alone draws nothing.
    """

    heading: str
    paragraphs: tuple[str, ...] = ()
    figures: dict[str, Callable[[], Figure]] = field(default_factory=dict)
    captions: dict[str, str] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """The result of one job.

    - `title`: one line on the job.
    - `metrics`: flat, SI units in the key's suffix; written to `metrics.json`.
    - `dataset`: every stage with `units` on every variable; written to `result.nc`.
    - `sections`: the page, in order.
    - `summary`: the table printed at the end of a run.
    - `files`: the text of further files, by name.
    """

    title: str
    metrics: dict[str, float | int | str | bool | None]
    dataset: xarray.Dataset
    sections: tuple[Section, ...]
    summary: Table
    files: dict[str, str] = field(default_factory=dict)
