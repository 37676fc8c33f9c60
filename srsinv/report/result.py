"""What a job returns: its data, what they show in one line, and the sections of its page."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import xarray

from .data import Scalar, metrics
from .section import Section

if TYPE_CHECKING:
    from .page import Page


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

    @property
    def page(self) -> "Page":
        """Its page, with the figures drawn."""
        from .page import Page  # draws: matplotlib is imported when there is something to draw

        return Page(self.title, self.dataset, self.sections)

    def _repr_html_(self) -> str:
        return self.page.html()
