"""`srsinv --help`, read from the files of the configuration folder.

Nothing is composed and neither Hydra nor jax is imported, so that help is immediate.
"""

import re
from dataclasses import dataclass
from pathlib import Path

_JOB = re.compile(r"^job:\s*[\"']?([\w.]+)", re.MULTILINE)

_USAGE = """\
srsinv: simulate and invert stress-rate tactile sensors.

usage
  srsinv [experiment=NAME] [GROUP=OPTION ...] [key=value ...]
                            run one experiment
  srsinv -m key=a,b ...     run a sweep: one run for each value, and one page of all runs;
                            repeat the command with the same hydra.sweep.dir to complete
                            missing runs
  srsinv -m hydra/launcher=parallel ...
                            run the jobs of a sweep in parallel (slurm: on a cluster)
  srsinv rerun=FOLDER       repeat an earlier run from its folder
  srsinv --cfg job ...      show the configuration with all its keys, without running it
  srsinv --hydra-help       show Hydra's other flags
"""

_RESULTS = """\
results
  The run's folder contains metrics.json, result.nc, report.html, figures/, run.json and .hydra/.
  It is outputs/NAME/DATE_TIME under the current folder, or the one of hydra.run.dir=FOLDER.
  The command prints it as its last line.
"""


@dataclass(frozen=True)
class Experiment:
    """One file of `configs/experiment`: its name, its job (None: that of the default run), its
    summary, and whether the job is installed."""

    name: str
    job: str | None
    summary: str
    runnable: bool


def experiments_folder(root: Path) -> Path:
    """Folder of the experiments' code in a clone: beside the configuration folder `root`."""
    return root.parent / "experiments"


def experiments(root: Path) -> list[Experiment]:
    """All experiments of the configuration folder `root`, by name."""
    entries = []
    for path in sorted((root / "experiment").glob("*.yaml")):
        job = _JOB.search(path.read_text(encoding="utf-8"))
        in_clone = job is not None and job.group(1).startswith("experiments.")
        runnable = not in_clone or experiments_folder(root).is_dir()
        name = None if job is None else job.group(1)
        entries.append(Experiment(path.stem, name, _first_comment(path), runnable))
    return entries


def groups(root: Path) -> dict[str, list[str]]:
    """The options of every group under `root` but `experiment`, both sorted."""
    options: dict[str, list[str]] = {}
    for path in sorted(root.rglob("*.yaml")):
        group = path.parent.relative_to(root).as_posix()
        if group not in (".", "experiment") and not group.startswith("hydra"):
            options.setdefault(group, []).append(path.stem)
    return options


def help_text(root: Path) -> str:
    """The whole help, ending with a newline."""
    listed = [(each.name, each.summary) for each in experiments(root) if each.runnable]
    default = [("(none)", _first_comment(root / "config.yaml"))]
    choices = [(f"{group}=", ", ".join(options)) for group, options in groups(root).items()]
    parts = [_USAGE, _listing("experiments (experiment=NAME)", default + listed)]
    if choices:
        parts.append(_listing("groups (GROUP=OPTION)", choices))
    return "\n".join([*parts, _RESULTS])


def _first_comment(path: Path) -> str:
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            # `# @package _global_` is for Hydra, not for the reader.
            if line.startswith("#") and not line.startswith("# @package"):
                return line.lstrip("#").strip()
    return ""


def _listing(heading: str, rows: list[tuple[str, str]]) -> str:
    width = max(len(name) for name, _ in rows)
    return "".join([f"{heading}\n", *(f"  {name:<{width}}  {text}\n" for name, text in rows)])
