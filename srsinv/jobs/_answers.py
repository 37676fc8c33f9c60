"""Quality of the answers of a job, as variables of its result."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from ..inverse.estimate import Estimate
from ..inverse.quality import Quality
from ..status import Status


def answer_variables(
    estimates: Mapping[str, Estimate], dim: str = "method"
) -> dict[str, tuple[Any, ...]]:
    """Quality, status, warnings and reasons of each answer along `dim`."""
    every = list(estimates.values())
    words = [" ".join(each.warnings) or "none" for each in every]
    return {
        "quality": (dim, [str(each.quality) for each in every], "1", f"quality_{{{dim}}}"),
        "status": (dim, [str(each.status) for each in every], "1", f"status_{{{dim}}}"),
        "warnings": (dim, words, "1", f"warnings_{{{dim}}}"),
        "reasons": (dim, [" ".join(each.reasons) for each in every], "1"),
    }


@runtime_checkable
class Answer(Protocol):
    """What has a quality: an estimate, or the answer of a job that has no sensor model."""

    @property
    def quality(self) -> Quality: ...
    @property
    def status(self) -> Status: ...
    @property
    def warnings(self) -> tuple[str, ...]: ...
    @property
    def reasons(self) -> tuple[str, ...]: ...


def answer_of(estimate: Answer) -> dict[str, tuple[Any, ...]]:
    """The same for a job's only answer."""
    return {
        "quality": ((), str(estimate.quality), "1", "quality"),
        "status": ((), str(estimate.status), "1", "status"),
        "warnings": ((), " ".join(estimate.warnings) or "none", "1", "warnings"),
        "reasons": ((), " ".join(estimate.reasons), "1"),
    }
