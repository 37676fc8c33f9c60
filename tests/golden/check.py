"""Tests that what the tree gives is what was recorded. Every short form is checked in the file of
tests/jobs that looks at it too, one of its `FORMS`, so that it is computed once."""

from collections.abc import Callable, Collection, Sequence

import pytest

from tests.golden.cases import entries, file
from tests.golden.compare import differences
from tests.golden.entries import read


def golden_test(
    names: Sequence[str], *some: str, claims: Collection[str] = (), family: str = "forms"
) -> Callable[[str], None]:
    """The test of these cases: `make test` runs `some` of them, `make claims` the `claims`, and
    `make test-all` the others."""
    marks = {name: pytest.mark.claim if name in claims else pytest.mark.full for name in names}
    marked = [pytest.param(name, marks=() if name in some else marks[name]) for name in names]

    @pytest.mark.parametrize("name", marked)
    def test(name: str) -> None:
        case = f"{family}/{name}"
        moved = differences(case, read(file(case)), entries(case))
        assert not moved, "\n".join(str(each) for each in moved)

    return test
