"""What a job reads of the configuration, by the table `reads.yaml` beside the configurations.

A job is given the keys that the table names and no others: so what it does not name has no effect,
and is refused where a user has typed it.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import yaml


def keys_read(job: Any, root: Path) -> frozenset[str] | None:
    """The top keys of the configuration that a job reads, or the command for it; None for one that
    the table of `root` does not have, as a user's own, which may read any."""
    command, jobs = _table(root)
    return command | jobs[job] if isinstance(job, str) and job in jobs else None


def only_read(settings: Mapping[str, Any], root: Path) -> dict[str, Any]:
    """What the job of `settings` is given of them."""
    keys = keys_read(settings.get("job"), root)
    return {key: value for key, value in settings.items() if keys is None or key in keys}


@cache
def _table(root: Path) -> tuple[frozenset[str], dict[str, frozenset[str]]]:
    path = root / "reads.yaml"
    if not path.is_file():
        return frozenset(), {}
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    jobs = {job: frozenset(_joined(keys)) for job, keys in table["jobs"].items()}
    return frozenset(table["command"]), jobs


def _joined(keys: Any) -> Iterator[str]:
    for each in keys:
        yield from _joined(each) if isinstance(each, list) else (each,)
