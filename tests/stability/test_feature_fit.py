"""Features fitted where the signal hardly holds them: the truth within the error, an infinite one,
or a word that it is no answer; and what the page says of it."""

import json
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.errors import BadInput
from srsinv.forward.feature import LineFeature, StepFeature, StripFeature
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.inverse.features import FeatureFitter, FeatureModel
from srsinv.recording import Recording, save
from tests.jobs.run import command, outcome, words
from tests.stability.matrix import PRECISIONS
from tests.tiers import rare

SAMPLES = 120
TIME = np.arange(SAMPLES) / 600
END_M = 6e-3
DEPTH_M = 0.75e-3
MU = 0.4
FEATURES = {
    "line": LineFeature(), "other": LineFeature(), "strip": StripFeature(), "step": StepFeature(),
}  # fmt: skip
STRIP = {"position_m": 0.7e-3, "width_m": 2.9e-3, "pressure_Pa": -4e3}
LINE = {"position_m": 1.1e-3, "load_N_per_m": 10.0}
STEP = {"position_m": -0.9e-3, "pressure_Pa": 3e3}
DRAWN = np.random.default_rng(0).normal(size=(2, SAMPLES))
MAX_ERROR_SIGMA = 5  # standard errors from the truth at most
NOISE_FRACTION = 0.01  # of noise in the signal of the plain features

# What stays.
LIMITS = [
    ("a feature beyond the scan whose tail is felt, or data at the rail",
     "a feature within the scan is fitted to what is no such feature; its errors are those of the "
     "noise alone", "explains is False, and the page says that the errors are too small"),
    ("a load beyond the scan, hardly felt",
     "it is looked for within the scan, and its strength has the prior of features there",
     "10 N/m at 3 mm beyond the end is 4.5 of the prior's standard deviations"),
]  # fmt: skip


class FittedScan(NamedTuple):
    fitter: FeatureFitter
    finer: FeatureModel


@cache
def bench(precision):
    """The fit, and a simulation on cells three times finer."""
    del precision  # of the context: what is cached is of its own
    motion = Motion.from_speed(TIME, 2 * END_M / TIME[-1], -END_M)
    angles = (0.0, np.pi / 2)
    sensor = Sensor([Film(DEPTH_M, angle, effects=(StripAverage(0.5e-3),)) for angle in angles])
    return FittedScan(
        FeatureFitter.along(sensor, motion),
        FeatureModel.along(sensor, motion, float(sensor.depth_m) / 96),
    )


@pytest.fixture(params=PRECISIONS)
def precision(request):
    with jax.enable_x64(request.param == "float64"):
        yield request.param


def clean_signal(name, **own):
    """The clean signal of a feature; always simulated in double precision."""
    with jax.enable_x64(True):
        feature = FEATURES[name]
        own = own | {feature.shear: MU * own[feature.amplitude]}
        model = bench("float64").finer.with_features({name: feature})
        return np.asarray(model({name: {k: jnp.asarray(v) for k, v in own.items()}}))


def rms(signal):
    return float(np.sqrt(np.mean(signal**2)))


def fitted(precision, names, y, noise):
    return bench(precision).fitter({name: FEATURES[name] for name in names}, y, noise)


def assert_honest(estimate, truth, margin):
    """Finite values; an error of the truth, or no claim to one."""
    values = np.array([value for value, _ in estimate.parameters.values()])
    assert np.isfinite(values).all()
    assert not np.isnan([stderr for _, stderr in estimate.parameters.values()]).any()
    if estimate.status != "converged" or not estimate.explains:
        return
    read = estimate.parameters
    error = max(abs(read[part][0] - true) / read[part][1] for part, true in truth.items())
    margin(error, MAX_ERROR_SIGMA)
    assert error < MAX_ERROR_SIGMA


class HardScene(NamedTuple):
    """`determined`: what must have a finite error, so that honesty is not silence."""

    hard: str
    name: str
    truth: dict
    determined: tuple[str, ...]


SCENES = {
    "plain strip": HardScene("nothing", "strip", STRIP, ("position_m", "width_m", "friction")),
    "narrower than a cell": HardScene(
        "a line to the film, of any width up to a tenth of its depth",
        "strip", STRIP | {"width_m": 2e-6, "pressure_Pa": 4e6}, ("position_m", "friction"),
    ),
    "wider than the scan": HardScene(
        "both edges outside", "strip", STRIP | {"width_m": 30e-3, "position_m": 0.0}, (),
    ),
    "line outside": HardScene(
        "felt by its tail", "line", {"position_m": 9e-3, "load_N_per_m": 5.0}, (),
    ),
    "line far outside": HardScene("not felt", "line", LINE | {"position_m": 40e-3}, ()),
    "step outside": HardScene("felt by its tail", "step", STEP | {"position_m": 9e-3}, ()),
    "step at the scan's "
    "end": HardScene("half of it", "step", STEP | {"position_m": END_M - 2e-4}, ()),
    "plain step": HardScene("nothing", "step", STEP, ("position_m", "pressure_Pa", "friction")),
}  # fmt: skip
NOMINAL = {"line": LINE, "strip": STRIP, "step": STEP}


# Each kind of feature compiles its own programs; tests/inverse/features/test_fit.py fits steps.
KINDS = rare(NOMINAL, "step")


@pytest.mark.parametrize("name", rare(SCENES, *(n for n, s in SCENES.items() if s.name == "step")))
def test_scene(name, precision, margin):
    scene = SCENES[name]
    noise = NOISE_FRACTION * rms(clean_signal(scene.name, **NOMINAL[scene.name]))
    if name == "narrower than a cell":
        noise = NOISE_FRACTION * rms(clean_signal(scene.name, **scene.truth))
    y = clean_signal(scene.name, **scene.truth) + noise * DRAWN
    estimate = fitted(precision, [scene.name], y, noise)
    assert_honest(estimate, scene.truth | {"friction": MU}, margin)
    for part in scene.determined:
        assert estimate.parameters[part][1] < np.inf, part


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", KINDS)
def test_no_load(name, seed, precision):
    """Noise alone: the strength is nothing within its prior, and nothing else is known."""
    noise = NOISE_FRACTION * rms(clean_signal(name, **NOMINAL[name]))
    y = noise * np.random.default_rng(seed).normal(size=DRAWN.shape)
    estimate = fitted(precision, [name], y, noise)
    assert estimate.undetected == (name,)
    amplitude = FEATURES[name].amplitude
    for part, (value, stderr) in estimate.parameters.items():
        assert np.isfinite(value)
        if part == amplitude:
            # The prior: thirty times the largest datum, of the shape that the film feels most.
            assert abs(value) < 0.2 * stderr
        else:
            assert np.isposinf(stderr), part


@pytest.mark.parametrize("name", KINDS)
def test_a_signal_of_zeros(name, precision):
    noise = NOISE_FRACTION * rms(clean_signal(name, **NOMINAL[name]))
    estimate = fitted(precision, [name], np.zeros(DRAWN.shape), noise)
    assert estimate.undetected == (name,)
    assert_honest(estimate, {FEATURES[name].amplitude: 0.0}, lambda *_: None)


# The next test has the sum and its error, too.
@pytest.mark.claim
def test_two_on_one_spot(precision, margin):
    """Found one after the other, the first takes both: each strength is told in their sum only."""
    half = clean_signal("line", **LINE)
    noise = NOISE_FRACTION * rms(half)
    estimate = fitted(precision, ["line", "other"], 2 * half + noise * DRAWN, noise)
    truth = {f"{n}_{part}": v for n in ("line", "other") for part, v in LINE.items()}
    assert estimate.explains
    assert_honest(estimate, truth, margin)
    total, stderr = estimate.fit.derive(
        lambda params: params["line"]["load_N_per_m"] + params["other"]["load_N_per_m"]
    )
    assert abs(total - 20) < MAX_ERROR_SIGMA * stderr < 1


def test_two_begun_on_one_spot(precision):
    """The direction in which one gives to the other is named, and the sum has its error."""
    half = clean_signal("line", **LINE)
    noise = NOISE_FRACTION * rms(half)
    pair = {"line": FEATURES["line"], "other": FEATURES["other"]}
    fitter = bench(precision).fitter
    model = fitter._model.with_features(pair)
    shape = {"position_m": LINE["position_m"], "load_N_per_m": 0.0, "shear_N_per_m": 0.0}
    fit = srsinv.fit(
        model, {"line": shape, "other": dict(shape)}, 2 * half + noise * DRAWN, noise=noise,
        free=model.linear, linear=model.linear,
    )  # fmt: skip
    assert fit.converged, fit.status
    named = {name for direction in fit.undetermined for name in direction}
    assert {"line.load_N_per_m", "other.load_N_per_m"} <= named
    assert np.isposinf(fit.stderr["line"]["load_N_per_m"])
    total, stderr = fit.derive(lambda p: p["line"]["load_N_per_m"] + p["other"]["load_N_per_m"])
    assert abs(total - 20) < MAX_ERROR_SIGMA * stderr < 1


# test_fit.py has it of a bell.
@pytest.mark.claim
def test_begun_ten_widths_away(precision, margin):
    """Alone, without the search for a start, it is not sure of a wrong place."""
    y = clean_signal("line", **LINE)
    noise = NOISE_FRACTION * rms(y)
    model = bench(precision).fitter._model.with_features({"line": FEATURES["line"]})
    away = {"position_m": LINE["position_m"] - 7e-3, "load_N_per_m": 0.0, "shear_N_per_m": 0.0}
    fit = srsinv.fit(model, {"line": away}, y + noise * DRAWN, noise=noise, linear=model.linear)
    place, error = fit.value["line"]["position_m"], fit.stderr["line"]["position_m"]
    if fit.converged and fit.explains:
        margin(abs(place - LINE["position_m"]) / error, MAX_ERROR_SIGMA)
        assert abs(place - LINE["position_m"]) < MAX_ERROR_SIGMA * error


def test_a_missing_sample(precision, margin):
    """Refused in one sentence, or left out where the noise says so."""
    y = clean_signal("line", **LINE)
    noise = NOISE_FRACTION * rms(y)
    y = y + noise * DRAWN
    y[0, 70] = np.nan
    with pytest.raises(BadInput, match=r"1 values .*infinite noise.*\.$"):
        fitted(precision, ["line"], y, noise)
    estimate = fitted(precision, ["line"], y, np.where(np.isnan(y), np.inf, noise))
    assert estimate.explains
    assert_honest(estimate, LINE | {"friction": MU}, margin)
    assert np.isfinite([stderr for _, stderr in estimate.parameters.values()]).all()


def test_an_outlier(precision):
    """A million times the noise: it explains nothing else, and says so."""
    y = clean_signal("line", **LINE)
    noise = NOISE_FRACTION * rms(y)
    y = y + noise * DRAWN
    y[0, 40] += 1e6 * noise
    estimate = fitted(precision, ["line"], y, noise)
    assert np.isfinite([value for value, _ in estimate.parameters.values()]).all()
    assert not estimate.explains


def test_fewer_samples_than_parameters(precision, margin):
    """Two samples for four: the priors of the strengths make up for them, and nothing is told."""
    y = clean_signal("strip", **STRIP)
    noise = np.full(y.shape, np.inf)
    noise[0, 55], noise[1, 60] = 2 * [NOISE_FRACTION * rms(y)]
    estimate = fitted(precision, ["strip"], y, noise)
    assert_honest(estimate, STRIP | {"friction": MU}, margin)
    assert np.isposinf([s for _, s in estimate.parameters.values()]).any()


def test_clipped(precision):
    """Every sample at the rail: what is fitted to it explains nothing."""
    noise = NOISE_FRACTION * rms(clean_signal("line", **LINE))
    estimate = fitted(precision, ["line"], np.full(DRAWN.shape, 100 * noise), noise)
    assert estimate.status != "converged" or not estimate.explains


# --- the page -----------------------------------------------------------------------------------

EXAMPLES = Path(srsinv.__file__).parent / "examples"
SIDECAR = json.loads((EXAMPLES / "strip_two_element.json").read_text())
COUNT = 240


@pytest.fixture
def recorded(tmp_path):
    """The path of a recording of these signals, with the example's sensor."""

    def of(signal):
        recording = Recording(
            signal, np.arange(COUNT) / 1000, np.full(COUNT, 0.05), ("voltage_0_V", "voltage_1_V"),
            {key: value for key, value in SIDECAR.items() if key != "sample_rate_hz"},
        )  # fmt: skip
        path = tmp_path / "recording.csv"
        save(recording, path)
        return f"recording.path={path}"

    return of


def test_the_page_of_no_load(recorded):
    """The words and the numbers of noise alone."""
    noise = 1e-6 * np.random.default_rng(5).normal(size=(2, COUNT))
    result = outcome("experiment=fit_recording", recorded(noise), "feature=[line_load]")
    metrics = result.metrics
    assert metrics["status"] == "converged"
    assert metrics["undetected_features"] == "line_load"
    assert np.isposinf([metrics["position_m_stderr"], metrics["friction_stderr"]]).all()
    assert abs(metrics["load_N_per_m"]) < MAX_ERROR_SIGMA * metrics["load_N_per_m_stderr"]
    said = words(result)
    assert "do not detect line load" in said
    assert "The data determine every parameter" not in said


def test_the_page_of_a_rail(recorded, tmp_path, capsys):
    rail = recorded(np.full((2, COUNT), 5.0))
    given = ("experiment=fit_recording", rail, "feature=[line_load]", "noise.white.rms=1e-3")
    assert command(tmp_path / "run", *given) == 2
    said = capsys.readouterr().err.strip()
    assert "rail" in said
    assert len(said.splitlines()) == 1
