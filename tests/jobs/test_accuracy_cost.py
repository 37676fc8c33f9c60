"""Accuracy against cost: what the scores of its parts must say."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

from srsinv.__main__ import find_config_root
from srsinv.errors import BadInput
from srsinv.jobs import accuracy_cost
from srsinv.jobs._cost_contact import Wave
from srsinv.jobs._cost_trials import relative
from srsinv.namespaces import benchmark, import_experiments
from tests.golden.check import golden_test
from tests.jobs.run import check_page, composed, outcome, result_of, short_form, short_run

FORMS = ("accuracy_cost",)
TINY = {
    "parts": ["forward", "contact"], "forward_cells": [64], "contact_cells": [256],
    "tolerances": [1e-4], "repeats": 1, "budget_s": None,
}  # fmt: skip
OTHERS = {"parts": ["effects", "recordings"], "effects_cells": [64], "recording_samples": [256]}

test_nothing_has_moved = golden_test(FORMS, claims=FORMS)


@cache
def unchanged() -> dict[str, Any]:
    """The experiment's configuration with one method and one effect."""
    return composed("experiment=accuracy_cost", "method=[wiener]", "effects=[film_angle]")


def changed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The same with these settings."""
    cfg = unchanged()
    own = {**cfg["accuracy_cost"], "effects": {}, **settings}
    return {**cfg, "accuracy_cost": own}


@pytest.fixture(scope="module")
def tiny():
    return result_of(changed(TINY))


@pytest.fixture(scope="module")
def others():
    return result_of(changed(TINY | OTHERS))


@pytest.fixture(scope="module")
def result():
    return short_run(*FORMS)


# --- what scores must say --------------------------------------------------------------------


@pytest.mark.full
def test_every_trial_has_units_and_a_time(tiny):
    ds = tiny.dataset
    assert set(ds["part"].values) == {"forward", "gradient", "contact"}
    assert set(ds["failure"].values) == {""}
    assert all("units" in ds[name].attrs for name in ds.variables)
    assert np.all(ds["steady_call_s"] > 0)


@pytest.mark.full
def test_a_refined_signal_is_nearer_than_one_of_cells_and_cells_than_points(tiny):
    errors = [
        tiny.metrics[f"forward_periodic_{family}_64_error"]
        for family in ("refined", "float64", "point_samples")
    ]
    assert errors[0] < errors[1] / 4 < errors[2] / 4


@pytest.mark.full
def test_the_contact_is_the_closed_form(tiny):
    assert tiny.metrics["contact_periodic_as_called_256_error"] < 2e-3
    apart = tiny.metrics["contact_periodic_from_no_pressure_0.0001_256_algebraic_error"]
    assert 0 < apart < 1e-2


def test_tamaas_is_near_the_closed_form():
    pytest.importorskip("tamaas")
    import_experiments(find_config_root())
    peers, wave = benchmark("peers"), Wave(256)
    assert peers is not None
    (other,) = peers.contacts([1e-8]).values()
    error = relative(wave.by_peer(other)(), wave.exact())
    assert error < 2e-3


def test_a_scene_that_is_none_is_refused_before_any_trial():
    cfg = changed(TINY)
    with pytest.raises(BadInput, match=r"scan\.speed_m_per_s"):
        result_of({**cfg, "scan": {**cfg["scan"], "speed_m_per_s": 0.0}})


def test_peers_are_those_of_a_clone(tmp_path):
    try:
        import_experiments(tmp_path / "configs")
        assert benchmark("peers") is None
    finally:
        import_experiments(find_config_root())
    assert benchmark("peers") is not None


def test_bad_settings_are_refused():
    for settings, named in (
        ({"forward_cells": [128, 200]}, "forward_cells"), ({"inverse_cells": []}, "inverse_cells"),
        ({"repeats": 0}, "repeats"), ({"tolerances": [0.0]}, "tolerances"),
        ({"contact_cells": [2]}, "contact_cells"), ({"parts": ["backward"]}, "parts"),
        ({"budget_s": -1}, "budget_s"), ({"rows": 3}, "rows"), ({"is_fresh": 1}, "is_fresh"),
    ):  # fmt: skip
        with pytest.raises(BadInput, match=f"accuracy_cost.{named}"):
            result_of(changed(settings))


# --- the short form of all parts -------------------------------------------------------------


@pytest.mark.full
def test_page(result):
    check_page(result)


@pytest.mark.full
def test_effects_and_recordings_are_on_the_page(others):
    assert set(others.dataset["failure"].values) == {""}
    assert others.metrics["effects_periodic_film_angle_64_error"] > 1e-2
    assert others.metrics["recordings_open_wiener_256_error"] < 1.0
    check_page(others)


@pytest.mark.full
def test_without_peers_the_rows_are_ours_alone(monkeypatch):
    monkeypatch.setattr(accuracy_cost, "benchmark", lambda name: None)
    alone = outcome(*short_form(*FORMS), "accuracy_cost.parts=[forward]")
    assert "numpy" not in set(alone.dataset["family"].values)
    assert set(alone.dataset["goal_peer"].values) == {"none"}
    check_page(alone)


@pytest.mark.full
@pytest.mark.parametrize("line", ["periodic", "open"])
def test_float64_forward_error_falls_with_the_square_of_the_cell(result, line):
    errors = [result.metrics[f"forward_{line}_float64_{n}_error"] for n in (64, 256)]
    assert errors[1] < errors[0] / 3**2


@pytest.mark.full
@pytest.mark.parametrize("line", ["periodic", "open"])
def test_numpy_agrees_on_the_forward_model(result, line):
    assert result.metrics[f"forward_{line}_numpy_256_algebraic_error"] < 1e-10
    assert 1e-9 < result.metrics[f"forward_{line}_float32_256_algebraic_error"] < 1e-4


@pytest.mark.full
@pytest.mark.parametrize(
    ("family", "most"),
    [
        ("periodic_numpy", 1e-10),
        ("periodic_direct", 1e-8),
        ("periodic_direct_evidence", 1e-2),
        ("periodic_spectral_float32", 1e-2),
        ("open_direct", 1e-8),
        ("open_iterative_gcv", 1e-2),
        *((f"open_{solver}_{tol:g}", 1e3 * tol) for solver in ("iterative", "scipy_cg")
          for tol in (1e-4, 1e-8)),
    ],
)  # fmt: skip
def test_ways_of_solving_agree(result, family, most):
    line, _, way = family.partition("_")
    assert result.metrics[f"tikhonov_{line}_{way}_64_algebraic_error"] < most


@pytest.mark.full
def test_the_fastest_is_the_fastest_of_those_that_are_near(result):
    ds = result.dataset
    first = ds.isel(goal=0)
    ways = ds.isel(case=np.flatnonzero((ds["part"] == "forward") & (ds["line"] == "periodic")))
    near = ways["steady_call_s"].where(
        (ways["family"] != "numpy") & (ways["error"] <= first.goal_within)
    )
    assert float(near.min()) == first["goal_steady_call_s"]


@pytest.mark.full
@pytest.mark.parametrize(
    ("family", "most"),
    [
        ("optimistix", 1e-6),
        ("optax_l_bfgs", 1e-3),
        ("scipy_2_point", 1e-3),
        ("scipy_analytic", 1e-3),
    ],
)
def test_solvers_of_the_fit_meet_in_one_minimum_near_the_truth(result, family, most):
    key = f"fit_tolerance_{family}_1e-08"
    assert result.metrics[f"{key}_error"] < most  # of a standard error
    assert result.metrics[f"{key}_error_cramer_rao"] < 3
