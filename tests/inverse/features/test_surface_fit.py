"""Features of a surface fitted: derivatives, truths found from nothing, what cannot be told."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface_feature import RidgeFeature, StepUpFeature, TapeFeature
from srsinv.grid import Open
from srsinv.inverse.features.fit import FeatureFitter
from srsinv.inverse.features.model import FeatureModel, scan_extent
from srsinv.inverse.features.search import Blocks, FeatureSearch
from srsinv.inverse.gridding.cells import Window
from srsinv.resolution import cell_m
from tests.refusals import refused

EDGE, NOMINAL = 4e-5, 2e4
WINDOW = Window(-0.009, 0.009)
TIME = np.arange(241) / 1200
STRIP = StripAverage.at_depth(0.7e-3, 0.75e-3)
SENSOR = Sensor(
    [Film(0.75e-3, angle, effects=[STRIP]) for angle in (0.0, np.pi / 2)],
    HalfSpace(),
    CurrentAmplifier(1e6),
)
ONWARDS = Motion.from_speed(TIME, 0.03 * (1 + 0.3 * np.sin(40 * TIME)), -0.003)
BACK = Motion.from_speed(TIME, -0.03, 0.003)
PLATE = {"nominal_pressure_Pa": NOMINAL, "gain": 1.0}
RIDGE = {"height_m": 3e-5, "width_m": 0.8e-3, "position_m": 0.4e-3}
TAPE = {
    "height_m": 5e-5, "width_m": 3.1e-3, "position_m": 0.2e-3, "friction_zone_length_m": 5e-4,
    "leading_edge_friction": 1.1, "trailing_edge_friction": 0.2,
}  # fmt: skip


def fine(feature, motion):
    """The model on cells in no simple ratio to the fit's."""
    return FeatureModel.on_window(SENSOR, motion, WINDOW, EDGE / 13, NOMINAL).with_features(
        {"it": feature}
    )


def tree(own, base):
    params = PLATE | {"base_friction": base, "it": own | {"edge_length_m": EDGE}}
    return jax.tree.map(jnp.asarray, params)


def noisy(signal, seed):
    """White and sliding noise, the latter over 0.2 mm at a constant step in time."""
    rng = np.random.default_rng(seed)
    rms = np.sqrt(np.mean(signal**2))
    slow = rng.normal(size=signal.shape)
    for i in range(1, signal.shape[1]):
        slow[:, i] = 0.88 * slow[:, i - 1] + np.sqrt(1 - 0.88**2) * slow[:, i]
    return signal + rms * (0.01 * rng.normal(size=signal.shape) + 0.005 * slow)


def fitter(feature, motion, also=()):
    return FeatureFitter.on_window(SENSOR, motion, {"it": feature}, WINDOW, NOMINAL, also)


@pytest.fixture(scope="module")
def ridges():
    return fitter(RidgeFeature(EDGE), ONWARDS)


@pytest.fixture(scope="module")
def simulated():
    return fine(RidgeFeature(EDGE), ONWARDS)


CASES = {
    "negative friction": (RIDGE | {"height_m": 1.2e-5, "position_m": -0.7e-3}, -0.35),
    "narrow": (RIDGE | {"width_m": 0.35e-3}, 0.1),
}


@pytest.fixture(scope="module")
def in_noise(ridges, simulated):
    """The signal of the ridge, and its fit in noise that is not known."""
    signal = np.asarray(simulated(tree(RIDGE, 0.4)))
    return signal, ridges({"it": RidgeFeature(EDGE)}, noisy(signal, 5))


@pytest.mark.full
def test_a_ridge_is_found_from_nothing_and_from_a_bad_start(ridges, in_noise):
    signal, fit = in_noise
    assert_found(ridges, noisy(signal, 5), fit, RIDGE, 0.4)


@pytest.mark.full
def test_its_arrays_have_the_contact_on_the_line_of_the_fit_alone(in_noise):
    _, made = in_noise
    data = made.to_xarray()
    assert all("units" in each.attrs for each in data.variables.values())
    assert float(data["height"].max()) == pytest.approx(made.parameters["height_m"][0], rel=1e-2)
    assert isinstance(plot.contact(data), Figure)
    assert "gap" not in made.on(Open(64, 2e-4, -6e-3)).to_xarray()
    assert len(made.plot().axes) == 2 + 2 * 2  # p, q, and each element's signal and residual
    assert str(made).splitlines()[0] == f"It fitted; quality: {made.quality}."


@pytest.mark.claim
@pytest.mark.parametrize("name", CASES)
def test_any_ridge_is_found_from_nothing_and_from_a_bad_start(ridges, simulated, name):
    own, base = CASES[name]
    y = noisy(np.asarray(simulated(tree(own, base))), 3)
    assert_found(ridges, y, ridges({"it": RidgeFeature(EDGE)}, y), own, base)


def assert_found(ridges, y, fit, own, base):
    truth = own | {"base_friction": base}
    assert fit.status == "converged"
    for name, (value, stderr) in fit.parameters.items():
        assert abs(value - truth[name]) < 4 * stderr, name
    bad = {
        "height_m": 1.5 * own["height_m"],
        "width_m": 0.5 * own["width_m"],
        "position_m": own["position_m"] + 0.5e-3,
    }
    again = ridges({"it": RidgeFeature(EDGE)}, y, start=bad)
    for name, (value, stderr) in fit.parameters.items():
        assert abs(again.parameters[name][0] - value) < 0.05 * stderr, name


@pytest.mark.full
def test_under_a_load_that_rises_a_ridge_is_a_doubtful_answer(ridges, in_noise):
    """By 30 % along the scan, and in a fifth of the noise: the fit's minimum is one, though
    differences over cells still have a slope in it."""
    signal, _ = in_noise
    y = signal * np.linspace(1.0, 1.3, TIME.size) + 0.2 * (noisy(signal, 5) - signal)
    estimate = ridges({"it": RidgeFeature(EDGE)}, y)
    assert estimate.status == "converged"
    assert estimate.quality == "doubtful"
    assert estimate.parameters["height_m"][0] == pytest.approx(1.15 * RIDGE["height_m"], rel=0.1)
    assert np.isfinite(estimate.parameters["height_m"][1])


@pytest.mark.full
def test_the_noise_is_what_the_fit_leaves(in_noise):
    signal, estimate = in_noise
    levels, rms = estimate.levels, np.sqrt(np.mean(signal**2))
    # 241 samples of each element: 5 % of the white level, a third of the sliding noise's.
    np.testing.assert_allclose(levels.white, 0.01 * rms, rtol=0.25)
    assert 0.2 * 0.005 * rms < levels.sliding < 2.5 * 0.005 * rms


@pytest.mark.full
def test_standard_errors_are_the_bound(in_noise, simulated):
    """That of the noise that was found, against central differences of the finer simulation."""
    signal, estimate = in_noise
    cell = float(simulated.line.cell_m)
    steps = {"height_m": 3e-7, "width_m": 4 * cell, "position_m": 2 * cell}
    columns = []
    for name, step in steps.items():
        above, below = (tree(RIDGE | {name: RIDGE[name] + s * step}, 0.4) for s in (1, -1))
        columns.append((simulated(above) - simulated(below)) / (2 * step))
    columns.append(simulated(tree(RIDGE, 1.4)) - signal)
    levels, x = estimate.levels, np.asarray(ONWARDS.position_m)
    sliding = levels.sliding**2 * np.exp(-np.abs(x[:, None] - x) / levels.correlation_m)
    information = 0.0
    for element, white in enumerate(levels.white):
        jacobian = np.stack([np.asarray(each)[element] for each in columns], axis=1)
        noise = sliding + white**2 * np.eye(x.size)
        information = information + jacobian.T @ np.linalg.solve(noise, jacobian)
    size = np.sqrt(np.diag(information))
    bound = np.sqrt(np.diag(np.linalg.inv(information / np.outer(size, size)))) / size
    stated = [stderr for _, stderr in estimate.parameters.values()]
    np.testing.assert_allclose(stated, bound, rtol=0.03)


@pytest.mark.full
def test_derivatives_of_the_signal_are_differences_in_both_modes():
    """To 1e-4 where the contact stays: steps that move no cell in or out of it."""
    model = FeatureModel.on_window(SENSOR, ONWARDS, WINDOW, 2e-5, NOMINAL).with_features(
        {"it": RidgeFeature(EDGE)}
    )
    units = {"height_m": 1e-11, "width_m": 1e-11, "position_m": 1e-11, "nominal": 1e-2}

    def own(values):
        it = dict(zip(RIDGE, values[:3], strict=True))
        return tree(it, 0.4) | {"nominal_pressure_Pa": values[3]}

    at = np.array([*RIDGE.values(), NOMINAL])
    weight = np.cos(np.arange(2 * TIME.size) / 9).reshape(2, -1)
    jacobian = np.asarray(jax.jit(jax.jacfwd(lambda values: model(own(values))))(at))
    back = jax.jit(jax.grad(lambda values: jnp.sum(weight * model(own(values)))))(at)
    np.testing.assert_allclose(back, np.tensordot(weight, jacobian, 2), rtol=1e-9)

    @jax.jit
    def made(values):
        params, loading, line = own(values), model.loading, model.line
        contact = loading.contact(line, model.features, params)
        return model(params), contact.touching

    touching = made(at)[1]
    for i, step in enumerate(units.values()):
        ends = [made(at + s * step * (np.arange(4) == i)) for s in (1, -1)]
        for _, there in ends:
            np.testing.assert_array_equal(there, touching)
        change = (np.asarray(ends[0][0]) - np.asarray(ends[1][0])) / (2 * step)
        error = np.linalg.norm(jacobian[..., i] - change)
        assert error < 1e-4 * np.linalg.norm(change), i


@pytest.mark.full
def test_friction_turns_with_the_motion():
    """Back on the same path with the other friction: the same charges, the last one first."""
    forward = Motion.from_speed(TIME, 0.03, -0.003)
    onwards, back = (fine(RidgeFeature(EDGE), motion) for motion in (forward, BACK))
    signal = np.asarray(onwards(tree(RIDGE, -0.4)))
    back_signal = back(tree(RIDGE, 0.4))
    np.testing.assert_allclose(back_signal, -signal[:, ::-1], atol=1e-9 * np.abs(signal).max())


@pytest.mark.claim
def test_there_and_back_a_ridge_between_the_places_tried_is_found():
    """In a long scan, where a wide ridge may have an edge beyond its end."""
    n, scan_m, speed, depth_m = 600, 0.0152, 0.03, 0.75e-3
    speeds = speed * np.clip(20 * (0.5 - np.arange(n) / n), -1, 1)
    both = Motion.from_speed(np.arange(n) * 2 * scan_m / speed / n, speeds, -scan_m / 2)
    window = Window(-0.0105, 0.0105)
    blocks = Blocks(both, cell_m("contact_search_samples", depth_m))
    coarse = FeatureModel.on_window(
        SENSOR, blocks.motion, window, cell_m("contact_search", depth_m), NOMINAL
    )
    search = FeatureSearch(coarse, blocks, scan_extent(SENSOR, both))
    made = FeatureModel.on_window(SENSOR, both, window, EDGE / 13, NOMINAL)
    made = made.with_features({"it": RidgeFeature(EDGE)})
    for width_m in (0.7e-3, 1.15e-3):
        own = {"height_m": 2.2e-5, "width_m": width_m, "position_m": depth_m / 4}
        y = np.asarray(made(tree(own, 0.23)))
        best, *_ = search.starts(y, np.ones(2), ({}, {}), RidgeFeature(EDGE), {})
        assert abs(best["position_m"] - own["position_m"]) < depth_m / 4
        assert abs(best["width_m"] - width_m) < depth_m


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_samples_that_are_missing_do_not_move_the_search(direction):
    """A recording that turns, of which one way alone is taken."""
    speeds = np.repeat([0.03, -0.03], TIME.size)
    both = Motion.from_speed(np.arange(speeds.size) / 1200, speeds, -0.003)
    blocks, depth_m = Blocks(both, cell_m("contact_search_samples", 0.75e-3)), 0.75e-3
    coarse = FeatureModel.on_window(
        SENSOR, blocks.motion, WINDOW, cell_m("contact_search", depth_m), NOMINAL
    )
    search = FeatureSearch(coarse, blocks, scan_extent(SENSOR, both))
    y = np.asarray(fine(TapeFeature(EDGE), both)(tree(TAPE, 0.35)))
    y = np.where(speeds == 0.03 * direction, y, np.nan)
    best, *_ = search.starts(y, np.ones(2), ({}, {}), TapeFeature(EDGE), {})
    assert abs(best["position_m"] - TAPE["position_m"]) < depth_m / 4
    assert abs(best["width_m"] - TAPE["width_m"]) < depth_m / 2


@pytest.mark.claim
def test_sliding_back_the_leading_edge_is_the_other_one():
    model = fine(TapeFeature(EDGE), BACK)
    y = noisy(np.asarray(model(tree(TAPE, 0.35))), 7)
    estimate = fitter(TapeFeature(EDGE), BACK)({"it": TapeFeature(EDGE)}, y)
    assert estimate.status == "converged"
    for name, truth in (TAPE | {"base_friction": 0.35}).items():
        value, stderr = estimate.parameters[name]
        assert abs(value - truth) < 4 * stderr, name
    assert estimate.parameters["leading_edge_friction"][1] < 0.05


FOLLOWS = ("motion", "edge")


def taped(follows):
    """A tape felt both ways, in noise of 0.13 of the signal, which is known; the fits of one whose
    grip follows this, and of the other."""
    speed = np.repeat([0.0, 0.03, -0.03, 0.0], [600, 300, 300, 600])
    both = Motion.from_speed(np.arange(speed.size) / 1500, speed, -0.003)
    near = {"height_range_m": [3e-5, 7e-5], "width_range_m": [2.5e-3, 3.5e-3]}
    near |= {"position_range_m": [-5e-4, 5e-4]}
    true, wrong = (
        TapeFeature(EDGE, friction_follows=each, **near)
        for each in (follows, *({*FOLLOWS} - {follows}))
    )
    clean = np.asarray(fine(true, both)(tree(TAPE | {"trailing_edge_friction": 0.6}, 0.35)))
    rms = 0.13 * np.sqrt(np.mean(clean**2))
    y = clean + rms * np.random.default_rng(3).normal(size=clean.shape)
    return (partial(fitter(each, both), {"it": each}, y, rms) for each in (true, wrong))


@pytest.mark.claim
@pytest.mark.parametrize("follows", FOLLOWS)
def test_a_tape_is_good_where_its_grip_is_assumed_at_the_right_edge(follows):
    fit, _ = taped(follows)
    right = fit()
    assert right.quality == "good"
    assert abs(right.parameters["leading_edge_friction"][0] - 1.1) < 0.1


@pytest.mark.claim
@pytest.mark.parametrize("follows", FOLLOWS)
def test_a_tape_says_where_its_grip_is_assumed_at_the_wrong_edge(follows):
    _, fit = taped(follows)
    other = fit()
    assert other.quality != "good"
    assert any(f"feature.it.friction_follows={follows}" in each for each in other.reasons)


@pytest.mark.claim
def test_gain_pressure_and_height_cannot_be_told_apart(simulated):
    """Twice the pressure and the height at half the gain is the same signal."""
    y = noisy(np.asarray(simulated(tree(RIDGE, 0.4))), 11)
    together = fitter(RidgeFeature(EDGE), ONWARDS, ["gain", "nominal_pressure_Pa"])
    estimate = together({"it": RidgeFeature(EDGE)}, y)
    (direction,) = estimate.fit.undetermined
    assert set(direction) == {"gain", "nominal_pressure_Pa", "it.height_m"}
    assert np.isinf(estimate.parameters["height_m"][1])
    width, stderr = estimate.parameters["width_m"]
    assert abs(width - RIDGE["width_m"]) < 4 * stderr


@pytest.mark.full
def test_noise_alone_prefers_nothing(ridges):
    y = 1e-6 * np.random.default_rng(2).normal(size=(2, TIME.size))
    ridge, nothing = ridges({"it": RidgeFeature(EDGE)}, y), ridges({}, y)
    assert nothing.log_evidence > ridge.log_evidence


@pytest.mark.full
def test_refusals(ridges):
    away = Window(0.0, 0.01)
    make = partial(FeatureFitter.on_window, SENSOR, ONWARDS, {"it": RidgeFeature(EDGE)})
    refused(lambda: make(away, NOMINAL), "contact window", "recording.contact_window_m")
    refused(lambda: make(WINDOW, NOMINAL, ["speed"]), "fit.free", "'speed'", "gain")
    refused(lambda: make(WINDOW, NOMINAL, ["depth"]), "fit.free", "nearest is depth_m")
    refused(lambda: RidgeFeature(edge_length_m=0.0), "edge_length_m", "positive")
    refused(lambda: RidgeFeature(width_range_m=[-1.0, 1.0]), "width_range_m")
    refused(lambda: StepUpFeature(width_range_m=[1e-3, 2e-3]), "StepUpFeature", "width_range_m")
