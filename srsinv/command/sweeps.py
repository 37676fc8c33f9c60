"""A sweep: what is missing of it is run, and what came out of all is gathered."""

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from hydra.core.plugins import Plugins
from hydra.types import HydraContext
from omegaconf import DictConfig, OmegaConf

from ..errors import refuse
from ..run_folder import FAILURES, GATHERED, hold, recover, writing
from .folders import check_sweep, no_empty_folders, recorded
from .launchers import batch_size, outcomes
from .outcome import DONE, FAULT, REFUSED, Outcome
from .sweep_jobs import SweepJob, SweepJobs, is_done, known_runs

_MOST_NAMED = 20  # failures that are printed; all are on the page

Failures = Sequence[tuple[SweepJob, Outcome]]


def sweep(context: HydraContext, task: Any, config: DictConfig, command: str) -> int:
    """The jobs of a sweep that are missing in its folder, and what they all gave gathered there;
    its exit code. Every job runs, whatever the outcome of others; a fault outranks a refusal.

    `task` is the `LaunchedTask`, `command` as typed. Raises `BadInput` for a folder that cannot be
    used, and where a job cannot be composed.
    """
    folder = Path(config.hydra.sweep.dir)
    inside = cast(dict[str, Any], OmegaConf.to_container(config.hydra.sweep))["subdir"]  # as typed
    refuse(
        os.path.normpath(str(inside)) == ".",
        f"hydra.sweep.subdir is {inside!r}, the sweep's own folder; leave it out, and each run has "
        "one by its number",
    )
    check_sweep(folder)
    with no_empty_folders(folder, inside=True), writing(folder), hold(folder) as space:
        recover(space.folder)
        jobs = SweepJobs(context, config, task.config_dir)
        wanted = jobs.wanted()
        missing = jobs.missing(wanted, space.folder)
        names = {job.configuration for job in wanted}

        def has_results() -> bool:
            return not names.isdisjoint(known_runs(space.folder))

        with recorded(space, config, command, has_results) as put:
            try:
                failures = _launched(context, task, config, missing, space.folder)
            finally:
                recover(space.folder)  # what is left of processes that were killed
            if has_any := has_results():
                put(_gathered(space.folder, failures, command))
    if has_any:
        print(f"{folder.absolute() / GATHERED[1]}\n{folder.absolute()}", flush=True)
    _say(failures, len(wanted))
    codes = [outcome.code for _, outcome in failures]
    return next((code for code in (FAULT, REFUSED) if code in codes), DONE)


def _launched(
    context: HydraContext,
    task: Any,
    config: DictConfig,
    jobs: Sequence[SweepJob],
    folder: Path,
) -> Failures:
    """Run the jobs by the launcher of the configuration, in batches; those that failed."""

    def launcher(batch: Sequence[SweepJob]) -> Any:
        numbered = replace(task, places=tuple((job.number, job.place) for job in batch))
        return Plugins.instance().instantiate_launcher(
            hydra_context=context, task_function=numbered, config=config
        )

    size = batch_size(launcher(jobs), config.hydra.sweeper.max_batch_size, len(jobs))
    failures = []
    for start in range(0, len(jobs), size):
        batch = jobs[start : start + size]
        ends = outcomes(launcher, batch, lambda job: is_done(job, folder))
        pairs = zip(batch, ends, strict=True)
        failures += [(job, outcome) for job, outcome in pairs if not outcome.is_done]
    return failures


def _gathered(folder: Path, failures: Failures, command: str) -> dict[str, bytes]:
    """The data set and the page of all runs in a sweep's folder, and the record of failures."""
    from ..jobs.gather import gathered
    from ..report.page import render

    reasons = {
        str(job.number): {"overrides": list(job.overrides), "reason": outcome.reason}
        for job, outcome in failures
    }
    files = render(gathered(folder, reasons), {}, command)
    record = json.dumps(reasons, indent=2, ensure_ascii=False).encode()
    return {name: files[name] for name in GATHERED} | ({FAILURES: record} if reasons else {})


def _say(failures: Failures, jobs: int) -> None:
    """Name the jobs that failed on standard error."""
    if not failures:
        return
    print(
        f"srsinv: {len(failures)} of {jobs} jobs failed; the same command runs these again",
        file=sys.stderr,
    )
    for job, outcome in failures[:_MOST_NAMED]:
        print(f"  {job}: {' '.join(outcome.reason.split())}", file=sys.stderr)
    if len(failures) > _MOST_NAMED:
        more = len(failures) - _MOST_NAMED
        print(f"  and {more} more, named in {FAILURES}", file=sys.stderr)
