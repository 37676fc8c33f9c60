"""A sweep: what is missing of it is run, and what came out of all is gathered."""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from hydra.core.plugins import Plugins
from hydra.types import HydraContext
from omegaconf import DictConfig, OmegaConf

from ..errors import printable, refuse
from ..run_folder import FAILURES, GATHERED, RunRecord, hold, writing
from .folders import RECORD, check_sweep, hint_at_remains, marked, no_empty_folders
from .interrupts import uninterrupted
from .launchers import batch_size, outcomes
from .outcome import DONE, FAULT, REFUSED, Outcome
from .surroundings import printing
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
        f"hydra.sweep.subdir is {inside!r}, the sweep's own folder; leave it out, so "
        "that each run has a folder of its own number",
    )
    check_sweep(folder)
    hint_at_remains(folder)
    with no_empty_folders(folder) as watch, writing(folder), hold(folder) as held:
        jobs = SweepJobs(context, config, task.config_dir)
        wanted = jobs.wanted()
        missing = jobs.missing(wanted, held.place)
        for job in missing:
            if job.place is not None:
                watch(folder / job.place)
        names = {job.configuration for job in wanted}
        record = {RECORD: OmegaConf.to_yaml(config).encode()}
        # The seed as typed: it may be of each job's own.
        seed = cast(dict[str, Any], OmegaConf.to_container(config, resolve=False)).get("seed")

        def put(files: Mapping[str, bytes]) -> None:
            uninterrupted(lambda: held.put_in({**record, **files}, RunRecord(command, seed)))

        def has_results() -> bool:
            return not names.isdisjoint(known_runs(held.place))

        with marked(held, put, has_results):
            failures = _launched(context, task, config, missing, held.place)
        if has_any := has_results():
            check_sweep(folder)  # nothing of the user's came in meanwhile
            put(_gathered(held.place, failures, command))
    if has_any:
        with printing("where the results are", f"they are in {folder.absolute()}"):
            whole = printable(str(folder.absolute()))
            print(f"{whole}/{GATHERED[1]}\n{whole}")
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
    from ..report.files import render

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
        print(f"  {job}: {printable(' '.join(outcome.reason.split()))}", file=sys.stderr)
    if len(failures) > _MOST_NAMED:
        more = len(failures) - _MOST_NAMED
        print(f"  and {more} more, named in {FAILURES}", file=sys.stderr)
