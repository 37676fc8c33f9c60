"""Features found in simulated signals: exact ones, noisy ones, and noise alone."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import ChargeReadout
from srsinv.forward.feature import (
    StripFeature,
)
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.inverse.features import FeatureFitter, FeatureModel
from srsinv.inverse.features.direct import friction_of
from srsinv.inverse.features.estimate import probabilities
from tests.features import FEATURES
from tests.tiers import rare

SAMPLES = 300
TIME = np.arange(SAMPLES) / 1500
TURN = 2 * np.pi / TIME[-1]
TRUTHS = {
    "line": {"position_m": 1.1e-3, "load_N_per_m": 10.0, "friction": -0.3},
    "strip": {"position_m": 0.7e-3, "width_m": 2.9e-3, "pressure_Pa": -4e3, "friction": 0.5},
    "hertz": {"position_m": -0.4e-3, "half_width_m": 1.7e-3, "pressure_Pa": 5e3, "friction": -0.6},
    "step": {"position_m": -0.9e-3, "pressure_Pa": 3e3, "friction": 0.4},
    "grating": {
        "pitch_m": 1.9e-3, "duty": 0.4, "phase_rad": 1.0, "pressure_Pa": 2e3, "friction": 0.7,
    },
}  # fmt: skip
MOTIONS = {
    "steady": lambda: Motion.from_speed(TIME, 0.06, -6e-3),
    "varying": lambda: Motion.from_speed(TIME, -0.06 * (1 - 0.4 * np.cos(2 * TURN * TIME)), 6e-3),
    "reversing": lambda: Motion(
        TIME, -6e-3 * np.cos(TURN * TIME), 6e-3 * TURN * np.sin(TURN * TIME)
    ),
}


def films(count):
    width = StripAverage(0.5e-3)
    return [Film(0.75e-3, angle, effects=(width,)) for angle in (0.0, np.pi / 2)[:count]]


SENSORS = {
    "two": Sensor(films(2)),
    "one": Sensor(films(1)),
    "slow": Sensor(films(2), amplifier=ChargeReadout(1e6)),
}


@cache
def fitter(sensor="two", motion="steady"):
    return FeatureFitter.along(SENSORS[sensor], MOTIONS[motion]())


@cache
def finer(sensor="two", motion="steady"):
    return FeatureModel.along(SENSORS[sensor], MOTIONS[motion](), 0.75e-3 / 96)


def parameters(name, truth, feature):
    own = {part: truth[part] for part in (*feature.axes, feature.amplitude)}
    if feature.friction is None:
        own[feature.shear] = truth["friction"] * truth[feature.amplitude]
    return {name: own}


def simulated(name, sensor="two", motion="steady", truth=None, feature=None, offset=None):
    """The signal on cells three times finer than the fit's."""
    feature = feature or FEATURES[name]
    own = parameters(name, truth or TRUTHS[name], feature)
    if offset is not None:
        own["offset"] = offset
    model = finer(sensor, motion).with_features({name: feature})
    return np.asarray(model(jax.tree.map(jnp.asarray, own)))


def rms(signal):
    return float(np.sqrt(np.mean(signal**2)))


def assert_recovered(read, truth, within):
    """Every parameter to `within` of itself, positions of the depth, phases of a radian."""
    assert set(read) == set(truth)
    for part, expected in truth.items():
        size = {"position_m": 0.75e-3, "phase_rad": 1.0}.get(part, abs(expected))
        assert read[part][0] == pytest.approx(expected, abs=within * size), part


# Without noise, and without a word on where to look.


@pytest.mark.full
# A line and a Hertz contact are found beside one another below.
@pytest.mark.parametrize("name", rare(FEATURES, "line", "hertz"))
def test_found_where_nothing_is_said(name):
    y = simulated(name)
    estimate = fitter()({name: FEATURES[name]}, y, 1e-3 * rms(y))
    assert estimate.status == "converged"
    assert_recovered(estimate.parameters, TRUTHS[name], 2e-4)


OFFSET = np.array([0.3, -0.7])  # of the slow readout, unknown to the fit


@pytest.mark.full
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(
    ("sensor", "motion"),
    rare([("two", "varying"), ("slow", "reversing")], ("two", "varying")),
)
def test_friction_of_either_sign_along_any_motion(sensor, motion, sign):
    truth = TRUTHS["strip"] | {"friction": 0.5 * sign}
    offset = OFFSET if sensor == "slow" else None
    y = simulated("strip", sensor, motion, truth, offset=offset)
    noise = 1e-3 * rms(y - y.mean(axis=1, keepdims=True))
    estimate = fitter(sensor, motion)({"strip": FEATURES["strip"]}, y, noise)
    assert_recovered(estimate.parameters, truth, 5e-4)
    if offset is not None:
        np.testing.assert_allclose(estimate.fit.value["offset"], offset, atol=2 * noise)


@pytest.mark.full
def test_a_constant_is_no_feature():
    """Where the offset is not known."""
    y = np.repeat(OFFSET[:, None], SAMPLES, axis=1)
    noise = 1e-2
    y = y + noise * np.random.default_rng(2).normal(size=y.shape)
    ranked = fitter("slow", "reversing").rank([{}, {"strip": FEATURES["strip"]}], y, noise)
    assert ranked[0].log_evidence > ranked[1].log_evidence + 3
    np.testing.assert_allclose(ranked[0].fit.value["offset"], OFFSET, atol=4e-3)


@pytest.mark.full
def test_one_element_and_known_friction():
    known = StripFeature(friction=0.5)
    y = simulated("strip", "one", feature=known)
    estimate = fitter("one")({"strip": known}, y, 1e-3 * rms(y))
    truth = {part: value for part, value in TRUTHS["strip"].items() if part != "friction"}
    assert_recovered(estimate.parameters, truth, 2e-4)


@pytest.mark.full
def test_a_sum_of_two():
    truths = {
        "line": TRUTHS["line"] | {"position_m": -3e-3},
        "hertz": TRUTHS["hertz"] | {"position_m": 2e-3},
    }
    y = sum(simulated(name, truth=truth) for name, truth in truths.items())
    estimate = fitter()({name: FEATURES[name] for name in truths}, y, 1e-3 * rms(y))
    for name, truth in truths.items():
        own = {
            part.removeprefix(f"{name}_"): pair
            for part, pair in estimate.parameters.items()
            if part.startswith(name)
        }
        assert_recovered(own, truth, 5e-4)


@pytest.mark.full
def test_a_grating_is_told_the_usual_way():
    """Gaps that pull are bars that press."""
    y = simulated("grating", truth=TRUTHS["grating"] | {"pressure_Pa": -2e3})
    estimate = fitter()({"grating": FEATURES["grating"]}, y, 1e-3 * rms(y))
    usual = {"pressure_Pa": 2e3, "duty": 0.6, "phase_rad": 1.0 - np.pi}
    assert_recovered(estimate.parameters, TRUTHS["grating"] | usual, 2e-4)


@pytest.mark.full
def test_standard_error_of_friction():
    """By hand: the ratio's gradient and the covariance of both amplitudes."""
    y = simulated("strip")
    estimate = fitter()({"strip": FEATURES["strip"]}, y, rms(y) / 30)
    mu, stderr = friction_of(estimate.fit, "strip", FEATURES["strip"])
    at = [estimate.fit.names.index(f"strip.{part}") for part in ("pressure_Pa", "shear_Pa")]
    gradient = np.array([-mu, 1.0]) / estimate.fit.value["strip"]["pressure_Pa"]
    by_hand = np.sqrt(gradient @ estimate.fit.covariance[np.ix_(at, at)] @ gradient)
    assert stderr == pytest.approx(by_hand, rel=1e-9)


# With noise.

DRAWS = 40


@pytest.mark.full
def test_error_is_the_bound_and_intervals_hold():
    """40 draws at 40 dB: a root mean squared error scatters by 11 %, the share within a standard
    error about 68 % by 7 %; four parameters leave three of these standard deviations."""
    y, truth = simulated("strip"), TRUTHS["strip"]
    noise = rms(y) / 100
    rng = np.random.default_rng(1)
    ys = y + noise * rng.normal(size=(DRAWS, *y.shape))
    model, fits = fitter().many("strip", FEATURES["strip"], ys, noise)
    assert all(fit.converged for fit in fits)
    read = [model.loading.report(model.features, fit) for fit in fits]
    bound = cramer_rao("strip", truth, noise)
    for part, expected in truth.items():
        value, stderr = np.array([each[part] for each in read]).T
        rmse = np.sqrt(np.mean((value - expected) ** 2))
        assert 0.67 < rmse / bound[part] < 1.33, part
        assert stderr.mean() == pytest.approx(bound[part], rel=0.02), part
        assert 0.45 <= np.mean(np.abs(value - expected) < stderr) <= 0.9, part


def cramer_rao(name, truth, noise):
    """From differences of the finer simulation."""
    columns = {}
    for part, value in truth.items():
        step = 1e-3 * (0.75e-3 if part.endswith("_m") else max(abs(value), 0.1))
        ends = [simulated(name, truth={**truth, part: value + s * step}) for s in (1, -1)]
        columns[part] = (ends[0] - ends[1]).ravel() / (2 * step * noise)
    scale = {part: np.linalg.norm(column) for part, column in columns.items()}
    jacobian = np.array([column / scale[part] for part, column in columns.items()])
    spread = np.sqrt(np.diagonal(np.linalg.inv(jacobian @ jacobian.T)))
    return {part: s / scale[part] for part, s in zip(columns, spread, strict=True)}


@pytest.mark.parametrize("name", rare(["nothing", *FEATURES], *FEATURES))
def test_the_right_one_is_most_probable(name):
    rng = np.random.default_rng(5)
    clean = np.zeros((2, SAMPLES)) if name == "nothing" else simulated(name)
    noise = (rms(clean) or 1.0) / 10
    y = clean + noise * rng.normal(size=clean.shape)
    candidates = [{}, *({one: feature} for one, feature in FEATURES.items())]
    fits = fitter().rank(candidates, y, noise)
    probability = probabilities(fits)
    assert fits[int(probability.argmax())].name == name
    assert probability.max() > 0.6
    assert probability.sum() == pytest.approx(1.0)
