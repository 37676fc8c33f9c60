"""The short form of accuracy against cost: what must fall, and what must agree."""

import numpy as np
import pytest

from srsinv.__main__ import find_config_root
from srsinv.errors import BadInput
from srsinv.jobs import accuracy_cost
from srsinv.namespaces import benchmark, import_experiments
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

FORMS = ("accuracy_cost",)
TOLERANCES = (1e-4, 1e-8)

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def result():
    return short_run(*FORMS)


@pytest.mark.full
def test_page(result):
    check_page(result)


@pytest.mark.full
def test_the_fastest_is_the_fastest_of_those_that_are_near(result):
    ds = result.dataset
    first = ds.isel(fastest=0)
    size = int(ds["size"].where(ds["part"] == "forward").max())
    ways = ds.isel(
        case=np.flatnonzero((ds["part"] == "forward") & (ds["line"] == first.fastest_line))
    )
    times = ways["steady_call_s"].where(
        (ways["size"] == size) & ways["family"].isin(["float64", "float32"])
        & (ways["algebraic_error"] <= first.fastest_within)
    )  # fmt: skip
    assert float(times.min()) == first["fastest_steady_call_s"]


def test_peers_are_those_of_a_clone(tmp_path):
    try:
        import_experiments(tmp_path / "configs")
        assert benchmark("peers") is None
    finally:
        import_experiments(find_config_root())
    assert benchmark("peers") is not None


@pytest.mark.full
def test_without_peers_the_rows_are_ours_alone(monkeypatch):
    monkeypatch.setattr(accuracy_cost, "benchmark", lambda name: None)
    result = outcome(*short_form(*FORMS))
    assert not {"numpy", "scipy cg, 1e-08"} & set(result.dataset["family"].values)
    assert set(result.dataset["fit_family"].values) == {
        "optimistix", "optax L-BFGS", "jaxopt LBFGSB",
    }  # fmt: skip
    assert set(result.dataset["fastest_peer"].values) == {"none"}
    check_page(result)


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
        ("periodic_spectral_float32", 1e-2),
        ("open_direct", 1e-8),
        *((f"open_{solver}_{tol:g}", 1e3 * tol) for solver in ("iterative", "scipy_cg")
          for tol in TOLERANCES),
    ],
)  # fmt: skip
def test_ways_of_solving_agree(result, family, most):
    line, _, way = family.partition("_")
    assert result.metrics[f"tikhonov_{line}_{way}_64_algebraic_error"] < most


@pytest.mark.full
@pytest.mark.parametrize("solver", ["iterative", "scipy_cg"])
def test_a_tighter_tolerance_is_closer(result, solver):
    loose, tight = (
        result.metrics[f"tikhonov_open_{solver}_{tol:g}_64_algebraic_error"] for tol in TOLERANCES
    )
    assert tight < loose / 10


@pytest.mark.full
def test_every_variable_has_units_and_every_time_is_positive(result):
    assert all("units" in result.dataset[name].attrs for name in result.dataset.variables)
    assert np.all(result.dataset["steady_call_s"] > 0)
    assert np.all(result.dataset["fit_steady_call_s"] > 0)


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


@pytest.mark.full
@pytest.mark.parametrize("sweep", ["starts", "batch"])
def test_fits_are_timed_over_starts_and_together(result, sweep):
    key = f"fit_{sweep}_optimistix_2"
    assert result.metrics[f"{key}_steady_call_s"] < result.metrics[f"{key}_first_call_s"]


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("forward_cells=[128,200]", "forward_cells"),
        ("inverse_cells=[]", "inverse_cells"),
        ("repeats=0", "repeats"),
        ("tolerances=[0.0]", "tolerances"),
        ("fit.tolerances=[]", "tolerances"),
        ("fit.starts=[0]", "starts"),
        ("fit.batches=[]", "batches"),
        ("fit.signals=0", "signals"),
    ],
)
def test_bad_settings_are_refused(setting, named):
    with pytest.raises(BadInput, match=named):
        outcome(*short_form(*FORMS), f"accuracy_cost.{setting}")
