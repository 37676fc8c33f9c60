"""The sentences of refusals: of what is typed, and of values put into a composed configuration.

What is refused is data in refusals.yaml, beside the sentence that was given last: `jobs`, what is
typed for each; `typed`, [what is typed, exit code, sentence]; `configured`, [job, key, value,
sentence]. Sentences name no folder of the machine: the current one is {here}, the clone {root}.
"""

import contextlib
import io
import os
import shlex
import shutil
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from srsinv.__main__ import main
from srsinv.errors import BadInput
from tests.golden.cases import put
from tests.jobs.run import ROOT, composed, result_of

FOLDER = Path(__file__).parent
FILE = FOLDER / "refusals.yaml"
NOT_REFUSED = "not refused"
PARTS = ("typed", "configured")


def stored() -> dict[str, Any]:
    """What the file has."""
    return yaml.safe_load(FILE.read_text(encoding="utf-8"))


def now(old: Mapping[str, Any], parts: Collection[str] = PARTS) -> dict[str, Any]:
    """The same with the sentences that are given now in these parts."""
    updated = dict(old)
    with _recordings() as here:
        if "typed" in parts:
            updated["typed"] = [[words, *_typed(words, here)] for words, *_ in old["typed"]]
        if "configured" in parts:
            asked = {job for job, *_ in old["configured"]}
            jobs = {name: composed(*shlex.split(old["jobs"][name])) for name in asked}
            updated["configured"] = [
                [job, key, value, _configured(put(jobs[job], key, value), here)]
                for job, key, value, _ in old["configured"]
            ]
    return updated


def changed(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[tuple[Any, Any]]:
    """The refusals that are other ones, as they were and as they are."""
    return [
        (was, now)
        for part in PARTS
        for was, now in zip(old[part], new[part], strict=True)
        if was != now
    ]


def write(content: Mapping[str, Any]) -> None:
    """Write the file, a case to a line."""
    lines = ["# The sentence of every refusal; what stands before it is what is refused.", "jobs:"]
    lines += [f"  {name}: {_flow(words)}" for name, words in content["jobs"].items()]
    for part in PARTS:
        lines += [f"{part}:", *(f"- {_flow(case)}" for case in content[part])]
    FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


@contextlib.contextmanager
def _recordings() -> Iterator[str]:
    """A current folder with the recordings that refusals read."""
    with TemporaryDirectory() as folder, contextlib.chdir(folder):
        shutil.copytree(FOLDER / "inputs", folder, dirs_exist_ok=True)
        yield os.path.realpath(folder)


def _typed(words: str, here: str) -> tuple[int, str]:
    """The exit code and the sentence of `srsinv WORDS`, as a shell would split them."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = main([*shlex.split(words), f"hydra.run.dir={here}/run"])
    return code, _anywhere(said.getvalue().strip(), here)


def _configured(cfg: dict[str, Any], here: str) -> str:
    """The sentence of a configuration."""
    try:
        result_of(cfg)
    except BadInput as refusal:
        return _anywhere(str(refusal), here)
    return NOT_REFUSED


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
    return text.removesuffix("\n...\n").rstrip("\n")


def _anywhere(text: str, here: str) -> str:
    return text.replace(here, "{here}").replace(str(ROOT), "{root}")
