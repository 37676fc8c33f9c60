"""Quality of answers, as variables of a result: the headline and the terminal say it of each."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Answer(Protocol):
    """What has a quality: an estimate, or the answer of a job without a sensor model."""

    @property
    def quality(self) -> str: ...
    @property
    def status(self) -> Any: ...
    @property
    def warnings(self) -> tuple[str, ...]: ...
    @property
    def reasons(self) -> tuple[str, ...]: ...


def answer_variables(answers: Mapping[str, Answer], dim: str = "estimator") -> dict[str, tuple]:
    """Quality, status, warnings and reasons of each answer along `dim`, for `data.dataset`."""
    every = [_words(each) for each in answers.values()]
    metrics = {name: f"{name}_{{{dim}}}" for name in ("quality", "status", "warnings")}
    return {
        name: (dim, [each[name] for each in every], "1", metrics.get(name))
        for name in ("quality", "status", "warnings", "reasons")
    }


def answer_of(answer: Answer) -> dict[str, tuple]:
    """The same for a result's only answer."""
    said = _words(answer)
    return {name: ((), said[name], "1", None if name == "reasons" else name) for name in said}


def _words(answer: Answer) -> dict[str, str]:
    return {
        "quality": str(answer.quality),
        "status": str(answer.status),
        "warnings": " ".join(answer.warnings) or "none",
        "reasons": " ".join(answer.reasons),
    }
