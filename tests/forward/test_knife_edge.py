"""A vibrating edge over a resting film, against closed forms of its own and a scan over a line."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.special import j1

from srsinv.forward.contact import press
from srsinv.forward.film import Film, Piezo
from srsinv.forward.filter import FirstOrder
from srsinv.forward.indentation import Indentation, relative_modulus
from srsinv.forward.knife_edge import KnifeEdge, VibratingEdge, contact_modulus_Pa, line_response
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.line_scan import integrated_scan
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import Periodic
from tests.refusals import refused
from tests.tiers import quick

D = (23e-12, 3e-12, -33e-12)
NU = 0.5
LENGTH, SPEED, OHM = 8e-3, 0.05, 1e6
PLACE = np.linspace(-3e-3, 3e-3, 25)
ON_FOAM = Layered([Layer(1.5e-3, 7e5, 0.5), Layer(5e-3, 5e4, 0.3)])
MODULUS = 7e5 / (1 - NU**2)


def kernels(x, depth, angle, width):
    """K_p and K_q (2, x): charge per line load, by the table of line-load stresses, the film turned
    by hand and averaged over the strip by quadrature."""
    nodes, weights = leggauss(64)
    t = (np.asarray(x)[..., None] + width / 2 * nodes) / depth
    base = -2 / (np.pi * depth * (1 + t**2) ** 2)
    c, s = np.cos(angle), np.sin(angle)
    rows = []
    for power in (0, 1):  # p, then q
        sz, sx, txz = base * t**power, base * t ** (2 + power), base * t ** (1 + power)
        s11 = sx * c**2 + sz * s**2 + 2 * txz * s * c
        s33 = sx * s**2 + sz * c**2 - 2 * txz * s * c
        density = D[0] * s11 + D[1] * NU * (sx + sz) + D[2] * s33
        rows.append(width * LENGTH * density @ (weights / 2))
    return np.stack(rows)


def strip(depth=0.75e-3, angle=0.0, width=0.7e-3, **parts):
    film = Film(depth, angle, width, LENGTH, Piezo(*D)).with_strip_average()
    return Sensor([film], **parts)


CASES = [(0.3e-3, 0.0, 0.7e-3), (0.75e-3, np.pi / 2, 0.5e-3), (2e-3, 0.4, 1e-3)]


@pytest.mark.parametrize(("depth", "angle", "width"), quick(CASES, CASES[1]))
@pytest.mark.parametrize("direction_deg", [0.0, 45.0, -45.0, 80.0])
def test_the_rig_is_the_mirror_image_of_a_scan(depth, angle, width, direction_deg):
    """Against the closed form as well: v_i = R_f [K_p + mu K_q] over the film's position, and the
    rig's curve the same at minus it, with p = F cos and mu = tan(direction)."""
    sensor, direction = strip(depth, angle, width), np.deg2rad(direction_deg)
    load = VibratingEdge(KnifeEdge(0.0, direction), 1.0, 0.1)
    rig = OHM * load.small_charge(sensor, PLACE)[0]
    p, q = kernels(-PLACE, depth, angle, width)
    mu = np.tan(direction)
    expected = OHM * 0.1 * np.cos(direction) * (p + mu * q)
    size = np.abs(expected).max()
    np.testing.assert_allclose(rig, expected, atol=1e-9 * size)
    loads = 0.1 * np.cos(direction), 0.1 * np.sin(direction)
    scan = integrated_scan(sensor, ConstantSpeed(SPEED), loads, -PLACE[::-1])[0]
    np.testing.assert_allclose(rig[::-1] - rig[-1], scan, atol=1e-6 * size)


def test_at_45_degrees_the_scan_with_friction_1_has_root_2_of_the_rig():
    sensor = strip()
    rig = KnifeEdge(0.0, np.pi / 4).charge_per_load(sensor, PLACE, 1.0)[0]
    scan = integrated_scan(sensor, ConstantSpeed(SPEED), (1.0, 1.0), -PLACE[::-1])[0] / OHM
    np.testing.assert_allclose(
        np.sqrt(2) * (rig[::-1] - rig[-1]), scan, atol=1e-6 * np.abs(rig).max()
    )


@pytest.mark.full
def test_the_mirror_image_holds_on_layers():
    sensor = strip(skin=ON_FOAM)
    rig = KnifeEdge(0.0, 0.6).charge_per_load(sensor, PLACE, 1.0)[0]
    loads = np.cos(0.6), np.sin(0.6)
    scan = integrated_scan(sensor, ConstantSpeed(SPEED), loads, -PLACE[::-1])[0] / OHM
    np.testing.assert_allclose(rig[::-1] - rig[-1], scan, atol=1e-6 * np.abs(rig).max())


@eqx.filter_jit
def transfer_of(stage, k):
    return stage.transfer(k)


@pytest.mark.full
def test_layers_under_a_line_load_against_the_transfer():
    sensor, x = strip(skin=ON_FOAM), np.array([-1.3e-3, 0.0, 0.4e-3, 2e-3])
    # Steps of 4/m: what wraps around after 1.6 m is nothing on a core.
    step = 4.0
    k = np.arange(step / 2, 4e4, step)
    transfer = np.asarray(transfer_of(sensor.charge(), jnp.asarray(k)))[0]
    expected = step * np.real(transfer @ np.exp(1j * np.outer(k, x))) / np.pi
    ours = line_response(sensor, x)[0]
    np.testing.assert_allclose(ours, expected, atol=1e-8 * np.abs(expected).max())


def test_the_sign_turns_where_the_flat_film_has_it():
    """Of a narrow flat strip K_p = 0 at (x/z)^2 = -(d3 + d2/2)/(d1 + d2/2)."""
    zero = 0.75e-3 * np.sqrt(-(D[2] + D[1] / 2) / (D[0] + D[1] / 2))
    sensor = Sensor([Film(0.75e-3, 0.0, 0.7e-3, LENGTH, Piezo(*D))])
    before, after = KnifeEdge().charge_per_load(sensor, [0.99 * zero, 1.01 * zero], 1.0)[0]
    assert before > 0 > after


@pytest.mark.parametrize("skin", [HalfSpace(), ON_FOAM, Viscoelastic(HalfSpace(), [1.0], [1e-3])])
def test_hertz(skin):
    assert contact_modulus_Pa(skin) == pytest.approx(MODULUS, rel=1e-12)
    edge = KnifeEdge(2e-3, np.pi / 3)
    half = edge.half_width_m(skin, np.array([-1.0, 0.0, 3.0]))
    expected = np.sqrt(4 * 3.0 * 0.5 * 2e-3 / (np.pi * MODULUS))
    np.testing.assert_allclose(half, [0, 0, expected], rtol=1e-12)


@pytest.mark.parametrize(
    "half", [pytest.param(0.05, marks=pytest.mark.claim), *quick([0.8, 4.0], 0.8)]
)
def test_charge_of_a_wide_contact_is_that_of_the_hertz_pressure(half):
    """Half-widths from narrow to four depths, by quadrature over the ellipse."""
    depth = 0.75e-3
    a = half * depth
    radius = np.pi * MODULUS * a**2 / 4 / 2.0
    nodes, weights = leggauss(400)
    at = np.pi / 2 * nodes  # x = a sin(angle): the ellipse's root turns into cos
    pressure = 2 * 2.0 / (np.pi * a) * np.cos(at)
    p, _ = kernels((a * np.sin(at)[None] - PLACE[:, None]).ravel(), depth, 0.0, 0.7e-3)
    along = a * np.cos(at) * pressure * weights * np.pi / 2
    expected = p.reshape(PLACE.size, -1) @ along
    ours = KnifeEdge(radius).charge(strip(), PLACE, [2.0])[0, :, 0]
    np.testing.assert_allclose(ours, expected, atol=1e-9 * np.abs(expected).max())


def test_charge_per_load_is_the_derivative():
    sensor, edge, step = strip(), KnifeEdge(0.2, 0.3), 1e-4
    low, high = np.moveaxis(edge.charge(sensor, PLACE, [1 - step, 1 + step])[0], -1, 0)
    ours = edge.charge_per_load(sensor, PLACE, 1.0)[0]
    np.testing.assert_allclose(ours, (high - low) / (2 * step), atol=1e-7 * np.abs(ours).max())


@pytest.mark.full
@pytest.mark.parametrize("radius", [0.0, 1e-3, 3.0])
def test_charge_of_many_loads_is_that_of_each(radius):
    sensor, edge, load = strip(), KnifeEdge(radius, 0.3), np.array([0.0, 0.1, 1.7, 4.0])
    ours = edge.charge_of_load(sensor, PLACE[:3], 4.0)(load)
    expected = edge.charge(sensor, PLACE[:3], load)
    np.testing.assert_allclose(ours, expected, atol=1e-12 * np.abs(expected).max())


def test_a_scan_beside_the_load():
    """The load lies beyond the positions of the scan."""
    sensor, x = strip(), np.linspace(0.5e-3, 2e-3, 9)
    scan = integrated_scan(sensor, ConstantSpeed(SPEED), (1.0, 0.0), x)[0] / OHM
    p, _ = kernels(x, 0.75e-3, 0.0, 0.7e-3)
    np.testing.assert_allclose(scan, p - p[0], atol=1e-6 * np.abs(p).max())


def test_a_line_load_is_linear_and_does_not_pull():
    charge = KnifeEdge().charge(strip(), [1e-4], [-1.0, 1.0, 2.5])[0, 0]
    np.testing.assert_allclose(charge, charge[1] * np.array([0.0, 1.0, 2.5]), rtol=1e-13)


@pytest.mark.full
def test_indentation_against_direct_quadrature():
    """delta = F/pi times the integral of C(k) 2 J_1(ka)/(ka), term by term on even wavenumbers;
    what wraps around after 0.8 m is nothing on a core."""
    edge, load = KnifeEdge(5e-3), np.array([1.0])
    a = edge.half_width_m(ON_FOAM, load)[0]
    step = 8.0
    k = np.arange(step / 2, 2e6, step)
    direct = step * np.sum(ON_FOAM.compliance_once(k) * 2 * j1(k * a) / (k * a)) / np.pi
    relation = Indentation(edge, ON_FOAM, 0.75e-3)
    assert relation.indentation_m(load)[0] == pytest.approx(direct, rel=1e-6)
    # The result does not depend on the length that splits the integral.
    other = Indentation(edge, ON_FOAM, 3e-3).indentation_m(load)
    np.testing.assert_allclose(relation.indentation_m(load), other, rtol=1e-9)


def test_indentation_and_load_are_inverse_and_its_derivative():
    relation = Indentation(KnifeEdge(5e-4), ON_FOAM, 0.75e-3)
    load, step = np.array([0.02, 0.3, 2.0]), 1e-5
    depth = relation.indentation_m(load)
    np.testing.assert_allclose(relation.load_N_per_m(depth, 1.0), load, rtol=1e-9)
    assert not relation.load_N_per_m([-1e-5, 0.0], 1.0).any()
    rise = relation.indentation_m(load * (1 + step)) - relation.indentation_m(load * (1 - step))
    np.testing.assert_allclose(relation.per_load(load), rise / (2 * step * load), rtol=1e-7)


@pytest.mark.full
def test_indentation_against_the_contact_solver():
    """A cylinder pressed into the same layers by `press`: the surface under its crest goes down by
    what the solved pressure displaces, the uniform part by the layers' compliance at k = 0."""
    radius, load, n, length = 5e-3, 1.0, 16384, 0.08
    line = Periodic(n, length / n, -length / 2)
    x = np.asarray(line.x)
    near = np.abs(x) < 0.9 * radius
    height = np.where(near, np.sqrt(radius**2 - np.where(near, x, 0.0) ** 2) - radius, -radius)
    contact = press(line, ON_FOAM, jnp.asarray(height), load / length)
    pressure = np.asarray(contact.pressure_Pa)
    k = np.asarray(line.k)
    compliance = np.concatenate(
        [ON_FOAM.compliance_once(k[:1] + 1e-3), ON_FOAM.compliance_once(k[1:])]
    )
    depth = np.fft.irfft(compliance * np.fft.rfft(pressure), n)[np.argmax(height)]
    edge = KnifeEdge(radius)
    half = edge.half_width_m(ON_FOAM, np.array([load]))[0]
    assert np.ptp(x[pressure > 0]) / 2 == pytest.approx(half, rel=0.05)
    assert pressure.max() == pytest.approx(2 * load / (np.pi * half), rel=0.01)
    ours = Indentation(edge, ON_FOAM, 0.75e-3).indentation_m(np.array([load]))[0]
    assert ours == pytest.approx(depth, rel=0.002)


def test_a_relaxing_skin_stiffens_by_its_prony_series():
    frequency, times, parts = np.array([3.0, 100.0, 2000.0]), (1e-3, 1e-2), (0.7, 0.4)
    turn = 2j * np.pi * frequency[:, None] * np.array(times)
    expected = 1 + (turn / (1 + turn)) @ np.array(parts)
    skin = Viscoelastic(ON_FOAM, parts, times)
    np.testing.assert_allclose(relative_modulus(skin, frequency, 0.75e-3), expected, rtol=1e-12)
    np.testing.assert_allclose(relative_modulus(ON_FOAM, frequency, 0.75e-3), 1, rtol=1e-12)


def test_refusals():
    edge, sensor = KnifeEdge(1e-4), strip()
    refused(lambda: KnifeEdge(-1e-3), "radius_m", "-0.001", "at least 0")
    refused(lambda: KnifeEdge(0.0, 2.0), "direction_rad", "2.0", "pi/2")
    refused(lambda: VibratingEdge(edge, 0.0, 1.0), "preload_N_per_m", "0.0", "positive")
    refused(lambda: VibratingEdge(edge, 1.0, -1.0), "amplitude_N_per_m", "-1.0", "positive")
    refused(lambda: edge.charge_per_load(sensor, [0.0], 0.0), "preload_N_per_m", "positive")
    refused(lambda: KnifeEdge(1e3).charge(sensor, [0.0], [1.0]), "40 depths", "smaller radius_m")
    for skin in (HalfSpace(), Layered([Layer(1e-3), Layer()])):
        words = "a rigid core", "half space", "prescribe the load"
        refused(lambda skin=skin: Indentation(edge, skin, 0.75e-3), *words)
    refused(lambda: Indentation(KnifeEdge(), ON_FOAM, 0.75e-3), "radius_m is 0", "without limit")
    relation = Indentation(edge, ON_FOAM, 0.75e-3)
    refused(lambda: relation.load_N_per_m([1e-2], 1.0), "0.01 m", "smaller amplitude")
    scan, far = ConstantSpeed(SPEED), np.linspace(0, 10.0, 5)
    refused(lambda: integrated_scan(sensor, scan, (1.0, 0.0), far), "10 m", "shorter range")


def test_filters_do_not_act_on_the_charge():
    slow = strip(filters=[FirstOrder(1e-2)])
    ours, ideal = (KnifeEdge().charge_per_load(s, PLACE, 1.0) for s in (slow, strip()))
    np.testing.assert_array_equal(ours, ideal)
