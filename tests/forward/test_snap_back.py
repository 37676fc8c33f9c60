"""Snap-back: its spectrum against closed forms, its draws event by event and in the mean."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from scipy import stats

from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier, IntegratedCurrent
from srsinv.forward.film import Film, Offset
from srsinv.forward.filter import Butterworth, FirstOrder
from srsinv.forward.noise import Johnson, Sliding, White, cross_spectrum, draw, with_noise
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.snap_back import SnapBackNoise
from srsinv.grid import Periodic
from tests.reference import closed_forms as cf
from tests.refusals import refused
from tests.tiers import quick

OHM, NU, D = 2e6, 0.45, (23e-12, 3e-12, -33e-12)
SCAN, BACKWARDS = ConstantSpeed(0.05), ConstantSpeed(-0.05)
LINE = Periodic(64, 1e-4)
DT = 2e-3
RATE, SHEAR, PATCH, CONTACT = 300.0, 1e3, 1.2e-3, 9e-3
RMS = jnp.asarray(1.0)
ELEMENTS = ((0.75e-3, 0.3, 0.0), (0.9e-3, 1.3, 1.5e-3))  # depth, angle, offset
AMPLIFIERS = {
    "current": CurrentAmplifier(OHM),
    "integrated": IntegratedCurrent(OHM),
    "slow": ChargeReadout(3e9, 0.1),
}


def sensor(amplifier="current", elements=ELEMENTS):
    films = [Film(z, angle, effects=(Offset(o),)) for z, angle, o in elements]
    return Sensor(films, HalfSpace(NU), AMPLIFIERS[amplifier])


def snap_back(decay_s=5e-3, amplifier="current", rate_hz=RATE, contact_m=CONTACT):
    return SnapBackNoise.recorded_by(sensor(amplifier), rate_hz, SHEAR, PATCH, decay_s, contact_m)


@eqx.filter_jit
def spectrum_of(noise, line, scan, rms=RMS):
    return noise.spectrum(line, scan, rms)


@eqx.filter_jit
def _drawn(noise, line, scan, keys):
    return jax.lax.map(lambda key: noise.draw(key, line, scan, RMS), keys)


def drawn(noise, scan, batches=1):
    """(draw, element, n): 250 draws in a batch, which is one program for every number of them."""
    keys = jax.random.split(jax.random.key(3), (batches, 250))
    return np.concatenate([_drawn(noise, LINE, scan, each) for each in keys])


def response(place_m, elements=ELEMENTS):
    """Charge per unit shear on patches at these places (element, place), in closed form."""

    def one(z, angle, offset):
        stress = cf.stress(cf.cauchy_strip(offset - place_m, z, PATCH), z)[:, 1]
        return 0.7e-3 * 8e-3 * cf.charge_density(stress, angle, D, NU)

    return np.stack([one(*element) for element in elements])


def mean_square(contact_m=CONTACT):
    """Of the charge of a jump: Simpson's rule over the contact, and the mean over the elements."""
    places = np.linspace(-contact_m / 2, contact_m / 2, 4001)
    weights = np.tile([4.0, 2.0], 2001)[:-1]
    weights = np.concatenate([[1.0], weights[:-2], [1.0]]) / (3 * 4000)
    return SHEAR**2 * float((response(places) ** 2 @ weights).mean())


# Spectrum


# A decay of 0.03 to 8 samples.
@pytest.mark.full
@pytest.mark.parametrize("decay", [6e-5, 1.3e-3, 16e-3])
@pytest.mark.parametrize("amplifier", AMPLIFIERS)
def test_spectrum_is_the_transform_of_the_covariance(amplifier, decay):
    """Campbell: the charge's covariance is rate E[a^2 K^2] decay/2 exp(-|t|/decay)."""
    lag = np.arange(-400, 401)

    def covariance(lag):
        return RATE * mean_square() * decay / 2 * np.exp(-np.abs(lag) * DT / decay)

    if amplifier == "current":
        ahead, behind = covariance(lag + 1), covariance(lag - 1)
        expected = (OHM / DT) ** 2 * (2 * covariance(lag) - ahead - behind)
    else:
        gain = {"integrated": 0.05 * OHM, "slow": 3e9}[amplifier]
        expected = gain**2 * covariance(lag)
    angle = 2 * np.pi * np.arange(33) / 64
    expected = np.cos(angle[:, None] * lag) @ expected
    spectrum = np.asarray(spectrum_of(snap_back(decay, amplifier), LINE, SCAN))
    np.testing.assert_allclose(spectrum, expected, rtol=1e-7, atol=1e-9 * expected.max())


def test_slow_decay_leaves_steps_white():
    """Each event is one sample of K a R_f/dt, and rate dt of them come in a sample."""
    spectrum = np.asarray(spectrum_of(snap_back(1e6), LINE, SCAN))
    assert spectrum[0] == 0
    np.testing.assert_allclose(spectrum[1:], RATE * mean_square() * OHM**2 / DT, rtol=1e-6)


def test_fast_decay_leaves_what_lasts_until_the_sample():
    """Of an event of age s a sample keeps K a exp(-s/decay), and the next one takes it back."""
    spectrum = np.asarray(spectrum_of(snap_back(DT / 50), LINE, SCAN))
    angle = 2 * np.pi * np.arange(33) / 64
    one = RATE * mean_square() * DT / 50 / 2 * (OHM / DT) ** 2
    np.testing.assert_allclose(spectrum, one * (2 - 2 * np.cos(angle)), rtol=1e-6, atol=1e-9 * one)


def test_spectrum_does_not_know_the_way():
    forwards, back = (spectrum_of(snap_back(), LINE, scan) for scan in (SCAN, BACKWARDS))
    np.testing.assert_array_equal(forwards, back)


# Draws. The bounds are those of a fair draw at one in a thousand; the keys are fixed.


@pytest.mark.full
@pytest.mark.parametrize("decay", [0.4e-3, 5e-3, 0.1])
def test_draws_have_the_spectrum_in_the_mean(decay):
    noise = snap_back(decay)
    power = np.abs(np.fft.rfft(drawn(noise, BACKWARDS, 2))) ** 2 / 64
    power = power.mean(1)[:, 1:]
    ratio = power / np.asarray(spectrum_of(noise, LINE, SCAN))[1:]
    whole = ratio.mean(1)
    assert abs(whole.mean() - 1) < 3.3 * whole.std() / np.sqrt(whole.size)
    off = (ratio.mean(0) - 1) / (ratio.std(0) / np.sqrt(whole.size))
    assert np.abs(off).max() < 4.2  # of 32
    assert stats.chi2(32).ppf(0.0005) < np.sum(off**2) < stats.chi2(32).ppf(0.9995)


@pytest.mark.parametrize("scan", quick([SCAN, BACKWARDS], SCAN), ids=["forwards", "backwards"])
def test_charge_relaxes_between_events(scan):
    """In time, Q falls by exp(-dt/decay) from sample to sample unless an event comes between,
    which happens to a share 1 - exp(-rate dt) of them."""
    charge = drawn(snap_back(5e-3, "slow"), scan)
    charge = charge if scan is SCAN else charge[..., ::-1]
    jumps = charge - np.exp(-DT / 5e-3) * np.roll(charge, 1, axis=-1)
    quiet = np.abs(jumps) < 1e-12 * np.abs(charge).max()
    np.testing.assert_array_equal(quiet[:, 0], quiet[:, 1])  # both feel the same events
    count, expected = quiet[:, 0].size, np.exp(-RATE * DT)
    test = stats.binomtest(int(quiet[:, 0].sum()), count, expected)
    assert test.pvalue > 1e-3


def jumps_of(noise):
    """What the first element's charge does between samples beside its decay (draw, sample)."""
    charge = drawn(noise, SCAN, 4)[:, 0] / 3e9
    jumps = charge - np.exp(-DT / float(noise.decay_s)) * np.roll(charge, 1, axis=-1)
    return np.where(np.abs(jumps) > 1e-12 * np.abs(charge).max(), jumps, 0.0)


@pytest.mark.claim
def test_number_of_events_is_that_of_poisson():
    """The samples with an event are as dispersed as if each were alone in the world."""
    counts = (jumps_of(snap_back(5e-3, "slow", rate_hz=20.0)) != 0).sum(1)
    probability = 1 - np.exp(-20 * DT)
    spread = ((counts - 64 * probability) ** 2).sum() / (64 * probability * (1 - probability))
    assert stats.chi2(counts.size).ppf(0.0005) < spread < stats.chi2(counts.size).ppf(0.9995)


@pytest.mark.claim
def test_amplitudes_are_gaussian():
    """At one place, hardly decayed when sampled and hardly ever two in a sample."""
    jumps = jumps_of(snap_back(1.0, "slow", rate_hz=8.0, contact_m=1e-12))
    amplitudes = jumps[jumps != 0] / (SHEAR * response(np.zeros(1))[0, 0])
    assert amplitudes.size > 700
    assert stats.kstest(amplitudes, "norm").pvalue > 1e-3


@pytest.mark.full
def test_more_events_than_a_block_holds():
    """Mean power of 1300 events in a draw."""
    noise = snap_back(1e-3, rate_hz=1e4)
    signal = drawn(noise, SCAN)
    power = (signal**2).mean((1, 2))
    spectrum = np.asarray(spectrum_of(noise, LINE, SCAN))
    expected = (2 * spectrum.sum() - spectrum[0] - spectrum[-1]) / 64
    assert abs(power.mean() - expected) < 3.3 * power.std() / np.sqrt(power.size)


@pytest.mark.parametrize(("depths", "error"), [(1e-6, 1e-12), (12, 1e-12), (50, 1e-8)])
def test_the_polynomials_are_the_response(depths, error):
    """At places all over a contact this long in depths of the shallower film."""
    contact = depths * ELEMENTS[0][0]
    coefficients = np.asarray(
        eqx.filter_jit(SnapBackNoise._over_contact)(snap_back(contact_m=contact))
    )
    at = np.linspace(-1, 1, 201)
    expected = response(contact / 2 * at)
    values = np.polynomial.chebyshev.chebval(at, coefficients.T)
    assert np.abs(values - expected).max() < error * np.abs(expected).max()


@pytest.mark.full
def test_rate_signal_is_the_difference_of_the_same_charge():
    rate = drawn(snap_back(), SCAN)
    charge = drawn(snap_back(amplifier="slow"), SCAN) / 3e9
    expected = OHM * (charge - np.roll(charge, 1, axis=-1)) / DT
    np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-13 * np.abs(rate).max())


def test_elements_share_events_in_the_measure_of_their_cross_spectrum():
    """Over the wavenumbers it is the mean product of two elements' draws."""
    matrix = np.asarray(cross_spectrum((snap_back(),), LINE, SCAN, RMS, elements=2))
    signals = drawn(snap_back(), SCAN)
    each = np.einsum("den,dfn->def", signals, signals)
    expected = np.fft.irfft(matrix, LINE.n)[..., 0] * LINE.n
    off = (each.mean(0) - expected) / (each.std(0) / np.sqrt(len(each)))
    assert np.abs(off).max() < 3.5
    mean = np.einsum("eek->k", matrix) / 2
    np.testing.assert_allclose(spectrum_of(snap_back(), LINE, SCAN), mean, rtol=1e-12)


def test_events_are_felt_by_every_element_in_its_measure():
    """On a patch that has but one place, the elements' signals are in one ratio."""
    signal = drawn(snap_back(contact_m=1e-12), SCAN)
    (first,), (second,) = response(np.zeros(1))
    np.testing.assert_allclose(signal[:, 1] * first, signal[:, 0] * second, rtol=1e-7, atol=1e-22)
    assert np.abs(signal).max() > 0


@pytest.mark.full
def test_elements_may_come_in_any_order():
    turned = SnapBackNoise.recorded_by(
        sensor(elements=ELEMENTS[::-1]), RATE, SHEAR, PATCH, 5e-3, CONTACT
    )
    ours, other = drawn(snap_back(), SCAN), drawn(turned, SCAN)
    np.testing.assert_allclose(other, ours[:, ::-1], rtol=1e-12, atol=1e-14 * np.abs(ours).max())


@pytest.mark.full
def test_the_key_decides_every_byte():
    first, again = drawn(snap_back(), SCAN), drawn(snap_back(), SCAN)
    assert first.tobytes() == again.tobytes()
    assert np.abs(first[0] - first[1]).max() > 0


SILENT = {
    "no_events": (snap_back(rate_hz=0.0), SCAN),
    "no_contact": (snap_back(contact_m=0.0), SCAN),
    "at_rest": (snap_back(), ConstantSpeed(0.0)),
    "charge_at_rest": (snap_back(amplifier="slow"), ConstantSpeed(0.0)),
}


@pytest.mark.parametrize("name", SILENT)
def test_silence(name):
    noise, scan = SILENT[name]
    np.testing.assert_array_equal(spectrum_of(noise, LINE, scan), 0.0)
    np.testing.assert_array_equal(drawn(noise, scan), 0.0)


# Behind filters

FILTERS = (FirstOrder(4e-3), Butterworth(90.0, 3))
FILTERED = Sensor(sensor().elements, HalfSpace(NU), AMPLIFIERS["current"], FILTERS)
BEHIND = SnapBackNoise.recorded_by(FILTERED, RATE, SHEAR, PATCH, 5e-3, CONTACT)


def test_spectrum_passes_the_filters():
    """Their power response in closed form, at the frequencies of samples every 2 ms."""
    omega = 2 * np.pi * np.arange(33) / (64 * DT)
    power = 1 / (1 + (4e-3 * omega) ** 2) / (1 + (omega / (2 * np.pi * 90)) ** 6)
    expected = np.asarray(spectrum_of(snap_back(), LINE, SCAN)) * power
    spectrum = np.asarray(spectrum_of(BEHIND, LINE, SCAN))
    np.testing.assert_allclose(spectrum, expected, rtol=1e-12, atol=0)


@pytest.mark.full
def test_draws_come_later_in_time():
    """Along x the filtered draw is scipy's response times the same draw without filters, its phase
    turned where the finger slides backwards."""
    scan = BACKWARDS
    omega = 2 * np.pi * np.arange(33) / (64 * DT) * np.sign(float(scan.speed_m_per_s))
    response = 1 / (1 + 4e-3j * omega)
    response *= scipy.signal.freqs(*scipy.signal.butter(3, 2 * np.pi * 90, analog=True), omega)[1]
    response[-1] = response[-1].real
    unfiltered = np.fft.rfft(drawn(snap_back(), scan))
    expected = np.fft.irfft(unfiltered * response, 64)
    filtered = drawn(BEHIND, scan)
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-12 * np.abs(filtered).max())


# Together with the other causes

GAUSSIAN = (White(3e-6), Johnson(), Sliding(0.2, 0.6e-3))


KEY = jax.random.key(11)


@pytest.fixture(scope="module")
def alone():
    """A signal, and what with_noise makes of it and the Gaussian causes."""
    signal = 1e-5 * jnp.sin(jnp.arange(128.0).reshape(2, 64))
    return signal, with_noise(GAUSSIAN, LINE, SCAN, signal, KEY)


def test_gaussian_causes_are_drawn_together(alone):
    """From their summed spectrum, with the key itself: as they are without causes of events."""
    signal, (noisy, spectrum, rms) = alone
    expected = np.sum([spectrum_of(noise, LINE, SCAN, rms) for noise in GAUSSIAN], axis=0)
    np.testing.assert_allclose(spectrum, expected, rtol=1e-14)
    np.testing.assert_allclose(noisy - signal, draw(KEY, spectrum, 2, 64), rtol=0, atol=1e-20)


@pytest.mark.full
def test_events_come_on_top(alone):
    """Wherever they are named, and two causes of them apart from each other."""
    signal, (gaussian, power, _) = alone
    first, second = snap_back(), snap_back(1e-3, rate_hz=900.0)
    causes = (first, *GAUSSIAN[:2], second, GAUSSIAN[2])
    noisy, spectrum, _ = with_noise(causes, LINE, SCAN, signal, KEY)
    keys = jnp.stack([jax.random.fold_in(KEY, at) for at in range(2)])
    keys = jnp.concatenate([keys] * 125)
    own = [_drawn(cause, LINE, SCAN, keys)[at] for at, cause in enumerate((first, second))]
    np.testing.assert_allclose(noisy - gaussian, own[0] + own[1], rtol=0, atol=1e-18)
    expected = power + sum(spectrum_of(cause, LINE, SCAN) for cause in (first, second))
    np.testing.assert_allclose(spectrum, expected, rtol=1e-12)


# Gradients, precision, refusals

VALUES = {"shear_Pa": SHEAR, "decay_s": 5e-3, "patch_m": PATCH, "contact_m": CONTACT}


def spectrum_total(values):
    noise = SnapBackNoise.recorded_by(sensor(), RATE, *(values[i] for i in (0, 2, 1, 3)))
    weights = jnp.cos(jnp.arange(33.0))
    return jnp.sum(weights * noise.spectrum(LINE, SCAN, RMS))


TOTAL, REVERSE = jax.jit(spectrum_total), jax.jit(jax.grad(spectrum_total))
FORWARD = jax.jit(lambda values, way: jax.jvp(spectrum_total, (values,), (way,))[1])


@pytest.mark.full
@pytest.mark.parametrize("name", VALUES)
def test_gradients_are_those_of_differences(name):
    values, at = jnp.asarray(list(VALUES.values())), list(VALUES).index(name)
    step = jnp.zeros(4).at[at].set(1e-5 * VALUES[name])
    expected = float(TOTAL(values + step) - TOTAL(values - step)) / 2e-5
    assert float(FORWARD(values, step * 1e5)) == pytest.approx(expected, rel=1e-7)
    assert float(REVERSE(values)[at]) * VALUES[name] == pytest.approx(expected, rel=1e-7)


def test_at_rest_derivatives_are_nothing():
    """And are there, though no interval between samples is."""

    def total(values):
        noise = eqx.tree_at(lambda n: n.decay_s, snap_back(), values[0])
        return jnp.sum(noise.spectrum(LINE, ConstantSpeed(values[1]), RMS))

    np.testing.assert_array_equal(jax.jit(jax.grad(total))(jnp.array([5e-3, 0.0])), 0.0)


@pytest.mark.full
def test_single_precision():
    double = np.asarray(spectrum_of(snap_back(), LINE, SCAN))
    with jax.enable_x64(False):
        device = Sensor(sensor().elements, HalfSpace(NU), CurrentAmplifier(OHM))
        noise = jax.tree.map(
            lambda leaf: leaf.astype("float32"),
            SnapBackNoise.recorded_by(device, RATE, SHEAR, PATCH, 5e-3, CONTACT),
        )
        line, scan = Periodic(64, 1e-4), ConstantSpeed(0.05)
        single = spectrum_of(noise, line, scan)
        signal = _drawn(noise, line, scan, jax.random.split(jax.random.key(1), 250))
    assert single.dtype == signal.dtype == np.float32
    assert np.abs(np.asarray(single) - double).max() < 64 * np.finfo(np.float32).eps * double.max()
    power = (np.asarray(signal, float) ** 2).mean((1, 2))
    expected = (2 * double.sum() - double[0] - double[-1]) / 64
    assert abs(power.mean() - expected) < 3.3 * power.std() / np.sqrt(power.size)


def with_value(**changed):
    values = {"rate_hz": 1.0, "shear_Pa": 1.0, "patch_m": 1e-3, "decay_s": 1.0, "contact_m": 1e-3}
    return lambda: SnapBackNoise.recorded_by(sensor(), **(values | changed))


REFUSED = {
    "rate": (with_value(rate_hz=-1.0), "rate_hz", "-1.0", "from 0"),
    "too_often": (with_value(rate_hz=2e6), "rate_hz", "2000000.0", "1e+06"),
    "shear": (with_value(shear_Pa=np.nan), "shear_Pa", "nan", "at least 0"),
    "patch": (with_value(patch_m=0.0), "patch_m", "0.0", "positive"),
    "decay": (with_value(decay_s=0.0), "decay_s", "0.0", "positive"),
    "contact": (with_value(contact_m=-1e-3), "contact_m", "-0.001", "at least 0"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])
