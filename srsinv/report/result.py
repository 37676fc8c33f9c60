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
        """Its page, with every figure drawn."""
        return self.page_with("all")

    def page_with(self, figures: str) -> "Page":
        """Its page with "all" figures drawn, with those of sections that are open when the page is
        ("page"), or with "none"."""
        from .page import Page

        return Page(self.title, self.dataset, self.sections, figures)

    def _repr_html_(self) -> str:
        return self.page.html()
