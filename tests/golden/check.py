"""The check that what the tree gives is what was recorded. The forms that a file of tests/jobs
looks at, its `FORMS`, are checked there, where they are computed anyhow."""

import ast
from collections.abc import Callable, Iterator, Sequence

import pytest

from tests.golden.compare import differences
from tests.golden.entries import read
from tests.golden.families import cases, entries, file
from tests.jobs.run import ROOT
from tests.tiers import quick


def check(case: str) -> None:
    """Fails with what has moved in FAMILY/CASE, if anything has."""
    moved = differences(case, read(file(case)), entries(case))
    assert not moved, "\n".join(str(each) for each in moved)


def golden_test(forms: Sequence[str], *some: str) -> Callable[[str], None]:
    """The test of a file of tests/jobs for its short forms; `make test` runs `some` of them."""

    @pytest.mark.parametrize("form", quick(forms, *some))
    def test(form: str) -> None:
        check(f"forms/{form}")

    return test


def other_cases() -> list[str]:
    """Those that no file of tests/jobs checks."""
    elsewhere = {f"forms/{form}" for form in _forms_of_jobs()}
    return [case for case in cases() if case not in elsewhere]


def _forms_of_jobs() -> Iterator[str]:
    for path in (ROOT / "tests" / "jobs").glob("test_*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            match node:
                case ast.Assign(targets=[ast.Name(id="FORMS")], value=value):
                    yield from ast.literal_eval(value)
