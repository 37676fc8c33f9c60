"""Names that were changed: what they were, and until when the old ones are given, too."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Alias:
    """An old name of a key of `metrics.json`, each with one `*` for the rest of the name.

    `until`: the version that no longer gives the old one.
    """

    old: str
    new: str
    until: str


METRICS = (
    Alias("doubts_*", "warnings_*", "0.3.0"),
    Alias("sure_float*", "good_float*", "0.3.0"),
    Alias("sure_and_wrong_float*", "silent_failures_float*", "0.3.0"),
)


def with_old_names(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """`metrics`, each value under its old name too where that was another."""
    named = dict(metrics)
    for alias in METRICS:
        start, end = alias.new.split("*")
        for key, value in metrics.items():
            if key.startswith(start) and key.endswith(end) and len(key) > len(start + end):
                named[alias.old.replace("*", key[len(start) : len(key) - len(end)])] = value
    return named
