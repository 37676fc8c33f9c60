"""The runs of a sweep as their folders and its record of failures have them."""

import functools
import json
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import xarray

from ..aliases import METRICS, current_name
from ..report.result import metric_units as units_of_metrics
from ..run_folder import FAILURES, described, runs_in

_MOST_BYTES = 2**26  # of a file of JSON: beyond it is none of ours
_MOST_READ = 5  # runs whose arrays are opened, each for metrics that no earlier one has


@dataclass(frozen=True)
class SweptJob:
    """One job: its folder within the sweep's or its number, what was typed, what came out, flat,
    and the reason where it failed."""

    place: str
    overrides: Mapping[str, str]
    metrics: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""


def swept_jobs(folder: Path, failures: Mapping[str, Any]) -> list[SweptJob]:
    """The runs in `folder` and the jobs that failed, in order of their numbers."""
    runs = [job for path in runs_in(folder) if (job := _run(folder, path))]
    places = {job.place for job in runs}
    failed = [
        SweptJob(
            # Over an earlier run, which stayed where it was.
            number if number not in places else f"{number} (failed)",
            _overrides(each["overrides"]),
            reason=each["reason"] or "no reason given",
        )
        for number, each in failures.items()
    ]
    return sorted([*runs, *failed], key=lambda job: _in_order(job.place))


def failed_jobs(folder: Path) -> dict[str, Any]:
    """The sweep's own record of failures: overrides and reason by the job's number."""
    document = _json(folder / FAILURES)
    entries = document.items() if isinstance(document, dict) else ()
    return {
        number: each
        for number, each in entries
        if isinstance(each, dict)
        and isinstance(each.get("reason"), str)
        and isinstance(each.get("overrides"), list)
        and all(isinstance(word, str) for word in each["overrides"])
    }


def metric_units(folder: Path, jobs: Sequence[SweptJob]) -> dict[str, str]:
    """Units of the runs' metrics as their `result.nc` have them; missing where none can be read."""
    units: dict[str, str] = {}
    read = 0
    for job in jobs:
        path = folder / job.place / "result.nc"
        if read == _MOST_READ or job.metrics.keys() <= units.keys() or not path.is_file():
            continue
        read += 1
        try:
            with xarray.open_dataset(path, engine="h5netcdf") as data:
                own = units_of_metrics(data)
        except (OSError, ValueError, KeyError):
            continue
        units |= own
    return units


def _run(folder: Path, place: Path) -> SweptJob | None:
    """The run in a folder; None where there is none, or the sweep itself."""
    manifest, metrics = described(place), _json(place / "metrics.json")
    if manifest is None or not isinstance(metrics, dict) or place == folder:
        return None
    words = shlex.split(str(manifest["command"]))
    name = place.relative_to(folder).as_posix()
    return SweptJob(name, _overrides(words), _current(dict(_flat(metrics))))


def _overrides(words: Sequence[str]) -> dict[str, str]:
    """Values by keys of what was typed; of a key that was typed twice, the last."""
    pairs = (word.partition("=") for word in words if "=" in word and not word.startswith("-"))
    return {key.lstrip("+~"): value for key, _, value in pairs}


def _flat(metrics: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in metrics.items():
        if isinstance(value, list):
            value = {str(i): each for i, each in enumerate(value)}
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}_")
        else:
            yield f"{above}{name}".replace("/", "."), value


def _current(metrics: dict[str, Any]) -> dict[str, Any]:
    """Metrics without those that are there under their new names, too."""
    newer = {name: _newer(name) for name in metrics}
    return {n: v for n, v in metrics.items() if newer[n] == n or newer[n] not in metrics}


@functools.cache  # thousands of runs have the same names
def _newer(name: str) -> str:
    return current_name(name, METRICS)


def _in_order(place: str) -> list[tuple[int, int | str]]:
    """Numbers within names by their size."""
    parts = (part for part in re.split(r"(\d+)", place) if part)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]


def _json(path: Path) -> Any:
    try:
        if path.stat().st_size <= _MOST_BYTES:
            return json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        pass
    return None
