"""Oblique features and the circle against the straight model and point loads on a half space."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier
from srsinv.forward.film import Film, LineEffect, Offset, SampleAverage, StripAverage
from srsinv.forward.filter import FirstOrder
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.oblique import turned, turned_scan
from srsinv.forward.planar import Circle, ObliqueRidge, PathScan
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.turned_skin import TurnedSkin
from srsinv.grid import Open, Periodic, as_real
from tests.forward.setups import LINES, SCAN, apply, derivatives, full_sensor, largest_error
from tests.refusals import refused
from tests.tiers import quick, rare

DEPTH = 0.75e-3
RANDOM = jnp.asarray(np.random.default_rng(5).normal(size=(2, 64)))


def per_line(name):
    return RANDOM[:, : LINES[name].n]


@eqx.filter_jit
def stress(skin, x, width):
    """Response and slope (2, 4, 2, x) of a strip."""
    place = x, jnp.asarray(DEPTH), width
    return jnp.stack([skin.strip_response(*place), skin.strip_slope(*place)])


def oblique(angle, line, sensor, r):
    scan = turned_scan(ConstantSpeed(0.05), angle)
    return apply(line, turned(sensor, angle).output(scan), r)


@pytest.mark.full
@pytest.mark.parametrize("name", ["periodic_even", "open_odd"])
def test_straight_features_are_the_straight_model(name):
    """Every element and effect, on every line."""
    sensor, r = full_sensor(CurrentAmplifier()), per_line(name)
    straight = apply(LINES[name], sensor.output(SCAN), r)
    assert largest_error(oblique(0.0, LINES[name], sensor, r), straight) < 1e-12


@pytest.mark.parametrize("angle", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("name", quick(["periodic_even", "open_odd"], "periodic_even"))
def test_sliding_along_the_features_is_silent(name, angle):
    assert not np.any(oblique(angle, LINES[name], full_sensor(), per_line(name)))
    motion = Motion.from_speed(np.linspace(0, 1, 9), 0.05)
    along = turned_scan(motion, angle)
    assert not np.any(along.position_m)
    assert not np.any(along.speed_m_per_s)


def test_scan_along_the_normal():
    """Friction keeps its sign up to a quarter turn."""
    motion = Motion.from_speed(np.linspace(0, 1, 9), np.linspace(0.05, -0.04, 9))
    across = turned_scan(motion, 1.2)
    np.testing.assert_allclose(across.position_m, np.cos(1.2) * motion.position_m, rtol=1e-14)
    np.testing.assert_allclose(across.speed_m_per_s, np.cos(1.2) * motion.speed_m_per_s, rtol=1e-14)
    np.testing.assert_array_equal(across.direction, motion.direction)
    assert turned_scan(ConstantSpeed(-0.05), -1.5).direction == -1


# --- a half space in three dimensions --------------------------------------------------------


def point_load(x, y, z, along):
    """Stress (3, 3, ...) under a unit force on a half space's surface, nu = 0.4, along x or z.

    Boussinesq and Cerruti (Johnson 1985, 3.2 and 3.6), tension positive, z into the solid.
    """
    nu, r = 0.4, np.sqrt(x**2 + y**2 + z**2)
    g = r + z
    if along == "z":
        radial = 1 / (r * g)
        sxx = 3 * x**2 * z / r**5
        sxx = sxx - (1 - 2 * nu) * (z / r**3 - radial + x**2 * (2 * r + z) / (r**3 * g**2))
        syy = 3 * y**2 * z / r**5
        syy = syy - (1 - 2 * nu) * (z / r**3 - radial + y**2 * (2 * r + z) / (r**3 * g**2))
        sxy = 3 * x * y * z / r**5 - (1 - 2 * nu) * x * y * (2 * r + z) / (r**3 * g**2)
        rest = 3 * z**3 / r**5, 3 * x * z**2 / r**5, 3 * y * z**2 / r**5
    else:
        a = 1 / (r * g**2)
        sxx = 3 * x**3 / r**5 - (1 - 2 * nu) * (
            x / r**3 - 3 * x * a + x**3 / (r**3 * g**2) + 2 * x**3 / (r**2 * g**3)
        )
        syy = 3 * x * y**2 / r**5 - (1 - 2 * nu) * (
            x / r**3 - x * a + x * y**2 / (r**3 * g**2) + 2 * x * y**2 / (r**2 * g**3)
        )
        sxy = 3 * x**2 * y / r**5 - (1 - 2 * nu) * (
            -y * a + x**2 * y / (r**3 * g**2) + 2 * x**2 * y / (r**2 * g**3)
        )
        rest = 3 * x * z**2 / r**5, 3 * x**2 * z / r**5, 3 * x * y * z / r**5
    szz, sxz, syz = rest
    return -np.array([[sxx, sxy, sxz], [sxy, syy, syz], [sxz, syz, szz]]) / (2 * np.pi)


def line_of_points(xi, angle, along):
    """(sigma_x, sigma_z, tau_xz, sigma_y) in the sensor's frame at (xi, DEPTH) under unit point
    loads along the whole line of features: the substitution eta = D tan b makes it finite."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    bend, reach = nodes * np.pi / 2, np.hypot(xi, DEPTH)[:, None]
    eta, weight = reach * np.tan(bend), reach * weights * np.pi / 2 / np.cos(bend) ** 2
    x = np.cos(angle) * xi[:, None] - np.sin(angle) * eta
    y = np.sin(angle) * xi[:, None] + np.cos(angle) * eta
    total = np.sum(weight * point_load(x, y, DEPTH, along), axis=-1)
    return total[0, 0], total[2, 2], total[0, 2], total[1, 1]


@pytest.mark.parametrize("angle", [0.6, -1.1])
def test_stress_of_point_loads_along_an_oblique_line(angle):
    """Unlike the model, the reference knows the third dimension and turns nothing."""
    xi = np.linspace(-3e-3, 3e-3, 13)
    reference = np.array([line_of_points(xi, angle, along) for along in "zx"]).swapaxes(0, 1)
    width = 1e-6 * DEPTH
    ours = stress(TurnedSkin(HalfSpace(0.4), angle), jnp.asarray(xi), jnp.asarray(width))[0] / width
    assert largest_error(ours, reference) < 1e-6


def test_antiplane_shear_is_in_equilibrium():
    """d tau_xieta/d xi + d tau_etaz/dz = 0, and the slope is the response's."""
    x, width = jnp.linspace(-2e-3, 2e-3, 9), jnp.asarray(0.4e-3)
    shear = TurnedSkin(HalfSpace(), 0.0).antiplane

    @jax.jit
    def derivatives(depth):
        of_x = jax.jvp(lambda x: shear.strip_response(x, depth, width), (x,), (jnp.ones(9),))[1]
        of_z = jax.jacfwd(lambda z: shear.strip_response(x, z, width))(depth)
        return shear.strip_slope(x, depth, width), of_x, of_z

    slope, of_x, of_z = map(np.asarray, derivatives(jnp.asarray(DEPTH)))
    np.testing.assert_allclose(of_x, slope, rtol=1e-9, atol=1e-12 * np.abs(slope).max())
    assert np.abs(of_x[0] + of_z[1]).max() < 1e-12 * np.abs(of_x).max()


@pytest.mark.full
def test_antiplane_transfer_is_that_of_the_line_load():
    """By quadrature over k, and -q on the surface."""
    shear, x = TurnedSkin(HalfSpace(), 0.0).antiplane, np.array([-1.3e-3, 0.2e-3, 2e-3])
    k = np.linspace(0, 40 / DEPTH, 20001)
    wave = np.exp(1j * k * x[:, None])

    @jax.jit
    def solve(k, x, width):
        at_surface = shear.transfer(jnp.asarray([-2e3, 2e3]), jnp.asarray(0.0))
        return shear.transfer(k, DEPTH), shear.strip_response(x, DEPTH, width), at_surface

    width = 1e-6 * DEPTH
    spectrum, strip, at_surface = map(np.array, solve(k, x, width))
    spectrum[0, 0] = 1j  # the limit from above, as only k > 0 is summed
    line = np.trapezoid(np.real(spectrum[:, None] * wave), k, axis=-1) / np.pi
    assert largest_error(strip / width, line) < 1e-5
    np.testing.assert_allclose(at_surface, [[-1j, 1j], [-1, -1]], atol=1e-15)


# --- the strip, and symmetry -----------------------------------------------------------------


@pytest.mark.full
def test_length_takes_the_stated_factor():
    angle, k = 0.6, np.linspace(0, 8e3, 57)
    film = Film(DEPTH, 0.3, length_m=6e-3)
    long = turned(Sensor([film]), angle)
    thin = Sensor([film], TurnedSkin(HalfSpace(), angle))
    a = k * 6e-3 * np.sin(angle) / 2
    factor = np.sin(a) / np.where(a > 0, a, 1.0) + (a == 0)
    ours, others = jax.jit(lambda k: [s.charge().transfer(k) for s in (long, thin)])(k)
    expected = factor * np.asarray(others)
    np.testing.assert_allclose(ours, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.full
@pytest.mark.parametrize("angle", rare([0.1, -1.5], -1.5))
def test_open_and_periodic_line_agree_on_the_length(angle):
    """Two ways to average over it: what is left falls with the cells' size, squared. A load without
    net force or moment is not felt in the middle of one window from the next."""
    errors = [difference_of_lines(angle, cells) for cells in (1024, 2048)]
    assert errors[1] < 1e-3
    assert 3.5 < errors[0] / errors[1] < 5


def difference_of_lines(angle, cells):
    cell = 64 * DEPTH / cells
    lines = [kind(cells, cell, -cells / 2 * cell) for kind in (Open, Periodic)]
    t = np.asarray(lines[0].x) / 1e-3
    hat = (1 - 2 * t**2) * np.exp(-(t**2))
    traction = jnp.asarray([hat, np.zeros_like(hat)])
    sensor = Sensor([Film(DEPTH, 0.0), Film(DEPTH, np.pi / 2)])
    ours, other = (oblique(angle, line, sensor, traction) for line in lines)
    middle = slice(cells // 3, 2 * cells // 3)
    return largest_error(np.asarray(ours)[:, middle], np.asarray(other)[:, middle])


def test_features_that_lean_either_way_feel_the_same():
    """The mirror y -> -y turns phi about and leaves x, z, p and a pull along x: at any film angle
    a straight scan cannot tell the side to which features lean."""
    ours = oblique(0.7, LINES["periodic_even"], full_sensor(), RANDOM)
    mirrored = oblique(-0.7, LINES["periodic_even"], full_sensor(), RANDOM)
    assert largest_error(mirrored, ours) < 1e-12


def test_effects_turn():
    effects = (StripAverage(0.7e-3), Offset(0.3e-3), SampleAverage(3, 4e-5))
    film = turned(Sensor([Film(effects=effects)]), 1.0).elements[0]
    width, offset, average, length = map(vars, film.effects)
    c = np.cos(1.0)
    sizes = width["width_m"], offset["offset_m"], average["spacing_m"], length["reach_m"]
    expected = 0.7e-3 * c, 0.3e-3 * c, 4e-5 * c, 8e-3 * np.sin(1.0)
    np.testing.assert_allclose(sizes, expected, rtol=1e-14)


def test_contact_is_across_the_features():
    k = jnp.asarray([10.0, 1e3])
    np.testing.assert_array_equal(
        TurnedSkin(HalfSpace(), 0.5).compliance(k), HalfSpace().compliance(k)
    )


# --- gradients -------------------------------------------------------------------------------


def value(kind, angle):
    sensor = Sensor([Film(DEPTH, 0.5, effects=(Offset(2e-4),))])
    line = LINES_SHORT[kind]
    signal = turned(sensor, angle).operator(line, turned_scan(SCAN, angle))(RANDOM[:, :24])
    return jnp.sum(jnp.sin(2e7 * signal) * RANDOM[:1, 24:48])


LINES_SHORT = {"open": Open(24, 2e-4), "periodic": Periodic(24, 2e-4)}


@pytest.mark.full
@pytest.mark.parametrize("kind", LINES_SHORT)
def test_gradient_in_the_angle(kind):
    step = 1e-3
    angles = np.array([0.0, 0.5, -1.2, np.pi / 2 - 3e-3])
    near = angles + step * np.arange(-2, 3)[:, None]

    def all_of(angle):
        """The value, and its derivative forward and in reverse, traced once."""
        number, push = jax.linearize(partial(value, kind), angle)
        return number, push(1.0), jax.linear_transpose(push, angle)(1.0)[0]

    columns = jax.jit(lambda a: jax.lax.map(all_of, a))(near.ravel())
    values, forward, reverse = (np.asarray(each).reshape(5, -1) for each in columns)
    expected = np.array([1, -8, 0, 8, -1]) @ values / (12 * step)
    forward, reverse = forward[2], reverse[2]
    scale = np.abs(expected).max()
    assert scale > 1e-2
    np.testing.assert_allclose(forward, expected, atol=1e-7 * scale)
    np.testing.assert_allclose(reverse, forward, atol=1e-11 * scale)


# --- the circle ------------------------------------------------------------------------------

PLACE = {"angle_rad": 2.1, "distance_m": 3e-3, "load_N_per_m": 1.5, "width_m": 4e-4}
FILMS = (
    Film(DEPTH, 0.4, effects=(StripAverage(0.7e-3), Offset(0.4e-3))),
    Film(0.9e-3, np.pi / 2),
)
CHARGE = ChargeReadout(1.0, 0.0)


def round_once(amplifier, samples=1024, **changed):
    ridge = ObliqueRidge(**(PLACE | {"friction": -0.4} | changed))
    return np.asarray(PathScan(Sensor(FILMS, amplifier=amplifier), Circle(samples=samples))(ridge))


@pytest.mark.full
@pytest.mark.parametrize(("amplifier", "friction"), [(CHARGE, -0.4), (CurrentAmplifier(), 0.0)])
def test_the_straight_model_where_the_finger_moves_along_x(amplifier, friction):
    """At the circle's lowest point; with friction the rate is that of a turning shear as well."""
    angle, circle = 0.8, Circle(samples=8, start_rad=-np.pi / 2)
    ridge = ObliqueRidge(angle, -7e-3, 1.5, 4e-4, friction)
    sensor = Sensor(FILMS, amplifier=amplifier)
    stage = turned(sensor, angle).output(turned_scan(ConstantSpeed(0.05), angle))
    xi = jnp.asarray([10e-3 * np.cos(-np.pi / 2 - angle) + 7e-3])
    each = eqx.filter_jit(stage.cell_response)(xi, ridge.width_m)[..., 0]
    expected = 1.5 / 4e-4 * (each[:, 0] + friction * each[:, 1])
    np.testing.assert_allclose(PathScan(sensor, circle)(ridge)[:, 0], expected, rtol=1e-9)


@pytest.mark.full
def test_rate_is_the_charge_in_time():
    """Charge returns after a turn, so that its Fourier series is differentiated exactly."""
    charge, rate = round_once(CHARGE), round_once(CurrentAmplifier(1.0))
    waves = 1j * np.fft.rfftfreq(1024, 1 / 1024) * 0.05 / 10e-3
    expected = np.fft.irfft(waves * np.fft.rfft(charge), 1024)
    assert largest_error(rate, expected) < 1e-9


@pytest.mark.full
def test_a_ridge_turned_half_about_is_the_same():
    turned_about = round_once(CHARGE, angle_rad=2.1 + np.pi, distance_m=-3e-3)
    assert largest_error(turned_about, round_once(CHARGE)) < 1e-10


def test_coarser_circle_stands_at_the_means():
    circle = Circle(samples=100, start_rad=0.3)
    means = np.asarray(circle.angle_rad)[:96].reshape(12, 8).mean(axis=1)
    np.testing.assert_allclose(circle.coarser(8).angle_rad, means, rtol=1e-14)
    period = 2 * np.pi * 10e-3 / 0.05
    np.testing.assert_allclose(circle.time_s, np.arange(100) / 100 * period, atol=1e-14)


@pytest.mark.full
@pytest.mark.parametrize("angle", [0.0, 2.1])
def test_gradients_on_the_circle(angle):
    """In all of the ridge's parameters, also where the strip's length does not reach along xi."""
    jacobians, expected = by_all_ways(angle)
    scale = np.abs(expected).max(axis=-1, keepdims=True)
    assert scale.min() > 1e-3
    for mode in jacobians:
        np.testing.assert_allclose(mode / scale, expected / scale, atol=1e-6)


@eqx.filter_jit
def circled(factors):
    """The signal of a ridge whose parameters are so many times the nominal ones."""
    circling = PathScan(Sensor(FILMS[:1]), Circle(samples=32))
    nominal = jnp.asarray([1.0, *list(PLACE.values())[1:], -0.4])
    return 1e6 * circling(ObliqueRidge(*(factors * nominal)))[0]


@eqx.filter_jit
def both_modes(factors):
    _, forward, reverse = derivatives(circled, factors)
    return forward.T, reverse.T


def by_all_ways(angle):
    at, step = np.array([angle, 1.0, 1.0, 1.0, 1.0]), 1e-4
    rows = {reach: np.array([circled(jnp.asarray(at + reach * step * e)) for e in np.eye(5)])
            for reach in (-2, -1, 1, 2)}  # fmt: skip
    differences = (rows[-2] - 8 * rows[-1] + 8 * rows[1] - rows[2]) / (12 * step)
    return both_modes(jnp.asarray(at)), differences


@pytest.mark.full
def test_layers_of_one_material_are_the_half_space():
    """In and out of the plane."""
    same = Layered([Layer(1e-3), Layer(2e-3), Layer()])
    name = "open_odd"
    signals = [
        oblique(0.6, LINES[name], Sensor([Film(DEPTH, 0.3)], skin), per_line(name))
        for skin in (same, HalfSpace())
    ]
    assert largest_error(*signals) < 1e-10


@pytest.mark.parametrize("k", [3.0, 40.0, 900.0, 8e3])
def test_shear_along_features_on_layers(k):
    """Against the four waves of skin on foam on a rigid core, solved as one system."""
    stiff, soft, mid, end = 7e5 / 3, 5e4 / 2.6, 1.5e-3, 6.5e-3
    near, through = np.exp(-k * mid), np.exp(-k * (end - mid))
    waves = np.linalg.solve(
        [
            [stiff * k * near, -stiff * k, 0, 0],
            [1, near, -through, -1],
            [stiff * k, -stiff * k * near, -soft * k * through, soft * k],
            [0, 0, 1, through],
        ],
        [-1, 0, 0, 0],
    )
    down, up = waves[0] * np.exp(-k * (mid - DEPTH)), waves[1] * np.exp(-k * DEPTH)
    expected = [1j * k * stiff * (down + up), k * stiff * (down - up)]
    skin = Layered([Layer(mid, 7e5, 0.5), Layer(end - mid, 5e4, 0.3)])
    ours = skin.antiplane.transfer(jnp.asarray([k]), jnp.asarray(DEPTH))[:, 0]
    np.testing.assert_allclose(ours, expected, rtol=1e-12)


# --- precision and refusals ------------------------------------------------------------------


@pytest.mark.full
def test_single_precision():
    p = 1e3 * (np.abs(np.arange(48) - 23.5) < 3)

    def simulate():
        films = (Film(DEPTH, 0.4, effects=(Offset(0.4e-3),)),)
        line, sensor = Open(48, 2e-4, -4.7e-3), Sensor(films)
        traction = as_real(np.stack([p, 0.4 * p]))
        silent = oblique(np.pi / 2, line, sensor, traction)
        circling = PathScan(sensor, Circle(samples=64))(ObliqueRidge(1.1, 2e-3, friction=0.3))
        return oblique(1.1, line, sensor, traction), circling, silent

    *double, _ = simulate()
    with jax.enable_x64(False):
        *single, silent = simulate()
    for ours, reference in zip(single, double, strict=True):
        assert ours.dtype == jnp.float32
        assert largest_error(ours, reference) < 1e-4
    assert not np.any(silent)


class Echo(LineEffect):
    def transfer(self, k):
        return k

    def spread(self, kernel):
        return kernel


class Twin(Echo):
    """The mean of two films, each `half_m` from the middle."""

    half_m: float

    def scaled(self, factor):
        return Twin(factor * self.half_m)

    def quadrature(self, nodes):
        return self.half_m * jnp.array([-1.0, 1.0]), jnp.array([0.5, 0.5])


@pytest.mark.full
def test_an_effect_of_ones_own_on_a_circle():
    ridge = ObliqueRidge(1.1, 2e-3, friction=0.3)

    def signal(*effects):
        sensor = Sensor([Film(effects=effects)])
        return np.asarray(PathScan(sensor, Circle(samples=16))(ridge))

    mean = (signal(Offset(-2e-4)) + signal(Offset(2e-4))) / 2
    np.testing.assert_allclose(signal(Twin(2e-4)), mean, atol=1e-12 * np.abs(mean).max())


def test_refused():
    refused(lambda: turned(Sensor([Film()]), 1.6), "angle_rad is 1.6", "pi/2")
    refused(lambda: turned_scan(ConstantSpeed(), np.nan), "angle_rad is nan")
    refused(lambda: turned(Sensor([Film(effects=(Echo(),))]), 0.5), "Echo", "effects")
    average = Sensor([Film(effects=(SampleAverage(3, 1e-5),))])
    refused(lambda: PathScan(average, Circle()), "SampleAverage")
    filtered = Sensor([Film()], filters=(FirstOrder(1e-3),))
    refused(lambda: PathScan(filtered, Circle()), "1 filters")
    assert turned(filtered, 0.5).filters == filtered.filters
    refused(lambda: Circle(radius_m=0.0), "circle.radius_m is 0.0")
    refused(lambda: Circle(samples=4), "circle.samples is 4")
    refused(lambda: Circle(speed_m_per_s=-0.05), "circle.speed_m_per_s is -0.05")
    refused(lambda: ObliqueRidge(0.0, 0.0, width_m=0.0), "ridge.width_m is 0.0")
