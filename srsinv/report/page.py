"""One self-contained page of a result: sections filled in from its dataset, and their figures."""

import base64
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import markupsafe
import numpy as np
import xarray

from .. import __version__
from ..progress import steps
from .data import metrics
from .section import Section
from .text import format_value, is_numeric, typeset
from .words import Block, Drawing, Paragraph, Table, answers, blocks, no_answer, summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 140
_COMPRESSION = 3  # zlib's: 6 takes a third longer for files that are 7 % smaller
_CODE = re.compile(r"`([^`]+)`")
_BEFORE_UNIT = re.compile(
    r"(?<=[\d⁰¹²³⁴-⁹]) (?=%|°|±|dB\b|MB\b|counts\b|[fpnµmkMG]?(?:m|s|A|C|Hz|N|Pa|V|rad)\b)"
    r"|(?<=±) (?=\d)|(?<=\d [fpnµm]V) (?=[ms]\b)|(?<=\d V) (?=[ms]\b)"
)
_LONG_WORD = re.compile(r"[^\s<>&;]{24,}")  # wider than a column of a small screen
_JOINT = re.compile(r"(?<=[/_.=,:-])(?=\w)")
_MOST_CARDS = 12  # rows: a longer table stays one on a small screen, and moves sideways


class Page:
    """A page of sections that are filled in from a dataset, those whose needs it meets.

    `drawn`: which figures are, "all", those of sections that are open when the page is ("page"), or
    "none".
    """

    def __init__(
        self, title: str, data: xarray.Dataset, sections: Sequence[Section], drawn: str = "all"
    ):
        self._title, self._data, self._sections, self._drawn = title, data, sections, drawn
        shown = (each for each in sections if each.heading and each.is_met(data))
        filled = [(each, blocks(each, data)) for each in shown]
        filled = [(section, own) for section, own in filled if own]
        has_open = any(not section.is_folded for section, _ in filled)
        self._filled = [
            (section.heading, section.is_folded and has_open, own) for section, own in filled
        ]

    @property
    def _drawings(self) -> list[Drawing]:
        return [
            each
            for _, is_folded, own in self._filled
            if self._drawn == "all" or (self._drawn == "page" and not is_folded)
            for each in own
            if isinstance(each, Drawing)
        ]

    @property
    def figures(self) -> dict[str, tuple["Figure", str]]:
        """The figures that are drawn, with their captions, by name."""
        return {each.name: (each.draw(), each.caption) for each in self._drawings}

    @cached_property
    def images(self) -> dict[str, bytes]:
        """The figures that are drawn as PNG, by name."""
        with steps("drawing figures", self._drawings) as each:
            return {drawing.name: _png(drawing.draw()) for drawing in each}

    def html(self, command: str = "") -> str:
        """The page as HTML, its figures within it, and the `command` that made it."""
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(Path(__file__).parent),
            autoescape=True,
            trim_blocks=True,
            lstrip_blocks=True,
            undefined=jinja2.StrictUndefined,
        )
        numbers = Table(("name", "value"), tuple(sorted(metrics(self._data).items())))
        return environment.get_template("page.html.j2").render(
            title=_printed(self._title),
            command=command,
            version=__version__,
            answers=[
                (name, quality, _printed(no_answer(quality) + reasons))
                for name, (quality, reasons) in answers(self._data).items()
            ],
            summary=list(_in_html(summary(self._sections, self._data), self.images)),
            sections=[
                (heading, is_folded, list(_in_html(own, self.images)))
                for heading, is_folded, own in self._filled
            ],
            metrics=_table(numbers),
        )


def _png(figure: "Figure") -> bytes:
    """The image of a figure, laid out once and drawn once; `savefig` draws it up to three times."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    image, canvas = io.BytesIO(), FigureCanvasAgg(figure)
    before = figure.dpi
    figure.set_dpi(_DPI)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # figures are opaque
    Image.fromarray(pixels).save(image, "png", dpi=(_DPI, _DPI), compress_level=_COMPRESSION)
    figure.set_dpi(before)
    return image.getvalue()


def _in_html(own: tuple[Block, ...], images: Mapping[str, bytes]) -> Iterator[dict[str, Any]]:
    for block in own:
        if isinstance(block, Paragraph):
            yield {"kind": "item" if block.is_item else "paragraph", "words": _inline(block.text)}
        elif isinstance(block, Drawing):
            caption = " ".join(block.caption.split())
            said = {"alt": caption, "caption": _inline(caption)}
            if block.name in images:
                image = base64.b64encode(images[block.name]).decode("ascii")
                yield {"kind": "figure", "source": f"data:image/png;base64,{image}", **said}
            else:
                yield {"kind": "undrawn", "python": block.python, **said}
        else:
            yield {"kind": "table", **_table(block)}


def _inline(text: str) -> markupsafe.Markup:
    """Words as HTML; between backticks they are code, which is left as it is typed."""
    words = _CODE.split(text)
    words[::2] = (str(markupsafe.escape(_printed(each))) for each in words[::2])
    words[1::2] = (f"<code>{markupsafe.escape(code)}</code>" for code in words[1::2])
    return markupsafe.Markup("".join(words))


def _printed(text: str) -> str:
    """Text with its powers and signs typeset, in which no line ends between a number and its
    unit."""
    return _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", typeset(text))


def _cell(value: object) -> markupsafe.Markup:
    """A cell as HTML, in which long names of files and settings may break at their joints."""
    text = str(markupsafe.escape(_printed(format_value(value))))
    return markupsafe.Markup(_LONG_WORD.sub(lambda word: _JOINT.sub("<wbr>", word[0]), text))


def _table(table: Table) -> dict[str, Any]:
    numeric = [is_numeric(cells) for cells in zip(*table.rows, strict=True)]
    numeric = numeric or [False] * len(table.columns)
    return {
        "caption": _inline(table.caption),
        "columns": list(zip(map(_printed, table.columns), numeric, strict=True)),
        "rows": [list(zip(map(_cell, row), numeric, strict=True)) for row in table.rows],
        "is_cards": len(table.columns) > 2 and len(table.rows) <= _MOST_CARDS,
    }
