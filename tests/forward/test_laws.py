"""The laws that the paper states, one test each, and what follows from the frame's symmetry."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import TractionScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.traction import FrictionStep, PressedStrip
from srsinv.grid import Open, as_real
from tests.forward.setups import AMPLIFIERS, LINES, apply, full_sensor, largest_error
from tests.tiers import quick

BOTH = pytest.mark.parametrize("line", quick(["periodic_even", "open_even"], "open_even"))
FAST, CURRENT = 0.05, AMPLIFIERS["current"]


@eqx.filter_jit
def _everything(line, sensor, scene, scan):
    r = scene.traction(line, scan.direction)
    stages = {
        "stress": sensor.stress(),
        "charge": sensor.charge(),
        "current": sensor.current(scan),
        "signal": sensor.output(scan),
    }
    outputs = {name: line.operator(stage)(r) for name, stage in stages.items()}
    return {**outputs, "p": r[:1], "q": r[1:]}


def everything(line, scene, speed=FAST, amplifier=CURRENT, change=lambda sensor: sensor):
    """Every stage's output from the full sensor, as numpy arrays."""
    line = LINES[line] if isinstance(line, str) else line
    sensor = change(full_sensor(amplifier))
    return jax.device_get(_everything(line, sensor, scene, ConstantSpeed(speed)))


def scene(
    pressure=2e3, background=100.0, friction=0.6, step=0.2, length=1.0, mirror=1.0
) -> TractionScene:
    """A pressed strip over a step of friction; lengths scaled by `length`, x by `mirror`."""
    strip = PressedStrip(pressure, 1.5e-3 * length, 0.3e-3 * length * mirror, 0.2e-3 * length)
    # base + change/2 (1 + tanh) mirrored is (base + change) - change/2 (1 + tanh).
    base = friction if mirror > 0 else friction + step
    edge = FrictionStep(step * mirror, -0.4e-3 * length * mirror, 0.2e-3 * length)
    return TractionScene(background, base, [strip], [edge])


def sigma_z_of_line_load(depth):
    """x and sigma_z under 1 N/m on one cell, a hundredth of the depth wide."""
    line = Open(401, depth / 100, -2 * depth)
    traction = np.zeros((2, 401))
    traction[0, 200] = 100 / depth
    stress = apply(line, Sensor([Film(depth)]).stress(), jnp.asarray(traction))
    return np.asarray(line.x), np.asarray(stress[1])


@pytest.mark.parametrize("depth", [0.4e-3, 0.75e-3, 3e-3])
def test_width_of_sigma_z_is_1_287_depths(depth):
    x, sigma_z = sigma_z_of_line_load(depth)
    half_width = np.interp(sigma_z[200] / 2, sigma_z[200:], x[200:])
    assert 2 * half_width == pytest.approx(1.287 * depth, rel=5e-4)


def test_intensity_falls_as_one_over_depth():
    depths = np.array([0.4e-3, 0.75e-3, 3e-3])
    peaks = np.array([-sigma_z_of_line_load(depth)[1].min() for depth in depths])
    np.testing.assert_allclose(peaks * depths, 2 / np.pi, rtol=1e-4)


@BOTH
def test_rate_signal_grows_with_speed(line):
    slow, fast = (everything(line, scene(), speed)["signal"] for speed in (0.01, 0.1))
    assert largest_error(fast, 10 * slow) < 1e-13


@pytest.mark.full
@pytest.mark.parametrize(("amplifier", "line"), [
    ("current", "open_even"), ("integrated", "periodic_even"), ("slow", "open_even"),
])  # fmt: skip
def test_signal_grows_with_load(line, amplifier):
    light, heavy = (
        everything(line, scene(2e3 * load, 100.0 * load), amplifier=AMPLIFIERS[amplifier])
        for load in (1.0, 3.0)
    )
    assert largest_error(heavy["signal"], 3 * light["signal"]) < 1e-13


@BOTH
def test_a_static_touch_gives_nothing(line):
    still = everything(line, scene(), speed=0.0)
    np.testing.assert_array_equal(still["signal"], 0.0)
    np.testing.assert_array_equal(still["current"], 0.0)


def test_no_modulus_appears():
    """In the stress under given traction: neither the skin's, nor hidden as a length (scaling every
    length leaves the stress as it was)."""

    def stress(modulus):
        skin = HalfSpace(0.5, modulus)
        change = partial(eqx.tree_at, lambda sensor: sensor.skin, replace=skin)
        return everything(Open(64, 1e-4, -3.15e-3), scene(), change=change)["stress"]

    np.testing.assert_array_equal(stress(1e3), stress(1e9))

    def scaled(length):
        return everything(
            Open(64, 1e-4 * length, -3.15e-3 * length),
            scene(length=length),
            change=lambda sensor: eqx.tree_at(
                lambda s: [film.depth_m for film in s.elements],
                sensor,
                replace_fn=lambda depth: depth * length,
            ),
        )["stress"]

    assert largest_error(scaled(7.0), scaled(1.0)) < 1e-12


@BOTH
@pytest.mark.parametrize("ohm", [1e5, 3e6])
def test_voltage_is_resistance_times_current(line, ohm):
    both = everything(line, scene(), amplifier=CurrentAmplifier(ohm))
    assert largest_error(both["signal"], ohm * both["current"]) < 1e-13


@BOTH
def test_integrated_signal_is_the_integral_of_the_rate_signal(line):
    rate, integrated = (
        everything(line, scene(), amplifier=AMPLIFIERS[name])["signal"]
        for name in ("current", "integrated")
    )
    grown = cumulative_simpson(rate, dx=1e-4, initial=0.0)
    assert largest_error(grown, integrated - integrated[:, :1]) < 1e-3


@BOTH
@pytest.mark.parametrize("speed", [0.0, FAST])
def test_slow_readout_sees_gain_times_charge(line, speed):
    both = everything(line, scene(), speed, AMPLIFIERS["slow"])
    assert largest_error(both["signal"], 2e9 * both["charge"]) < 1e-13


def test_friction_flips_with_the_direction():
    forth, back = (everything("open_even", scene(), speed) for speed in (0.02, -0.03))
    assert forth["q"].min() > 0
    np.testing.assert_array_equal(back["p"], forth["p"])
    np.testing.assert_array_equal(back["q"], -forth["q"])


@BOTH
def test_sliding_back_reverses_time_and_parts_p_from_q(line):
    """v = u d/dx: what p gives is met in reverse order and turned over; q itself has turned over
    as well, so its share is only met in reverse order."""
    by_time = np.argsort(ConstantSpeed(-FAST).time_s(LINES[line]))
    np.testing.assert_array_equal(by_time, np.arange(64)[::-1])
    forth = everything(line, scene())["signal"]
    back = everything(line, scene(), -FAST)["signal"][:, by_time]
    from_p = everything(line, scene(friction=0.0, step=0.0))["signal"]
    from_q = forth - from_p
    assert largest_error(back, (from_q - from_p)[:, ::-1]) < 1e-12


@BOTH
@pytest.mark.parametrize("amplifier", AMPLIFIERS)
def test_the_mirrored_world_gives_the_same_signal(line, amplifier):
    """Mirror x: the surface, the speed, the elements' angles and their offsets. In time nothing
    has changed, but that integrals along x run the other way: this ties the signs of q, of the
    shear stress and of every effect together."""

    def mirrored(sensor):
        def turned(s):
            offsets = s.elements[0].effects[1].offset_m, s.elements[2].effects[0].offset_m
            return [*offsets, *(film.angle_rad for film in s.elements)]

        return eqx.tree_at(turned, sensor, replace_fn=lambda value: -value)

    readout = AMPLIFIERS[amplifier]
    ours = everything(line, scene(), FAST, readout)["signal"]
    other = everything(line, scene(mirror=-1.0), -FAST, readout, mirrored)["signal"]
    sign = -1 if amplifier == "integrated" else 1
    assert largest_error(sign * other[:, ::-1], ours) < 1e-11


@BOTH
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_sigma_y_of_plane_strain(line, nu):
    def with_nu(sensor):
        return eqx.tree_at(lambda s: s.skin.poisson_ratio, sensor, as_real(nu))

    stress = everything(line, scene(), change=with_nu)["stress"].reshape(3, 4, -1)
    sx, sz, _, sy = stress.swapaxes(0, 1)
    np.testing.assert_allclose(sy, nu * (sx + sz), atol=1e-13 * np.abs(sx + sz).max(), rtol=0)


@pytest.mark.parametrize("line", ["periodic_even", "periodic_odd"])
def test_uniform_traction_gives_no_rate_signal(line):
    """The rate signal is blind to the mean of p and of q."""
    uniform = everything(line, scene(pressure=0.0, background=2e3, step=0.0))
    assert np.ptp(uniform["q"]) == 0
    assert np.abs(uniform["charge"]).min() > 0
    textured = everything(line, scene())["signal"]
    assert np.abs(uniform["signal"]).max() < 1e-13 * np.abs(textured).max()


@pytest.mark.parametrize("angle", [0.0, np.pi / 2])
def test_only_turned_films_feel_the_shear_stress(angle):
    straight, turned = (
        np.asarray(Film(angle_rad=a).charge_per_stress()) for a in (angle, angle + 0.3)
    )
    assert abs(straight[2]) < 1e-15 * abs(straight[1])
    assert abs(turned[2]) > 0.1 * abs(straight[1])
