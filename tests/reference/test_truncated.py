"""The sampler of truncated normals against closed forms."""

import numpy as np
import scipy.stats

from tests.reference.truncated import truncated_draws


def test_one_number_has_the_moments_of_a_truncated_normal():
    exact = scipy.stats.truncnorm(0.7, np.inf, loc=-0.7)
    draws = truncated_draws(np.array([-0.7]), np.eye(1), np.array([1.0]), 4000)[:, 0]
    # Trajectories of a quarter period are nearly independent.
    assert abs(draws.mean() - exact.mean()) < 6 * exact.std() / np.sqrt(draws.size)
    assert abs(draws.std() / exact.std() - 1) < 6 / np.sqrt(draws.size)


def test_two_correlated_numbers_have_their_mean():
    """E x of a normal about zero in the quadrant: (1 + rho) phi(0) Phi(0) / P, P the quadrant's
    probability 1/4 + asin(rho) / 2 pi (Tallis 1961)."""
    rho = 0.8
    covariance = np.array([[1.0, rho], [rho, 1.0]])
    draws = truncated_draws(np.zeros(2), covariance, np.ones(2), 4000)
    quadrant = 0.25 + np.arcsin(rho) / (2 * np.pi)
    wanted = (1 + rho) * scipy.stats.norm.pdf(0) * 0.5 / quadrant
    np.testing.assert_allclose(draws.mean(axis=0), wanted, atol=6 / np.sqrt(len(draws)))
