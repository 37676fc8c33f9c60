"""Standard errors against the spread over draws of the noise, and how often they cover."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.inverse.nonlinear import Cauchy, Huber, SoftL1, Spectrum

DRAWS = 500
X = np.linspace(0, 1, 50)
TRUTH = {"a": 3.0, "k": 2.0, "c": 1.0}
START = {"a": 1.0, "k": 1.0, "c": 0.0}
NEAR = {"a": 2.5, "k": 1.5, "c": 0.5}
RMS = 0.02
POWER = RMS**2 * 8 / (1 + (np.arange(26) / 3) ** 2)


def model(p):
    return p["a"] * jnp.exp(-p["k"] * X) + p["c"]


def matrix(power):
    row = np.fft.irfft(power, 50)
    return np.stack([np.roll(row, j) for j in range(50)])


def draws(covariance, count=DRAWS):
    rng = np.random.default_rng(11)
    return (
        np.asarray(model(TRUTH)) + rng.normal(size=(count, 50)) @ np.linalg.cholesky(covariance).T
    )


def columns(fits, what):
    return np.array([[getattr(f, what)[name] for name in TRUTH] for f in fits])


NOISES = {
    "white": (RMS, RMS**2 * np.eye(50)),
    "unknown_level": (None, RMS**2 * np.eye(50)),
    "spectrum": (Spectrum(POWER), matrix(POWER)),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("white", marks=pytest.mark.claim),
        *(pytest.param(each, marks=pytest.mark.full) for each in ("unknown_level", "spectrum")),
    ],
)
def test_spread(name):
    noise, covariance = NOISES[name]
    ys, linear = draws(covariance), ("a", "c")
    fits = srsinv.fit_many(model, START, ys, noise=noise, linear=linear)
    assert all(f.converged for f in fits)
    value, stderr = columns(fits, "value"), columns(fits, "stderr")
    truth = np.array(list(TRUTH.values()))
    np.testing.assert_allclose(stderr.mean(axis=0), value.std(axis=0), rtol=0.1)
    covered = np.mean(np.abs(value - truth) <= 1.6449 * stderr, axis=0)
    assert (np.abs(covered - 0.9) < 0.04).all()
    one = srsinv.fit(model, START, ys[-1], noise=noise, linear=linear)
    np.testing.assert_allclose(columns(fits[-1:], "value"), columns([one], "value"), rtol=1e-8)
    np.testing.assert_allclose(fits[-1].covariance, one.covariance, rtol=1e-7)
    np.testing.assert_allclose(fits[-1].residual, one.residual, atol=1e-9)
    chi2 = np.mean([f.stats["chi2_per_freedom"] for f in fits])
    np.testing.assert_allclose(chi2, 1.0 if noise is not None else RMS**2, rtol=0.02)


@pytest.mark.full
def test_solved_out_is_searched():
    """Variable projection changes how the minimum is found, not what it is."""
    y = draws(NOISES["white"][1], 1)[0]
    whole = srsinv.fit(model, START, y)
    split = srsinv.fit(model, START, y, linear=("a", "c"))
    assert split.stats["iterations"] < whole.stats["iterations"]
    for name in TRUTH:
        np.testing.assert_allclose(split.value[name], whole.value[name], rtol=1e-8)
    np.testing.assert_allclose(split.covariance, whole.covariance, rtol=1e-8)


# --- robust losses -----------------------------------------------------------------------------

LOSSES = (Huber(), SoftL1(), Cauchy())


def with_outliers(count):
    """A tenth of the data off by up to 40 standard deviations, either way."""
    rng = np.random.default_rng(7)
    y = draws(NOISES["white"][1], count)
    return y + np.where(rng.random(y.shape) < 0.1, rng.uniform(-40, 40, y.shape) * RMS, 0.0)


@pytest.mark.full
@pytest.mark.parametrize(
    ("loss", "noise"),
    [
        (Huber(), RMS),
        (Cauchy(), RMS),
        (Huber(), None),
        pytest.param(SoftL1(), RMS, marks=pytest.mark.claim),
    ],
    ids=str,
)
def test_outliers(loss, noise):
    fits = [srsinv.fit(model, NEAR, y, noise=noise, loss=loss) for y in with_outliers(120)]
    assert all(f.converged for f in fits)
    value, stderr = columns(fits, "value"), columns(fits, "stderr")
    # 120 draws know a spread to 6.5 %; the asymptotic form has to hold to 15 %.
    np.testing.assert_allclose(stderr.mean(axis=0), value.std(axis=0), rtol=0.15)
    if noise is None:
        level = np.median([f.noise_rms for f in fits])
        assert RMS < level < 1.3 * RMS


@pytest.mark.full
def test_robust_is_better_than_squares():
    ys = with_outliers(40)
    squares = columns([srsinv.fit(model, NEAR, y) for y in ys], "value").std(axis=0)
    huber = columns([srsinv.fit(model, NEAR, y, loss="huber") for y in ys], "value").std(axis=0)
    assert (huber < 0.5 * squares).all()


@pytest.mark.full
@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)
def test_root(loss):
    """t^2/2 is the loss, of the sign of r, r itself near zero, and smooth at the threshold."""
    d = loss.threshold
    r = np.concatenate([np.linspace(-9, 9, 181), [0.0, 1e-9, d, d * (1 + 1e-12), -d]])
    rho = {
        Huber: np.where(np.abs(r) <= d, r**2 / 2, d * np.abs(r) - d**2 / 2),
        SoftL1: d**2 * (np.sqrt(1 + (r / d) ** 2) - 1),
        Cauchy: d**2 / 2 * np.log1p((r / d) ** 2),
    }[type(loss)]
    root, influence = jax.jit(lambda r: loss.root(r)), jax.jit(lambda r: loss.influence(r))
    t = np.asarray(root(r))
    np.testing.assert_allclose(t**2 / 2, rho, rtol=1e-9, atol=1e-16)
    np.testing.assert_array_equal(np.sign(t), np.sign(r))
    slope, bend = map(np.asarray, influence(r))
    h = 1e-6
    numeric = np.diff([np.asarray(root(r + s)) ** 2 / 2 for s in (-h, h)], axis=0)
    np.testing.assert_allclose(slope, numeric[0] / (2 * h), atol=1e-6)
    inside = np.abs(r) < 1e-6
    np.testing.assert_allclose(bend[inside], 1.0, rtol=1e-9)
    if isinstance(loss, Huber):
        np.testing.assert_array_equal(t[np.abs(r) <= d], r[np.abs(r) <= d])
    across = np.asarray(influence(np.where(r < 0, d * (1 - 1e-9), d * (1 + 1e-9)))[0])
    np.testing.assert_allclose(across[0], across[-2], rtol=1e-8)
