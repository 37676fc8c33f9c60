"""Noise that is correlated along the motion: its whitener, and its levels from a residual."""

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.inverse.noise.sliding import Levels, estimate, first_levels
from srsinv.inverse.nonlinear import WhitePlusOU, WithNuisance, fit
from tests.refusals import refused

LENGTH = 2e-4
RNG = np.random.default_rng(5)
X = np.cumsum(RNG.uniform(0.1, 2.0, 157)) * 1e-5
WHITE = np.stack([np.full(157, 1.0), np.full(157, 2.0)])
WHITE[0, 5] = np.inf


def covariance(row):
    away = np.abs(X[:, None] - X[None])
    return 0.49 * np.exp(-away / LENGTH) + np.diag(np.where(np.isfinite(row), row, 0.0) ** 2)


@pytest.mark.parametrize("element", [0, 1])
def test_it_makes_its_own_noise_white(element):
    """W N W^T = 1 over the samples that are seen, and the volume is the determinant's."""
    noise = WhitePlusOU(X, WHITE, 0.7, LENGTH)
    basis = np.zeros((157, 2, 157))
    basis[np.arange(157), element, np.arange(157)] = 1.0
    rows = np.array([np.asarray(noise(jnp.asarray(b))).reshape(2, -1)[element] for b in basis]).T
    observed = np.isfinite(WHITE[element])
    white = (
        rows[np.ix_(observed, observed)] @ covariance(WHITE[element])[np.ix_(observed, observed)]
    )
    white = white @ rows[np.ix_(observed, observed)].T
    np.testing.assert_allclose(white, np.eye(observed.sum()), atol=1e-12)
    assert not rows[~observed].any()


def test_coloured_is_what_it_makes_white():
    noise = WhitePlusOU(X, WHITE, 0.7, LENGTH)
    data = RNG.normal(size=(3, 2, 157))
    white = np.stack([np.asarray(noise(jnp.asarray(each))) for each in data], axis=1)
    expected = np.where(np.isfinite(WHITE), data, 0.0)
    np.testing.assert_allclose(noise.coloured(white), np.moveaxis(expected, 0, -1), atol=1e-12)


@pytest.mark.parametrize("waves", [0, 2])
def test_missing_samples_at_the_end_change_nothing(waves):
    """By a program of as many samples as other lengths have, or of their own number."""
    noise = WhitePlusOU(X, WHITE, 0.7, LENGTH)
    noise = WithNuisance.of(noise, RNG.normal(size=(2, waves, 157))) if waves else noise
    y, filled = RNG.normal(size=(2, 157)), noise.filled_up((2, 157), 35)
    own = np.asarray(noise(jnp.asarray(y))).reshape(2, -1)
    whole = np.asarray(filled(jnp.asarray(np.pad(y, ((0, 0), (0, 35)))))).reshape(2, -1)
    np.testing.assert_allclose(whole, np.pad(own, ((0, 0), (0, 35))), atol=1e-13)
    np.testing.assert_allclose(noise.whitened(y), own.ravel(), atol=1e-13)
    assert filled.count((2, 192)) == noise.count((2, 157))
    assert filled.log_volume((2, 192)) == pytest.approx(noise.log_volume((2, 157)), rel=1e-14)


def test_samples_much_nearer_than_the_correlation():
    """Without white noise the second of two differs from the first by s sqrt(2 d/l)."""
    noise = WhitePlusOU(np.array([0.0, 1e-12 * LENGTH]), np.full((1, 2), 1e-30), 0.7, LENGTH)
    white = np.asarray(noise(jnp.array([[0.0, 1.0]])))
    assert white[1] == pytest.approx(1 / (0.7 * np.sqrt(2e-12)), rel=1e-10)


def test_its_volume_and_count():
    noise = WhitePlusOU(X, WHITE, 0.7, LENGTH)
    observed = [np.isfinite(row) for row in WHITE]
    exact = sum(
        np.linalg.slogdet(covariance(row)[np.ix_(s, s)])[1] / 2
        for row, s in zip(WHITE, observed, strict=True)
    )
    assert noise.log_volume(WHITE.shape) == pytest.approx(exact, rel=1e-12)
    assert noise.count(WHITE.shape) == 2 * 157 - 1


def test_a_fit_weighs_with_it_as_with_the_full_matrix():
    """A constant under it: its value and standard error by generalised least squares."""
    y = RNG.normal(size=(1, 157))
    noise = WhitePlusOU(X, WHITE[1:], 0.7, LENGTH)
    solution = fit(lambda p: p["level"] + jnp.zeros((1, 157)), {"level": 0.0}, y, noise=noise)
    inverse = np.linalg.inv(covariance(WHITE[1]))
    weight = inverse.sum()
    assert solution.stderr["level"] == pytest.approx(weight**-0.5, rel=1e-9)
    assert solution.value["level"] == pytest.approx((inverse @ y[0]).sum() / weight, rel=1e-7)


@pytest.mark.parametrize("uneven", [False, True])
def test_levels_come_back_from_the_noise(uneven):
    """Within what so many samples tell: the correlated part's are some hundred correlation lengths,
    worth 7 % of its level and 15 % of its length."""
    n = 6000
    step = RNG.uniform(0.2, 1.8, n) * 5e-6 if uneven else np.full(n, 5e-6)
    x = np.cumsum(step)
    white, sliding = np.array([1e-6, 1.5e-6]), 0.5e-6
    drive = RNG.normal(size=(2, n))
    decay = np.exp(-np.diff(x, prepend=x[0]) / LENGTH)
    slow = np.zeros((2, n))
    slow[:, 0] = drive[:, 0]
    for i in range(1, n):
        slow[:, i] = decay[i] * slow[:, i - 1] + np.sqrt(1 - decay[i] ** 2) * drive[:, i]
    y = sliding * slow + white[:, None] * RNG.normal(size=(2, n))
    y[0, 100:120] = np.nan
    levels = estimate(y, x, 7.5e-4)
    np.testing.assert_allclose(levels.white, white, rtol=0.04)
    assert levels.sliding == pytest.approx(sliding, rel=0.25)
    assert levels.correlation_m == pytest.approx(LENGTH, rel=0.6)


@pytest.mark.full
def test_levels_are_not_too_low_for_what_a_fit_takes_out():
    """The median of 40 draws, to four of its standard errors: a fit of 8 slow waves takes out a
    fifth of the noise that is slow."""
    n, draws = 400, 40
    x = np.arange(n) * 2e-5
    drive, white = RNG.normal(size=(2, draws, 1, n))
    slow, decay = drive.copy(), np.exp(-2e-5 / LENGTH)
    for i in range(1, n):
        slow[..., i] = decay * slow[..., i - 1] + np.sqrt(1 - decay**2) * drive[..., i]
    waves = np.linalg.qr(np.cos(np.pi * np.outer(np.arange(n) + 0.5, np.arange(8)) / n))[0]
    y = slow + white
    left = y - (y @ waves) @ waves.T
    middle, error = {}, {}
    for name, fitted in (("restricted", waves[None]), ("plain", None)):
        levels = [estimate(each, x, 7.5e-4, fitted) for each in left]
        power = np.log([each.sliding**2 * each.correlation_m / LENGTH for each in levels])
        low, middle[name], high = np.quantile(power, [0.16, 0.5, 0.84])
        error[name] = 1.25 * (high - low) / 2 / draws**0.5
    assert abs(middle["restricted"]) < 4 * error["restricted"]
    assert middle["plain"] < -4 * error["plain"]


def test_levels_are_the_likeliest_of_what_no_fit_takes_out():
    """Whatever of the fitted directions is in the residual, and wherever the search begins."""
    rng, x = np.random.default_rng(6), np.arange(400) * 2e-5
    waves = np.cos(np.pi * np.outer(np.arange(400) + 0.5, np.arange(3)) / 400)
    y = np.cumsum(rng.normal(size=(1, 400)), axis=1) * 0.1 + rng.normal(size=(1, 400))
    near, far = Levels(np.ones(1), 0.3, LENGTH), Levels(np.full(1, 0.5), 2.0, 3 * LENGTH)
    first, *others = (
        estimate(y + size * waves.sum(axis=1), x, 7.5e-4, waves[None], start)
        for size, start in ((0, near), (10, near), (0, far))
    )
    for other in others:
        assert other.white == pytest.approx(first.white, rel=1e-8)
        assert other.sliding == pytest.approx(first.sliding, rel=1e-8)
        assert other.correlation_m == pytest.approx(first.correlation_m, rel=1e-8)


@pytest.mark.parametrize("every", [1, 2, 3])
def test_first_levels_are_those_of_white_noise_on_a_smooth_signal(every):
    """With all samples, or where no four follow one another."""
    x = np.linspace(0, 20, 20_000)
    level = np.array([[0.3], [2.0]])
    y = 50 * np.sin(x) + level * np.random.default_rng(7).normal(size=(2, 20_000))
    y = np.where(np.arange(20_000) % every == 0, y, np.nan)
    np.testing.assert_allclose(first_levels(y, 7.5e-4).white, level[:, 0], rtol=0.05)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_first_levels_of_few_samples(count):
    """On average of the noise's size, from so few."""
    y = 1 + 1e-3 * np.random.default_rng(count).normal(size=(4000, count))
    white = first_levels(y, 7.5e-4).white
    assert np.all(white > 0)
    if count > 1:
        assert 0.5e-3 < np.sqrt(np.mean(white**2)) < 2e-3


def test_white_noise_alone_leaves_no_sliding():
    y = 1e-6 * RNG.normal(size=(2, 3000))
    levels = estimate(y, np.arange(3000) * 5e-6, 7.5e-4)
    np.testing.assert_allclose(levels.white, 1e-6, rtol=0.06)
    assert levels.sliding < 0.3e-6


def test_levels_of_a_motion_that_stands_still():
    """Samples at one place share the sliding noise: what differs is white."""
    rng, step = np.random.default_rng(8), np.exp(-5e-6 / 7.5e-4)
    slow = 3e-6 * rng.normal(size=300)
    for i in range(1, 300):
        slow[i] = step * slow[i - 1] + np.sqrt(1 - step**2) * slow[i]
    x = np.repeat(np.arange(300) * 5e-6, 2)
    levels = estimate(1e-6 * rng.normal(size=(1, 600)) + np.repeat(slow, 2), x, 7.5e-4)
    assert levels.white[0] == pytest.approx(1e-6, rel=0.15)


def test_refusals():
    refused(lambda: WhitePlusOU(X, WHITE, 0.0, LENGTH), "sliding", "above 0")
    refused(lambda: WhitePlusOU(X, WHITE, 1.0, -1.0), "correlation_m", "above 0")
    refused(lambda: WhitePlusOU(X, np.zeros((2, 157)), 1.0, LENGTH), "level", "above 0")
    refused(lambda: WhitePlusOU(X, WHITE, 1.0, LENGTH).observed((3, 5)), "shape", "(3, 5)")


def test_rows_may_have_levels_and_lengths_of_their_own():
    own = WhitePlusOU(X, WHITE, np.array([0.7, 0.2]), np.array([LENGTH, 5 * LENGTH]))
    y = np.random.default_rng(3).normal(size=WHITE.shape)
    each = [
        WhitePlusOU(X, WHITE[:1], 0.7, LENGTH)(y[:1]),
        WhitePlusOU(X, WHITE[1:], 0.2, 5 * LENGTH)(y[1:]),
    ]
    np.testing.assert_allclose(own(y), np.concatenate(each), rtol=1e-12, atol=1e-12)
