"""Names that were changed: the old one is still given, until its time is over."""

import json

import pytest
from packaging.version import Version

import srsinv
from srsinv.aliases import METRICS, with_old_names
from srsinv.report.page import metrics_json


@pytest.mark.parametrize("alias", METRICS, ids=lambda alias: alias.old)
def test_an_old_name_holds_what_the_new_one_does(alias):
    new, old = (name.replace("*", "wiener") for name in (alias.new, alias.old))
    assert json.loads(metrics_json({new: "said"})) == {new: "said", old: "said"}
    assert Version(srsinv.__version__) < Version(alias.until), f"take {alias.old} out of the table"


def test_other_names_have_no_alias():
    metrics = {"warnings": "none", "quality_wiener": "good", "position_m": 1.0}
    assert with_old_names(metrics) == metrics
