"""The default run in a short form: its files, its numbers, its page, and what may be varied."""

import json
import re

import numpy as np
import pytest
import xarray

from srsinv.report.data import metrics_json
from tests.golden.cases import is_measured
from tests.golden.check import golden_test
from tests.jobs.run import command, outcome, short_form, short_run

FORMS = ("default", "default_float32", "default_open", "default_effects")

test_nothing_has_moved = golden_test(FORMS, FORMS[0], claims=FORMS[1:])

SMALL = short_form("default")
METHODS = ("wiener", "tikhonov")
HEADINGS = [
    "Recovered p and q",
    "Scene and sensor",
    "Traction on the skin",
    "Stress at the film",
    "Current",
    "Signal",
    "Residual",
    "Spectra",
    "Averaging kernel",
    "Assumptions",
]
FEEDBACK_OHM = 1e6
WEIGHTS = ("method.tikhonov.weight_p=1e-6", "method.tikhonov.weight_q=1e-6")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "default"
    assert command(folder, *SMALL, "figures=all") == 0
    return folder


@pytest.fixture(scope="module")
def result(folder):
    with xarray.open_dataset(folder / "result.nc", engine="h5netcdf") as dataset:
        yield dataset.load()


@pytest.fixture(scope="module")
def metrics(folder):
    return json.loads((folder / "metrics.json").read_text())


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "report.html").read_text()


def untimed(text):
    return [line for line in text.splitlines() if not is_measured(line)]


def test_folder(folder):
    names = {path.name for path in folder.iterdir()}
    assert names == {"metrics.json", "result.nc", "report.html", "run.json", "figures", ".hydra"}
    assert len(list((folder / "figures").glob("*.png"))) >= len(HEADINGS) - 1


def test_every_stage_with_its_unit(result):
    assert all("units" in variable.attrs for variable in result.variables.values())
    units = {
        "traction": "Pa",
        "stress": "Pa",
        "charge": "C",
        "current": "A",
        "signal": "V",
        "estimate": "Pa",
        "estimate_stderr": "Pa",
    }
    assert {name: result[name].attrs["units"] for name in units} == units
    assert all(np.all(np.isfinite(result[name])) for name in units)


def test_one_estimate_is_chosen_by_its_name(result):
    """No dimension is named as an argument of `sel` (method, tolerance, drop)."""
    one = result["estimate"].sel(estimator="Wiener", component="p")
    np.testing.assert_array_equal(one, result["estimate"].values[0, 0])


def test_current_through_the_feedback_resistor(result):
    np.testing.assert_allclose(
        FEEDBACK_OHM * result["current"], result["signal_noise_free"], rtol=1e-12
    )


def test_noise_is_what_was_asked_for(result):
    clean, noise = result["signal_noise_free"], result["signal"] - result["signal_noise_free"]
    assert 10 * np.log10(np.mean(clean**2) / np.mean(noise**2)) == pytest.approx(40.0, abs=1.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("component", ["p", "q"])
def test_recovered(metrics, method, component):
    assert metrics[f"status_{method}"] == "converged"
    assert 0 < metrics[f"error_{component}_{method}"] < 0.15
    assert 0.8 <= metrics[f"coverage_{component}_{method}"] <= 1


def test_error_is_that_of_the_arrays(result, metrics):
    truth = result["traction"] - result["traction"].mean("x")
    estimate = result["estimate"] - result["estimate"].mean("x")
    error = np.sqrt(((estimate - truth) ** 2).sum("x") / (truth**2).sum("x"))
    for method in METHODS:
        for component in ("p", "q"):
            expected = float(error.sel({"estimator": method.capitalize(), "component": component}))
            assert metrics[f"error_{component}_{method}"] == pytest.approx(expected, rel=1e-9)


def test_seed_decides_the_metrics(folder):
    written = untimed((folder / "metrics.json").read_text())
    assert untimed(metrics_json(short_run("default").metrics)) == written
    assert untimed(metrics_json(outcome(*SMALL, "seed=1").metrics)) != written


def test_single_precision(result):
    dataset = outcome(*SMALL, "precision=float32", "method=wiener").dataset
    assert dataset["estimate"].dtype == np.float32
    expected = result["estimate"].sel({"estimator": "Wiener"})
    difference = np.linalg.norm(dataset["estimate"].sel({"estimator": "Wiener"}) - expected)
    assert 0 < difference < 1e-2 * np.linalg.norm(expected)


@pytest.mark.full
@pytest.mark.parametrize(
    ("overrides", "error"),
    [
        (("grid.line=open", "grid.cells=128", "grid.refinement=2", *WEIGHTS), 0.25),
        (("sensor=one_element", "scene=sinusoid", "friction=0.3"), 0.15),
    ],
)
def test_variants(overrides, error):
    values = outcome(*SMALL, "method=tikhonov", *overrides).metrics
    assert values["status_tikhonov"] == "converged"
    assert values["error_p_tikhonov"] < error


def test_sections_in_order(page):
    headings = [re.sub("<[^>]*>", "", h) for h in re.findall(r"<h2[^>]*>(.*?)</h2>", page, re.S)]
    assert [re.sub(r"^[\d.\s]+", "", heading).strip() for heading in headings] == HEADINGS


def test_page_is_self_contained(page):
    assert "://" not in page
    sources = re.findall(r"""\bsrc=["']?(.{5})""", page)
    assert len(sources) >= len(HEADINGS) - 1
    assert set(sources) == {"data:"}
    assert all(link.startswith("#") for link in re.findall(r"""\bhref=["']?([^"'>]*)""", page))
