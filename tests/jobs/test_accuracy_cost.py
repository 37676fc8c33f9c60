"""Accuracy against cost: how trials are run, resumed and left out; what their scores must say."""

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

from srsinv.__main__ import find_config_root
from srsinv.errors import BadInput
from srsinv.jobs import accuracy_cost
from srsinv.jobs._cost_contact import Wave
from srsinv.jobs._cost_rows import RowFile
from srsinv.jobs._cost_runner import run as run_trials
from srsinv.jobs._cost_table import tables
from srsinv.jobs._cost_trials import CostScore, CostTrial, relative
from srsinv.memory import weighed
from srsinv.namespaces import benchmark, import_experiments
from srsinv.report import plot
from tests.golden.check import golden_test
from tests.jobs.run import check_page, composed, outcome, result_of, short_form, short_run

FORMS = ("accuracy_cost",)
SIZES = (16, 64, 256)
TINY = {
    "parts": ["forward", "contact"], "forward_cells": [64], "contact_cells": [256],
    "tolerances": [1e-4], "repeats": 1, "budget_s": None,
}  # fmt: skip
OTHERS = {"parts": ["effects", "recordings"], "effects_cells": [64], "recording_samples": [256]}

test_nothing_has_moved = golden_test(FORMS)


def trial(family: str, size: int, work=lambda: 2.0, group: str = "forward", **more) -> CostTrial:
    """A trial that costs nothing; its error falls as the size grows."""
    return CostTrial(
        group=group, part=group, line="open", family=family, size=size, prepare=lambda: work,
        score=lambda value: CostScore({"error": value / size}), **more,
    )  # fmt: skip


def some_trials() -> list[CostTrial]:
    """Two families of one group, one of another."""
    first = [trial(family, size) for family in ("one", "other") for size in SIZES]
    return first + [trial("third", size, group="contact") for size in SIZES]


def refusing():
    raise BadInput("The cells are too many: take fewer.")


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


# --- how trials are run ----------------------------------------------------------------------


def test_all_trials_are_measured_and_stay_in_order():
    trials = some_trials()
    rows = run_trials(trials, 2, RowFile(None, {})).rows
    assert [row["key"] for row in rows] == [each.key for each in trials]
    assert all(row["failure"] == "" and row["steady_call_s"] > 0 for row in rows)
    assert [row["error"] for row in rows] == [2.0 / each.size for each in trials]


def test_without_time_all_is_left_out():
    done = run_trials(some_trials(), 1, RowFile(None, {}), budget_s=0.0)
    assert not done.rows
    ds = tables(done)
    assert ds.sizes["left"] == 3
    assert set(ds["left_sizes"].values) == {"16, 64, 256"}


def test_a_trial_that_fails_is_a_row_and_the_next_one_follows():
    trials = [trial("bad", 16, refusing), trial("good", 16), trial("good", 64)]
    done = run_trials(trials, 1, RowFile(None, {}))
    assert [row["failure"] for row in done.rows] == ["The cells are too many: take fewer.", "", ""]
    (axes,) = plot.cost(tables(done), failure="failure").axes
    assert [line.get_marker() for line in axes.lines].count("x") == 1


def test_a_further_run_measures_what_is_missing_of_a_file_that_was_cut_short(tmp_path):
    path, calls = tmp_path / "rows.jsonl", []

    def counted(size):
        return trial("one", size, lambda: calls.append(size) or 1.0)

    run_trials([counted(size) for size in SIZES[:2]], 1, RowFile(str(path), {"seed": 0}))
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    calls.clear()
    trials = [counted(size) for size in SIZES]
    done = run_trials(trials, 1, RowFile(str(path), {"seed": 0}))
    assert set(calls) == set(SIZES[1:])
    assert [row["size"] for row in done.rows] == list(SIZES)
    assert len(path.read_text().splitlines()) == 3
    calls.clear()
    again = run_trials(trials, 1, RowFile(str(path), {"seed": 0}))
    assert not calls
    assert again.rows[0]["steady_call_s"] == done.rows[0]["steady_call_s"]
    run_trials(trials[:1], 1, RowFile(str(path), {"seed": 1}))
    assert set(calls) == {SIZES[0]}


@pytest.mark.parametrize(
    "content",
    [
        "time,value\n1,2\n",
        '{"identity": 1}\n',
        '{"identity": "a", "row": []}\n',
        '{"identity": "a", "row": {"failure": ""}}\n',
        "[" * 5000 + "\n",
        "time,value",
    ],
)
def test_a_file_of_something_else_is_refused_and_stays(tmp_path, content):
    path = tmp_path / "table.csv"
    path.write_text(content)
    with pytest.raises(BadInput, match=r"line 1 of .*table\.csv is no row of accuracy_cost"):
        RowFile(str(path), {})
    assert path.read_text() == content


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(BadInput, match="name a file that can be read and written"):
        RowFile(str(tmp_path), {})
    with pytest.raises(BadInput, match="name a file that can be read and written"):
        RowFile(str(tmp_path / "absent" / "rows.jsonl"), {})


def test_rows_are_numbers_and_words_of_json(tmp_path):
    path = tmp_path / "rows.jsonl"
    run_trials([trial("one", 16, lambda: np.nan)], 1, RowFile(str(path), {}))
    row = json.loads(path.read_text())["row"]
    assert row["error"] is None
    assert np.isnan(RowFile(str(path), {}).row(trial("one", 16))["error"])


def test_memory_is_what_a_call_touches():
    size = 2**25
    taken = weighed(lambda: np.ones(size // 8)).rise_bytes
    assert np.isnan(taken) or 0.9 * size < taken < 1.2 * size


# --- what scores must say --------------------------------------------------------------------


def test_every_trial_has_units_and_a_time(tiny):
    ds = tiny.dataset
    assert set(ds["part"].values) == {"forward", "gradient", "contact"}
    assert set(ds["failure"].values) == {""}
    assert all("units" in ds[name].attrs for name in ds.variables)
    assert np.all(ds["steady_call_s"] > 0)


def test_a_refined_signal_is_nearer_than_one_of_cells_and_cells_than_points(tiny):
    errors = [
        tiny.metrics[f"forward_periodic_{family}_64_error"]
        for family in ("refined", "float64", "point_samples")
    ]
    assert errors[0] < errors[1] / 4 < errors[2] / 4


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
