"""A number beyond its bounds is refused where it is known; where jax traces it, what it enters is
NaN, and within the bounds value and gradient are as ever."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.errors import number
from srsinv.forward.amplifier import CurrentAmplifier, IntegratedCurrent
from srsinv.forward.drift import SinusoidalLoad
from srsinv.forward.film import Film
from srsinv.forward.filter import Butterworth, FirstOrder
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.noise import Johnson, SignalToNoise, Sliding, White
from srsinv.forward.oblique import turned, turned_scan
from srsinv.forward.sampling import Quantiser, Saturation
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.snap_back import SnapBackNoise
from srsinv.forward.speed_profile import RippleProfile, StandstillProfile
from srsinv.forward.surface import (
    Bump,
    Cylinder,
    Ridge,
    Ridges,
    Rough,
    SineWave,
    StepDown,
    StepUp,
    Tape,
)
from srsinv.forward.traction import Bars, FrictionStep, Hertz, PressedStrip, Sinusoid, UniformStrip
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import Open, Periodic
from tests.refusals import refused

LINE, SCAN = Periodic(32, 2e-4, -3.1e-3), ConstantSpeed(0.05)
TIME = jnp.linspace(0.0, 0.1, 32)
SIGNAL = jnp.sin(100 * TIME)[None]


def recorded(sensor: Sensor, line=LINE):
    """The sensor's signal of a smooth traction."""
    p = jnp.exp(-((LINE.x / 1e-3) ** 2))
    return sensor.operator(line, SCAN)(jnp.stack([p, 0.3 * p]))


def film_signal(film):
    return recorded(Sensor([film]))


def skin_signal(skin):
    return recorded(Sensor([Film()], skin))


def skin_displacement(skin):
    return jnp.abs(skin.compliance(LINE.k[1:]))


def amplified(amplifier):
    return recorded(Sensor([Film()], amplifier=amplifier))


def filtered(filter):
    return recorded(Sensor([Film()], filters=(filter,)))


def line_signal(line):
    return recorded(Sensor([Film()]), line)


def profile(pressure):
    return pressure.cell_average(LINE)


def height(shape):
    return shape.height(LINE)


def power(noise):
    return noise.spectrum(LINE, SCAN, jnp.asarray(0.3))


def layer(**given):
    known = {"thickness_m": 1e-3, "youngs_modulus_Pa": 7e5, "poisson_ratio": 0.4} | given
    return Layered([Layer(**known), Layer(youngs_modulus_Pa=2e5)])


def prony(fraction, time):
    return Viscoelastic(HalfSpace(), [0.5, fraction], [1e-2, time])


def snap_back(**given):
    known = {"rate_hz": 50.0, "shear_Pa": 10.0, "patch_m": 5e-4, "decay_s": 1e-2}
    sensor = Sensor([Film()])
    return SnapBackNoise.recorded_by(sensor, **(known | {"contact_m": 5e-3} | given))


class Case(NamedTuple):
    """A bounded number: `made` takes it as `key`; `signal` is what it ends in."""

    made: Callable[..., Any]
    key: str
    inside: float
    outside: float
    signal: Callable[..., Any]


SCALE = 1e-3  # m, s or any other positive number of that size
CASES = [
    *(Case(Film, key, SCALE, -SCALE, film_signal) for key in ("depth_m", "width_m", "length_m")),
    Case(HalfSpace, "poisson_ratio", 0.3, 0.51, skin_displacement),
    Case(HalfSpace, "poisson_ratio", 0.3, -0.1, skin_signal),
    Case(HalfSpace, "youngs_modulus_Pa", 1e6, -1e6, skin_displacement),
    Case(layer, "thickness_m", 2e-3, -2e-3, skin_signal),
    Case(layer, "youngs_modulus_Pa", 1e6, -1e6, skin_signal),
    Case(layer, "poisson_ratio", 0.3, 0.51, skin_signal),
    Case(partial(prony, time=1e-3), "fraction", 0.3, -0.3, skin_displacement),
    Case(partial(prony, 0.3), "time", 1e-3, 0.0, skin_displacement),
    Case(CurrentAmplifier, "feedback_resistance_ohm", 1e6, -1e6, amplified),
    Case(IntegratedCurrent, "feedback_resistance_ohm", 1e6, 0.0, amplified),
    Case(FirstOrder, "time_constant_s", SCALE, -SCALE, filtered),
    Case(FirstOrder, "time_constant_s", SCALE, -SCALE, lambda f: jnp.abs(f.response(TIME))),
    Case(FirstOrder, "time_constant_s", SCALE, -SCALE, lambda f: f.in_time(SIGNAL, TIME[1])),
    Case(Butterworth, "cutoff_hz", 200.0, -200.0, filtered),
    Case(partial(Periodic, 32), "cell_m", 2e-4, -2e-4, line_signal),
    Case(partial(Open, 32), "cell_m", 2e-4, 0.0, line_signal),
    *(
        Case(partial(PressedStrip, 1e3, position_m=0.0, **{other: SCALE}), key, SCALE, 0.0, profile)
        for key, other in (("width_m", "edge_m"), ("edge_m", "width_m"))
    ),
    Case(partial(UniformStrip, 1e3), "width_m", SCALE, -SCALE, profile),
    Case(partial(Hertz, 1e3), "half_width_m", SCALE, -SCALE, profile),
    Case(partial(Sinusoid, 1e3), "wavelength_m", 2e-3, -2e-3, profile),
    Case(partial(Bars, 1e3), "pitch_m", 2e-3, -2e-3, profile),
    Case(partial(Bars, 1e3, 2e-3), "duty", 0.3, 1.0, profile),
    Case(partial(FrictionStep, 0.1, 0.0), "edge_m", SCALE, 0.0, lambda step: step(LINE.x)),
    Case(partial(Ridge, 1e-4), "width_m", SCALE, -SCALE, height),
    Case(partial(Ridge, 1e-4, 1e-3), "edge_length_m", SCALE, -SCALE, height),
    Case(partial(Tape, 1e-4), "width_m", SCALE, -SCALE, height),
    Case(partial(StepUp, 1e-4), "edge_length_m", SCALE, -SCALE, height),
    Case(partial(StepDown, 1e-4), "edge_length_m", SCALE, -SCALE, height),
    Case(partial(Ridges, 1e-4, 5e-4), "pitch_m", 2e-3, -2e-3, height),
    Case(Cylinder, "radius_m", 1e-2, -1e-2, height),
    Case(partial(Bump, 1e-4), "sigma_m", SCALE, -SCALE, height),
    Case(partial(SineWave, 1e-4), "wavelength_m", 2e-3, 0.0, height),
    Case(partial(Rough, longest_m=2e-3, shortest_m=4e-4), "rms_m", 1e-5, -1e-5, height),
    Case(partial(Rough, 1e-5, shortest_m=4e-4), "longest_m", 2e-3, -2e-3, height),
    Case(partial(Rough, 1e-5, 2e-3), "shortest_m", 4e-4, 3e-3, height),
    Case(partial(Rough, 1e-5, 2e-3, 4e-4), "hurst", 0.5, 1.1, height),
    Case(White, "rms", SCALE, -SCALE, power),
    Case(SignalToNoise, "snr_dB", 30.0, 1e9, power),
    Case(Johnson, "temperature_K", 300.0, -4.0, power),
    Case(Sliding, "correlation_m", SCALE, -SCALE, power),
    *(
        Case(snap_back, key, SCALE, -SCALE, power)
        for key in ("rate_hz", "shear_Pa", "patch_m", "decay_s", "contact_m")
    ),
    Case(Saturation, "limit", 0.5, -0.5, lambda rail: rail.convert(SIGNAL)),
    Case(partial(Quantiser, 4), "full_scale", 0.5, -0.5, lambda bits: bits.convert(SIGNAL)),
    Case(partial(SinusoidalLoad, period_s=1.0), "fraction", 0.3, 1.1, lambda d: d.load(TIME)),
    Case(partial(SinusoidalLoad, 0.3), "period_s", 1.0, -1.0, lambda d: d.load(TIME)),
    Case(partial(RippleProfile, 0.3), "frequency_hz", 9.0, 0.0, lambda r: r.factor(TIME, jnp)),
    Case(
        partial(StandstillProfile, 0.0, 0.01), "ramp_s", 0.01, 0.0, lambda r: r.factor(TIME, jnp)
    ),
    Case(partial(turned, Sensor([Film()])), "angle_rad", 0.3, 1.6, recorded),
    Case(partial(turned_scan, SCAN), "angle_rad", 0.3, -1.6, lambda scan: scan.speed_m_per_s),
    Case(
        lambda p: SurfaceScene(p, [Ridge(1e-4, 1e-3)]), "p", 500.0, -500.0,
        lambda scene: scene.pressure(LINE),
    ),
]  # fmt: skip
NAMES = [f"{case.signal.__name__}-{case.key}-{i}" for i, case in enumerate(CASES)]
QUICK = 4  # every fourth is in `make test`
FEW = [pytest.param(i, marks=pytest.mark.full if i % QUICK else ()) for i in range(len(CASES))]
cases = pytest.mark.parametrize("i", FEW, ids=NAMES)


def end(case: Case, value):
    return case.signal(case.made(**{case.key: value}))


def like(i: int) -> dict[int, Case]:
    """The cases that are in the same tier."""
    return {j: case for j, case in enumerate(CASES) if bool(j % QUICK) == bool(i % QUICK)}


@cache
def _traced(first: int):
    group = like(first)

    @jax.jit
    def all_of(values):
        return {
            j: jax.jvp(partial(end, group[j]), (value,), (jnp.ones_like(value),))
            for j, value in values.items()
        }

    inside, outside = ({j: getattr(case, side) for j, case in group.items()} for side in SIDES)
    return jax.device_get((all_of(inside), all_of(outside)))


SIDES = ("inside", "outside")


def traced(i: int, side: str):
    """Value and derivative of where a number ends: one program for all cases of a tier, for what is
    inside and outside."""
    return _traced(min(like(i)))[SIDES.index(side)][i]


@cache
def _untraced(first: int):
    return jax.device_get(jax.jit(lambda: {j: end(c, c.inside) for j, c in like(first).items()})())


@cases
def test_traced_beyond_its_bounds_it_is_nan(i):
    value, gradient = traced(i, "outside")
    assert np.isnan(value).any()
    assert np.isnan(gradient).any()


@pytest.mark.full
@cases
def test_traced_within_them_it_is_what_it_is_untraced(i):
    ours, gradient = traced(i, "inside")
    assert np.isfinite(ours).all()
    assert np.isfinite(gradient).all()
    untraced = _untraced(min(like(i)))[i]
    np.testing.assert_allclose(ours, untraced, rtol=1e-12, atol=1e-12 * np.abs(untraced).max())


@cases
def test_known_beyond_them_it_is_refused_in_the_same_words(i):
    case = CASES[i]
    given = (case.outside, np.float64(case.outside), jnp.asarray(case.outside))
    sentences = {
        refused(partial(case.made, **{case.key: value}), f" is {case.outside!r}") for value in given
    }
    assert len(sentences) == 1


def test_value_and_gradient_within_the_bounds_are_unchanged_to_the_last_bit():
    values = jnp.asarray([1e-300, 0.1, 1 / 3, 1e300])

    def bounded(value):
        return number("it", value, above=0) ** 2

    ours, unbounded = (jax.vmap(jax.value_and_grad(f)) for f in (bounded, lambda value: value**2))
    for each, reference in zip(ours(values), unbounded(values), strict=True):
        np.testing.assert_array_equal(each, reference)


@pytest.mark.full
def test_an_array_in_place_of_one_number_is_refused():
    refused(lambda: Film(depth_m=jnp.ones(2)), "depth_m", "positive length")
