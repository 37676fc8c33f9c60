"""What golden data are of: cases FAMILY/NAME, and what the tree gives of each.

- `forms`: the short forms of tests/short_forms.yaml, their metrics and their variables.
- `products`: values of operators and models, and products of their Jacobians.
- `public`: the functions of `import srsinv`, as README shows them.
- `random`: sets of random overrides, of random.yaml.
"""

import copy
import json
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from srsinv.errors import BadInput
from srsinv.report.data import METRIC
from tests.golden import products, public
from tests.golden.entries import Entries, entry
from tests.jobs.run import composed, result_of, short_forms, short_run

FOLDER = Path(__file__).parent
DATA = FOLDER / "data"
# In the names of what a clock was read for, and at the end of those of measured memory.
CLOCKED = ("time_s", "_call_s", "fastest", "goal_family", "goal_size", "goal_peer", "cost_s")
WEIGHED = "memory_bytes"
PROFILES = ("signal_noise_free", "signal", "estimate", "estimate_stderr")  # of a random set


class GoldenFamily(NamedTuple):
    """`names()` of its cases; `entries(name)`: what the tree gives of one."""

    names: Callable[[], Iterator[str]]
    entries: Callable[[str], Entries]


def cases() -> Iterator[str]:
    """FAMILY/NAME of everything."""
    return (f"{family}/{name}" for family, each in FAMILIES.items() for name in each.names())


def entries(case: str) -> Entries:
    """What the tree gives of FAMILY/NAME."""
    family, _, name = case.partition("/")
    return FAMILIES[family].entries(name)


def file(case: str) -> Path:
    """Where the golden data of FAMILY/NAME are."""
    return DATA / f"{case}.json"


def is_measured(name: str) -> bool:
    """Whether a quantity is a time or a memory, and so is another in every run."""
    return any(each in name for each in CLOCKED) or name.endswith(WEIGHED)


def put(cfg: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A copy of a composed configuration whose `key` is `value`: composing takes longer than many
    a run."""
    whole = node = copy.deepcopy(cfg)
    *above, last = key.split(".")
    for name in above:
        node = node[name]
    node[last] = value
    return whole


def _form(name: str) -> Entries:
    """`metrics.NAME` and `variables.NAME`."""
    result = short_run(name)
    metrics = {f"metrics.{key}": entry(value) for key, value in result.metrics.items()}
    variables = {
        f"variables.{key}": entry(each.values, each.attrs["units"])
        for key, each in result.dataset.variables.items()
        if each.ndim or METRIC not in each.attrs  # a single metric is among the metrics
    }
    return {key: each for key, each in (metrics | variables).items() if not is_measured(key)}


@cache
def _random() -> Mapping[str, Mapping[str, Any]]:
    """By name the `structure`, and `numbers`, a row of overrides to each set."""
    return yaml.safe_load((FOLDER / "random.yaml").read_text(encoding="utf-8"))


def _random_sets(name: str) -> Entries:
    """`SET.metrics.NAME`, and `SET.norm.NAME` of the profiles; `SET.refused`: the sentence."""
    structure, collected = composed(*_random()[name]["structure"].split()), {}
    for i, numbers in enumerate(_random()[name]["numbers"]):
        cfg = structure
        for key, _, text in (override.partition("=") for override in numbers.split()):
            cfg = put(cfg, key, json.loads(text))
        collected |= {f"{i}.{key}": each for key, each in _random_set(cfg).items()}
    return collected


def _random_set(cfg: dict[str, Any]) -> Entries:
    try:
        result = result_of(cfg)
    except BadInput as refusal:
        return {"refused": str(refusal)}
    metrics = {f"metrics.{key}": entry(each) for key, each in result.metrics.items()}
    data = result.dataset
    norms = {f"norm.{key}": entry(data[key].values)["norm"] for key in PROFILES if key in data}
    return {key: each for key, each in (metrics | norms).items() if not is_measured(key)}


FAMILIES = {
    "forms": GoldenFamily(lambda: iter(short_forms()), _form),
    "products": GoldenFamily(lambda: iter(products.MODELS), products.entries),
    "public": GoldenFamily(lambda: iter(public.SCRIPTS), public.entries),
    "random": GoldenFamily(lambda: iter(_random()), _random_sets),
}
