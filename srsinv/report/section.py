"""Sections of a page: which data each needs, and its words, figures and tables as a template."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import xarray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plot = Callable[..., "Figure"]
PAGES = Path(__file__).parent / "pages"
_END = ".md.j2"
_NEED = re.compile(r"(\w+)(?:\(([\w, ]*)\))?")


class Section:
    """Base of sections: one part of a page, shown where the dataset of a result has what it needs.

    - `heading`: empty for what stands above the page's contents and is printed, too.
    - `needs`: the dimensions that each variable needed must have, by the variable's name.
    - `words`: a template (docs/how_to/write_other_parts.md): paragraphs with blank lines between
      them, and `{{ figure(...) }}` and `{{ table(...) }}` among them. In it `ds` is the dataset,
      `m` its metrics, `plot` is `srsinv.plot` and `own` this section.
    - `is_folded`: whether the section is closed until a reader opens it; where a page has no other,
      it is open.
    """

    heading: str = ""
    needs: Mapping[str, tuple[str, ...]] = {}
    words: str = ""
    is_folded: bool = False

    def is_met(self, data: xarray.Dataset) -> bool:
        """Whether the dataset has the variables that this section needs, with their dimensions."""
        return all(
            name in data.variables and set(dims) <= set(data[name].dims)
            for name, dims in self.needs.items()
        )


@dataclass(frozen=True)
class WrittenSection(Section):
    """A section that a file holds."""

    heading: str = ""
    needs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    words: str = ""
    is_folded: bool = False
    plots: Mapping[str, Plot] = field(default_factory=dict)


def sections(*sources: str, **plots: Plot) -> tuple[Section, ...]:
    """The sections of pages, in order; `plots` are their own, `own.plots.NAME` in the words.

    A source is the name of a page of this package, `inversion`, or the path of a Python file that
    has its page beside it, `__file__`: `NAME.md.j2` of NAME.py, `page.md.j2` of a folder's
    `__init__.py`. In the file a line `# Heading` begins a section; the lines
    `needs: variable(dimension, ...), ...` and `folded` may follow it. Text before the first
    heading is a section without one.
    """
    return tuple(section for source in sources for section in _read(_path(source), plots))


def _path(source: str) -> Path:
    path = Path(source)
    if path.name == "__init__.py":
        return path.with_name(f"page{_END}")
    return path.with_suffix(_END) if path.suffix == ".py" else PAGES / f"{source}{_END}"


def _read(path: Path, plots: Mapping[str, Plot]) -> Iterator[WrittenSection]:
    text = path.read_text(encoding="utf-8")
    for part in re.split(r"^(?=# )", text, flags=re.MULTILINE):
        if part.strip():
            yield _section(part, plots)


def _section(text: str, plots: Mapping[str, Plot]) -> WrittenSection:
    lines = text.strip("\n").split("\n")
    heading = lines.pop(0).removeprefix("# ").strip() if text.startswith("# ") else ""
    needs, is_folded = {}, False
    while lines and (lines[0].startswith("needs: ") or lines[0] == "folded"):
        line = lines.pop(0)
        is_folded = is_folded or line == "folded"
        for name, dims in _NEED.findall(line.removeprefix("needs: ") if ":" in line else ""):
            needs[name] = tuple(dim for dim in dims.replace(" ", "").split(",") if dim)
    return WrittenSection(heading, needs, "\n".join(lines), is_folded, plots)
