"""What the golden files hold: numbers, words, and of arrays their norm and 64 fixed samples.

A case, such as a short form, is one JSON file: a mapping from the name of a quantity to its entry.
The entry of an array is `{"shape", "units", "norm", "samples"}`, those of numbers and words are
themselves. Thirteen digits are written, of which the tightest tolerance compares ten.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

SAMPLES = 64
DIGITS = 13
A_LINE = 6  # samples

Entries = dict[str, Any]


def entry(value: Any, units: str = "1") -> Any:
    """The entry of a number, a word or an array."""
    array = np.asarray(value)
    if array.ndim == 0:
        return _scalar(array.item())
    is_number = array.dtype.kind in "biufc"
    parts = [array.real, array.imag] if array.dtype.kind == "c" else [array]
    chosen = [_scalar(each.item()) for part in parts for each in part.flat[sampled(array.size)]]
    summary = {"shape": list(array.shape), "units": units}
    if is_number:
        finite = np.abs(np.where(np.isfinite(array), array, 0)).astype(float)
        largest = float(finite.max(initial=0.0)) or 1.0  # squares of what is tiny would be nothing
        summary["norm"] = _scalar(largest * float(np.linalg.norm(finite / largest)))
    return summary | {"samples": chosen}


def sampled(size: int) -> np.ndarray:
    """The places of the samples in a flat array of this size: even ones, or all."""
    return np.unique(np.linspace(0, size - 1, min(size, SAMPLES)).round().astype(int))


def place(shape: list[int], sample: int) -> str:
    """Where in an array of this shape a sample stands."""
    size = math.prod(shape)
    places = sampled(size)
    at = np.unravel_index(places[sample % len(places)], shape)
    return str([int(each) for each in at])


def read(path: Path) -> Entries:
    """The entries of a golden file; none where there is no such file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def write(path: Path, entries: Mapping[str, Any]) -> None:
    """Write a golden file: a line for each number, some for each array, so that differences read
    well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [f" {json.dumps(name)}: {_text(entries[name])}" for name in sorted(entries)]
    path.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


def _text(one: Any) -> str:
    if not isinstance(one, Mapping):
        return json.dumps(one, ensure_ascii=False)
    head = json.dumps({key: each for key, each in one.items() if key != "samples"})
    samples = [json.dumps(each, ensure_ascii=False) for each in one["samples"]]
    lines = [", ".join(samples[at : at + A_LINE]) for at in range(0, len(samples), A_LINE)]
    return f'{head[:-1]}, "samples": [\n  ' + ",\n  ".join(lines) + "]}"


def _scalar(value: Any) -> Any:
    """As JSON holds it; what is not finite as a word."""
    if not isinstance(value, float):
        return value if isinstance(value, bool | int | str | None) else str(value)
    return float(f"{value:.{DIGITS - 1}e}") if math.isfinite(value) else str(value)
