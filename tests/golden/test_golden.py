"""The tree against the golden data: the same numbers, sentences and options as were recorded."""

import json

import pytest

from srsinv.__main__ import find_config_root
from srsinv.command.help import experiments
from tests.golden import options, refusals
from tests.golden.check import check, other_cases
from tests.golden.compare import FOLDER, tolerance_of
from tests.golden.families import DATA, cases, file
from tests.golden.floors import FILE as FLOORS
from tests.golden.floors import OF_STDERR
from tests.jobs.run import short_forms
from tests.tiers import quick

QUICK = {
    "forms/default", "forms/fit_fabricslide", "forms/inspect_recording",
    "public/operator", "public/recording", "public/fit_readme",
    *(f"products/{name}" for name in (
        "viscoelastic", "filters_periodic", "differences", "contact_viscoelastic")),
}  # fmt: skip
MOST_BYTES = 2_000_000
RANDOM = [case for case in other_cases() if case.startswith("random/")]
EACH = 8  # of the refusals are one for make test-all, and the rest for make claims
REST = [pytest.param(first, marks=pytest.mark.claim) for first in range(1, EACH)]
MARGIN = 3  # of a tolerance over what the quantity moves by itself


@pytest.mark.parametrize("case", quick([c for c in other_cases() if c not in RANDOM], *QUICK))
def test_nothing_has_moved(case):
    check(case)


@pytest.mark.claim
@pytest.mark.parametrize("case", RANDOM)
def test_nothing_random_has_moved(case):
    check(case)


@pytest.mark.parametrize("first", [pytest.param(0, marks=pytest.mark.full), *REST])
@pytest.mark.parametrize("part", ["typed", "configured"])
def test_refusals_say_what_they_said(part, first):
    old = refusals.stored()
    old[part] = old[part][first::EACH]
    new = refusals.now(old, [part])
    moved = [
        f"{was} is now {now}" for was, now in zip(old[part], new[part], strict=True) if was != now
    ]
    assert not moved, "\n".join(moved)


def test_the_options_are_the_same():
    assert options.text() == (FOLDER / "options.yaml").read_text(encoding="utf-8")


def test_every_experiment_has_a_short_form():
    assert {each.name for each in experiments(find_config_root())} < set(short_forms())


def test_golden_data_have_their_case_and_are_small():
    files = {path for path in DATA.rglob("*") if path.is_file()}
    assert files == {file(case) for case in cases()}
    assert sum(path.stat().st_size for path in FOLDER.rglob("*.*")) < MOST_BYTES


def test_tolerances_are_above_what_moves_by_itself():
    floors = json.loads(FLOORS.read_text(encoding="utf-8"))["quantities"]
    names = {quantity.removesuffix(OF_STDERR) for quantity in floors}
    low = []
    for name in names:
        own = tolerance_of(name)
        relative, errors = (
            max(floors.get(key, {"": 0.0}).values()) for key in (name, f"{name}{OF_STDERR}")
        )
        by_error = own.of_stderr > 0 and f"{name}{OF_STDERR}" in floors
        if not (own.ignore or own.absolute or own.any_digits or MARGIN * relative <= own.relative):
            low += [] if by_error and MARGIN * errors <= own.of_stderr else [(name, relative)]
    assert not low
