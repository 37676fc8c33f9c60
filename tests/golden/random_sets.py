"""A hundred random sets of overrides: of each of five structures twenty sets of numbers."""

import copy
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from srsinv.errors import BadInput
from tests.golden import scenes
from tests.golden.entries import Entries, entry
from tests.golden.forms import is_time
from tests.jobs.run import composed, result_of

FILE = Path(__file__).parent / "random.yaml"
SEED, STRUCTURES, SETS = 16, 5, 20
SHOWN = ("signal_noise_free", "signal", "estimate", "estimate_stderr")


@cache
def stored() -> dict[str, dict[str, Any]]:
    """By name the `structure` and its `numbers`, a row to each set."""
    return yaml.safe_load(FILE.read_text(encoding="utf-8"))


def draw() -> None:
    """Draw them, once and for all: the file is what counts."""
    rng = np.random.default_rng(SEED)
    drawn = {}
    for i in range(STRUCTURES):
        structure = scenes.structure(rng)
        numbers = [scenes.numbers(rng, structure) for _ in range(SETS)]
        drawn[f"structure_{i}"] = {"structure": structure, "numbers": numbers}
    text = yaml.safe_dump(drawn, sort_keys=False, width=10**6)
    FILE.write_text(f"# Drawn by random_sets.draw, numpy's default_rng({SEED}).\n{text}", "utf-8")


def cases() -> list[str]:
    """The structures."""
    return list(stored())


def entries(name: str) -> Entries:
    """`SET.metrics.NAME`, and `SET.norm.NAME` of some variables; `SET.refused`: the sentence."""
    one, collected = stored()[name], {}
    cfg = composed(*one["structure"].split())
    for i, numbers in enumerate(one["numbers"]):
        # Composing takes longer than such a run: the numbers are put into what is composed once.
        own = copy.deepcopy(cfg)
        for override in numbers.split():
            _put(own, *override.split("="))
        collected |= {f"{i}.{key}": each for key, each in _of(own).items()}
    return collected


def _put(cfg: dict[str, Any], key: str, text: str) -> None:
    *above, last = key.split(".")
    for name in above:
        cfg = cfg[name]
    cfg[last] = json.loads(text)


def _of(cfg: dict[str, Any]) -> Entries:
    try:
        result = result_of(cfg)
    except BadInput as refusal:
        return {"refused": str(refusal)}
    metrics = {
        f"metrics.{key}": entry(each) for key, each in result.metrics.items() if not is_time(key)
    }
    norms = {
        f"norm.{key}": entry(result.dataset[key].values)["norm"]
        for key in SHOWN
        if key in result.dataset
    }
    return metrics | norms
