"""Depth, gain ratio and angle found with the traction: two elements show them, one does not."""

from functools import cache

import numpy as np
import pytest

from srsinv.inverse.estimate import TractionEstimate
from srsinv.inverse.rig.error import RigError
from srsinv.inverse.rig.found import FoundFacts
from srsinv.inverse.rig.maxima import information_of, slope_of
from srsinv.inverse.semi_blind import SemiBlind
from srsinv.inverse.wiener import Exponential, Wiener
from srsinv.modules import with_fields
from tests.inverse.cases import make_case
from tests.inverse.rough_scans import DEPTH_M, rough_scan, sensor
from tests.refusals import refused
from tests.tiers import quick

SHORT_M = 0.0145  # of a scan: one shape of program serves all tests of two elements
ALL = ("depth_m", "gain_2", "angle_2_deg")


def scan(surface="Hurst 0.8", seed=0, off=1.1, elements=2, true=None, **other):
    stated = sensor(off * DEPTH_M, elements)
    return rough_scan(surface, seed, stated, true, length_m=SHORT_M, **other)


@cache
def found(surface="Hurst 0.8", seed=0, off=1.1):
    """The estimate of a scan whose depth is stated wrong by a factor."""
    return SemiBlind()(scan(surface, seed, off).problem)


def z_of(estimate, **truth):
    """The errors of parameters in standard errors."""
    pairs = (estimate.parameters[name] for name in truth)
    return [abs(v - t) / s for (v, s), t in zip(pairs, truth.values(), strict=True)]


@pytest.mark.full
def test_the_evidence_has_its_slope_and_its_information():
    """The slope by differences; the information by its definition, of differences of the
    covariance."""
    model = FoundFacts.model_of(scan().problem, ALL)
    rng = np.random.default_rng(1)
    x = model.start() + 0.05 * rng.normal(size=model.start().size)
    slope = np.asarray(slope_of(model, x)[1])
    one = [each[0] for each in model.stretches[:4]]

    def covariance(x):
        return np.asarray(model.of_stretch(model.parted(x), one))

    along = [0, 1, 2, 5, x.size - 1]
    inverse, changes, step = np.linalg.inv(covariance(x)), [], 1e-4
    for i in along:
        above, below = x.copy(), x.copy()
        above[i], below[i] = x[i] + step, x[i] - step
        difference = float(slope_of(model, above)[0]) - float(slope_of(model, below)[0])
        assert abs(difference / (2 * step) - slope[i]) < 1e-4 * np.abs(slope).max()
        changes.append(inverse @ (covariance(above) - covariance(below)) / (2 * step))
    expected = np.array([[np.trace(a @ b) / 2 for b in changes] for a in changes])
    expected[-1, -1] += 1 / 0.3**2  # the prior of the white noise's level
    own = np.asarray(information_of(model, x))[np.ix_(along, along)]
    own[3, 3] = expected[3, 3] = 0.0  # with the prior of the spectra
    assert np.allclose(own, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("surface", "off"),
    quick(
        [("Hurst 0.8", 1.1), ("ridges", 0.75), ("tape", 1.3), ("Gaussian", 0.8)], ("Hurst 0.8", 1.1)
    ),
)
def test_two_elements_show_the_depth_of_an_unknown_surface(surface, off):
    """The gain ratio and the angle with it."""
    estimate = found(surface, 0, off)
    assert max(z_of(estimate, depth_m=DEPTH_M, gain_ratio_2=1.0, angle_2_deg=90.0)) < 4
    depth, stderr = estimate.parameters["depth_m"]
    assert abs(depth / DEPTH_M - 1) < 0.05
    assert stderr < 0.03 * depth
    assert not any("identifiable" in each for each in estimate.warnings)


@pytest.mark.claim
def test_a_gain_and_an_angle_that_are_off_are_found_with_the_depth():
    true = sensor(gain=1.2, angle_deg=84.0)
    estimate = SemiBlind()(scan(off=0.85, true=true).problem)
    assert max(z_of(estimate, depth_m=DEPTH_M, gain_ratio_2=1.2, angle_2_deg=84.0)) < 4
    assert estimate.parameters["gain_ratio_2"][1] < 0.02


def test_a_common_gain_changes_no_fact():
    """It goes with the level of the traction."""
    problem = scan().problem
    louder = with_fields(problem, data=7 * problem.data, noise=49 * problem.noise)
    ours, other = found(), SemiBlind()(louder)
    for name, (value, stderr) in ours.parameters.items():
        assert abs(other.parameters[name][0] - value) < 0.1 * stderr


@pytest.mark.full
def test_bands_hold_the_traction_where_the_depth_is_stated_wrong():
    """They do not by the stated depth, whose residual is beyond the noise."""
    case = scan("exponential", 2, 1.2)
    cells = case.problem.observed_cells
    stated = Wiener(scale="evidence")(case.problem)
    estimate = SemiBlind()(case.problem)
    assert stated.misfit > 1.3
    assert estimate.misfit < 1.1
    assert estimate.coverage(case.truth, cells)[0] > 0.8


@pytest.mark.full
def test_one_element_does_not_show_its_depth():
    """Another spectrum of the traction makes up for any: the inversion is that of the stated
    depth."""
    problem = scan(elements=1, off=1.2).problem
    estimate = SemiBlind()(problem)
    value, stderr = estimate.parameters["depth_m"]
    assert stderr > 0.15 * value
    assert any("depth is not identifiable" in each for each in estimate.warnings)
    assert estimate.quality == "doubtful"
    assert np.array_equal(estimate.value, Wiener(scale="evidence")(problem).value)


@pytest.mark.full
def test_the_bound_before_measuring_is_the_standard_error_after():
    bound = SemiBlind().expected_stderr(scan("exponential").problem, Exponential(2000, 2e-3))
    parameters = found("exponential").parameters
    assert bound.keys() == parameters.keys()
    for name, stderr in bound.items():
        assert 0.5 < stderr / parameters[name][1] < 2


@pytest.mark.claim
def test_tolerances_of_other_facts_widen_the_depth():
    """The speed's goes into it as it is: with k z alone the response is the same."""
    rig = RigError(
        ("speed", "strip_width_1_m", "strip_width_2_m", "offset_2_m"),
        np.array([1.0, 7e-4, 7e-4, 3e-4]),
        np.diag(np.square([0.02, 3e-5, 3e-5, 3e-5])),
        ("assumed",) * 4,
    )
    estimate = SemiBlind(["depth_m"])(scan(rig=rig).problem)
    depth, stderr = estimate.parameters["depth_m"]
    assert 0.015 < stderr / depth < 0.03
    assert abs(depth - DEPTH_M) < 3 * stderr
    assert isinstance(estimate, TractionEstimate)
    assert set(estimate.rig_sources) == {"found"}


def test_bad_input_is_refused():
    refused(lambda: SemiBlind(["depth"]), "method.semi_blind.unknown", "depth_m")
    refused(lambda: SemiBlind("depth_m"), "method.semi_blind.unknown", "list")
    refused(lambda: SemiBlind(method=3), "method.semi_blind.method", "Tikhonov")
    refused(lambda: SemiBlind(["gain"])(scan(elements=1).problem), "one element", "depth_m")
    refused(lambda: SemiBlind()(make_case().problem), "no sensor")
