"""Names that were changed: the old one is still read or given, until its time is over."""

import json

import pytest
import yaml
from packaging.version import Version

import srsinv
from srsinv.__main__ import main
from srsinv.aliases import (
    CLASSES,
    KEYS,
    METRICS,
    OPTIONS,
    current_override,
    with_current_keys,
    with_old_names,
)
from srsinv.report.page import metrics_json
from srsinv.targets import make
from tests.jobs.run import composed


@pytest.mark.parametrize("alias", METRICS, ids=lambda alias: alias.old)
def test_an_old_name_of_a_metric_holds_what_the_new_one_does(alias):
    new, old = (name.replace("*", "wiener") for name in (alias.new, alias.old))
    assert json.loads(metrics_json({new: "said"})) == {new: "said", old: "said"}


@pytest.mark.parametrize("alias", [*METRICS, *KEYS, *OPTIONS, *CLASSES], ids=str)
def test_no_alias_outlives_its_time(alias):
    assert Version(srsinv.__version__) < Version(alias.until), f"take {alias.old} out of the table"


def test_other_names_have_no_alias():
    metrics = {"warnings": "none", "quality_wiener": "good", "position_m": 1.0}
    assert with_old_names(metrics) == metrics


TYPED = {
    "noise.snr.snr_db=20": "noise.snr.snr_dB=20",
    "+compare.snr_db=[20.0]": "+compare.snr_dB=[20.0]",
    "~fit.choose": "~fit.select",
    "ranking.drawn.grating.duty=[0.2,0.3]": "ranking.truth_ranges.grating.duty=[0.2,0.3]",
    "hard_cases.cases.deep.hard=snr_db": "hard_cases.cases.deep.label=snr_db",
    "seed=3": "seed=3",
}


@pytest.mark.parametrize("typed", TYPED)
def test_an_old_key_may_be_typed(typed):
    assert current_override(typed) == TYPED[typed]


@pytest.mark.full
def test_the_command_reads_old_keys(capsys):
    assert main(["noise=[snr]", "noise.snr.snr_db=17", "--cfg", "job"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["noise"] == {
        "snr": {"_target_": "srsinv.forward.noise.SignalToNoise", "snr_dB": 17}
    }


def test_an_old_key_in_a_file_counts_before_the_default():
    own = {"noise": {"snr": {"snr_dB": 40.0, "snr_db": 17.0}}, "levels": [{"snr_db": 3.0}]}
    assert with_current_keys(own) == {
        "noise": {"snr": {"snr_dB": 17.0}}, "levels": [{"snr_dB": 3.0}],
    }  # fmt: skip


@pytest.mark.parametrize("alias", OPTIONS, ids=lambda alias: alias.old)
def test_an_old_option_is_the_new_one(alias):
    assert composed(alias.old) == composed(alias.new)


OLD_CLASSES = {
    "srsinv.forward.amplifier.SlowReadout": ("amplifier", {"gain_per_C": 2.0}, "ChargeReadout"),
    "srsinv.forward.effects.clipping.Clipping": ("effects", {"limit": 2.0}, "Clipping"),
}


@pytest.mark.parametrize("old", OLD_CLASSES)
def test_an_old_class_is_the_new_one(old):
    kind, settings, new = OLD_CLASSES[old]
    assert type(make({"_target_": old, **settings}, kind, kind)).__name__ == new


def test_every_alias_of_a_class_is_tried():
    assert all(any(alias.newer(old) for old in OLD_CLASSES) for alias in CLASSES)
