"""The files of a run: numbers, arrays, figures and one self-contained page.

The same outcome gives the same bytes: no date, no random name, no version of a drawing library.
"""

import base64
import io
import json
import math
from collections.abc import Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import jinja2
import xarray
from matplotlib.figure import Figure

from .. import __version__
from ..aliases import with_old_names
from .outcome import Outcome, Section, Table
from .text import format_value, is_numeric

_DPI = 110


def render(
    outcome: Outcome, record: Mapping[str, str], command: str = "srsinv"
) -> dict[str, bytes]:
    """The files of a run's folder by their names in it: `metrics.json`, `result.nc`, `report.html`,
    `figures/*.png`, `.hydra/` and the outcome's own.

    Nothing is written: all is made in memory, where no full disk can cut it short. `record` maps
    the names in `.hydra` to their text, `command` is the command on the page. Raises `ValueError`
    for a variable without `units`, `TypeError` for a metric that JSON cannot hold.
    """
    figures = {
        stem: _png(draw()) for section in outcome.sections for stem, draw in section.figures.items()
    }
    texts = {
        **{f".hydra/{name}": text for name, text in record.items()},
        **outcome.files,
        "metrics.json": metrics_json(outcome.metrics),
        "report.html": _page(outcome, figures, command),
    }
    return {
        **{name: text.encode() for name, text in texts.items()},
        "result.nc": _netcdf(outcome.dataset),
        **{f"figures/{stem}.png": image for stem, image in figures.items()},
    }


def metrics_json(metrics: Mapping[str, Any]) -> str:
    """`metrics` as JSON with sorted keys, old names beside new ones; numbers that are not finite
    become null."""
    values = {key: _json_value(key, value) for key, value in with_old_names(metrics).items()}
    return json.dumps(values, sort_keys=True, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _netcdf(dataset: xarray.Dataset) -> bytes:
    unitless = [
        str(name) for name, values in dataset.variables.items() if "units" not in values.attrs
    ]
    if unitless:
        raise ValueError(f"variables without units in the result: {', '.join(unitless)}")
    return bytes(dataset.to_netcdf(engine="h5netcdf"))


def _png(figure: Figure) -> bytes:
    image = io.BytesIO()
    figure.savefig(
        image, format="png", dpi=_DPI, bbox_inches="tight", facecolor="white",
        metadata={"Software": None},
    )  # fmt: skip
    return image.getvalue()


def _json_value(key: str, value: object) -> object:
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value) if math.isfinite(value) else None
    raise TypeError(f"metric {key} is {type(value).__name__}, not a plain value")


def _page(outcome: Outcome, figures: Mapping[str, bytes], command: str) -> str:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    numbers = sorted(outcome.metrics.items())
    metrics = Table(("name", "value"), tuple((k, "–" if v is None else v) for k, v in numbers))
    return environment.get_template("page.html.j2").render(
        title=outcome.title,
        command=command,
        version=__version__,
        summary=_table(outcome.summary),
        sections=[_section(section, figures) for section in outcome.sections],
        metrics=_table(metrics),
    )


def _section(section: Section, figures: Mapping[str, bytes]) -> dict[str, Any]:
    return {
        "heading": section.heading,
        "paragraphs": section.paragraphs,
        "figures": [
            {
                "source": _data_address(figures[stem]),
                "caption": section.captions.get(stem, stem.replace("_", " ")),
            }
            for stem in section.figures
        ],
        "tables": [_table(table) for table in section.tables],
    }


def _table(table: Table) -> dict[str, Any]:
    numeric = [is_numeric(cells) for cells in zip(*table.rows, strict=True)]
    numeric = numeric or [False] * len(table.columns)
    return {
        "caption": table.caption,
        "notes": table.notes,
        "columns": list(zip(table.columns, numeric, strict=True)),
        "rows": [
            [(format_value(cell), isinstance(cell, Real)) for cell in row] for row in table.rows
        ],
    }


def _data_address(image: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(image).decode("ascii")
