"""The table of mutations fits the package, and the results beside it are those of the table."""

import ast
from dataclasses import replace

import pytest

from tests.mutations import results
from tests.mutations.table import ROOT, Stale, mutations

TABLE = mutations()
ONE = TABLE["contact_modulus"]
DOES_NOT_FIT = {
    "a module that is gone": ({"symbol": "srsinv.forward.fur:HalfSpace"}, "fur.py"),
    "a symbol that is gone": ({"symbol": "srsinv.forward.skin:HalfSpace.feel"}, "'feel'"),
    "a fragment that is gone": ({"old": "1 + self.poisson_ratio**2"}, "stands 0 times"),
    "a fragment that stands twice": ({"old": "self"}, "stands 2 times"),
}


@pytest.mark.parametrize("name", TABLE)
def test_it_applies(name):
    mutation = TABLE[name]
    compile(mutation.applied(), mutation.path, "exec")
    assert ast.dump(ast.parse(mutation.old)) != ast.dump(ast.parse(mutation.new))
    assert [test for test in mutation.tests if not (ROOT / test).is_file()] == []


@pytest.mark.parametrize("case", DOES_NOT_FIT)
def test_what_does_not_fit_is_said(case):
    changed, words = DOES_NOT_FIT[case]
    with pytest.raises(Stale, match=rf"^Mutation contact_modulus: [^.]*.*{words}.*: bring "):
        replace(ONE, **changed).applied()


def test_a_fragment_is_found_whatever_its_spacing():
    spread = replace(ONE, old="(1\n - self . poisson_ratio ** 2)")
    assert spread.applied() == ONE.applied()


def test_what_is_recorded_is_of_this_table():
    """Else: python -m tests.mutations NAME."""
    recorded = results.read()
    stale = {n for n in recorded if n not in TABLE or not results.is_of(recorded[n], TABLE[n])}
    assert stale == set()


def test_every_mutation_is_noticed():
    """By a test, in the run that was recorded last, or by none as it changes nothing. Else: python
    -m tests.mutations NAME, and a test of what it guards, or what guards nothing goes."""
    recorded = results.read()
    missed = [
        name
        for name, each in TABLE.items()
        if not each.equivalent and not recorded.get(name, {}).get("tier")
    ]
    assert missed == []
