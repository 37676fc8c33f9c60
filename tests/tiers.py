"""Which tier of tests has a case: `make test`, `make test-all` or `make claims`."""

from collections.abc import Callable, Collection, Iterable
from typing import Any

import pytest

SINGLE = "float32"


def quick(cases: Iterable[Any], *some: Any) -> list[Any]:
    """The cases of a `parametrize`, marked `full` but for `some` of them."""
    return tiered(cases, lambda case: () if case in some else pytest.mark.full)


def rare(cases: Iterable[Any], *some: Any) -> list[Any]:
    """The cases of a `parametrize`, of which `some` are in `make claims` alone."""
    return tiered(cases, lambda case: pytest.mark.claim if case in some else ())


def hardest(cases: Iterable[Any], first: Collection[Any], second: Collection[Any]) -> list[Any]:
    """The cases of a `parametrize`: `first` for every tier, `second` from `make test-all` on, and
    the others in `make claims` alone."""
    rest = {True: pytest.mark.full, False: pytest.mark.claim}
    return tiered(cases, lambda case: () if case in first else rest[case in second])


def tiered(cases: Iterable[Any], mark_of: Callable[[Any], Any]) -> list[Any]:
    """The cases of a `parametrize` with the mark of each."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark_of(case))
        for case in cases
    ]


def mark_single_precision(items: Collection[pytest.Item]) -> None:
    """Single precision is of numerical kernels alone, and in `make test-all` alone."""
    for item in items:
        values = getattr(item, "callspec", None)
        if values and any(isinstance(v, str) and v == SINGLE for v in values.params.values()):
            item.add_marker(pytest.mark.full)
