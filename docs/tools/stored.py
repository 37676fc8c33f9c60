"""Outputs of the pages' code, kept in `docs/stored/outputs` between executions.

A page's outputs are known by the code of all its cells: a page whose code has changed has none
until `make docs-all` executes it, and the site is not built without.
"""

import hashlib
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import nbformat
from myst_nb.core.read import read_myst_markdown_notebook
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)
OUTPUTS = Path(__file__).parents[1] / "stored" / "outputs"


def code_cells(notebook: Any) -> list[Any]:
    """The cells of a notebook that are executed."""
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def digest(cells: Iterable[Any]) -> str:
    """What the outputs of these cells are known by."""
    return hashlib.sha256("\0".join(cell.source for cell in cells).encode()).hexdigest()[:12]


def with_outputs(text: str) -> nbformat.NotebookNode:
    """The notebook of a page's text with its stored outputs; warns where there are none."""
    notebook = read_myst_markdown_notebook(text, add_source_map=True)
    cells = code_cells(notebook)
    if cells:
        notebook.metadata["language_info"] = {"name": "python", "pygments_lexer": "python"}
        files = list(OUTPUTS.glob(f"*.{digest(cells)}.json"))
        if not files:
            title = re.search(r"^# .*", text, re.MULTILINE)
            LOGGER.warning("no outputs are stored of the code of: %s", title and title[0])
            return notebook
        for cell, outputs in zip(cells, json.loads(files[0].read_text("utf-8")), strict=True):
            cell.outputs = nbformat.from_dict(outputs)
    return notebook


def store(name: str, cells: list[Any], folder: Path) -> None:
    """Keep the outputs of a page's cells, executed in a folder, in place of those kept of that page
    before; progress lines and the folder's path are left out."""
    OUTPUTS.mkdir(parents=True, exist_ok=True)
    for old in OUTPUTS.glob(f"{name}.*.json"):
        old.unlink()
    outputs = [_plain(cell.outputs) for cell in cells]
    path = OUTPUTS / f"{name}.{digest(cells)}.json"
    text = json.dumps(outputs, indent=1, ensure_ascii=False).replace(f"{folder}/", "")
    path.write_text(f"{text}\n", encoding="utf-8")


def _plain(outputs: list[Any]) -> list[Any]:
    """Outputs without progress and what differs from one execution to the next, text in one
    piece."""
    kept: list[Any] = []
    for each in outputs:
        is_text = each.output_type == "stream"
        if is_text and each.name == "stderr":
            continue
        if is_text and kept and kept[-1]["output_type"] == "stream":
            kept[-1]["text"] += each.text
            continue
        kept.append(dict(each) | ({"execution_count": None} if "execution_count" in each else {}))
    return kept
