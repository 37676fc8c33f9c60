"""What the short forms of short_forms.yaml give: their metrics and their variables, times aside."""

from tests.golden.entries import Entries, entry
from tests.jobs.run import short_forms, short_run

TIME = "time_s"  # in the name of everything that a clock was read for


def cases() -> list[str]:
    """Every short form."""
    return list(short_forms())


def entries(name: str) -> Entries:
    """`metrics.NAME` and `variables.NAME`."""
    outcome = short_run(name)
    metrics = {f"metrics.{key}": entry(value) for key, value in outcome.metrics.items()}
    variables = {
        f"variables.{key}": entry(each.values, each.attrs["units"])
        for key, each in outcome.dataset.variables.items()
    }
    return {key: each for key, each in (metrics | variables).items() if TIME not in key}
