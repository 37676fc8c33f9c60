"""The runs of a sweep as their folders and its record of failures have them.

Anybody may have made a folder: what it holds is checked against what srsinv writes, and is only
ever text and numbers. A run with anything else is listed with the reason, as one that failed.
"""

import itertools
import os
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import BadInput, is_number, printable, refuse
from ..files import open_file, read_json
from ..recording.formats.result import UnitsByPattern
from ..report.data import units_of_metrics
from ..run_folder import FAILURES, MANIFEST, METRICS_FILE, MOST_OF_METRICS, described_runs

_KEY = "gather.folder"
_MOST_OF_ALL = 2**26  # bytes of the metrics of all runs
_MOST_OF_FAILURES = 2**26
_MOST_METRICS = 5_000  # of a run
_MOST_NAMES = 10_000  # of metrics, and of settings, in all runs
_MOST_READ = 5  # runs whose arrays are opened, each for metrics that no earlier one has
_DEEPEST = 20  # folders, mappings and lists within each other
_LONGEST_NAME, _LONGEST_TEXT, _LONGEST_COMMAND = 200, 1_000, 100_000  # characters
_LARGEST = 1e100  # a number that plots and sums still take
_SETTING = re.compile(r"[+~]{0,2}([A-Za-z_][\w./@:$-]*)=(.*)", re.ASCII | re.DOTALL)


@dataclass(frozen=True)
class SweptJob:
    """One job: its folder within the sweep's or its number, what was typed, what came out, flat,
    and the reason where it failed."""

    place: str
    overrides: Mapping[str, str]
    metrics: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    folder: Path | None = None


def swept_jobs(folder: Path, failures: Mapping[str, Any]) -> list[SweptJob]:
    """The runs in `folder` and the jobs that failed, in order of their numbers.

    Raises `BadInput` for a folder that is too large to be a sweep's.
    """
    runs, size = [], 0
    for place, manifest in described_runs(folder):
        metrics = place / METRICS_FILE
        if place == folder or not os.path.lexists(metrics):
            continue
        size += min(metrics.lstat().st_size, MOST_OF_METRICS)  # a longer one is not read
        refuse(
            size > _MOST_OF_ALL,
            f"{_text(str(folder))}: its {METRICS_FILE} files have more than "
            f"{_MOST_OF_ALL} bytes together: give the folder of one sweep.",
        )
        runs.append(_run(folder, place, manifest))
    places = {job.place for job in runs}
    failed = [
        SweptJob(
            # Over an earlier run, which stayed where it was.
            number if number not in places else f"{number} (failed)",
            _overrides(each["overrides"]),
            reason=_text(each["reason"]) or "no reason given",
        )
        for number, each in failures.items()
    ]
    jobs = sorted([*runs, *failed], key=lambda job: _in_order(job.place))
    for what in ("metrics", "overrides"):
        names = {name for job in jobs for name in getattr(job, what)}
        refuse(
            len(names) > _MOST_NAMES,
            f"{_text(str(folder))}: its runs have {len(names)} different {what}, above "
            f"the limit of {_MOST_NAMES}: give the folder of one sweep.",
        )
    return jobs


def failed_jobs(folder: Path) -> dict[str, Any]:
    """The sweep's own record of failures: overrides and reason by the job's number.

    Raises `BadInput` for one that is not as srsinv writes it.
    """
    path = folder / FAILURES
    if not os.path.lexists(path):
        return {}
    what, most = "record of failures", _MOST_OF_FAILURES
    document = read_json(path, what=what, key=_KEY, most=most, below=folder)
    entries = document if isinstance(document, dict) else {"": document}
    for number, each in entries.items():
        refuse(
            not _is_failure(number, each),
            f"{_text(str(path))}: entry {_text(number)!a} is not as srsinv writes it: "
            "move this file away to gather without the failed runs.",
        )
    return entries


def _is_failure(number: str, entry: Any) -> bool:
    return (
        bool(re.fullmatch(r"\d{1,9}", number, re.ASCII))
        and isinstance(entry, dict)
        and isinstance(entry.get("reason"), str)
        and isinstance(entry.get("overrides"), list)
        and all(isinstance(word, str) for word in entry["overrides"])
    )


def metric_units(jobs: Iterable[SweptJob]) -> dict[str, str]:
    """Units of the runs' metrics as their `result.nc` have them; missing where none can be read."""
    units: dict[str, str] = {}
    read = 0
    for job in jobs:
        unknown = job.metrics.keys() - units.keys()
        if read == _MOST_READ or not unknown or job.folder is None:
            continue
        read += 1
        try:
            with open_file(job.folder / "result.nc", key=_KEY, below=job.folder) as file:
                patterns = UnitsByPattern().read(file).sidecar
        except (BadInput, EOFError, MemoryError):
            continue
        units |= units_of_metrics(patterns, unknown)
    return {name: unit for name, unit in units.items() if _is_name(unit)}


def _run(folder: Path, place: Path, manifest: Mapping[str, Any] | None) -> SweptJob:
    """The run in the folder `place`, which has this manifest, or why it is none."""
    job = SweptJob(_text(place.relative_to(folder).as_posix()), {})
    command = None if manifest is None else manifest["command"]
    try:
        if not isinstance(command, str) or len(command) > _LONGEST_COMMAND:
            raise ValueError(f"{MANIFEST} is not as srsinv writes it")
        job = SweptJob(job.place, _overrides(shlex.split(command)))
        metrics = read_json(
            place / METRICS_FILE,
            what="file of metrics",
            key=_KEY,
            most=MOST_OF_METRICS,
            below=folder,
        )
        if not isinstance(metrics, dict):
            raise ValueError(f"{METRICS_FILE} holds no metrics by their names")
        found = list(itertools.islice(_flat(metrics), _MOST_METRICS + 1))
        if len(found) > _MOST_METRICS:
            raise ValueError(f"{METRICS_FILE} has more than {_MOST_METRICS} metrics")
        flat = dict(map(_checked, found))
    except (ValueError, RecursionError) as error:
        return SweptJob(job.place, job.overrides, reason=f"left out: {_text(str(error))}")
    return SweptJob(job.place, job.overrides, flat, folder=place)


def _checked(metric: tuple[str, Any]) -> tuple[str, Any]:
    """A metric's name and value. Raises `ValueError` for what srsinv would not write."""
    name, value = metric
    if not _is_name(name):
        raise ValueError(f"{METRICS_FILE} has the name {_text(name)!a}, which is none of a metric")
    is_word = value is None or isinstance(value, bool)
    if not is_word and not isinstance(value, str):
        is_word = is_number(value) and abs(value) <= _LARGEST
    elif isinstance(value, str):
        is_word = value.isprintable() and len(value) <= _LONGEST_TEXT
    if not is_word:
        raise ValueError(f"{METRICS_FILE} has no number or short text as {name}")
    return name, value


def _is_name(name: str) -> bool:
    """Whether this can be the name of a metric, as such and in a file."""
    short = 0 < len(name) <= _LONGEST_NAME and name == name.strip()
    return short and name.isprintable() and not set(name) <= {"."}


def _text(text: str) -> str:
    """Text of a folder on one line, for a terminal and a page, cut short."""
    text = printable(" ".join(text[: 2 * _LONGEST_TEXT].split()))
    return text if len(text) <= _LONGEST_TEXT else f"{text[:_LONGEST_TEXT]}…"


def _overrides(words: Sequence[str]) -> dict[str, str]:
    """Values by keys of what was typed; of a key that was typed twice, the last."""
    typed = (match for word in words if (match := _SETTING.fullmatch(word)))
    return {each[1]: _text(each[2]) for each in typed if len(each[1]) <= _LONGEST_NAME}


def _flat(metrics: Mapping[str, Any], above: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    if depth > _DEEPEST:
        raise RecursionError(f"{METRICS_FILE} is nested too deeply")
    for name, value in metrics.items():
        if isinstance(value, list):
            value = {str(i): each for i, each in enumerate(value)}
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}_", depth + 1)
        else:
            yield f"{above}{name}".replace("/", "."), value


def _in_order(place: str) -> list[tuple[int, int | str]]:
    """Numbers within names by their size."""
    parts = (part for part in re.split(r"(\d+)", place) if part)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]
