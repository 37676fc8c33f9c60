"""Passes over known surfaces: a folder of recordings, each with its traction beside it (without
jax).

Beside the recording `NAME.csv`, with its sidecar `NAME.yaml`, stands `NAME.traction.csv`: columns
`position_m` [m], `p_Pa` and `q_Pa` [Pa], the pressure and the shear along the scan.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..errors import check_name, number, refuse
from ..files import path_of, quoted
from ._sidecar import SUFFIXES as SIDECARS
from .flat_columns import load_columns

KEY, END = "bands.passes", ".traction.csv"
KEYS = "passes", "confidence", "share"
COLUMNS = "position_m", "p_Pa", "q_Pa"
WANTED = f"recordings whose NAME{END} has the columns {', '.join(COLUMNS)}"
MOST_PASSES = 10_000  # in a folder: an inversion of each takes a second


class KnownPass(NamedTuple):
    """The recording at `path`, and its traction: `position_m` (n,) [m], which increases, and p and
    q there, `traction_Pa` (2, n)."""

    path: Path
    position_m: Float[np.ndarray, " n"]
    traction_Pa: Float[np.ndarray, "2 n"]

    @classmethod
    def beside(cls, path: Path) -> "KnownPass":
        """Raises `BadInput` for a traction that cannot be read, and for positions that do not
        increase."""
        file = path.with_name(path.stem + END)
        columns = load_columns(file, COLUMNS, KEY, WANTED)
        position_m, p, q = columns.values()
        refuse(
            position_m.size < 2 or not np.all(np.diff(position_m) > 0),
            f"{quoted(file.name)}: position_m does not increase from row to row: sort the rows, "
            "and give one for each position.",
        )
        return cls(path, position_m, np.stack([p, q]))

    def cell_means(self, edges_m: Float[np.ndarray, " edge"]) -> Float[np.ndarray, "2 cell"]:
        """The mean traction [Pa] in cells between these edges, linear between the positions and
        constant beyond them."""
        at = np.union1d(edges_m, self.position_m)
        values = np.stack([np.interp(at, self.position_m, row) for row in self.traction_Pa])
        steps = np.diff(at) * (values[:, 1:] + values[:, :-1]) / 2
        integral = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
        return np.diff(integral[:, np.searchsorted(at, edges_m)], axis=1) / np.diff(edges_m)


class CalibrationPasses(NamedTuple):
    """Passes to calibrate bands on, with the `confidence` and the `share` of cells asked for."""

    passes: tuple[KnownPass, ...]
    confidence: float
    share: float

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "CalibrationPasses | None":
        """Those of `bands` in the configuration; None where it has none.

        Raises `BadInput` for numbers out of their range, a folder that cannot be read, a recording
        without its traction, and fewer passes than the confidence needs.
        """
        if settings.get("passes") is None:
            for key in settings:
                refuse(key != "passes", f"bands.{key} needs passes: give bands=conformal.")
            return None
        for key in settings:
            check_name("bands", key, KEYS)
        confidence, share = (
            _fraction(f"bands.{key}", settings.get(key, 0.9)) for key in ("confidence", "share")
        )
        paths = _recordings(path_of(settings["passes"], KEY))
        check_count(len(paths), confidence)
        return cls(tuple(map(KnownPass.beside, paths)), confidence, share)


def check_count(passes: int, confidence: float) -> None:
    """Refuse fewer passes than a confidence needs: of K passes and a further one, the score of the
    further one is the largest with probability 1 / (K + 1)."""
    needed = math.ceil(confidence / (1 - confidence) - 1e-9)
    refuse(
        passes < needed,
        f"{passes} passes are too few for a confidence of {confidence:g}: give {needed} or more, "
        "or a lower confidence.",
    )


def _fraction(key: str, given: Any) -> float:
    return float(number(key, given, "a number between 0 and 1", above=0, below=1))


def _recordings(folder: Path) -> list[Path]:
    """The recordings in a folder, in the order of their names: all files but tractions, sidecars
    and hidden ones."""
    name = quoted(folder.name)
    refuse(
        not folder.is_dir(),
        f"{KEY} is {name}, and there is no such folder: give the folder of {WANTED}.",
    )
    files = [each for each in sorted(folder.iterdir()) if not each.name.startswith(".")]
    refuse(len(files) > MOST_PASSES, f"{name} holds more than {MOST_PASSES} files: give fewer.")
    found = [
        each
        for each in files
        if not each.name.endswith(END) and each.suffix.lower() not in SIDECARS
    ]
    refuse(not found, f"{name} holds no recording: put {WANTED} into it.")
    for each in found:
        refuse(
            not each.with_name(each.stem + END).is_file(),
            f"{quoted(each.name)} has no known traction: put {quoted(each.stem + END)} beside it, "
            f"with the columns {', '.join(COLUMNS)}, or move the recording out of {name}.",
        )
    return found
