"""What the short forms of short_forms.yaml give: their metrics and their variables, times aside."""

from srsinv.report.data import METRIC
from tests.golden.entries import Entries, entry
from tests.jobs.run import short_forms, short_run

# In the names of what a clock was read for, and at the end of those of measured memory.
CLOCKED = (
    "time_s",
    "_call_s",
    "fastest",
    "goal_family",
    "goal_size",
    "goal_peer",
    "cost_s",
)
WEIGHED = "memory_bytes"


def is_time(name: str) -> bool:
    """Whether what is named so was measured on this machine, and so is another in every run."""
    return any(each in name for each in CLOCKED) or name.endswith(WEIGHED)


def cases() -> list[str]:
    """Every short form."""
    return list(short_forms())


def entries(name: str) -> Entries:
    """`metrics.NAME` and `variables.NAME`."""
    result = short_run(name)
    metrics = {f"metrics.{key}": entry(value) for key, value in result.metrics.items()}
    variables = {
        f"variables.{key}": entry(each.values, each.attrs["units"])
        for key, each in result.dataset.variables.items()
        if each.ndim or METRIC not in each.attrs  # a single metric is among the metrics
    }
    return {key: each for key, each in (metrics | variables).items() if not is_time(key)}
