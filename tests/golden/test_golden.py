"""The tree against the golden data, but for the short forms, which tests/jobs checks: the same
numbers and sentences as were recorded."""

import re

import pytest

from srsinv.__main__ import find_config_root
from srsinv.command.help import experiments
from tests.golden import refusals
from tests.golden.cases import DATA, FAMILIES, FOLDER, cases, file
from tests.golden.check import golden_test
from tests.jobs.run import ROOT, short_forms

MOST_BYTES = 2_000_000
EACH = 32  # of the refusals are one for `make test-all`, and the rest for `make claims`
PRODUCTS, PUBLIC, RANDOM = (tuple(FAMILIES[each].names()) for each in FAMILIES if each != "forms")
# Of parts that one of the other products has, too, or whose values and derivatives tests/forward
# and tests/stability compare with references.
REPEATED = (
    "half_space_periodic", "half_space_open", "layers_periodic", "layers_open", "core_periodic",
    "uneven_periodic", "uneven_open", "even_filtered", "filters_open", "oblique",
    "circular", "contact_elastic", "contact_lagging", "features", "surface_ridge", "surface_tape",
)  # fmt: skip

test_no_product_has_moved = golden_test(
    PRODUCTS,
    *("viscoelastic", "filters_periodic", "differences"),
    claims=REPEATED,
    family="products",
)
test_nothing_public_has_moved = golden_test(
    PUBLIC,
    *("operator", "recording", "fit_readme"),
    claims=("fit_starts", "fit_gradients", "fit_sliding"),
    family="public",
)
test_nothing_random_has_moved = golden_test(RANDOM, claims=RANDOM, family="random")


@pytest.mark.parametrize("first", [
    pytest.param(first, marks=pytest.mark.claim if first else pytest.mark.full)
    for first in range(EACH)
])  # fmt: skip
def test_refusals_say_what_they_said(first):
    old = refusals.stored()
    old |= {part: old[part][first::EACH] for part in refusals.PARTS}
    moved = refusals.changed(old, refusals.now(old))
    assert not moved, "\n".join(f"{was} is now {now}" for was, now in moved)


def test_every_experiment_has_a_short_form_and_every_form_a_test():
    assert {each.name for each in experiments(find_config_root())} < set(short_forms())
    texts = (path.read_text() for path in (ROOT / "tests" / "jobs").glob("test_*.py"))
    tested = [each for text in texts for each in re.findall(r"^FORMS = \(([^)]*)\)", text, re.M)]
    assert sorted(re.findall(r'"(\w+)"', " ".join(tested))) == sorted(short_forms())


def test_golden_data_have_their_case_and_are_small():
    files = {path for path in DATA.rglob("*") if path.is_file()}
    assert files == {file(case) for case in cases()}
    assert sum(path.stat().st_size for path in FOLDER.rglob("*.*")) < MOST_BYTES
