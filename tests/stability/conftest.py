"""The hard cases of a test file, its GROUPS, one after the other in both precisions as `hard`; and
at the end of a run how many there were and which came nearest to its bound.

All but those of test_more_derivatives.py are in `make test-all` in double precision, and each
file's first group in single precision, too: the rest is for `make claims`. `make test` runs each
file's first group in double precision.
"""

from pathlib import Path

import pytest

from tests.stability.matrix import PRECISIONS, measured, rows

MARGIN = "margin"
HERE = Path(__file__).parent


def pytest_generate_tests(metafunc):
    if "hard" in metafunc.fixturenames:
        cases = rows(metafunc.module.GROUPS)
        metafunc.parametrize("hard", list(cases.values()), ids=list(cases), indirect=True)


def pytest_collection_modifyitems(items):
    for item in items:
        if HERE in item.path.parents:
            for tier in _tier(item):
                item.add_marker(getattr(pytest.mark, tier))


def _tier(item) -> list[str]:
    """The mark of a test in this folder, if it has one."""
    params = item.callspec.params if hasattr(item, "callspec") else {}
    given = params.get("hard")
    is_first = given is not None and given[0] is item.module.GROUPS[0]
    is_double = (params.get("precision") if given is None else given[2]) != PRECISIONS[1]
    return [] if is_first and is_double else ["full"] if is_first or is_double else ["claim"]


@pytest.fixture
def hard(request, margin):
    """What one case measured."""
    measurement = measured(*request.param)
    margin(measurement.error, measurement.bound)
    return measurement


@pytest.fixture
def margin(request):
    """Notes the error and the bound of a hard case for the summary at the end."""

    def note(error, bound):
        request.node.user_properties.append((MARGIN, [float(error), float(bound)]))

    return note


def pytest_terminal_summary(terminalreporter):
    noted = [
        (report.nodeid.split("::")[-1], *value)
        for report in terminalreporter.getreports("passed")
        for name, value in report.user_properties
        if name == MARGIN
    ]
    if noted:
        name, error, bound = max(noted, key=lambda each: each[1] / each[2])
        margin = f"{bound / error:.1f}" if error else "infinite"
        terminalreporter.write_line(
            f"{len(noted)} hard cases hold; the worst margin is {margin}, of {name} "
            f"({error:.1e} of {bound:.1e})"
        )
