"""The files of a run: numbers, arrays, figures and one self-contained page.

The same result gives the same bytes: no date, no random name, no version of a drawing library.
"""

import base64
import io
import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jinja2
import markupsafe
import numpy as np
import xarray
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from .. import __version__
from .result import Result, Scalar
from .section import Section
from .terminal import no_answer
from .text import format_value, is_numeric
from .words import Block, Drawing, Paragraph, Table, answers, blocks, summary

_DPI = 140
_COMPRESSION = 3  # zlib's: 6 takes a third longer for files that are 7 % smaller
_CODE = re.compile(r"`([^`]+)`")
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=%|dB\b|[fpnµmkMG]?(?:m|s|A|C|Hz|N|Pa|V|rad)\b)")


def render(result: Result, record: Mapping[str, str], command: str = "srsinv") -> dict[str, bytes]:
    """The files of a run's folder by their names in it: `metrics.json`, the dataset (`result.nc`),
    the page (`report.html`), `figures/*.png`, `.hydra/` and the result's own.

    Nothing is written: all is made in memory, where no full disk can cut it short. `record` maps
    the names in `.hydra` to their text, `command` is the command on the page. Raises `ValueError`
    for a variable without `units`.
    """
    filled = _filled(result)
    figures = {each.name: _png(each.figure) for each in _drawings(filled)}
    texts: dict[str, str | bytes] = {
        **{f".hydra/{name}": text for name, text in record.items()},
        **result.files,
        "metrics.json": metrics_json(result.metrics),
        result.page_name: _page(result, filled, figures, command),
    }
    return {
        **{name: text.encode() if isinstance(text, str) else text for name, text in texts.items()},
        result.data_name: _netcdf(result.dataset),
        **{f"figures/{name}.png": image for name, image in figures.items()},
    }


def page(result: Result, command: str = "") -> str:
    """The page of a result as HTML, its figures within it."""
    filled = _filled(result)
    images = {each.name: _png(each.figure) for each in _drawings(filled)}
    return _page(result, filled, images, command)


def metrics_json(metrics: Mapping[str, Scalar]) -> str:
    """`metrics` as JSON with sorted keys; None becomes null, and so do
    numbers that are not finite."""
    values = {
        key: None if isinstance(each, float) and not math.isfinite(each) else each
        for key, each in metrics.items()
    }
    return json.dumps(values, sort_keys=True, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def figures(result: Result) -> dict[str, tuple[Figure, str]]:
    """The figures of a result with their captions, by name."""
    return {each.name: (each.figure, each.caption) for each in _drawings(_filled(result))}


Filled = list[tuple[Section, tuple[Block, ...]]]


def _filled(result: Result) -> Filled:
    """The sections that are shown, with what is in them."""
    shown = (each for each in result.sections if each.heading and each.is_met(result.dataset))
    filled = [(each, blocks(each, result.dataset)) for each in shown]
    return [(section, own) for section, own in filled if own]


def _drawings(filled: Filled) -> Iterator[Drawing]:
    return (block for _, own in filled for block in own if isinstance(block, Drawing))


def _netcdf(data: xarray.Dataset) -> bytes:
    unitless = [str(name) for name, each in data.variables.items() if "units" not in each.attrs]
    if unitless:
        raise ValueError(f"variables without units in the result: {', '.join(unitless)}")
    return bytes(data.to_netcdf(engine="h5netcdf"))


def _png(figure: Figure) -> bytes:
    """The image of a figure, laid out once and drawn once; `savefig` draws it up to three times."""
    image, canvas = io.BytesIO(), FigureCanvasAgg(figure)
    before = figure.dpi
    figure.set_dpi(_DPI)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # figures are opaque
    Image.fromarray(pixels).save(image, "png", dpi=(_DPI, _DPI), compress_level=_COMPRESSION)
    figure.set_dpi(before)
    return image.getvalue()


def _page(result: Result, filled: Filled, images: Mapping[str, bytes], command: str) -> str:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    numbers = Table(("name", "value"), tuple(sorted(result.metrics.items())))
    return environment.get_template("page.html.j2").render(
        title=_unbroken(result.title),
        command=command,
        version=__version__,
        answers=[
            (name, quality, no_answer(quality) + reasons)
            for name, (quality, reasons) in answers(result.dataset).items()
        ],
        summary=list(_in_html(summary(result), images)),
        sections=[
            (section.heading, section.is_folded, list(_in_html(own, images)))
            for section, own in filled
        ],
        metrics=_table(numbers),
    )


def _in_html(own: tuple[Block, ...], images: Mapping[str, bytes]) -> Iterator[dict[str, Any]]:
    for block in own:
        if isinstance(block, Paragraph):
            yield {"kind": "item" if block.is_item else "paragraph", "words": _inline(block.text)}
        elif isinstance(block, Drawing):
            source = "data:image/png;base64," + base64.b64encode(images[block.name]).decode("ascii")
            caption = " ".join(block.caption.split())
            yield {"kind": "figure", "source": source, "alt": caption, "caption": _inline(caption)}
        else:
            yield {"kind": "table", **_table(block)}


def _inline(text: str) -> markupsafe.Markup:
    """Words as HTML; between backticks they are code, which is left as it is typed."""
    words = _CODE.split(str(markupsafe.escape(text)))
    words[::2] = map(_unbroken, words[::2])
    words[1::2] = (f"<code>{code}</code>" for code in words[1::2])
    return markupsafe.Markup("".join(words))


def _unbroken(text: str) -> str:
    """Text in which no line ends between a number and its unit."""
    return _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", text)


def _table(table: Table) -> dict[str, Any]:
    numeric = [is_numeric(cells) for cells in zip(*table.rows, strict=True)]
    numeric = numeric or [False] * len(table.columns)
    return {
        "caption": _inline(table.caption),
        "columns": list(zip(table.columns, numeric, strict=True)),
        "rows": [
            list(zip(map(_unbroken, map(format_value, row)), numeric, strict=True))
            for row in table.rows
        ],
    }
