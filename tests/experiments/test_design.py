"""Designs by gradient: expected errors against independent ones, and their invariances."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from experiments.design.geometry import DesignSpace, Parameter, parameters, with_elements
from experiments.design.optimum import gradient_error, tolerance
from experiments.design.search import Criterion, descend, log_error, search_grid, starts
from experiments.design.tasks import TractionError, direction_error, least_height
from srsinv.forward.noise import exponential_spectrum
from srsinv.forward.scene import SurfaceScene, TractionScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Ridge
from srsinv.forward.traction import PressedStrip
from srsinv.inverse.detection import needed_known
from srsinv.inverse.wiener import Exponential
from tests.refusals import refused
from tests.tiers import quick

LINE = srsinv.Periodic(512, 2e-4, -0.05)
FINE = srsinv.Periodic(512 * 16, 2e-4 / 16, -0.05)
SCAN, NOISE_V = srsinv.ConstantSpeed(0.05), 2e-6
NOISE = jnp.full(LINE.k.shape, NOISE_V**2)
RIDGE = SurfaceScene(2e4, [Ridge(1e-6, 2e-4, 0.0, 2e-5)], 0.4)
STRIP = TractionScene(0.0, 0.4, [PressedStrip(5e3, 3e-3, 0.3e-3, 2e-4)])
RMS_PA, CORRELATION_M = 1500.0, 2e-3
STRENGTH = needed_known(0.05, 0.9)
RANGES = {
    "depth": (5e-4, 2e-3),
    "width": (3e-4, 2e-3),
    "angle": (0.0, np.pi),
    "offset": (-2e-3, 2e-3),
}
SHARED = ("depth", "width")


def task(name):
    if name == "least_height":
        return least_height(LINE, FINE, RIDGE, STRENGTH)
    if name == "direction":
        return direction_error(LINE, STRIP)
    mu = {"error": None, "error of p": jnp.asarray(0.3)}[name]
    power = RMS_PA**2 * exponential_spectrum(LINE.k, LINE.cell_m, CORRELATION_M)
    return TractionError(jnp.stack([power] * (2 if mu is None else 1)), mu, LINE.n)


def criterion(name="error", elements=2, free=tuple(RANGES), shared=SHARED):
    ranges = tuple(Parameter(each, *RANGES[each], each in shared, each == "angle") for each in free)
    space = DesignSpace(with_elements(Sensor(), elements), ranges)
    return Criterion.checked(space, task(name), LINE, SCAN, NOISE)


def points(of, count=3, seed=1):
    return np.random.default_rng(seed).uniform(0.1, 0.9, (count, len(of.space.coordinates)))


def error(of, sensor):
    return float(np.exp(log_error(of, sensor)))


def test_films_of_one_depth_and_width_enter_by_the_sum_of_their_double_angles():
    """With equal films G^H G has the angles only in C = sum exp(2 i theta): its real part, and its
    size in the determinant. So any three films with C = 0 are as good, and a mirror image is."""
    of = criterion(elements=3, free=("depth", "angle"), shared=("depth",))
    even, own = np.array([0.0, 1 / 3, 2 / 3]), np.array([0.1, 0.25, 0.6])
    angles = np.stack([even, even + 0.1, even + 0.37, own, -own])
    values = of.values(np.column_stack([np.full(5, 0.2), angles]))
    np.testing.assert_allclose(values[1:3], values[0], rtol=0, atol=1e-11)
    assert values[4] == pytest.approx(values[3], abs=1e-11)
    assert values[3] > values[0] + 1e-3


@pytest.mark.parametrize("name", quick(["error", "least_height", "direction"], "error"))
def test_offsets_have_no_effect(name):
    """Every element alone, not only all together."""
    of = criterion(name)
    assert of.active == ("depth", "width", "angle")
    (point,) = points(of, 1)
    moved = point + np.where(of.is_active, 0.0, [0.0, 0.0, 0.0, 0.3, 0.0, -0.2])
    before, after = of.values(np.stack([point, moved]))
    assert after == pytest.approx(before, abs=1e-11)


CASES = [
    ("error", 1, ()), ("error", 2, ()), ("error", 3, SHARED), ("error of p", 2, SHARED),
    ("least_height", 2, ()), ("direction", 1, SHARED), ("direction", 2, ()),
]  # fmt: skip


@pytest.mark.parametrize(("name", "elements", "shared"), quick(CASES, ("error", 2, ())))
def test_gradient_is_that_of_differences(name, elements, shared):
    of = criterion(name, elements, shared=shared)
    assert gradient_error(of, points(of)) < 1e-8


def test_error_is_that_of_the_inversion():
    of, sensor = criterion(free=("depth",)), Sensor()
    data, spectrum = jnp.zeros((2, LINE.n)), Exponential(RMS_PA, CORRELATION_M)
    problem = srsinv.LineProblem(LINE, sensor.operator(LINE, SCAN), data, NOISE)
    estimate = srsinv.invert(problem, srsinv.Wiener(spectrum, spectrum))
    weights = np.full(LINE.k.size, 2.0)
    weights[[0, -1]] = 0.0, 1.0
    power = 2 * weights @ np.asarray(spectrum.power(problem)) / LINE.n  # of p and of q
    variance = np.sum(np.mean(np.asarray(estimate.stderr) ** 2, axis=1))
    assert error(of, sensor) == pytest.approx(np.sqrt(variance / power), rel=1e-9)


@pytest.mark.full
def test_direction_is_bounded_by_the_jacobian_of_the_signal():
    of, sensor = criterion("direction", free=("depth",)), Sensor()
    operator = sensor.operator(LINE, SCAN)

    def signal(values):
        pressure, width, position, friction = values
        strip = PressedStrip(pressure, width, position, 2e-4)
        return np.asarray(operator(TractionScene(0.0, friction, [strip]).traction(LINE))).ravel()

    at, steps = np.array([5e3, 3e-3, 0.3e-3, 0.4]), np.array([1.0, 1e-7, 1e-7, 1e-4])
    slopes = [(signal(at + d) - signal(at - d)) / (2 * d.sum()) for d in np.diag(steps)]
    covariance = NOISE_V**2 * np.linalg.inv(np.stack(slopes) @ np.stack(slopes).T)
    expected = np.rad2deg(np.sqrt(covariance[-1, -1]) / (1 + 0.4**2))
    assert error(of, sensor) == pytest.approx(expected, rel=1e-5)


@pytest.mark.full
def test_least_height_is_that_of_a_matched_filter():
    """A very low ridge in contact, and the d' of its signal; the height is that of its top."""
    of, sensor = criterion("least_height", free=("depth",)), Sensor()
    low = eqx.tree_at(lambda s: s.surface.shapes[0].height_m, RIDGE, jnp.asarray(1e-10))
    top = float(low.height(FINE).max())
    p = np.asarray(low.pressure(FINE)).reshape(LINE.n, -1).mean(axis=1)
    signal = sensor.operator(LINE, SCAN)(jnp.stack([jnp.asarray(p), 0.4 * p]))
    strength = np.sqrt(np.sum(np.asarray(signal) ** 2)) / NOISE_V
    assert error(of, sensor) == pytest.approx(top * STRENGTH / strength, rel=1e-6)
    high = least_height(LINE, FINE, RIDGE, STRENGTH, height_m=1e-10)
    assert error(dataclasses.replace(of, task=high), sensor) == pytest.approx(
        error(of, sensor), rel=1e-6
    )


@pytest.mark.full
def test_independent_elements_detect_like_averages():
    """d'^2 adds up over elements, so that four films as good as one halve the least height."""
    film = srsinv.Film(angle_rad=0.7).with_strip_average()
    of = criterion("least_height", free=("depth",))
    assert error(of, Sensor([film] * 4)) == pytest.approx(error(of, Sensor([film])) / 2, rel=1e-10)


@pytest.fixture(scope="module")
def searched():
    of = criterion(free=("depth", "width", "angle"))
    begin = starts(of.base, 6, 0)
    return of, descend(of, begin), search_grid(of, 1200)


@pytest.mark.full
def test_optimum_of_two_films(searched):
    """Where p and q are alike the best sum C of exp(2 i theta) is real: the films lie like mirror
    images, within a few degrees of a right angle. Nothing on the grid is better."""
    of, descent, grid = searched
    values = of.space.quantities(descent.point)
    first, second = np.rad2deg(values["angle"])
    assert (first + second) % 90 == pytest.approx(0, abs=1e-3) or (first + second) % 90 > 89.999
    assert second - first == pytest.approx(90, abs=6)
    assert values["depth"][0] == RANGES["depth"][0]
    assert grid.values.min() >= descent.value
    assert grid.value >= descent.value - 1e-9
    assert grid.value == pytest.approx(descent.value, abs=1e-3)


@pytest.mark.full
def test_price_of_a_bound(searched):
    """The slope at a bound is what the optimum gains when the bound moves."""
    of, descent, _ = searched
    step = 1e-6  # m
    depth, *others = of.space.parameters
    moved = depth._replace(low=depth.low - step)
    space = DesignSpace(of.space.given, (moved, *others))
    again = descend(dataclasses.replace(of, space=space), descent.point[None])
    per_metre = of.slope(descent.point)[1][0] / depth.span
    assert (descent.value - again.value) / step == pytest.approx(per_metre, rel=1e-2)


@pytest.mark.full
def test_tolerances_grow_the_error_as_stated(searched):
    of, descent, _ = searched
    profiles, reach = tolerance(of, descent.point, 0.05, np.linspace(0, 1, 5))
    assert profiles.shape == (4, 5)
    assert np.all(profiles >= descent.value - 1e-9)
    assert np.isnan(reach[0, 0])  # at the least depth
    for at, sides in enumerate(reach):
        for sign, distance in zip((-1, 1), sides, strict=True):
            if np.isfinite(distance):
                moved = descent.point + sign * distance * np.eye(4)[at]
                assert of.value(moved) - descent.value == pytest.approx(np.log(1.05), abs=1e-6)


@pytest.mark.full
def test_a_strip_averages_over_its_own_width():
    of = criterion(free=("width",))
    sensor = of.space.sensor(np.array([0.5]))
    width = np.mean(RANGES["width"])
    k = 2 * np.pi / width
    assert [len(film.effects) for film in sensor.elements] == [1, 1]
    transfer = sensor.output(SCAN).transfer(jnp.array([k, k / 2]))
    assert np.abs(transfer[..., 0]).max() < 1e-12 * np.abs(transfer[..., 1]).max()


SETTINGS = {
    "free": ["depth"], "shared": ["depth"], "depth_m": [5e-4, 2e-3], "width_m": [3e-4, 2e-3],
    "angle_deg": [0.0, 180.0], "offset_m": [-2e-3, 2e-3],
}  # fmt: skip


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"depth_m": [0.0, 1e-3]}, ("design.depth_m[0] is 0.0", "positive")),
        ({"width_m": [2e-3, 1e-3]}, ("design.width_m", "increasing")),
        ({"width_m": 1e-3}, ("design.width_m is 0.001", "[least, greatest]")),
        ({"free": ["deep"]}, ("design.free[0] is 'deep'", "depth, width")),
        ({"free": []}, ("design.free is []",)),
        ({"shared": "depth"}, ("design.shared is 'depth'", "list")),
        ({"angle_deg": [0.0, 1000.0]}, ("design.angle_deg[1] is 1000.0", "degrees")),
    ],
)
def test_settings_are_refused(setting, words):
    refused(lambda: parameters(SETTINGS | setting), *words)


def test_scenes_of_tasks_are_refused():
    refused(lambda: least_height(LINE, FINE, STRIP, 3.0), "design.ridge is not one ridge")
    flat = SurfaceScene(2e4, [Ridge(0.0, 2e-4, 0.0, 2e-5)], 0.4)
    refused(lambda: least_height(LINE, FINE, flat, 3.0), "design.ridge is flat")
    narrow = SurfaceScene(2e4, [Ridge(1e-6, 2e-5, 0.0, 2e-6)], 0.4)
    refused(lambda: least_height(LINE, FINE, narrow, 3.0), "grid.refinement=40")
    two = TractionScene(0.0, 0.4, [*STRIP.pressures] * 2)
    refused(lambda: direction_error(LINE, two), "not one strip")
    refused(lambda: direction_error(LINE, RIDGE), "not one strip")
    outside = TractionScene(0.0, 0.4, [PressedStrip(5e3, 3e-3, -0.05, 2e-4)])
    refused(lambda: direction_error(LINE, outside), "from -0.0515", "place within")
