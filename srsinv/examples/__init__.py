"""The recordings that come with srsinv, by name: `srsinv.invert(srsinv.examples.path(NAME))`.

Each is a file of columns with its sidecar, and the truth that it was simulated from.
"""

import json
from pathlib import Path
from typing import Any

from ..errors import check_name

__all__ = ["names", "path", "truth"]

_FOLDER = Path(__file__).parent
_TRUTH = ".truth.json"


def names() -> list[str]:
    """The names of the bundled recordings."""
    return sorted(each.stem for each in _FOLDER.glob("*.csv"))


def path(name: str) -> Path:
    """The path of the bundled recording `name`.

    `srsinv.load`, `invert` and `fit_recording` take it. Raises `BadInput` for another
    name, with the nearest one.
    """
    check_name("srsinv.examples.path", name, names())
    return _FOLDER / f"{name}.csv"


def truth(name: str) -> dict[str, Any]:
    """What the bundled recording `name` was simulated from, in SI units.

    Returns the feature's kind, its parameters by the names that a fit reports, and the rms of the
    noise. Raises `BadInput` as `path` does.
    """
    return json.loads(path(name).with_suffix(_TRUTH).read_text(encoding="utf-8"))
