"""What estimates say against their own bands: where it is true, and not where it is not."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.inverse.rule import Discrepancy
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import DEPTH_M, gaps, make_case

P, Q = Exponential(1.5e3, 0.8e-3), Exponential(5e2, 1.5e-3)
WIENER = Wiener(P, Q)
SAME = (Film(DEPTH_M, 0.5), Film(DEPTH_M, 0.5))
SHALLOW = (Film(1e-6, 0.2), Film(2e-6, 1.5))


def louder(problem, factor):
    """The problem with `factor` times the stated noise's rms."""
    return eqx.tree_at(lambda p: p.noise, problem, problem.noise * factor**2)


# Doubt by its first words: a method, and a problem that calls for it and nothing else.
CALLED = {
    "The signal tells": (WIENER, lambda: louder(make_case().problem, 1e5)),
    "The elements feel one mix": (WIENER, lambda: make_case(films=SAME).problem),
    "p is": (Wiener(Exponential(15.0, 0.8e-3), Q), lambda: make_case().problem),
    "The residual is": (WIENER, lambda: louder(make_case().problem, 0.3)),
    "The noise (": (WIENER, lambda: louder(make_case().problem, 1e-15)),
    "The band takes the weights": (
        Tikhonov(1, rule=Discrepancy()),
        lambda: louder(make_case().problem, 1e5),
    ),
}


@pytest.mark.parametrize("words", CALLED)
def test_a_doubt_is_said_where_it_is_due(words):
    method, problem = CALLED[words]
    assert any(doubt.startswith(words) for doubt in method(problem()).doubts)


def test_waves_shorter_than_cells_are_doubted():
    doubts = WIENER(make_case(films=SHALLOW, noise_share=1e-4).problem).doubts
    assert any("down to waves of two cells" in doubt for doubt in doubts)


def test_missing_samples_are_doubted():
    problem = make_case("open", observed=gaps()).problem
    assert any("samples are missing" in doubt for doubt in WIENER(problem).doubts)
    iterative = Wiener(P, Q, path="iterative")(problem)
    assert any("path=direct gives their own" in doubt for doubt in iterative.doubts)


def test_a_plain_case_is_not_doubted():
    assert WIENER(make_case(noise_share=0.1).problem).doubts == ()


@pytest.mark.parametrize("path", ["spectral", "direct"])
def test_draws_from_the_model_itself_are_hardly_ever_doubted(path):
    """Traction from the prior and noise as stated: five standard deviations are no chance."""
    case = make_case(noise_share=0.1)
    problem, rng = case.problem, np.random.default_rng(5)
    method, doubted = Wiener(P, Q, path=path), 0
    power = np.stack([np.asarray(each.power(problem)) for each in (P, Q)])
    for _ in range(20):
        white = np.fft.rfft(rng.normal(size=(2, problem.line.n)))
        white[:, 0] = 0.0
        truth = np.fft.irfft(white * np.sqrt(power), problem.line.n)
        signal = np.asarray(problem.forward(jnp.asarray(truth)))
        data = signal + case.sigma * rng.normal(size=signal.shape)
        estimate = method(eqx.tree_at(lambda p: p.data, problem, jnp.asarray(data)))
        doubted += bool(estimate.doubts)
    assert doubted == 0


@pytest.mark.parametrize("path", ["spectral", "direct", "iterative"])
def test_what_is_told_is_the_trace_of_the_resolution(path):
    """Of the dense answer: the derivative of the estimate by the traction behind the data."""
    problem = make_case().problem
    method = Wiener(P, Q, path=path)
    zero = eqx.tree_at(lambda p: p.data, problem, jnp.zeros_like(problem.data))
    offset = np.asarray(method(zero).value)
    for c, name in enumerate("pq"):
        impulse = np.zeros((2, problem.line.n))
        impulse[c, 7] = 1.0
        data = problem.forward(jnp.asarray(impulse))
        answer = np.asarray(method(eqx.tree_at(lambda p: p.data, problem, data)).value) - offset
        # On a periodic line every cell is resolved alike.
        told = method(problem).stats[f"told_{name}"]
        assert told == pytest.approx(problem.line.n * answer[c, 7], rel=1e-6)
