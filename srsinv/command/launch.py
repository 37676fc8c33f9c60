"""One run or a sweep: compose, run the job that the configuration names, write its results.

Hydra composes, sweeps and launches; srsinv returns its exit codes.
"""

import os
import shlex
import traceback
from argparse import Namespace
from collections.abc import Callable, Sequence
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
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from ..config import check_early, sections
from ..errors import BadInput, printable, refuse
from ..namespaces import fault_in_plugin, load_job, open_plugins, plugin_files
from ..run_folder import RunFolder, RunRecord, claim
from .compilation_cache import compilation_cache
from .folders import run
from .hydra_settings import check_hydra_settings, check_typed
from .identity import identity, resolved
from .interrupts import in_own_thread, uninterrupted
from .option_files import guard_files
from .outcome import DONE, FAULT, Outcome, say
from .overrides import check
from .programs import release_programs
from .reads import only_read
from .rerun import note_change, replayed
from .surroundings import (
    printing,
    settle_drawing,
    settle_streams,
    started_with_jax,
    too_little_memory,
)
from .sweep_jobs import overrides_of
from .sweeps import sweep
from .typed import composing, parse, refusing

_PLACES = ("hydra.run.dir", "hydra.sweep.dir")


def launch(arguments: Sequence[str], root: Path) -> int:
    """Run the command of `arguments` with the configurations in `root`; the exit code.

    Raises `BadInput` where nothing can be composed; a job's own refusals are already printed.
    """
    flags, recorded = replayed(_flags(arguments))
    if flags.shell_completion:
        with printing():
            return _complete(root, flags.overrides)
    typed = parse(flags.overrides, root)
    check_typed(typed)
    searched = _config_folder(flags)
    overrides = [*parse(searched, root), *typed]
    flags.overrides = [*searched, *flags.overrides]
    with (
        refusing(),
        initialize_config_dir(str(root.resolve()), _run_name(overrides), version_base="1.3"),
    ):
        hydra = cast(Hydra, GlobalHydra.instance().hydra)
        guard_files()
        check(hydra, overrides, root, flags.multirun, flags.config_dir)
        if flags.hydra_help or flags.cfg or flags.info:
            with printing():
                return _show(hydra, flags)
        mode = RunMode.MULTIRUN if flags.multirun else RunMode.RUN
        with composing():
            config = hydra.compose_config("config", flags.overrides, run_mode=mode)
        check_hydra_settings(config)
        context = HydraContext(config_loader=hydra.config_loader, callbacks=Callbacks(config))
        given = ("--config-dir", flags.config_dir) if flags.config_dir else ()
        here = str(Path(flags.config_dir).resolve()) if flags.config_dir else None
        task = LaunchedTask(root, given, here, recorded=recorded)
        if not flags.multirun:
            return run(context, task, config)
        command = task.command(["-m", *overrides_of(config)])
        return sweep(context, task, config, command)


@dataclass(frozen=True)
class LaunchedTask:
    """The task that Hydra launches, here or in another process: one job and its results.

    - `root`: the folder of configurations.
    - `flags`: those of the command that set where configurations come from.
    - `config_dir`: the user's own folder of options and plugins, wherever the job is run.
    - `places`: numbers and folders of a sweep's jobs in the order in which they are launched, as
      some may have been done before; no folder where only the job itself knows it.
    - `recorded`: what the run was known by that is repeated; None where none is.
    """

    root: Path
    flags: tuple[str, ...]
    config_dir: str | None
    places: tuple[tuple[int, str | None], ...] = ()
    recorded: str | None = None

    def __call__(self, config: DictConfig) -> Outcome:
        """Run the job of a composed configuration; what became of it, with the reason printed."""
        settle_streams(are_own=False)  # of a process that a launcher began, too
        settle_drawing()
        if self.places:
            self._take_place()
        folder = Path(HydraConfig.get().runtime.output_dir)
        try:
            with claim(folder) as held:
                result, write = in_own_thread(lambda: self._run(config))
                if result is not None:
                    uninterrupted(lambda: write(held))
            if result is not None:
                _show_result(result, folder)
        except BadInput as refusal:
            return Outcome(say(refusal), str(refusal))
        except (Exception, SystemExit) as error:
            if refusal := fault_in_plugin(error) or too_little_memory(error):
                return Outcome(say(refusal), str(refusal))
            traceback.print_exception(error)
            return Outcome(FAULT, _reason(error))
        finally:
            release_programs()
        return Outcome(DONE)

    def _take_place(self) -> None:
        """Give a job of a sweep its own number and folder, and print what it is."""
        hydra = cast(Any, HydraConfig.get())
        with read_write(hydra), open_dict(hydra):
            hydra.job.num, place = self.places[hydra.job.num]
            if place is not None:
                hydra.runtime.output_dir = str(Path(hydra.sweep.dir, place).absolute())
        with printing("the number of a job"):
            print(f"job {hydra.job.num}: {printable(' '.join(hydra.overrides.task))}")

    def command(self, overrides: Sequence[str]) -> str:
        """The command as typed."""
        return shlex.join(["srsinv", *self.flags, *overrides])

    def _run(self, config: DictConfig) -> tuple[Any, Callable[[RunFolder], None]]:
        """The job's result, and what writes the files of its run; None of a job that prints what it
        finds, and leaves nothing."""
        settings = resolved(config)
        known_by = identity(settings, self.config_dir)
        note_change(known_by, self.recorded)
        open_plugins(self.config_dir)
        check_early(settings)
        job = started_with_jax(lambda: load_job(settings["job"], self.root))
        with compilation_cache(settings.get("compilation_cache", False)):
            extra = sections(settings)
            result = job(only_read(settings, self.root))
            if result is None:
                return None, lambda held: None
            result = result.with_sections(extra)

            # After the job, whose module decides when jax and matplotlib are imported.
            from ..report.files import render

            command = self.command(HydraConfig.get().overrides.task)
            files = render(result, _record(config), command, settings.get("figures", "page"))
        seed, plugins = settings.get("seed"), plugin_files(settings)
        return result, lambda held: held.replace(files, RunRecord(command, seed, plugins, known_by))


def _reason(error: BaseException) -> str:
    """Why a job failed; a scheduler's signal arrives as an exit."""
    if isinstance(error, SystemExit) and isinstance(error.code, int) and error.code > 128:
        return f"stopped by a signal, as at a time limit (exit code {error.code})"
    return f"{type(error).__name__}: {error}"


def _record(config: DictConfig) -> dict[str, str]:
    """The configuration of a run as text, by the names that Hydra gives its parts.

    Where the run stands, by default a folder named after the time, is left out: the same run
    elsewhere is the same.
    """
    whole = OmegaConf.to_container(HydraConfig.instance().cfg, enum_to_str=True)
    hydra = cast(dict[str, Any], whole)["hydra"]
    hydra["run"]["dir"] = hydra["sweep"]["dir"] = None
    hydra["runtime"] |= {"output_dir": None, "cwd": None}
    typed = hydra["overrides"]["hydra"]
    hydra["overrides"]["hydra"] = [o for o in typed if o.split("=")[0] not in _PLACES]
    return {
        "config.yaml": OmegaConf.to_yaml(config),
        "overrides.yaml": OmegaConf.to_yaml(HydraConfig.get().overrides.task),
        "hydra.yaml": OmegaConf.to_yaml({"hydra": hydra}),
    }


def _show_result(result: Any, folder: Path) -> None:
    from ..report.terminal import print_summary

    with printing("what was found", f"it is in {folder}"):
        print_summary(result)
        print(f"{printable(str(folder / result.page_name))}\n{printable(str(folder))}")


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
    """Name of a run's folder in `outputs`: that of its experiment."""
    chosen = [o for o in overrides if o.key_or_group == "experiment" and not o.is_delete()]
    if not chosen:
        return "default"
    name = None if chosen[-1].is_sweep_override() else chosen[-1].value()
    return name if isinstance(name, str) else "several"


def _config_folder(flags: Namespace) -> list[str]:
    """`--config-dir`, where it is given, as the search path that it is short for."""
    if flags.config_dir is None:
        return []
    refuse(
        not os.path.isdir(flags.config_dir),  # False too for a name that no file system takes
        f"--config-dir {flags.config_dir} is not a folder; give one that holds groups of options",
    )
    path = str(Path(flags.config_dir).resolve()).replace("'", r"\'")
    return [f"hydra.searchpath=['file://{path}']"]


def _show(hydra: Hydra, flags: Namespace) -> int:
    """Handle Hydra's own flags that print the configuration and run nothing."""
    # Hydra sets up loggers for either, of which only those of its own and of ours are taken.
    if flags.hydra_help:
        flags.overrides = []
        hydra.hydra_help("config", get_args_parser(), flags)
    elif flags.cfg:
        _check_package(hydra, flags)
        hydra.show_cfg("config", flags.overrides, flags.cfg, flags.package, flags.resolve)
    else:
        check_hydra_settings(hydra.compose_config("config", flags.overrides, RunMode.RUN))
        hydra.show_info(flags.info, "config", flags.overrides)
    return DONE


def _check_package(hydra: Hydra, flags: Namespace) -> None:
    """Refuse a package that the configuration does not have, as Hydra would end the process."""
    with composing():
        config = hydra.compose_config("config", flags.overrides, run_mode=RunMode.RUN)
        found = None if flags.package is None else OmegaConf.select(config, flags.package)
    refuse(
        flags.package is not None and found is None,
        f"--package {flags.package} is no key of the configuration; see srsinv --cfg job",
    )


def _complete(root: Path, words: list[str]) -> int:
    """Completions for a shell, or the lines that install the completion."""
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
