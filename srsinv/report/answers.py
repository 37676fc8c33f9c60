"""Answers as variables of a result: their quality, of which the headline and the terminal speak,
their parameters, and whole answers as datasets to draw."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
import xarray

from ..errors import BadInput, echo
from .text import unit_of


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


def reported_parameters(
    parameters: Mapping[str, tuple[float, float]], unit: Callable[[str], str] = unit_of
) -> dict[str, tuple[Any, ...]]:
    """Values and standard errors of parameters by name, and the `unit` of each, by default the one
    at its name's end."""
    pairs = np.array(list(parameters.values()), float).reshape(-1, 2)
    return {
        "parameter_value": ("reported", pairs[:, 0], "SI", "{reported!s}"),
        "parameter_stderr": ("reported", pairs[:, 1], "SI", "{reported!s}_stderr"),
        "parameter_unit": ("reported", np.array([unit(name) for name in parameters], str), "1"),
    }


def as_dataset(given: Any) -> xarray.Dataset:
    """The dataset of a result as it is, or that of an answer: an estimate or a fit. Of estimates by
    name p and q with their standard errors along `estimator`, all on the line of the first.

    Raises `BadInput` for anything else.
    """
    if isinstance(given, xarray.Dataset):
        return given
    if isinstance(given, Mapping):
        if given and all(hasattr(each, "on") for each in given.values()):
            return _compared(given)
    elif hasattr(given, "to_xarray"):
        return given.to_xarray()
    raise BadInput(
        f"{echo(given)} cannot be drawn: give an estimate, estimates by name as "
        "{'Wiener': estimate}, or the dataset of a result."
    )


def _compared(named: Mapping[str, Any]) -> xarray.Dataset:
    first = next(iter(named.values())).to_xarray()
    line = next(iter(named.values())).line
    every = [first, *(each.on(line).to_xarray() for each in list(named.values())[1:])]
    # Ends of bands that are not symmetric only where all have them.
    names = "estimate", "estimate_stderr", "estimate_low", "estimate_high"
    own = [name for name in names if all(name in each for each in every)]
    parts = [each[own] for each in every]
    joined = xarray.concat(parts, xarray.DataArray([*named], dims="estimator", name="estimator"))
    observed = {"observed": first["observed"]} if "observed" in first else {}
    return joined.assign(observed).assign_attrs(first.attrs)
