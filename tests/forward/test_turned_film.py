"""Strips turned in the skin's plane, against point loads and against features turned instead."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.describe import elements
from srsinv.forward.film import Film, Offset, StripAverage
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.measured import KernelTable, MeasuredFilm
from srsinv.forward.oblique import turned, turned_scan
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open, Periodic
from tests.forward.setups import apply, largest_error
from tests.forward.test_oblique import point_load
from tests.refusals import refused
from tests.tiers import quick

DEPTH, WIDTH, LENGTH = 0.75e-3, 0.7e-3, 3e-3
XI = np.linspace(-3e-3, 3e-3, 9)
RANDOM = jnp.asarray(np.random.default_rng(7).normal(size=(2, 48)))
LINES = {"periodic": Periodic(48, 1.5e-4, -3.6e-3), "open": Open(48, 1.5e-4, -3.6e-3)}


def film(turn, **changed):
    given = {"width_m": WIDTH, "length_m": LENGTH, "turn_rad": turn, "angle_rad": 0.3}
    return Film(DEPTH, **given | changed)


def tensor(xi, angle, along):
    """The stress (3, 3, xi) at depth under unit point loads along a line whose normal is at
    `angle`; `along` x or z."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    bend, reach = nodes * np.pi / 2, np.hypot(xi, DEPTH)[:, None]
    eta, weight = reach * np.tan(bend), reach * weights * np.pi / 2 / np.cos(bend) ** 2
    x = np.cos(angle) * xi[:, None] - np.sin(angle) * eta
    y = np.sin(angle) * xi[:, None] + np.cos(angle) * eta
    return np.sum(weight * point_load(x, y, DEPTH, along), axis=-1)


def charge_of_points(turn, angle, tilt):
    """Charge (2, xi) of a small film under line loads p and q along x, from point loads alone."""
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    lean = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    axes, constants = lean @ axes, (23e-12, 3e-12, -33e-12)
    rows = []
    for along in "zx":
        own = np.einsum("ia,jb,abx->ijx", axes, axes, tensor(XI, angle, along))
        rows.append(WIDTH * LENGTH * sum(d * own[i, i] for i, d in enumerate(constants)))
    return np.stack(rows)


@pytest.mark.parametrize(
    ("turn", "angle"), quick([(0.8, 0.5), (-1.2, 0.0), (2.1, -0.9)], (2.1, -0.9))
)
def test_charge_is_that_of_point_loads(turn, angle):
    """The reference knows the third dimension; a short strip, so that nothing is averaged."""
    small = film(turn, length_m=1e-6 * LENGTH)
    cell = 1e-6 * DEPTH

    @jax.jit
    def response(x):
        sensor = Sensor([small], HalfSpace(0.4))
        oblique = turned(sensor, angle) if angle else sensor
        return oblique.charge().cell_response(x, jnp.asarray(cell))[0]

    ours = 1e6 * response(jnp.asarray(XI)) / cell
    assert largest_error(ours, charge_of_points(turn, angle, 0.3)) < 1e-6


@pytest.mark.parametrize("name", quick(LINES, "open"))
def test_turning_the_strip_is_turning_the_features(name):
    """Under pressure alone only the angle between them counts, on a layered skin too."""
    pressure = RANDOM * jnp.array([[1.0], [0.0]])
    skin = HalfSpace() if name == "open" else Layered((Layer(1.5e-3, 7e5), Layer(5e-3, 5e4)))
    strip = film(0.0).with_strip_average()
    features = turned(Sensor([strip], skin), 0.6)
    ours = Sensor([film(-0.6).with_strip_average()], skin)
    expected = apply(LINES[name], features.charge(), pressure)
    assert largest_error(apply(LINES[name], ours.charge(), pressure), expected) < 1e-9


def test_strip_averages_over_its_own_width_and_length():
    """The mean over the rectangle, point by point."""
    turn, angle = 0.7, 0.4
    long, thin = film(turn).with_strip_average(), film(turn, length_m=1e-6 * LENGTH)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    across, along = WIDTH / 2 * nodes, LENGTH / 2 * nodes
    shift = np.cos(angle - turn) * across[:, None] + np.sin(angle - turn) * along[None]

    @eqx.filter_jit
    def response(film, x):
        return turned(Sensor([film]), angle).charge().cell_response(x, jnp.asarray(1e-4))[0]

    places = (XI[:, None] + shift.ravel()).ravel()
    points = 1e6 * np.asarray(response(thin, jnp.asarray(places))).reshape(2, XI.size, -1)
    mean = points @ np.outer(weights / 2, weights / 2).ravel()
    assert largest_error(response(long, jnp.asarray(XI)), mean) < 1e-9


def test_place_in_the_plane():
    """Along the normal an element lies at dx cos(phi) + dy sin(phi)."""
    placed = Sensor([film(0.5, offset_m=3e-4, offset_y_m=-7e-4)])
    at_origin = Sensor([film(0.5, effects=(Offset(3e-4 - 7e-4 * np.tan(0.9)),))])
    scan = turned_scan(ConstantSpeed(0.05), 0.9)
    ours, other = (turned(each, 0.9).output(scan) for each in (placed, at_origin))
    line = LINES["periodic"]
    assert largest_error(apply(line, ours, RANDOM), apply(line, other, RANDOM)) < 1e-12


def test_a_turn_that_differs_tells_the_side_to_which_features_lean():
    """The mirror y -> -y, under which one strip across x gives the same signal."""
    line, scan = LINES["periodic"], ConstantSpeed(0.05)
    sensor = Sensor([film(0.0), film(np.pi / 4)])
    either = [
        apply(line, turned(sensor, angle).output(turned_scan(scan, angle)), RANDOM)
        for angle in (0.7, -0.7)
    ]
    rms = np.sqrt(np.mean(np.square(either[0]), axis=-1))
    change = np.sqrt(np.mean(np.square(either[0] - either[1]), axis=-1)) / rms
    assert change[0] < 1e-12
    assert change[1] > 0.5


@pytest.mark.full
def test_gradient_in_the_turn():
    line = LINES["open"]

    def value(turn):
        strip = Film(DEPTH, 0.3, WIDTH, LENGTH, turn_rad=turn, effects=(StripAverage(WIDTH),))
        signal = Sensor([strip]).operator(line, ConstantSpeed(0.05))(RANDOM)
        return jnp.sum(signal**2)

    slope, step = jax.jit(jax.grad(value)), 1e-4
    jitted = jax.jit(value)
    difference = (jitted(0.4 + step) - jitted(0.4 - step)) / (2 * step)
    assert float(slope(0.4)) == pytest.approx(float(difference), rel=1e-5)


def test_description():
    part = {"orientation": "1_to_x_3_to_z", "strip_width_m": WIDTH, "active_length_m": LENGTH}
    plane = {"turn_deg": 45, "offset_y_m": 1e-3}
    straight, leaning = elements({"depth_m": DEPTH, "elements": [part, part | plane]})
    assert straight.turn_rad is None
    assert float(np.asarray(leaning.turn_rad)) == pytest.approx(np.pi / 4)
    assert float(leaning.offset_y_m) == 1e-3
    assert Sensor([straight, leaning]).element_names[1].endswith("turned 45 deg")


def test_refused():
    table = KernelTable.of(np.linspace(-1e-3, 1e-3, 16), np.zeros((2, 16)))
    refused(lambda: MeasuredFilm.of(film(0.3), (1.0, 1.0), table), "turned in the plane")
    refused(lambda: film("a"), "turn_rad")
