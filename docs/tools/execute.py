"""Executes what the pages show, and stores what it prints and draws.

    python -m docs.tools.execute [PAGE ...]

The blocks of a page are executed in order, in a fresh folder that has the example recordings in
`example/`: commands (`sh`) by bash, Python (`python`, code cells) in one session. A block `output`
right behind one holds what it prints. Files of plugins and configurations, whose first line is
their name, are tests' (tests/test_plugins.py).
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from markdown_it import MarkdownIt
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

from .stored import store

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
FILE = re.compile(r"# [\w/]+\.(py|yaml)\n")
SECONDS = 600  # longest time of one block


# Commands of a notebook print as they do into a file, without colours.
PLAIN = "import os; os.environ.pop('FORCE_COLOR', 0); os.environ.pop('CLICOLOR_FORCE', 0)"


class Wrong(Exception):
    """A block that fails, or prints something else than the page says."""


def blocks(text: str) -> Iterator[tuple[str, str]]:
    """The fenced blocks of a page: their language and their text."""
    for token in MarkdownIt().parse(text):
        if token.type == "fence":
            yield token.info.strip(), token.content


def pages() -> list[Path]:
    """All pages that are executed, the README among them."""
    own = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
    return [ROOT / "README.md", *own]


def execute(page: Path, folder: Path) -> None:
    """Execute a page in a folder; raises `Wrong`."""
    text = page.read_text("utf-8")
    cells: list[Any] = []
    notebook = nbformat.v4.new_notebook()
    client = NotebookClient(
        notebook,
        timeout=SECONDS,
        resources={"metadata": {"path": str(folder)}},
        extra_arguments=["--log-level=ERROR"],
    )
    printed = ""
    with client.setup_kernel():
        notebook.cells.append(nbformat.v4.new_code_cell(PLAIN))
        client.execute_cell(notebook.cells[0], 0, store_history=False)
        for language, code in blocks(text):
            if language == "output":
                if printed.strip() != code.strip():
                    raise Wrong(f"printed:\n{printed}\nthe page says:\n{code}")
            elif language == "sh":
                printed = _by_bash(code, folder)
            elif language.startswith(("python", "{code-cell}")) and not FILE.match(code):
                cell = nbformat.v4.new_code_cell(_without_options(code))
                notebook.cells.append(cell)
                try:
                    client.execute_cell(cell, len(notebook.cells) - 1)
                except CellExecutionError as error:
                    raise Wrong(f"{code}\n{error}") from error
                printed = "".join(each.get("text", "") for each in cell.outputs)
                if language.startswith("{code-cell}"):
                    cells.append(cell)
    if cells:
        name = page.relative_to(DOCS).with_suffix("").as_posix().replace("/", "-")
        store(name, cells, folder)


def _without_options(code: str) -> str:
    return re.sub(r"\A(:[\w-]+:.*\n)+", "", code).strip("\n")


def _by_bash(code: str, folder: Path) -> str:
    command = ["bash", "-euo", "pipefail", "-c", code]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=SECONDS, check=False
    )
    if done.returncode:
        raise Wrong(f"{code}\n{done.stdout}{done.stderr}")
    return done.stdout


def main(names: list[str]) -> int:
    """Execute the pages whose path contains one of these words, all of them without one."""
    failed = 0
    examples = Path(tempfile.mkdtemp()) / "example"
    _by_bash(f"srsinv experiment=example_recording hydra.run.dir={examples}", examples.parent)
    for page in pages():
        label = page.relative_to(ROOT).as_posix()
        if names and not any(name in label for name in names):
            continue
        if not any(_is_executed(*each) for each in blocks(page.read_text("utf-8"))):
            continue
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name).resolve()
            shutil.copytree(examples, folder / "example")
            try:
                execute(page, folder)
                print(f"{label}: {time.perf_counter() - began:.0f} s", flush=True)
            except Wrong as wrong:
                failed += 1
                print(f"{label}: WRONG\n{wrong}", flush=True)
    shutil.rmtree(examples.parent)
    return failed


def _is_executed(language: str, code: str) -> bool:
    return language.startswith(("sh", "python", "{code-cell}")) and not FILE.match(code)


if __name__ == "__main__":
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    sys.exit(main(sys.argv[1:]))
