"""The study of faults in a short form."""

import pytest

from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_run
from tests.refusals import refused

FORMS = ("robustness",)

test_nothing_has_moved = golden_test(FORMS)


@pytest.mark.full
def test_page():
    check_page(short_run(*FORMS))


def test_unknown_faults_and_none_are_refused():
    for faults, words in {"[nune]": "none", "[]": "null for all", "dead": "null for all"}.items():
        refused(lambda faults=faults: outcome("experiment=robustness",
                                              f"robustness.faults={faults}"), words)  # fmt: skip
    refused(lambda: outcome("experiment=robustness", "robustness.draws=0"), "robustness.draws")
