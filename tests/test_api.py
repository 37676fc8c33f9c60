"""The functions of `import srsinv`: simulate, invert, fit_recording."""

import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import srsinv

EXAMPLE = srsinv.examples.path("strip_two_element")
LINE = srsinv.Periodic(128, cell_m=1.5e-4, start_m=-9.6e-3)


@cache
def simulated(refinement=4, seed=0):
    scene = srsinv.TractionScene(
        background_pressure_Pa=1e4, base_friction=0.4, pressures=[srsinv.UniformStrip(4e3, 3e-3)]
    )
    scan, noises = srsinv.ConstantSpeed(0.05), (srsinv.SignalToNoise(40.0),)
    scenario = srsinv.Scenario(scene, srsinv.Sensor(), scan, noises)
    return srsinv.simulate(scenario, LINE, refinement=refinement, seed=seed)


def test_a_simulated_signal_has_its_noise_and_its_truth():
    problem, signal, traction = simulated()
    noise = np.asarray(problem.data + problem.mean_signal - signal)
    ratio = np.sqrt(np.mean(np.asarray(signal) ** 2) / np.mean(noise**2))
    assert 20 * np.log10(ratio) == pytest.approx(40.0, abs=0.5)
    np.testing.assert_allclose(traction[1], 0.4 * traction[0], rtol=1e-12)
    again, other = simulated(seed=0).problem, simulated(seed=1).problem
    assert np.array_equal(again.data, problem.data)
    assert not np.array_equal(other.data, problem.data)


def test_a_simulated_signal_is_inverted():
    problem, _, traction = simulated()
    for method in (None, srsinv.Tikhonov()):
        estimate = srsinv.invert(problem, method)
        assert isinstance(estimate, srsinv.Estimate)
        error = np.array(estimate.value - traction)
        error -= error.mean(axis=-1, keepdims=True)
        size = np.asarray(traction) - np.asarray(traction).mean(axis=-1, keepdims=True)
        assert np.linalg.norm(error) < 0.2 * np.linalg.norm(size)
        assert estimate.quality == "good"


@pytest.mark.full
def test_a_file_is_inverted_and_fitted():
    """The bundled strip of 4 kPa, from its path and from the recording."""
    estimate = srsinv.invert(EXAMPLE)
    fitted = srsinv.fit_recording(srsinv.load(EXAMPLE), {"strip": srsinv.StripFeature()})
    assert {estimate.quality, fitted.quality} == {"good"}
    peak = float(estimate.line.x[int(np.argmax(estimate.value[0]))])
    position, width = (fitted.parameters[key][0] for key in ("position_m", "width_m"))
    assert abs(peak - position) < width / 2
    fine = fitted.on(estimate.line)
    inside = np.abs(np.asarray(estimate.line.x) - position) < width / 4
    error = np.abs(np.asarray(fine.value - estimate.value))[0, inside]
    assert np.median(error) < 0.2 * fitted.parameters["pressure_Pa"][0]


REFUSED = {
    "no scene": lambda: srsinv.simulate(srsinv.Scenario(None, srsinv.Sensor(), SCAN), LINE),
    "refinement is 0": lambda: simulated(refinement=0),
    "give one or more by name": lambda: srsinv.fit_recording(EXAMPLE, {}),
    "all of traction": lambda: srsinv.fit_recording(
        EXAMPLE, {"strip": srsinv.StripFeature(), "ridge": srsinv.RidgeFeature(1e-5)}
    ),
    "leave `sensor` out": lambda: srsinv.invert(simulated().problem, sensor=srsinv.Sensor()),
    "2 signal columns but 1 film": lambda: srsinv.invert(
        EXAMPLE, sensor=srsinv.Sensor([srsinv.Film()])
    ),
    "there is no such file": lambda: srsinv.invert("absent.csv"),
}
SCAN = srsinv.ConstantSpeed()


@pytest.mark.parametrize("sentence", REFUSED)
def test_refused(sentence):
    with pytest.raises(srsinv.BadInput, match=sentence):
        REFUSED[sentence]()


@pytest.mark.full
def test_what_is_no_such_thing_is_refused_where_it_is_given():
    made = subprocess.run(
        [sys.executable, "-m", "tests.wrong_arguments"],
        cwd=Path(srsinv.__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
    )
    for sentence, said in json.loads(made.stdout).items():
        assert re.search(sentence, said), said
