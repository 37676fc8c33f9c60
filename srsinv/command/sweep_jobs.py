"""The jobs of a sweep, and which of them its folder lacks."""

import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import HydraContext
from omegaconf import DictConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from .. import __version__
from ..errors import BadInput, printable, refuse
from ..run_folder import METRICS_FILE, MOST_OF_METRICS, described, described_runs, has
from .identity import identity, resolved


@dataclass(frozen=True)
class SweepJob:
    """One job of a sweep.

    - `number`: Hydra's `hydra.job.num`.
    - `place`: its folder within the sweep's; None where only the job itself knows it.
    - `configuration`: what it is known by; None where its configuration cannot be resolved.
    """

    number: int
    overrides: tuple[str, ...]
    place: str | None
    configuration: str | None

    def __str__(self) -> str:
        return f"job {self.number}: {printable(' '.join(self.overrides))}"


@dataclass(frozen=True)
class SweepJobs:
    """Composes the jobs of a sweep as its launcher will.

    - `config`: the sweep's; `config_dir`: the user's folder of options and plugins.
    """

    context: HydraContext
    config: DictConfig
    config_dir: str | None

    def wanted(self) -> list[SweepJob]:
        """Every job of the sweep, each configuration once. Raises `BadInput` where one cannot be
        composed."""
        parser = OverridesParser.create(config_loader=self.context.config_loader)
        typed = parser.parse_overrides(overrides_of(self.config))
        (batch,) = BasicSweeper.split_arguments(typed, None)
        jobs = [self._job(number, tuple(overrides)) for number, overrides in enumerate(batch)]
        first: dict[str | int, SweepJob] = {}
        for job in jobs:
            first.setdefault(job.configuration or job.number, job)
        return list(first.values())

    def missing(self, wanted: Sequence[SweepJob], folder: Path) -> list[SweepJob]:
        """Those of the jobs that `folder` has no run of, each in a folder of its own: the one of
        its number, or of a later one where that folder has another wanted run.

        Raises `BadInput` where two would have the same.
        """
        known = known_runs(folder)
        taken = {known[job.configuration] for job in wanted if job.configuration in known}
        later = itertools.count(len(wanted))
        jobs = []
        for job in wanted:
            if job.configuration in known:
                continue
            own = self._with_free_folder(job, later, taken, folder) if job.place in taken else job
            refuse(
                own.place in taken,
                f"two runs of this sweep would share {folder / str(own.place)}; leave "
                "hydra.sweep.subdir out, so that each run has a folder of its own number",
            )
            if own.place is not None:
                taken.add(own.place)
            jobs.append(own)
        return jobs

    def _job(self, number: int, overrides: tuple[str, ...]) -> SweepJob:
        before = HydraConfig.instance().cfg
        try:
            composed = self._composed(number, overrides)
            HydraConfig.instance().set_config(composed)
            return SweepJob(number, overrides, _place(composed), self._configuration(composed))
        finally:
            HydraConfig.instance().cfg = before

    def _composed(self, number: int, overrides: Sequence[str]) -> DictConfig:
        composed = self.context.config_loader.load_sweep_config(self.config, list(overrides))
        with read_write(composed.hydra), open_dict(composed.hydra.job):
            composed.hydra.job.num = number
        return composed

    def _configuration(self, composed: DictConfig) -> str | None:
        settings = OmegaConf.masked_copy(composed, [str(key) for key in composed if key != "hydra"])
        try:
            return identity(resolved(settings), self.config_dir)
        except BadInput:  # the job itself is refused by the same sentence
            return None

    def _with_free_folder(
        self, job: SweepJob, numbers: Iterator[int], taken: set[str], folder: Path
    ) -> SweepJob:
        for number in numbers:
            moved = self._job(number, job.overrides)
            is_free = moved.place not in taken and not (folder / str(moved.place)).exists()
            if is_free or moved.place == job.place:  # its folder does not depend on the number
                return moved
        return job


def overrides_of(config: DictConfig) -> list[str]:
    """The overrides of a sweep as typed: what they refer to may be each job's own."""
    return cast(list[str], OmegaConf.to_container(config.hydra.overrides.task, resolve=False))


def known_runs(folder: Path) -> dict[str, str]:
    """The places in a sweep's folder of whole runs of this version, by what they are known by."""
    return {
        name: path.relative_to(folder).as_posix()
        for path, manifest in described_runs(folder)
        if (name := _known_by(path, manifest)) is not None
    }


def is_done(job: SweepJob, folder: Path) -> bool:
    """Whether the sweep's folder has a whole run of this job."""
    if job.configuration is None:
        return False
    if job.place is None:
        return job.configuration in known_runs(folder)
    place = folder / job.place
    return _known_by(place, described(place)) == job.configuration


def _known_by(folder: Path, manifest: Mapping[str, Any] | None) -> str | None:
    if manifest is None or manifest["version"] != __version__:
        return None
    files = manifest["files"]
    is_whole = all((folder / name).is_file() for name in files)
    # A changed page or array is the user's, who may have annotated it; numbers are gathered.
    is_ours = is_whole and has(folder, METRICS_FILE, files.get(METRICS_FILE), MOST_OF_METRICS)
    return manifest.get("configuration") if is_ours else None


def _place(composed: DictConfig) -> str | None:
    try:
        return os.path.normpath(str(composed.hydra.sweep.subdir))
    except OmegaConfBaseException:  # of the job's id, which its launcher gives
        return None
