"""Sample conversion: what clipping and rounding do to samples, and the noise that rounding adds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.sampling import Quantiser, Saturation
from tests.refusals import refused

RAMP = jnp.linspace(-3, 3, 25)[None]


def test_clipping():
    clipping = Saturation(1.5)
    np.testing.assert_array_equal(clipping.convert(RAMP), np.clip(RAMP, -1.5, 1.5))
    expected = np.abs(RAMP) < 1.5
    assert clipping.variance() == 0
    for given in (RAMP, clipping.convert(RAMP)):
        np.testing.assert_array_equal(clipping.valid(given), expected)


def test_levels():
    """Three bits over -2 to 2: steps of a half, from -2 to 1.5, 0 among them."""
    quantisation = Quantiser(3, 2.0)
    assert quantisation.step == 0.5
    signal = jnp.linspace(-2.6, 2.6, 105)[None]
    converted = np.asarray(quantisation.convert(signal))
    np.testing.assert_array_equal(np.unique(converted), np.arange(-4, 4) / 2)
    inside = (signal >= -2) & (signal <= 1.75)
    assert np.abs(converted - signal)[inside].max() <= 0.25 + 1e-12
    valid = (converted > -2) & (converted < 1.5)
    for given in (signal, quantisation.convert(signal)):
        np.testing.assert_array_equal(quantisation.valid(given), valid)


@pytest.mark.parametrize("bits", [4, 10, 16, 24])
def test_noise_of_rounding(bits):
    """Uniform over a step: variance step^2/12 to five of its standard errors, mean 0 to five, and
    not correlated with the level."""
    quantisation, n = Quantiser(bits, 5.0), 200_000
    step = 10.0 / 2**bits
    end = 5.0 - 1.5 * step  # whole steps
    signal = np.random.default_rng(bits).uniform(-end, end, size=(1, n))
    converted = np.asarray(quantisation.convert(jnp.asarray(signal)))
    error = converted - signal
    assert float(quantisation.variance()) == pytest.approx(step**2 / 12, rel=1e-14)
    # The square of a uniform error has the variance step^4 (1/80 - 1/144).
    spread = step**2 * np.sqrt((1 / 80 - 1 / 144) / n)
    assert abs(np.mean(error**2) - quantisation.variance()) < 5 * spread
    assert abs(np.mean(error)) < 5 * step / np.sqrt(12 * n)
    assert abs(np.corrcoef(error[0], converted[0])[0, 1]) < 5 / np.sqrt(n)
    assert np.all(quantisation.valid(jnp.asarray(signal)))


CONVERSIONS = {"clipping": Saturation(1.4), "quantisation": Quantiser(5, 1.4)}


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
@pytest.mark.parametrize("name", CONVERSIONS)
def test_derivative_in_the_signal(name, mode):
    """1 within the ends and 0 beyond; of a rounded signal it is that of the one before."""
    slope = jax.jit(lambda s: mode(lambda s: CONVERSIONS[name].convert(s[None])[0])(s))(RAMP[0])
    np.testing.assert_array_equal(slope, np.diag((np.abs(RAMP[0]) < 1.4).astype(float)))


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_derivative_in_the_limit(mode):
    slope = jax.jit(mode(lambda limit: Saturation(limit).convert(RAMP)))(1.4)
    np.testing.assert_array_equal(slope, np.where(np.abs(RAMP) < 1.4, 0, np.sign(RAMP)))


def test_derivative_at_the_rail_is_that_within():
    slope = jax.grad(lambda v: Saturation(1.5).convert(v[None, None])[0, 0])
    assert slope(1.5) == slope(-1.5) == 1


@pytest.mark.parametrize("name", CONVERSIONS)
def test_single_precision(name):
    """The levels of 24 bits are whole numbers of steps in single precision too."""
    make = {"clipping": lambda: Saturation(1.4), "quantisation": lambda: Quantiser(24, 1.0)}[name]
    with jax.enable_x64(False):
        signal = jnp.asarray(np.linspace(-2, 2, 41), dtype=jnp.float32)[None]
        conversion = make()
        converted, valid = conversion.convert(signal), conversion.valid(signal)
        again = conversion.convert(converted)
    assert converted.dtype == np.float32
    np.testing.assert_array_equal(converted, again)
    inside = np.abs(np.asarray(signal)) < (1.4 if name == "clipping" else 1.0 - 2.0**-22)
    np.testing.assert_array_equal(valid, inside)
    assert np.abs(np.asarray(converted) - np.asarray(signal))[inside].max() <= 2.0**-24


REFUSED = {
    "limit": (lambda: Saturation(0.0), "limit", "0.0", "positive"),
    "endless_limit": (lambda: Saturation(np.inf), "limit", "inf", "positive"),
    "one_bit": (lambda: Quantiser(1, 5.0), "bits", "1", "2 to 24"),
    "many_bits": (lambda: Quantiser(25, 5.0), "bits", "25", "2 to 24"),
    "half_a_bit": (lambda: Quantiser(8.5, 5.0), "bits", "8.5", "2 to 24"),
    "full_scale": (lambda: Quantiser(8, -5.0), "full_scale", "-5.0", "positive"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])
