"""How sure it is that noise has a correlated part."""

import numpy as np
import pytest

from srsinv.inverse.noise.sliding import estimate, evidence_of_sliding

N, DEPTH_M, STEP_M = 1200, 7.5e-4, 1e-5
X_M = STEP_M * np.arange(N)


def evidence(rng, sliding: float) -> float:
    """That of a draw: white noise of 1, correlated of `sliding` over a third of the depth."""
    decay = np.exp(-STEP_M / (DEPTH_M / 3))
    slow = np.zeros(N)
    for i in range(1, N):
        slow[i] = decay * slow[i - 1] + np.sqrt(1 - decay**2) * rng.normal()
    residual = rng.normal(size=(2, N)) + sliding * slow
    return evidence_of_sliding(residual, X_M, None, estimate(residual, X_M, DEPTH_M))


@pytest.mark.full
def test_chance_makes_little_of_it():
    """Twice a log ratio of likelihoods is a chi-square of at most two numbers: one draw in 400 is
    above 6."""
    rng = np.random.default_rng(0)
    of_white = [evidence(rng, 0.0) for _ in range(20)]
    assert min(of_white) > -0.05
    assert np.mean(np.array(of_white) > 3) < 0.15
    assert max(of_white) < 7.5


def test_it_grows_with_the_correlated_part():
    rng = np.random.default_rng(1)
    weak, strong = (np.mean([evidence(rng, s) for _ in range(4)]) for s in (0.3, 1.0))
    assert strong > 5 * weak > 5 * 7
