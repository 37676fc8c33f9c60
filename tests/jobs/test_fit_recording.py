"""Features fitted to recordings: the bundled example against its truth, choosing, refusals."""

import json
from pathlib import Path

import numpy as np
import pytest

import srsinv
from srsinv.errors import BadInput
from srsinv.recording import Recording, save
from srsinv.report.result import Result
from tests.golden.check import golden_test
from tests.jobs.run import check_page, command, outcome, short_run, tables, words
from tests.tiers import quick

FORMS = ("fit_recording", "fit_recording_choose")

test_nothing_has_moved = golden_test(FORMS, FORMS[0], claims=FORMS[1:])

EXAMPLES = Path(srsinv.__file__).parent / "examples"
TRUTH = json.loads((EXAMPLES / "strip_two_element.truth.json").read_text())
SHAPE = ("position_m", "width_m", "pressure_Pa", "friction")


@pytest.fixture(scope="module")
def example():
    return short_run("fit_recording")


def test_the_bundled_example_gives_its_truth_without_a_start(example):
    """The data come from the strip's closed form, the model from cells."""
    metrics = example.metrics
    assert metrics["status"] == "converged"
    for name in SHAPE:
        error = metrics[name] - TRUTH[name]
        assert abs(error) < 4 * metrics[f"{name}_stderr"], name
        assert metrics[f"{name}_stderr_noise"] < 0.015 * abs(TRUTH[name])
    assert metrics["noise_rms_V"] == pytest.approx(TRUTH["white_noise_rms_V"], rel=0.05)
    assert metrics["chi2_per_freedom"] == pytest.approx(1.0, abs=0.12)


def test_the_evidence_prefers_the_strip_to_nothing(example):
    assert example.metrics["probability_strip_load"] > 0.999
    assert example.metrics["log_evidence_strip_load"] > example.metrics["log_evidence_nothing"]


def test_every_stage_of_the_fit_is_in_the_result(example):
    ds = example.dataset
    left = ds["signal"] - ds["fitted_signal"]
    white = ds["whitened_residual"].values
    np.testing.assert_allclose(white, left.values / example.metrics["noise_rms_V"], rtol=1e-9)
    p = ds["estimate"].sel(component="p")
    at = int(np.argmin(np.abs(ds["x"].values - TRUTH["position_m"])))
    assert float(p[at]) == pytest.approx(example.metrics["pressure_Pa"], rel=1e-9)
    band = float(ds["estimate_stderr"].sel(component="p")[at])
    assert band == pytest.approx(example.metrics["pressure_Pa_stderr"], rel=1e-6)


@pytest.fixture(scope="module")
def noise_only(tmp_path_factory):
    """A recording of noise alone, with the example's sensor."""
    sidecar = json.loads((EXAMPLES / "strip_two_element.json").read_text())
    sidecar |= {"sample_rate_hz": 1000}
    n = 400
    noise = 1e-6 * np.random.default_rng(5).standard_normal((2, n))
    recording = Recording(
        noise, np.arange(n) / 1000, np.full(n, 0.05), ("voltage_0_V", "voltage_1_V"), sidecar
    )
    path = tmp_path_factory.mktemp("noise") / "noise.csv"
    save(recording, path)
    return path


@pytest.mark.full
def test_nothing_is_chosen_on_noise(noise_only):
    metrics = outcome(
        "experiment=fit_recording", f"recording.path={noise_only}",
        "feature=[line_load,step_load]", "fit.select=true",
    ).metrics  # fmt: skip
    assert metrics["feature"] == "nothing"
    assert metrics["probability_nothing"] > 0.9


@pytest.fixture(scope="module")
def sampled():
    return outcome("experiment=fit_recording", "recording.tolerance=none", "fit.samples=300")


@pytest.mark.claim
def test_samples_of_the_posterior_agree_with_a_fit_of_strong_signals(sampled):
    """The model is linear over so small errors: moments agree to their Monte Carlo errors."""
    metrics, data = sampled.metrics, sampled.dataset
    assert set(data["reported"].values) == set(SHAPE)
    for name in SHAPE:
        ess = float(data["ess_bulk"].sel(reported=name))
        off = metrics[f"{name}_sample_mean"] - metrics[name]
        stderr = metrics[f"{name}_stderr"]
        assert abs(off) < 4.5 * stderr / np.sqrt(ess), name
        ratio = metrics[f"{name}_sample_std"] / stderr
        assert ratio == pytest.approx(1.0, abs=4.5 / np.sqrt(2 * ess)), name
    assert "Quality of the samples: " in words(sampled)
    check_page(sampled, ("correlation",))


@pytest.mark.full
def test_asymmetric_intervals_have_a_table(example):
    low, high = np.array([[np.nan, 3.7e-3, np.nan, np.nan], [np.nan, np.inf, np.nan, np.nan]])
    own = {
        f"profile_{what}": ("reported", ends, {"units": "SI"})
        for what, ends in (("low", low), ("high", high))
    }
    made = Result(example.title, example.dataset.assign(own), example.sections)
    (table,) = [each for each in tables(made) if "by profile likelihood" in str(each.columns)]
    assert len(table.rows) == 1
    assert table.rows[0][1] == "above 3.70 mm"


REFUSED = {
    "samples": (["fit.samples=10"], "fit.samples is 10"),
    "no feature": (["feature=[]"], "feature=[strip_load]"),
    "unknown key": (["+feature.strip_load.pitch_range_m=[0.1,0.2]"], "pitch_range_m"),
    "range turned": (["feature.strip_load.width_range_m=[0.004,0.001]"], "width_range_m"),
    "range below zero": (["feature.strip_load.width_range_m=[-0.004,0.001]"], "width_range_m"),
    "friction in words": (["feature.strip_load.friction=high"], "friction"),
    "friction of all": (["friction=0.3"], "feature.strip_load.friction"),
    "tolerance": (["solver.tolerance=2"], "tolerance"),
    "noise by ratio": (["noise=[snr]"], "noise=snr"),
}


@pytest.mark.parametrize(
    ("given", "word"), quick(REFUSED.values(), next(iter(REFUSED.values()))), ids=REFUSED
)
def test_bad_requests_are_refused_before_any_fit(given, word, tmp_path, capsys):
    assert command(tmp_path / "run", "experiment=fit_recording", *given) == 2
    said = capsys.readouterr().err.strip()
    assert word in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_a_missing_recording_is_refused_by_name():
    with pytest.raises(BadInput, match="nowhere"):
        outcome("experiment=fit_recording", "recording.path=nowhere.csv")


@pytest.mark.full
def test_tolerances_have_a_part_in_every_standard_error(example):
    """Their squares add up, and the whole is more than where facts are exact."""
    metrics = example.metrics
    exact = outcome("experiment=fit_recording", "recording.tolerance=none").metrics
    for name in SHAPE:
        assert f"{name}_stderr_noise" not in exact
        parts = [value for key, value in metrics.items() if key.startswith(f"{name}_stderr_")]
        assert sum(part**2 for part in parts) == pytest.approx(metrics[f"{name}_stderr"] ** 2)
        assert metrics[f"{name}_stderr"] > exact[f"{name}_stderr"]
