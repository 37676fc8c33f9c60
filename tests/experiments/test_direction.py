"""The direction of a ridge from one noisy circle over it."""

import numpy as np
import pytest

from experiments.circular_scan.direction import angle_bounds_deg
from srsinv.forward.amplifier import ChargeReadout
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.planar import Circle, ObliqueRidge, PathScan
from srsinv.forward.sensor import Sensor
from srsinv.inverse.planar.finder import DirectionFinder
from srsinv.inverse.planar.signal import RidgeShape
from tests.refusals import refused

CIRCLE = Circle(radius_m=6e-3, samples=192)
# Across x, along x, nearly so, near the circle's edge, and through its centre.
RIDGES = [(1.0, 4.5e-3), (89.0, -3e-3), (90.0, 0.0), (127.0, 0.0), (179.5, -4.7e-3)]


def sensor(elements):
    width = StripAverage.at_depth(0.7e-3, 0.75e-3)
    films = [Film(0.75e-3, angle, effects=(width,)) for angle in (0.0, np.pi / 2)]
    return Sensor(films[:elements])


@pytest.fixture(scope="module", params=[1, 2], ids=["one_element", "two_elements"])
def directions(request):
    """Every ridge with the one found at 20 dB, and without noise the first."""
    device, rng = sensor(request.param), np.random.default_rng(request.param)
    circling = PathScan(device, CIRCLE)
    finder = DirectionFinder(circling, RidgeShape())
    pairs = []
    for angle, distance in RIDGES:
        clean = np.asarray(circling(ObliqueRidge(np.deg2rad(angle), distance, 1.0, 0.5e-3, -0.4)))
        noise = rng.normal(size=clean.shape) * np.sqrt(np.mean(clean**2)) / 10
        pairs.append(((angle, distance, clean), finder(clean + noise)))
    return pairs


def away(angle, other):
    """The angle between two normals, of either sense."""
    return (angle - other + 90) % 180 - 90


# tests/jobs/test_circular_scan.py finds two directions in `make test-all`.
@pytest.mark.claim
def test_direction_at_20_dB(directions):
    """The project's bound, 2 degrees; the standard errors say a hundredth of it."""
    for (angle, _, _), direction in directions:
        value, stderr = direction.parameters["angle_deg"]
        assert direction.fit.converged
        assert abs(away(value, angle)) < 2
        assert abs(away(value, angle)) < 5 * stderr < 1
        assert 0 <= value < 180


@pytest.mark.claim
def test_what_else_is_read(directions):
    for (angle, distance, clean), direction in directions:
        flipped = abs(direction.parameters["angle_deg"][0] - angle) > 90
        truth = {
            "distance_m": -distance if flipped else distance,
            "load_N_per_m": 1.0,
            "width_m": 0.5e-3,
            "friction": -0.4,
        }
        for name, expected in truth.items():
            value, stderr = direction.parameters[name]
            assert abs(value - expected) < 5 * stderr, name
        rest = direction.signal - clean
        assert np.sqrt(np.mean(rest**2)) < 0.04 * np.sqrt(np.mean(clean**2))


@pytest.mark.claim
def test_standard_errors_are_those_of_the_noise(directions):
    """Deviations in their units, over all ridges: chi squared of what was found."""
    pulls = [
        away(direction.parameters["angle_deg"][0], angle) / direction.parameters["angle_deg"][1]
        for (angle, _, _), direction in directions
    ]
    assert 0.5 < np.sum(np.square(pulls)) < 17  # 99 % of five


@pytest.mark.claim
def test_standard_error_of_an_angle_is_at_the_bound(directions):
    """At 20 dB the model is nearly linear over the error: fits reach Cramer and Rao's bound."""
    circling = PathScan(sensor(directions[0][0][2].shape[0]), CIRCLE)
    for (angle, distance, _), direction in directions:
        ridge = {"distance_m": distance, "load_N_per_m": 1.0, "width_m": 0.5e-3, "friction": -0.4}
        (bound,) = angle_bounds_deg(circling, ridge, np.array([angle]), 20.0)
        assert direction.parameters["angle_deg"][1] == pytest.approx(bound, rel=0.15)


def test_refused():
    offset_unknown = Sensor([Film()], amplifier=ChargeReadout(1.0))
    unknown, known = PathScan(offset_unknown, CIRCLE), PathScan(sensor(1), CIRCLE)
    refused(lambda: DirectionFinder(unknown, RidgeShape()), "offset is not known")
    widths = {"width_m": (1e-3, 5e-4)}
    refused(lambda: DirectionFinder(known, RidgeShape(), widths), "width_m has the range")
