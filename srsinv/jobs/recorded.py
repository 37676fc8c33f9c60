"""A recording, the problem of finding what made it, and what their pages say of both."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..effects import NAMES
from ..inverse.problem import Problem
from ..recording import Recording

Rows = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class RecordedProblem:
    """A recording, and the problem of finding what made it."""

    recording: Recording
    problem: Problem

    @property
    def noise_rms(self) -> float:
        """The white noise per sample."""
        return float(self.problem.noise.rms)


def effects_rows(on: Iterable[str]) -> Rows:
    """Rows of a page: which effects are on and off."""
    names = tuple(on)
    off = [name for name in NAMES if name not in names]
    return (("effects on", ", ".join(names) or "none"), ("effects off", ", ".join(off) or "none"))


def times_rows(recording: Recording, times: Any) -> Rows:
    """Rows of a page: samples that are missing, and times that were left out: where `times`, the
    configuration's own word for them, is "ignore"."""
    rows = []
    if recording.missing_rows:
        rows.append((
            "lost rows",
            f"{recording.missing_rows} at {recording.gaps} places, by the time stamps: missing "
            "samples, speed and measured position interpolated there",
        ))  # fmt: skip
    missing = np.isnan(recording.signal)
    empty = int(missing.sum()) - recording.missing_rows * len(recording.channels)
    if empty > 0:
        rows.append(("other missing samples", f"{empty} of {missing.size}"))
    if times == "ignore":
        rate = f"{recording.sample_rate_hz:.6g} Hz"
        rows.append(("times", f"the file's left out: rows taken as even at {rate}, none lost"))
    return tuple(rows)
