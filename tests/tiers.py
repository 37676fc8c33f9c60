"""Cases of which `make test` runs some and `make test-all` all."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest

SINGLE = "float32"


def quick(cases: Iterable[Any], *some: Any) -> list[Any]:
    """The cases of a `parametrize`, marked `full` but for `some` of them."""
    rest = pytest.mark.full
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)),
                     marks=() if case in some else rest)
        for case in cases
    ]  # fmt: skip


def mark_single_precision(items: Collection[pytest.Item]) -> None:
    """Single precision is of numerical kernels alone, and in `make test-all` alone."""
    for item in items:
        values = getattr(item, "callspec", None)
        if values and any(isinstance(v, str) and v == SINGLE for v in values.params.values()):
            item.add_marker(pytest.mark.full)
