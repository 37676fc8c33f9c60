"""Faults of the elements' wiring, by the evidence of each."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.inverse.rig.wiring import element_findings
from srsinv.modules import with_fields
from tests.inverse.cases import DEPTH_M, make_case, make_operator

NAMES = ("first", "second")
SAME = (Film(DEPTH_M), Film(DEPTH_M))
PAIR = (Film(DEPTH_M), Film(DEPTH_M, np.pi / 2))


def findings(change=lambda data, noise: data, films=PAIR, **known):
    """What is found of two elements' signals after a change."""
    case = make_case(films=films, **known)
    noise = case.sigma * np.random.default_rng(1).normal(size=case.problem.data.shape)
    data = jnp.asarray(change(np.asarray(case.problem.data), noise))
    changed = eqx.tree_at(lambda p: p.data, case.problem, data)
    return element_findings(changed, NAMES, DEPTH_M)


FAULTS = {
    "second seems to be of the other sign": lambda data, _: data * [[1], [-1]],
    "first and second seem to be exchanged": lambda data, _: data[::-1],
    "first seems to be dead": lambda data, noise: np.stack([noise[0], data[1]]),
    "second seems to be dead": lambda data, noise: np.stack([data[0], noise[1]]),
    "seem to have the signal of first's element": lambda data, noise: data[:1] + 0 * noise,
}


@pytest.mark.parametrize("friction", [None, 0.4])
@pytest.mark.parametrize("words", FAULTS)
def test_a_fault_of_the_wiring_is_named(words, friction):
    (sentence,) = findings(FAULTS[words], friction=friction, colour=False)
    assert words in sentence


@pytest.mark.parametrize("noise_fraction", [1e-3, 1e-2, 0.3])
def test_elements_wired_as_stated_are_not_warned_of(noise_fraction):
    for seed in range(5):
        assert findings(noise_fraction=noise_fraction, seed=seed) == ()


def test_equal_elements_may_have_equal_signals():
    assert findings(FAULTS["seem to have the signal of first's element"], films=SAME) == ()


def test_one_element_has_no_other_to_be_held_against():
    problem = make_case(films="one", friction=0.4).problem
    assert make_operator(problem.line, "one").transfer.shape[0] == 1
    assert element_findings(problem, NAMES[:1], DEPTH_M) == ()


def test_hum_that_is_stated_is_no_fault_of_the_wiring():
    """Waves that the skin transmits, of ten times the signal and of another phase in each."""
    problem = make_case(films=PAIR).problem
    data = np.asarray(problem.data)
    phase = 2 * np.pi * 6.3 * np.arange(problem.line.n) / problem.line.n
    waves = 10 * data.std() * np.stack([np.cos(phase), np.sin(phase)])
    hum = np.array([[1.0, 0.2], [-0.3, -0.9]]) @ waves
    hummed = with_fields(problem, data=jnp.asarray(data + hum))
    assert element_findings(hummed, NAMES, DEPTH_M)
    stated = with_fields(hummed, nuisance=jnp.asarray(np.stack([waves, waves])))
    assert element_findings(stated, NAMES, DEPTH_M) == ()
    exchanged = with_fields(stated, data=jnp.asarray((data + hum)[::-1]))
    (sentence,) = element_findings(exchanged, NAMES, DEPTH_M)
    assert "exchanged" in sentence


@pytest.mark.parametrize("factor", [30.0, 300.0])
def test_a_signal_that_no_wiring_explains_is_not_called_dead(factor):
    """A strong signal that the model has nothing for, as of shear that turns over at a reversal."""
    step = np.random.default_rng(4).normal(size=512)

    def foreign(data, noise):
        strong = factor * noise.std() * np.resize(step, data.shape[1])
        return np.stack([data[0], strong])

    sentences = findings(foreign, colour=False)
    assert not any("dead" in each for each in sentences)
