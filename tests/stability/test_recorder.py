"""What happens to samples, as hard as it gets: rails and few or many bits, fast and slow drift, and
bursts that last for ever or not at all."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.drift import SinusoidalLoad
from srsinv.forward.film import Film
from srsinv.forward.sampling import Quantiser, Saturation
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.snap_back import SnapBackNoise
from srsinv.grid import Periodic
from tests.stability.matrix import PRECISIONS, Group, HardCase

EACH = np.array([float(np.finfo(precision).eps) for precision in PRECISIONS])
BITS = 2, 12, 24
# In rails: far within, at steps, at halves of the coarsest step, at the rails, and far beyond.
RAILS = (0.0, -0.0, 1e-30, 1e-9, 0.1, -0.3, 0.4375, 0.625, -0.6875, 0.999, -1.0, 1.0, 1e3, -1e12)


def converted(v):
    """Clipped, and clipped and rounded to 2, 12 and 24 bits, in rails."""
    signal, rail = v["signal"][None], v["rail"]
    rounded = [Quantiser(bits, rail).convert(signal) for bits in BITS]
    return jnp.concatenate([Saturation(rail).convert(signal), *rounded]) / rail


def converted_reference(v):
    fraction = np.asarray(v["signal"], np.longdouble) / np.longdouble(v["rail"])
    rows = [np.clip(fraction, -1, 1)]
    for bits in BITS:
        half = np.longdouble(2) ** (bits - 1)
        rows.append(np.rint(np.clip(fraction * half, -half, half - 1)) / half)
    return np.array(rows, float)


def signal_in(rail, name, hard):
    # A quotient at 24 bits is rounded to half a level in float32: it may come out the next one.
    bounds = (16 * EACH[0], 2.0**-23 + 4 * EACH[1])
    return HardCase(name, hard, {"signal": rail * np.array(RAILS), "rail": rail}, bounds)


def drifting(v):
    """1 + d, and its rate over the fastest."""
    drift = SinusoidalLoad(v["fraction"], v["period_s"], v["phase_rad"])
    rate = drift.load_rate(v["time_s"]) * (v["period_s"] / (2 * np.pi))
    return jnp.stack([drift.load(v["time_s"]), rate])


def drifting_reference(v):
    turn = np.asarray(v["time_s"], np.longdouble) / np.longdouble(v["period_s"])
    angle = 2 * np.arccos(np.longdouble(-1)) * (turn - np.rint(turn)) + v["phase_rad"]
    return np.array([1 + v["fraction"] * np.sin(angle), v["fraction"] * np.cos(angle)], float)


def drift(name, hard, period, end=1.0, fraction=1.0):
    numbers = {
        "time_s": np.linspace(0, end, 33),
        "period_s": period,
        "phase_rad": 0.3,
        "fraction": fraction,
    }
    # A round-off of a time is one of the angle that it makes.
    return HardCase(name, hard, numbers, tuple(EACH * (8 + 4 * 2 * np.pi * end / period)))


# The bursts' spectrum over that of bursts that last a sample: only the decay is left.
DT_S, CELLS, CELL_M, SPEED_M_PER_S = 2e-3, 32, 1e-4, 0.05


def bursts(rate_hz, decay_s, contact_m, patch_m=1.2e-3):
    sensor = Sensor([Film(7.5e-4, 0.3)], HalfSpace(0.45), CurrentAmplifier(2e6))
    return SnapBackNoise.recorded_by(sensor, rate_hz, 1e3, patch_m, decay_s, contact_m)


def spectrum(rate_hz, decay_s, contact_m):
    line, scan = Periodic(CELLS, CELL_M), ConstantSpeed(SPEED_M_PER_S)
    power = bursts(rate_hz, decay_s, contact_m).spectrum(line, scan, jnp.ones(()))
    return power[1:]  # the mean of a rate is nothing


def relaxing(v):
    usual = spectrum(v["rate_hz"], jnp.asarray(DT_S), v["contact_m"])
    power = spectrum(v["rate_hz"], v["decay_s"], v["contact_m"])
    return power / jax.lax.stop_gradient(usual) / v["size"]


def relaxing_reference(v):
    angle = 2 * np.arccos(np.longdouble(-1)) * np.arange(1, CELLS // 2 + 1) / CELLS

    def power(decay):
        a = np.exp(-np.longdouble(DT_S) / decay)
        square = -np.expm1(-2 * np.longdouble(DT_S) / decay)
        return decay * square / ((1 - a) ** 2 + 4 * a * np.sin(angle / 2) ** 2)

    usual = power(np.longdouble(DT_S))
    return np.array(power(np.longdouble(v["decay_s"])) / usual / v["size"], float)


def decay(name, hard, decay_s, rate=300.0, contact=9e-3):
    numbers = {"rate_hz": rate, "decay_s": decay_s, "contact_m": contact, "size": min(decay_s, 1.0)}
    return HardCase(name, hard, numbers, tuple(64 * EACH))


GROUPS = (
    Group(
        "converter",
        converted,
        converted_reference,
        (
            signal_in(1.0, "unit", "from nothing to a million million rails"),
            signal_in(1e-12, "picovolt", "rails of 1e-12"),
            signal_in(1e6, "megavolt", "rails of 1e6"),
        ),
    ),
    Group(
        "drift",
        drifting,
        drifting_reference,
        (
            drift("fast", "a period of 1e-6 s", 1e-6, end=1e-4),
            drift("slow", "a period of 1e6 s", 1e6),
            drift("for ever", "a period of 1e15 s", 1e15),
            drift("none", "of fraction 0", 1.0, fraction=0.0),
            drift("tiny", "of fraction 1e-12", 1.0, fraction=1e-12),
        ),
        frozenset(("time_s",)),
    ),
    Group(
        "bursts",
        relaxing,
        relaxing_reference,
        (
            decay("lasting", "for 1e9 s", 1e9),
            decay("long", "for 1e3 s", 1e3),
            decay("short", "gone after 1e-4 s", 1e-4),
            decay("many", "a million a second", 1e-2, rate=1e6),
            decay("wide", "on 200 depths of contact", 1e-2, contact=0.15),
            decay("narrow", "on a nanometre of contact", 1e-2, contact=1e-9),
        ),
        frozenset(("size",)),
    ),
)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound


@pytest.mark.parametrize("bits", [0, 1, 25, 64, 12.5])
def test_bits_that_cannot_be_are_refused(bits):
    with pytest.raises(BadInput, match="a whole number from 2 to 24"):
        Quantiser(bits, 1.0)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("bits", [2, 24])
def test_what_is_converted_says_itself_whether_it_is_kept(bits, precision):
    """The ends may be anything beyond, and are told as such after conversion too."""
    with jax.enable_x64(precision == "float64"):
        device = Quantiser(bits, 1.0)
        signal = jnp.asarray([[0.0, -1e30, 1e30, -1.0, 1.0, -0.5 + 2.0**-23]], precision)
        before, after = device.valid(signal), device.valid(device.convert(signal))
        assert np.array_equal(np.asarray(before), np.asarray(after))
        inside = [True, False, False, False, False, True]
        assert np.array_equal(np.asarray(before)[0], inside)


@jax.jit
def drawn(noise):
    line, scan = Periodic(CELLS, CELL_M), ConstantSpeed(SPEED_M_PER_S)
    signal = noise.draw(jax.random.key(0), line, scan, jnp.ones(()))
    return signal, noise.spectrum(line, scan, jnp.ones(()))


# Rate, decay, contact and patch, and whether anything is felt.
DRAWS = {
    "no events": ((0.0, 5e-3, 9e-3, 1.2e-3), False),
    "no contact": ((3e3, 5e-3, 0.0, 1.2e-3), False),
    "lasting": ((3e3, 1e9, 9e-3, 1.2e-3), True),
    "gone at once": ((3e3, 1e-12, 9e-3, 1.2e-3), False),
    "a million a second": ((1e6, 5e-3, 9e-3, 1.2e-3), True),
    "wide": ((3e4, 5e-3, 0.15, 1.2e-3), True),
    "narrow": ((3e3, 5e-3, 1e-9, 1.2e-3), True),
    "points": ((3e3, 5e-3, 9e-3, 1e-12), True),
}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", DRAWS)
def test_draws_stay_finite(name, precision):
    """Nothing where nothing is felt; else of the size that the spectrum says, within a factor."""
    (rate, decay_s, contact, patch), has_signal = DRAWS[name]
    with jax.enable_x64(precision == "float64"):
        arrays = drawn(bursts(rate, decay_s, contact, patch))
        signal, power = (np.asarray(each, float) for each in arrays)
    assert np.all(np.isfinite(signal))
    assert np.all(np.isfinite(power))
    if not has_signal:
        assert not signal.any()
        return
    expected = np.sqrt((power[0] + power[-1] + 2 * np.sum(power[1:-1])) / CELLS)
    assert 0.2 < np.sqrt(np.mean(signal**2)) / expected < 5


# Where nothing can be told: name, reason, and from how many depths of contact on.
LIMITS = (("wide contact", "the rules over the contact miss what a shallow film feels", 200),)


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit[0])
def test_limits_are_refused(limit):
    with pytest.raises(BadInput, match=r"give at most 0\.15 m, 200 times"):
        bursts(3e3, 5e-3, 7.5e-4 * limit[-1] * 1.01)
