"""A run's folder: numbers, arrays, figures and one page that needs nothing beside itself.

The same outcome gives the same bytes: no date, no random name, no version of a drawing library.
"""

import base64
import errno
import glob
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import jinja2
import xarray
from matplotlib.figure import Figure

from .. import __version__
from ..aliases import with_old_names
from ..scratch import abandoned
from .outcome import Outcome, Section, Table
from .text import format_value, is_numeric

_DPI = 110


def write(
    outcome: Outcome, folder: Path, hydra_files: Mapping[str, str], command: str = "srsinv"
) -> None:
    """Write `metrics.json`, `result.nc`, `report.html`, `figures/*.png`, `.hydra/` and the
    outcome's own files to `folder`.

    Every file appears whole or not at all, in an empty folder all at once, else `metrics.json`
    last; those of an earlier run are replaced. `hydra_files` maps the names in `.hydra` to their
    text, `command` is what the page says was run. Raises `ValueError` for a variable without
    `units`, `TypeError` for a metric that is not a plain value.
    """
    with _staged(folder) as stage:
        for name, text in hydra_files.items():
            _write_text(stage / ".hydra" / name, text)
        for name, text in outcome.files.items():
            _write_text(stage / name, text)
        _write_text(stage / "metrics.json", metrics_json(outcome.metrics))
        _write_dataset(outcome.dataset, stage / "result.nc")
        for section in outcome.sections:
            for stem, draw in section.figures.items():
                _write_figure(draw(), stage / "figures" / f"{stem}.png")
        _write_text(stage / "report.html", _page(outcome, stage / "figures", command))


def metrics_json(metrics: Mapping[str, Any]) -> str:
    """`metrics` as JSON with sorted keys, old names beside new ones; what is not finite becomes
    null."""
    plain = {key: _plain(key, value) for key, value in with_old_names(metrics).items()}
    return json.dumps(plain, sort_keys=True, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    # Beside the folder, which a run that is killed then leaves empty, where that is possible.
    beside = os.access(folder.parent, os.W_OK) and not folder.is_mount() and folder != Path.cwd()
    home, prefix = (folder.parent, f".{folder.name}.writing-") if beside else (folder, ".writing-")
    for left_over in home.glob(f"{glob.escape(prefix)}*"):  # by a run that was killed
        if abandoned(left_over.name[len(prefix) :].partition("-")[0]):
            shutil.rmtree(left_over, ignore_errors=True)
    stage = Path(tempfile.mkdtemp(prefix=f"{prefix}{os.getpid()}-", dir=home))
    try:
        yield stage
        stage.chmod(folder.stat().st_mode)
        try:
            os.rename(stage, folder)  # all files at once, where there are none yet
        except OSError:
            _replace(stage, folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def _replace(stage: Path, folder: Path) -> None:
    files = [path for path in stage.rglob("*") if path.is_file()]
    for path in sorted(files, key=lambda path: (path.name == "metrics.json", path)):
        target = folder / path.relative_to(stage)
        target.parent.mkdir(exist_ok=True)
        try:
            os.replace(path, target)
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            # A folder that is mounted there, though it does not look so: a copy takes its place.
            copy = target.with_name(f".{target.name}.writing")
            shutil.copyfile(path, copy)
            os.replace(copy, target)


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="\n")


def _write_dataset(dataset: xarray.Dataset, path: Path) -> None:
    bare = [str(name) for name, values in dataset.variables.items() if "units" not in values.attrs]
    if bare:
        raise ValueError(f"variables without units in the result: {', '.join(bare)}")
    dataset.to_netcdf(path, engine="h5netcdf")


def _write_figure(figure: Figure, path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    figure.savefig(
        path, dpi=_DPI, bbox_inches="tight", facecolor="white", metadata={"Software": None}
    )


def _plain(key: str, value: object) -> object:
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value) if math.isfinite(value) else None
    raise TypeError(f"metric {key} is {type(value).__name__}, not a plain value")


def _page(outcome: Outcome, figures: Path, command: str) -> str:
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


def _section(section: Section, figures: Path) -> dict[str, Any]:
    return {
        "heading": section.heading,
        "paragraphs": section.paragraphs,
        "figures": [
            {
                "source": _data_address(figures / f"{stem}.png"),
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


def _data_address(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
