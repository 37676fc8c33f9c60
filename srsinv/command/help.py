"""`srsinv --help`, read from the files of the configuration folder.

Nothing is composed and neither Hydra nor jax is imported, so that help is immediate.
"""

import re
from dataclasses import dataclass
from pathlib import Path

_JOB = re.compile(r"^job:\s*[\"']?([\w.]+)", re.MULTILINE)

_USAGE = """\
srsinv: what a stress-rate tactile sensor feels, and what that says about the surface.

usage
  srsinv [experiment=NAME] [GROUP=OPTION ...] [key=value ...]
  srsinv -m key=a,b ...     a sweep: one run for each value, gathered in one page; called again
                            with the same hydra.sweep.dir it runs what is missing
  srsinv -m hydra/launcher=parallel ...
                            the same side by side; slurm: on a cluster
  srsinv --cfg job ...      show the composed configuration and its keys, run nothing
  srsinv --hydra-help       the rest of Hydra's flags
"""

_RESULTS = """\
results
  metrics.json, result.nc, report.html, figures/, run.json and .hydra/ go to
  outputs/NAME/DATE_TIME under the current folder, or to hydra.run.dir=FOLDER;
  the last line printed is that folder.
"""


@dataclass(frozen=True)
class Experiment:
    """One file of `configs/experiment`: its name, its job (None: that of the default run), its
    subject, and whether the job is installed."""

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
