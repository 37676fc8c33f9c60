"""Noise with columns of unknown sizes beside it, against dense linear algebra."""

import numpy as np
import pytest

from srsinv.inverse.nonlinear import WhitePlusOU, WithNuisance

N, ELEMENTS, WAVES = 120, 2, 4
X = np.linspace(0, 0.01, N)


@pytest.fixture(scope="module")
def made():
    """The noise with its columns, and the whole covariance of each element."""
    rng = np.random.default_rng(0)
    columns = 30 * rng.normal(size=(ELEMENTS, WAVES, N))
    columns[:, -1] = 0.3 * columns[:, -1] + 20 * columns[:, 0]  # hardly apart from another
    white = np.full((ELEMENTS, N), 0.7)
    white[1, 40:50] = np.inf
    alone = WhitePlusOU(X, white, 0.5, 1e-3)
    slow = 0.25 * np.exp(-np.abs(X[:, None] - X) / 1e-3)
    whole = [slow + 0.49 * np.eye(N) + own.T @ own for own in columns]
    return WithNuisance.of(alone, columns), whole, np.isfinite(white)


def whitening(noise, e):
    """The matrix from an element's samples to whitened ones."""
    rows = np.zeros((N, ELEMENTS, N))
    rows[np.arange(N), e, np.arange(N)] = 1.0
    return np.stack([np.asarray(noise(row)).reshape(ELEMENTS, N)[e] for row in rows], axis=1)


def test_it_whitens_noise_and_columns_together(made):
    noise, whole, observed = made
    for e, covariance in enumerate(whole):
        there = observed[e]
        matrix = whitening(noise, e)
        inverse = np.linalg.inv(covariance[np.ix_(there, there)])
        np.testing.assert_allclose(
            (matrix.T @ matrix)[np.ix_(there, there)], inverse, atol=1e-7 * np.abs(inverse).max()
        )


def test_its_volume_is_the_determinants(made):
    noise, whole, observed = made
    logs = [
        np.linalg.slogdet(each[np.ix_(there, there)])[1]
        for each, there in zip(whole, observed, strict=True)
    ]
    assert noise.log_volume((ELEMENTS, N)) == pytest.approx(sum(logs) / 2, rel=1e-9)


def test_colouring_is_the_inverse_of_whitening(made):
    noise, _, observed = made
    data = np.where(observed, np.random.default_rng(1).normal(size=(ELEMENTS, N)), 0.0)
    white = np.asarray(noise(data))[:, None]
    np.testing.assert_allclose(noise.coloured(white)[..., 0], data, atol=1e-8)


def test_data_without_the_waves_are_noise_in_every_direction(made):
    """Less drawn sizes they are as the noise alone, along the columns too."""
    noise, whole, observed = made
    rng, root = np.random.default_rng(2), np.linalg.cholesky(whole[0])
    alone = whole[0] - noise.waves[0].T @ noise.waves[0]
    along = np.asarray(noise.waves)[0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    squares = []
    for seed in range(200):
        data = np.zeros((ELEMENTS, N))
        data[0] = root @ rng.normal(size=N)
        left = noise.without(np.where(observed, data, np.nan), seed)
        assert np.isnan(left[1, 40:50]).all()
        squares.append((along @ left[0]) ** 2)
    expected = np.einsum("mi,ij,mj->m", along, np.asarray(alone), along)
    # The mean of 200 squares has a relative scatter of 0.1.
    np.testing.assert_allclose(np.mean(squares, axis=0), expected, rtol=0.4)
