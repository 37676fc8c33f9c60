"""Faults of the elements' wiring, by the evidence of each."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES
from srsinv.forward.film import Film
from srsinv.forward.sensor import Sensor
from srsinv.inverse.rig.wiring import wiring_finding
from srsinv.modules import with_fields
from srsinv.recorded import problem_of, ready
from tests.inverse.cases import DEPTH_M, make_case, make_operator
from tests.tiers import quick

NAMES = ("first", "second")
SAME = (Film(DEPTH_M), Film(DEPTH_M))
PAIR = (Film(DEPTH_M), Film(DEPTH_M, np.pi / 2))


def finding(change=lambda data, noise: data, films=PAIR, **known):
    """What is found of two elements' signals after a change."""
    case = make_case(films=films, **known)
    noise = case.sigma * np.random.default_rng(1).normal(size=case.problem.data.shape)
    data = jnp.asarray(change(np.asarray(case.problem.data), noise))
    changed = eqx.tree_at(lambda p: p.data, case.problem, data)
    return wiring_finding(changed, NAMES, DEPTH_M)


FAULTS = {
    "second seems to be of the other sign": lambda data, _: data * [[1], [-1]],
    "first and second seem to be exchanged": lambda data, _: data[::-1],
    "first seems to be dead": lambda data, noise: np.stack([noise[0], data[1]]),
    "second seems to be dead": lambda data, noise: np.stack([data[0], noise[1]]),
    "seem to record the same element": lambda data, noise: data[:1] + 0 * noise,
}


@pytest.mark.parametrize("friction", [None, 0.4])
@pytest.mark.parametrize("words", FAULTS)
def test_a_fault_of_the_wiring_is_named(words, friction):
    found = finding(FAULTS[words], friction=friction, colour=False)
    assert words in found.words
    assert found.wiring is not None


@pytest.mark.parametrize("words", FAULTS)
def test_a_sensor_is_wired_as_the_responses_by_which_that_was_found(words):
    """In both directions of motion."""
    wiring = finding(FAULTS[words], colour=False).wiring
    sensor, k = Sensor(PAIR).in_both_directions(), jnp.linspace(0.0, 10 / DEPTH_M, 9)
    stated, wired = (own.charge().transfer(k) for own in (sensor, wiring.sensor(sensor)))
    expected = np.concatenate([wiring.gain(np.asarray(way)) for way in (stated[:2], stated[2:])])
    np.testing.assert_allclose(wired, expected, rtol=1e-12)


@pytest.mark.parametrize("noise_fraction", [1e-3, 1e-2, 0.3])
def test_elements_wired_as_stated_are_not_warned_of(noise_fraction):
    for seed in range(5):
        assert finding(noise_fraction=noise_fraction, seed=seed) is None


def test_equal_elements_may_have_equal_signals():
    assert finding(FAULTS["seem to record the same element"], films=SAME) is None


def test_one_element_has_no_other_to_be_held_against():
    problem = make_case(films="one", friction=0.4).problem
    assert make_operator(problem.line, "one").transfer.shape[0] == 1
    assert wiring_finding(problem, NAMES[:1], DEPTH_M) is None


def test_hum_that_is_stated_is_no_fault_of_the_wiring():
    """Waves that the skin transmits, of ten times the signal and of another phase in each."""
    problem = make_case(films=PAIR).problem
    data = np.asarray(problem.data)
    phase = 2 * np.pi * 6.3 * np.arange(problem.line.n) / problem.line.n
    waves = 10 * data.std() * np.stack([np.cos(phase), np.sin(phase)])
    hum = np.array([[1.0, 0.2], [-0.3, -0.9]]) @ waves
    hummed = with_fields(problem, data=jnp.asarray(data + hum))
    assert wiring_finding(hummed, NAMES, DEPTH_M) is not None
    stated = with_fields(hummed, nuisance=jnp.asarray(np.stack([waves, waves])))
    assert wiring_finding(stated, NAMES, DEPTH_M) is None
    exchanged = with_fields(stated, data=jnp.asarray((data + hum)[::-1]))
    assert "exchanged" in wiring_finding(exchanged, NAMES, DEPTH_M).words


@pytest.mark.parametrize("fault", quick(["slow_sine", "step"], "slow_sine"))
def test_a_drift_that_nobody_stated_is_no_fault_of_the_wiring(fault):
    """Of what it has at long waves the elements would be 10^12 times as probable otherwise."""
    made = faulty(faults()[fault], SCENES["strip, two elements"], 0)
    stated = problem_of(ready(made.recording), cell_m=2e-4, is_wired_as_stated=True)
    assert not any("of the other sign" in each for each in stated.warnings)


@pytest.mark.parametrize("factor", [30.0, 300.0])
def test_a_signal_that_no_wiring_explains_is_not_called_dead(factor):
    """A strong signal that the model has nothing for, as of shear that turns over at a reversal."""
    step = np.random.default_rng(4).normal(size=512)

    def foreign(data, noise):
        strong = factor * noise.std() * np.resize(step, data.shape[1])
        return np.stack([data[0], strong])

    found = finding(foreign, colour=False)
    assert found is None or "dead" not in found.words
