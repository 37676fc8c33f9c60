"""Settings of the jobs that simulate features of known parameters."""

from collections.abc import Mapping
from typing import Any

from ..errors import BadInput, echo, number
from ..forward.feature import Feature


def sample_rate(job: str, given: Mapping[str, Any]) -> float:
    """The samples per second that a job's settings give. Raises `BadInput` for none above 0."""
    wanted = "the samples per second, above 0"
    return float(number(f"{job}.sample_rate_hz", given["sample_rate_hz"], wanted, above=0))


def of_feature(key: str, given: Any, name: str, feature: Feature) -> Mapping[str, Any]:
    """The mapping of a feature's parameters at `key`. Raises `BadInput` where it does not hold just
    those."""
    wanted = (*feature.axes, feature.amplitude, "friction")
    held = given.get(name) if isinstance(given, Mapping) else None
    if not isinstance(held, Mapping) or set(held) != set(wanted):
        have = ", ".join(map(str, held)) if isinstance(held, Mapping) else echo(held)
        raise BadInput(f"{key}.{name} has {have}: give {', '.join(wanted)}.")
    return held
