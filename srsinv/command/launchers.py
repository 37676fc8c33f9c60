"""Jobs of a sweep by each of Hydra's launchers, with the outcome of every one.

Hydra's launchers for several processes return nothing where one of these dies, though the other
jobs are done or still running.
"""

import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hydra.core.singleton import Singleton
from hydra.plugins.launcher import Launcher
from omegaconf import OmegaConf

from .outcome import DONE, FAULT, Outcome

# Read once, when numpy and jax are loaded; NPROC is the size of jax's pool of threads on a CPU.
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NPROC")
_PATIENCE_S = 5.0  # for processes that were told to end: submitit gives its own 1 s
_POLL_S = 0.05

Batch = Sequence[Any]  # jobs with their `overrides`
Make = Callable[[Batch], Any]  # the launcher of these jobs, by their order


def batch_size(launcher: Launcher, largest: int | None, jobs: int) -> int:
    """How many jobs are handed to the launcher together: at most `largest` where it is given."""
    # submitit's local executor begins all jobs at once.
    usual = cores() if type(launcher).__name__ == "LocalLauncher" else jobs
    return max(1, min(usual if largest is None else largest, jobs))


def outcomes(make: Make, jobs: Batch, is_done: Callable[[Any], bool]) -> list[Outcome]:
    """What became of each of the `jobs`, by the launcher that `make` gives for them; `is_done` says
    whether the results of a job are in its folder."""
    launcher = make(jobs)
    match type(launcher).__name__:
        case "BasicLauncher":
            return _launched(launcher, jobs)
        case "JoblibLauncher":
            from joblib import effective_n_jobs

            processes = effective_n_jobs(launcher.joblib["n_jobs"])
            with _threads(min(processes, len(jobs))):
                return _in_processes(make, jobs, is_done, processes)
        case "LocalLauncher":
            with _threads(len(jobs)):
                return _submitted(launcher, jobs)
        case _:  # a cluster gives each job its own cores
            return _submitted(launcher, jobs)


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _threads(processes: int) -> Iterator[None]:
    """Divide the cores among `processes` that begin inside: threads of several that each use all
    cores wait for one another. What the user has set stays."""
    each = str(max(1, cores() // processes))
    ours = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(ours, each))
    try:
        yield
    finally:
        for name in ours:
            del os.environ[name]


def _launched(launcher: Any, jobs: Batch) -> list[Outcome]:
    returned = launcher.launch([job.overrides for job in jobs], initial_job_idx=0)
    values = [each._return_value for each in returned]
    for value in values:
        if isinstance(value, Exception):  # what a job raised, without Hydra's own words for that
            raise value
    return values


def _in_processes(
    make: Make, jobs: Batch, is_done: Callable[[Any], bool], processes: int
) -> list[Outcome]:
    """Jobs by joblib, which ends all processes when one of them dies: the jobs that may have been
    running then are launched again, one at a time, and the others as before."""
    try:
        return _launched(make(jobs), jobs)
    except Exception as error:
        if len(jobs) == 1:
            return [_without_result(_how(error))]
    missing = [job for job in jobs if not is_done(job)]
    ends = dict.fromkeys(map(id, jobs), Outcome(DONE))
    for job in missing[:processes]:
        ends[id(job)] = _in_processes(make, [job], is_done, processes)[0]
    if rest := missing[processes:]:
        again = _in_processes(make, rest, is_done, processes)
        ends |= dict(zip(map(id, rest), again, strict=True))
    return [ends[id(job)] for job in jobs]


def _submitted(launcher: Any, jobs: Batch) -> list[Outcome]:
    """Jobs by submitit, each waited for; they are cancelled where the command is stopped."""
    executor = _executor(launcher.params, launcher._EXECUTOR)
    state = Singleton.get_state()
    numbers = range(len(jobs))
    columns = zip(
        *((list(job.overrides), "hydra.sweep.dir", i, str(i), state)
          for i, job in zip(numbers, jobs, strict=True)),
        strict=True,
    )  # fmt: skip
    with _interruptible():
        submitted = executor.map_array(launcher, *columns)
    for job, its in zip(jobs, submitted, strict=True):
        print(f"{job}\n{its.paths.stdout}", flush=True)
    try:
        return [_result(its) for its in submitted]
    except BaseException:
        _cancel(submitted)
        raise


@contextmanager
def _interruptible() -> Iterator[None]:
    """Processes that begin inside can be interrupted, as submitit cancels them, though this one
    ignores SIGINT, as in the background."""
    is_main = threading.current_thread() is threading.main_thread()
    is_ignored = is_main and signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    if is_ignored:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        if is_ignored:
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def _executor(settings: Mapping[str, Any], cluster: str) -> Any:
    """submitit's executor with the launcher's settings, by the names that submitit has for them."""
    import submitit
    from hydra_plugins.hydra_submitit_launcher.config import BaseQueueConf

    common = set(OmegaConf.structured(BaseQueueConf))
    named = {key if key in common else f"{cluster}_{key}": value for key, value in settings.items()}
    at_first = {"folder": _own_folder(named.pop("submitit_folder"))}
    if (retries := f"{cluster}_max_num_timeout") in named:
        at_first[retries] = named.pop(retries)
    executor = submitit.AutoExecutor(cluster=cluster, **at_first)
    executor.update_parameters(**named)
    return executor


def _own_folder(given: str) -> Path:
    """A new folder beside the one that was given, under a name that nobody can guess, for what jobs
    say and return: submitit unpickles, and with that executes, what it finds."""
    parts = Path(given).absolute().parts
    own = next((n for n, part in enumerate(parts) if "%" in part), len(parts))  # %j: of each job
    beside = Path(*parts[:own])
    beside.parent.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(prefix=f"{beside.name}-", dir=beside.parent), *parts[own:])


def _result(submitted: Any) -> Outcome:
    from submitit.core.utils import FailedJobError, UncompletedJobError

    try:
        return submitted.results()[0].return_value
    except (FailedJobError, UncompletedJobError) as error:
        return _without_result(f"{_how(error)}; what it said is in {submitted.paths.stderr}")


def _cancel(submitted: Sequence[Any]) -> None:
    for each in submitted:
        with suppress(Exception):  # it has ended, or the cluster is not there
            each.cancel(check=False)
    latest = time.monotonic() + _PATIENCE_S
    while not all(each.done() for each in submitted) and time.monotonic() < latest:
        time.sleep(_POLL_S)


def _how(error: Exception) -> str:
    """How a process ended, by what its launcher raised."""
    if type(error).__name__ in ("TerminatedWorkerError", "UncompletedJobError"):
        return "killed, out of memory or out of time"
    return f"{type(error).__name__}: {(str(error).strip().splitlines() or [''])[-1]}"


def _without_result(how: str) -> Outcome:
    return Outcome(FAULT, f"its process ended without a result, {how}")
