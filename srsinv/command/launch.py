"""One run or a sweep: compose, run the job that the configuration names, write what it found.

Hydra composes, sweeps and launches. What it would leave behind when something is refused (folders,
a sweep's record) is taken away again here, and its exit codes are ours.
"""

import os
import shlex
import sys
import traceback
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

from hydra import initialize_config_dir
from hydra._internal.callbacks import Callbacks
from hydra._internal.hydra import Hydra
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.core.utils import run_job
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf

from ..config import check_early, load_job
from ..errors import BadInput, refuse
from .hydra_settings import check_hydra_settings, check_search_path
from .overrides import check, parse, refusing
from .programs import release_programs

DONE, FAULT, REFUSED = 0, 1, 2


def say(refusal: BadInput) -> int:
    """Print a refusal as one line on standard error; the exit code that goes with it."""
    print("srsinv:", " ".join(str(refusal).split()), file=sys.stderr)
    return REFUSED


def launch(arguments: Sequence[str], root: Path) -> int:
    """Do what `arguments` ask with the configurations in `root`; the exit code.

    Raises `BadInput` for what cannot be composed; a job's own refusals are already said.
    """
    flags = _flags(arguments)
    if flags.shell_completion:
        return _complete(root, flags.overrides)
    typed = parse(flags.overrides, root)
    check_search_path(typed)
    flags.overrides = _with_config_folder(flags)
    overrides = parse(flags.overrides, root)
    with (
        refusing(),
        initialize_config_dir(str(root.resolve()), _run_name(overrides), version_base="1.3"),
    ):
        hydra = cast(Hydra, GlobalHydra.instance().hydra)
        check(hydra, overrides, root, flags.multirun)
        if _shows_only(flags):
            return _show(hydra, flags)
        mode = RunMode.MULTIRUN if flags.multirun else RunMode.RUN
        config = hydra.compose_config("config", flags.overrides, run_mode=mode)
        check_hydra_settings(config)
        folder = Path(config.hydra.sweep.dir if flags.multirun else config.hydra.run.dir)
        _check_folder(folder)
        context = HydraContext(config_loader=hydra.config_loader, callbacks=Callbacks(config))
        start = _sweep if flags.multirun else _run
        return start(context, Task(root), config, folder)


@dataclass(frozen=True)
class Task:
    """What Hydra launches, here or in another process: one job and its results."""

    root: Path

    def __call__(self, config: DictConfig) -> int:
        """Run the job of a composed configuration; the exit code, with the reason printed."""
        try:
            self._run(config)
        except BadInput as refusal:
            return say(refusal)
        except Exception as error:
            traceback.print_exception(error)
            return FAULT
        finally:
            release_programs()
        return DONE

    def _run(self, config: DictConfig) -> None:
        with refusing():
            settings = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
        settings = cast(dict[str, Any], settings)
        check_early(settings)
        job = load_job(settings["job"], self.root)
        outcome = job(settings)

        # After the job, whose module decides when jax and matplotlib are imported.
        from ..report.page import write
        from ..report.text import print_table

        hydra = HydraConfig.get()
        folder = Path(hydra.runtime.output_dir)
        command = shlex.join(["srsinv", *hydra.overrides.task])
        record = {
            "config.yaml": OmegaConf.to_yaml(config),
            "overrides.yaml": OmegaConf.to_yaml(hydra.overrides.task),
            "hydra.yaml": OmegaConf.to_yaml(HydraConfig.instance().cfg),
        }
        write(outcome, folder, record, command)
        print_table(outcome.summary)
        print(f"{folder / 'report.html'}\n{folder}", flush=True)


def _flags(arguments: Sequence[str]) -> Namespace:
    parser = get_args_parser()
    parser.allow_abbrev = False

    def refuse_flag(message: str) -> NoReturn:
        raise BadInput(f"{message}; see srsinv --help and srsinv --hydra-help")

    parser.error = refuse_flag
    flags = parser.parse_intermixed_args(list(arguments))
    for name in ("config_path", "config_name", "experimental_rerun"):
        flag = f"--{name.replace('_', '-')}"
        refuse(
            getattr(flags, name) is not None,
            f"{flag} is not for srsinv, which has one configuration; "
            "add a folder of your own options with --config-dir FOLDER",
        )
    asked = [flags.run, flags.multirun, flags.cfg, flags.info, flags.shell_completion]
    refuse(
        sum(map(bool, asked)) > 1,
        "give only one of --run, --multirun, --cfg, --info and --shell-completion",
    )
    return flags


def _run_name(overrides: Sequence[Override]) -> str:
    """Which folder of `outputs` a run belongs to: its experiment's."""
    chosen = [o for o in overrides if o.key_or_group == "experiment" and not o.is_delete()]
    if not chosen:
        return "default"
    name = None if chosen[-1].is_sweep_override() else chosen[-1].value()
    return name if isinstance(name, str) else "several"


def _with_config_folder(flags: Namespace) -> list[str]:
    """The overrides, with `--config-dir` as the search path that it is short for."""
    if flags.config_dir is None:
        return flags.overrides
    refuse(
        not os.path.isdir(flags.config_dir),  # False too for a name that no file system takes
        f"--config-dir {flags.config_dir} is not a folder; give one that holds groups of options",
    )
    path = str(Path(flags.config_dir).resolve()).replace("'", r"\'")
    return [f"hydra.searchpath=['file://{path}']", *flags.overrides]


def _shows_only(flags: Namespace) -> bool:
    return bool(flags.hydra_help or flags.cfg or flags.info)


def _show(hydra: Hydra, flags: Namespace) -> int:
    """Hydra's own flags that look at the configuration and run nothing."""
    if flags.hydra_help:
        hydra.hydra_help("config", get_args_parser(), flags)
    elif flags.cfg:
        hydra.show_cfg("config", flags.overrides, flags.cfg, flags.package, flags.resolve)
    else:
        hydra.show_info(flags.info, "config", flags.overrides)
    return DONE


def _complete(root: Path, words: list[str]) -> int:
    """What a shell asks when Tab is pressed, or the lines that make it ask."""
    commands = ("install", "uninstall", "query")
    asked = [word for word in words if word.partition("=")[0] in commands and "=" in word]
    refuse(
        len(words) != 1 or not asked,
        f"--shell-completion takes one of {'=SHELL, '.join(commands)}=SHELL, as install=bash.",
    )
    with (
        refusing(),
        initialize_config_dir(str(root.resolve()), "default", version_base="1.3"),
    ):
        try:
            cast(Hydra, GlobalHydra.instance().hydra).shell_completion("config", words)
        except ValueError as error:
            raise BadInput(f"{' '.join(str(error).split())}; name one of those.") from error
    return DONE


def _check_folder(folder: Path) -> None:
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    refuse(
        not (existing.is_dir() and os.access(existing, os.W_OK)),
        f"cannot write to {folder}: {existing} is not a folder that can be written to; "
        "choose another with hydra.run.dir=FOLDER (hydra.sweep.dir with -m)",
    )


def _run(context: HydraContext, task: Task, config: DictConfig, folder: Path) -> int:
    with _no_empty_folders(folder):
        return run_job(
            hydra_context=context,
            task_function=task,
            config=config,
            job_dir_key="hydra.run.dir",
            job_subdir_key=None,
        ).return_value


def _sweep(context: HydraContext, task: Task, config: DictConfig, folder: Path) -> int:
    """Every job runs, whatever became of those before; a fault outranks a refusal."""
    sweeper = Plugins.instance().instantiate_sweeper(
        config=config, hydra_context=context, task_function=task
    )
    codes = [FAULT]
    with _no_empty_folders(folder, inside=True), _no_lonely_record(folder / "multirun.yaml", codes):
        batches = sweeper.sweep([*config.hydra.overrides.task])
        codes[:] = [job.return_value for batch in batches for job in batch]
    if DONE in codes:
        print(folder.absolute(), flush=True)
    return next((code for code in (FAULT, REFUSED) if code in codes), DONE)


@contextmanager
def _no_lonely_record(record: Path, codes: list[int]) -> Iterator[None]:
    """Put the sweeper's `record` back as it was unless one of the jobs was done."""
    before = record.read_bytes() if record.is_file() else None
    try:
        yield
    finally:
        if DONE not in codes:
            if before is not None:
                record.write_bytes(before)
            else:
                record.unlink(missing_ok=True)


@contextmanager
def _no_empty_folders(folder: Path, inside: bool = False) -> Iterator[None]:
    """Remove the folders made for `folder`, and `inside` it, that are still empty at the end."""
    folder = folder.absolute()

    def folders() -> Iterator[Path]:
        if inside:
            yield from sorted((path for path in folder.rglob("*") if path.is_dir()), reverse=True)
        yield from (path for path in (folder, *folder.parents) if path.is_dir())

    before = set(folders())
    try:
        yield
    finally:
        for path in folders():
            if path not in before and not any(path.iterdir()):
                path.rmdir()
