"""What came out of the runs of a sweep against what was varied, as one data set and one page.

Only `run.json` and `metrics.json` of each run are read (thousands in seconds), and the `result.nc`
of a few runs for the units of the metrics, which the names alone do not always tell. A run whose
files are not as srsinv writes them is listed with those that failed.
"""

import itertools
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from .. import config
from ..errors import LARGEST, echo, printable, refuse
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import in_words, quantity, spoken, suffix, unit_of
from ..run_folder import GATHERED
from ._swept import SweptJob, failed_jobs, metric_units, swept_jobs

MOST_SHOWN = 6  # metrics in figures and in the table, unless they are chosen
_TIMES = re.compile(r"(^|_)(call|time)_s(_|$)")  # differ from run to run, whatever is varied
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)
# Names in the dataset that no metric and no setting can have.
_TAKEN = {"job", "jobs", "jobs_failed", "setting", "status", "reason", "shown", "metric_shown"}
_SAME = 1e-9  # relative: rounding, not an outcome


def run(cfg: config.Config) -> Result:
    """The job: read the runs in `gather.folder`, gather them."""
    given = config.part(cfg, "gather")
    name = given.get("folder")
    is_folder = isinstance(name, str) and os.path.isdir(name)
    refuse(not is_folder, f"gather.folder is {echo(name)}: give the folder of a sweep.")
    folder, chosen = Path(str(name)), given.get("metrics")
    refuse(
        not (chosen is None or isinstance(chosen, list)),
        f"gather.metrics is {echo(chosen)}: give a list of names of metrics, or null.",
    )
    return gathered(folder, failed_jobs(folder), chosen)


def gathered(
    folder: Path, failures: Mapping[str, Any], chosen: Sequence[str] | None = None
) -> Result:
    """The runs in a sweep's `folder`, and the jobs that failed: their overrides and the reason by
    their number. `chosen` are the metrics to show, by default those that say most.

    Raises `BadInput` for a folder without runs, and for a metric that no run has.
    """
    jobs = swept_jobs(folder, failures)
    done = [job for job in jobs if not job.reason]
    first_reason = f" ({jobs[0].place}: {jobs[0].reason})" if jobs else ""
    refuse(
        not done,
        f"{printable(str(folder))} has no runs of srsinv{first_reason}: give the "
        "folder of a sweep, which has one folder for each run.",
    )
    keys, units = _varied(jobs), metric_units(done)
    every = dict.fromkeys(itertools.chain.from_iterable(job.metrics for job in done))
    metrics = {name: units.get(name) or unit_of(name) for name in every}
    # A setting that is a metric, too, stays the setting's.
    data = dataset(
        {
            **{_free(name): ("job", *_column(name, jobs, each)) for name, each in metrics.items()
               if _free(name) not in keys},
            "setting": ("job", [_setting(job, keys) for job in jobs], "1"),
            "status": ("job", ["failed" if job.reason else "done" for job in jobs], "1"),
            "reason": ("job", [job.reason for job in jobs], "1"),
            **scalars({"jobs": len(jobs), "jobs_failed": len(jobs) - len(done)}),
        },
        {"job": ([job.place for job in jobs], "1")}
        | {name: ("job", *values) for name, values in keys.items()},
    )  # fmt: skip
    names = _drawn_metrics(data, list(keys), chosen)
    data = data.assign(shown=xarray.Variable("metric_shown", names, {"units": "1"}))
    data.attrs["is_grid"] = int(_is_grid(jobs, keys))
    return Result(
        _title(data, list(keys), names),
        data,
        sections("gather"),
        data_name=GATHERED[0],
        page_name=GATHERED[1],
    )


# --- columns ---------------------------------------------------------------------------------


def _varied(jobs: Sequence[SweptJob]) -> dict[str, tuple[Any, str]]:
    """Values and units of every override that is not the same in all jobs, numbers as numbers."""
    keys = dict.fromkeys(itertools.chain.from_iterable(job.overrides for job in jobs))
    columns = {key: [job.overrides.get(key) for job in jobs] for key in keys}
    return {
        _free(key.replace("/", ".")): _typed(values, unit_of(key))
        for key, values in columns.items()
        if len(set(values)) > 1
    }


def _free(name: str) -> str:
    """A name that the dataset has no other use for."""
    return f"{name}_" if name in _TAKEN else name


def _typed(values: Sequence[str | None], units: str) -> tuple[Any, str]:
    """Typed overrides as numbers where each is one, NaN where a job has none; else as text."""
    if all(each in (None, "null") or _NUMBER.fullmatch(each) for each in values):
        numbers = np.array([np.nan if each in (None, "null") else float(each) for each in values])
        if not np.any(np.abs(numbers) > LARGEST):
            return numbers, units
    return ["" if each is None else each for each in values], "1"


def _column(name: str, jobs: Sequence[SweptJob], units: str) -> tuple[Any, str]:
    """A metric over the jobs: NaN, or of words nothing, where a job has none."""
    values = [job.metrics.get(name) for job in jobs]
    if all(each is None or isinstance(each, int | float) for each in values):
        return np.array([np.nan if each is None else float(each) for each in values]), units
    return ["" if each is None else str(each) for each in values], "1"


def _is_grid(jobs: Sequence[SweptJob], keys: Mapping[str, tuple[Any, str]]) -> bool:
    """Whether there is one job for each combination of the varied values."""
    columns = [[str(each) for each in values] for values, _ in keys.values()]
    combinations = set(zip(*columns, strict=True))
    levels = int(np.prod([len(set(column)) for column in columns]))
    return len(combinations) == levels == len(jobs)


# --- words -----------------------------------------------------------------------------------


def _drawn_metrics(
    data: xarray.Dataset, keys: Sequence[str], chosen: Sequence[str] | None
) -> list[str]:
    """The metrics to show: errors first, then what has a unit; none that is the same in all jobs,
    that is a time or a standard error."""
    numeric = [
        str(name)
        for name, each in data.data_vars.items()
        if each.dims == ("job",) and each.dtype.kind == "f"
    ]
    if chosen is not None:
        for name in chosen:
            refuse(
                name not in numeric,
                f"gather.metrics names {echo(name)}, which is not a number of these runs: "
                f"choose from {', '.join(numeric[:20])}.",
            )
        return list(chosen)
    names = [
        name
        for name in numeric
        if not (_TIMES.search(name) or name.endswith("_stderr")) and _differs(data[name].values)
    ]
    names.sort(key=lambda name: (not name.startswith("error"), data[name].attrs["units"] == "1"))
    return names[:MOST_SHOWN]


def _differs(values: np.ndarray) -> bool:
    finite = values[np.isfinite(values)]
    return finite.size > 1 and bool(np.ptp(finite) > _SAME * np.max(np.abs(finite)))


def _title(data: xarray.Dataset, keys: Sequence[str], names: Sequence[str]) -> str:
    """How far the first metric goes, and where its ends are."""
    jobs, failed = data.sizes["job"], int(data["jobs_failed"])
    count = f"{jobs - failed} of {jobs} jobs" if failed else f"{jobs} jobs"
    if not names:
        varied = ", ".join(map(in_words, keys)) or "one setting"
        return f"{count} over {varied}: no metric differs"
    values, units = data[names[0]].values, data[names[0]].attrs["units"]
    low, high = (
        f"{quantity(float(values[at]), units)} ({_job_in_words(data.isel(job=at), keys)})"
        for at in (np.nanargmin(values), np.nanargmax(values))
    )
    name = in_words(names[0])
    return f"{name[:1].upper()}{name[1:]} goes from {low} to {high} in {count}"


def _job_in_words(job: xarray.Dataset, keys: Sequence[str]) -> str:
    """What was varied in one job, in words: `signal-to-noise ratio 40 dB, scene ridge`."""
    words = (
        f"{in_words(key)} {spoken(job[key].item())}{suffix(job[key].attrs['units'])}"
        for key in keys
    )
    return ", ".join(words) or str(job["setting"].item())


def _setting(job: SweptJob, keys: Iterable[str]) -> str:
    """What was varied, as it was typed for one job."""
    typed = {_free(key.replace("/", ".")): value for key, value in job.overrides.items()}
    words = (f"{key}={typed[key]}" for key in keys if key in typed)
    return ", ".join(words) or f"job {job.place}"
