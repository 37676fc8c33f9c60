"""The command and its jobs on the project's own configurations, in this process."""

import shlex
from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from srsinv.__main__ import find_config_root, main
from srsinv.command.reads import only_read
from srsinv.namespaces import load_job
from srsinv.report.result import Result
from srsinv.report.words import Paragraph, Table, blocks, summary

ROOT = Path(__file__).resolve().parents[2]


def short_forms() -> dict[str, str]:
    """What to type for a short form of every experiment, by its name in short_forms.yaml."""
    return yaml.safe_load((ROOT / "tests" / "short_forms.yaml").read_text(encoding="utf-8"))


def short_form(name: str) -> tuple[str, ...]:
    """The overrides of one of them."""
    return tuple(
        override.replace("{root}", str(ROOT)) for override in shlex.split(short_forms()[name])
    )


@cache
def short_run(name: str) -> Result:
    """What the short form `name` returns: computed once in a process, for all tests of it."""
    return outcome(*short_form(name))


def short_outcome(name: str, *overrides: str) -> Result:
    """What the short form `name` returns with further overrides."""
    return outcome(*short_form(name), *overrides)


def command(folder: Path | str, *overrides: str) -> int:
    """The exit code of `srsinv OVERRIDES`, its results in `folder`."""
    return main([*overrides, f"hydra.run.dir={folder}"])


def composed(*overrides: str) -> dict[str, Any]:
    """The configuration that the overrides make."""
    with initialize_config_dir(str(find_config_root()), version_base="1.3"):
        cfg = compose("config", list(overrides))
    return cast(dict[str, Any], OmegaConf.to_container(cfg, resolve=True))


def outcome(*overrides: str) -> Result:
    """What the configured job returns, without the command around it and without a page."""
    return result_of(composed(*overrides))


def result_of(cfg: dict[str, Any]) -> Result:
    """What the job of a configuration returns."""
    root = find_config_root()
    return load_job(cfg["job"], root)(only_read(cfg, root))


def tables(result: Result) -> list[Table]:
    """Every table of the page, in order."""
    return [block for block in _blocks(result) if isinstance(block, Table)]


def assumed(result: Result) -> dict[str, Any]:
    """The rows of what was assumed."""
    return dict(tables(result)[-1].rows)


def words(result: Result) -> str:
    """All that is said in sentences: the reasons against the answers, and the page's paragraphs."""
    said = [block.text for block in _blocks(result) if isinstance(block, Paragraph)]
    reasons = np.ravel(result.dataset["reasons"]).tolist() if "reasons" in result.dataset else []
    return " ".join([*reasons, *said])


def _blocks(result: Result) -> list[Any]:
    shown = [each for each in result.sections if each.heading and each.is_met(result.dataset)]
    own = (blocks(each, result.dataset) for each in shown)
    return [*summary(result.sections, result.dataset), *(block for each in own for block in each)]


def check_page(result: Result, images: Collection[str] = ()) -> None:
    """Every variable with its unit, every figure with a caption and a curve drawn (those named in
    `images`: an image), the assumptions last."""
    assert all("units" in variable.attrs for variable in result.dataset.variables.values())
    assert result.sections[-1].heading == "Assumptions"
    for name, (figure, caption) in result.page.figures.items():
        assert caption.endswith("."), name
        drawn = [axes.images if name in images else axes.lines for axes in figure.axes]
        assert any(drawn), name
