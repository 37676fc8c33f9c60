"""The short form of the feature fit's coverage: what its numbers must say, and what is refused."""

import numpy as np
import pytest

from srsinv import config
from srsinv.forward.feature import StripFeature
from srsinv.inverse.features.fit import FeatureFitter
from srsinv.inverse.features.synthetic import KnownLoad, SampledScan, SyntheticScan
from srsinv.jobs._statistics import coverage
from srsinv.jobs.coverage import errors
from tests.golden.check import golden_test
from tests.jobs.run import check_page, composed, outcome, short_run
from tests.refusals import refused
from tests.tiers import quick

DRAWS = 16
FORMS = ("coverage",)
SHORT = (
    "experiment=coverage",
    "grid.length_m=0.012",
    "grid.start_m=-0.006",
    f"coverage.draws={DRAWS}",
)
PARAMETERS = ("position_m", "load_N_per_m", "friction")

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def coloured():
    return short_run(*FORMS)


@pytest.mark.full
def test_every_parameter_is_efficient_and_covered(coloured):
    """16 draws: a root mean squared error scatters by 18 %."""
    metrics = coloured.metrics
    assert metrics["line_load_converged"] == DRAWS
    assert 36 < metrics["line_load_snr_dB"] < 40  # sliding noise comes on top of 40 dB
    for name in PARAMETERS:
        label = f"line_load_{name}"
        assert 0.45 < metrics[f"{label}_rmse_over_crb"] < 1.6
        assert metrics[f"{label}_stderr_over_crb"] == pytest.approx(1, abs=0.02)
        assert metrics[f"{label}_coverage_68"] <= metrics[f"{label}_coverage_95"]
        assert metrics[f"{label}_coverage_95"] > 0.7


@pytest.mark.full
def test_numbers_are_those_of_the_dataset(coloured):
    data, metrics = coloured.dataset, coloured.metrics
    assert all("units" in data[name].attrs for name in data.variables)
    assert data["line_load_load_N_per_m"].attrs["units"] == "N/m"
    error = data["line_load_position_m"].values - float(data["line_load_position_m_truth"])
    assert metrics["line_load_rmse_position_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
    normal = error / data["line_load_position_m_stderr"].values
    assert metrics["line_load_position_m_coverage_90"] == np.mean(np.abs(normal) < 1.6448536)


@pytest.mark.full
def test_page(coloured):
    check_page(coloured)


def test_a_phase_is_wrong_by_half_a_turn_at_most():
    value = np.array([[3.1, -3.1, 3.0]])
    wrong = errors(["phase_rad"], value, np.array([3.1]))
    np.testing.assert_allclose(wrong, [[0, 2 * np.pi - 6.2, -0.1]], atol=1e-12)
    np.testing.assert_allclose(errors(["position_m"], value, np.array([3.1]))[0, 1], -6.2)


def test_coverage_is_the_fraction_of_intervals_that_hold_the_truth():
    rng = np.random.default_rng(1)
    z = rng.normal(size=(2, 20_000)) * np.array([[1.0], [2.0]])
    right, narrow = coverage(z, 0.9)
    assert right == pytest.approx(0.9, abs=0.01)
    assert narrow == pytest.approx(0.589, abs=0.015)  # of errors twice as large as stated


REFUSED = {
    "draws": ("coverage.draws=3", "coverage.draws", "8"),
    "seed": ("seed=-1", "seed is -1", "whole number from 0"),
    "no_features": ("feature=[]", "No feature", "feature=[strip_load]"),
    "rate": ("coverage.sample_rate_hz=0", "sample_rate_hz", "above 0"),
    "slow": ("coverage.sample_rate_hz=50", "sample_rate_hz", "two samples per film depth"),
    "still": ("scan.speed_m_per_s=0.0", "scan.speed_m_per_s", "speed"),
    "silent": ("noise=[]", "no noise", "noise=[snr]"),
    "outside": ("coverage.truth.line_load.position_m=0.1", "position_m is 0.1", "-0.006"),
    "nothing": ("coverage.truth.line_load.load_N_per_m=0", "load_N_per_m", "another value"),
    "word": ("coverage.truth.line_load.friction=some", "friction", "number"),
    "missing": ("coverage.truth.line_load=null", "line_load", "position_m, load_N_per_m, friction"),
    "known": ("feature.line_load.friction=0.1", "friction", "0.1"),
}


@pytest.mark.parametrize("name", quick(REFUSED, *[*REFUSED][::4]))
def test_refused_in_one_sentence(name):
    override, *words = REFUSED[name]
    given = ("feature=[line_load]",) if not override.startswith("feature=") else ()
    refused(lambda: outcome(*SHORT, *given, override), *words)


@pytest.mark.full
def test_known_friction_is_no_parameter():
    cfg = composed(*SHORT)
    parts = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
    on = SyntheticScan.along(config.line(cfg), SampledScan("coverage", 1e3, *parts))
    fitter = FeatureFitter.along(on.sensor, on.motion)
    truth = {"position_m": 1e-3, "width_m": 3e-3, "pressure_Pa": 5e3, "friction": 0.4}
    free, known = (
        KnownLoad(on, "strip", truth, StripFeature(friction=friction), fitter).bounds()
        for friction in (None, 0.4)
    )
    assert set(free) - set(known) == {"friction"}
    assert all(known[part] <= free[part] for part in known)


RECORDINGS = 10


@pytest.fixture(scope="module")
def surface():
    """Wider edges and a shorter window than the scene's, which take fewer cells."""
    return outcome(
        "experiment=coverage",
        "scene=ridge",
        "scene.surfaces.ridge.edge_length_m=4e-5",
        "coverage.window_m=[-0.009,0.009]",
        f"coverage.draws={RECORDINGS}",
    )


@pytest.mark.claim
def test_page_is_whole(surface):
    check_page(surface)


@pytest.mark.claim
@pytest.mark.parametrize("part", ["height_m", "width_m", "position_m", "base_friction"])
def test_a_ridge_is_covered_too(surface, part):
    """10 recordings: the share in a 90 % interval scatters by 10 %, an rms error by 22 %."""
    metrics = surface.metrics
    assert metrics["ridge_converged"] == RECORDINGS
    assert metrics[f"ridge_{part}_coverage_90"] >= 0.7
    assert 0.4 < metrics[f"ridge_{part}_rmse_over_crb"] < 1.7  # 99.8 % of chi squared
    assert 1 / 1.3 < metrics[f"ridge_{part}_stderr_over_crb"] < 1.3


def test_a_surface_that_cannot_be_fitted_is_refused():
    refused(lambda: outcome("experiment=coverage", "scene=rough"), "scene=ridge", "Ridge")
    refused(
        lambda: outcome("experiment=coverage", "scene=ridge", "coverage.window_m=[1,0]"),
        "coverage.window_m",
    )
    refused(
        lambda: outcome("experiment=coverage", "scene=ridge", "feature=[tape]"), "tape", "leave"
    )
