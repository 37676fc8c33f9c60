"""The short form of the ranking: what is counted, and what is refused."""

import numpy as np
import pytest

from srsinv.jobs._statistics import wilson
from srsinv.jobs.ranking import chosen, margins
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run
from tests.refusals import refused
from tests.tiers import quick

FORMS = ("ranking",)
CANDIDATES = ["line_load", "step_load", "nothing"]

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module", params=quick(FORMS))
def ranked(request):
    return short_run(request.param)


def test_every_draw_is_right(ranked):
    metrics = ranked.metrics
    assert metrics["fraction_right"] == 1.0
    for name in CANDIDATES:
        assert metrics[f"{name}_fraction_right"] == 1.0
        assert metrics[f"{name}_margin_least"] > 0
    assert metrics["line_load_margin_mean"] > 100


def test_what_was_drawn_is_in_the_dataset(ranked):
    data = ranked.dataset
    assert list(data["candidate"].values) == CANDIDATES
    np.testing.assert_array_equal(data["chosen"].values, 2 * np.eye(3))
    assert all("units" in data[name].attrs for name in data.variables)
    assert np.all(np.abs(data["line_load_position_m"]) <= 3e-3)
    load = np.abs(data["line_load_load_N_per_m"])
    assert np.all((load >= 5) & (load <= 20))


def test_page(ranked):
    check_page(ranked, images=["confusion"])
    for drawn, _ in ranked.page.figures.values():
        labels = [label.get_text() for label in drawn.axes[0].get_yticklabels()]
        assert labels == [name.replace("_", " ") for name in CANDIDATES]


@pytest.mark.parametrize(
    ("right", "total", "low", "high"),
    # At the ends the interval is n and z^2 over n + z^2.
    [(40, 40, 0.9366, 1.0), (0, 10, 0.0, 0.2129)],
)
def test_wilson(right, total, low, high):
    assert wilson(right, total) == pytest.approx((low, high), abs=2e-4)


@pytest.mark.parametrize(("right", "total"), [(3, 10), (95, 100), (1, 2)])
def test_wilson_solves_its_equation(right, total):
    for p in wilson(right, total):
        distance = abs(right / total - p) / np.sqrt(p * (1 - p) / total)
        assert distance == pytest.approx(1.6448536)


def test_margin_and_choice():
    log_evidence = np.array([[[3.0, 1.0], [0.0, 4.0]], [[2.0, 5.0], [-np.inf, 0.0]]])
    np.testing.assert_array_equal(chosen(log_evidence), [[1, 1], [0, 2]])
    np.testing.assert_array_equal(margins(log_evidence), [[2, -4], [3, np.inf]])


REFUSED = {
    "draws": ("ranking.draws=0", "ranking.draws", "from 1"),
    "seed": ("seed=0.5", "seed is 0.5", "whole number from 0"),
    "alone": ("feature=[line_load]", "at least two"),
    "rate": ("ranking.sample_rate_hz=fast", "sample_rate_hz", "above 0"),
    "backwards": ("ranking.truth_ranges.line_load.friction=[1,0]", "friction", "[least, greatest]"),
    "sign": ("ranking.truth_ranges.step_load.pressure_Pa=[-1,1]", "pressure_Pa", "either sign"),
    "missing": (
        "ranking.truth_ranges.step_load=null",
        "step_load",
        "position_m, pressure_Pa, friction",
    ),
    "known": ("feature.step_load.friction=0.1", "friction", "null"),
}


@pytest.mark.parametrize("name", quick(REFUSED, *[*REFUSED][::4]))
def test_refused_in_one_sentence(name):
    override, *words = REFUSED[name]
    refused(lambda: outcome(*short_form(*FORMS), override), *words)
