"""The two lines: one sinusoid, Hertz pressure by order of convergence, and the lines' ends."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film, Offset, SampleAverage, StripAverage
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import TractionScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.traction import Hertz
from srsinv.grid import Open, Periodic, half_spectrum_weights, wavenumbers
from tests.forward.setups import (
    AMPLIFIERS,
    LINES,
    SCAN,
    apply,
    fitted_order,
    full_sensor,
    largest_error,
)
from tests.reference import closed_forms as cf
from tests.tiers import quick

DEPTH, NU, SPEED, OHM = 0.75e-3, 0.45, -0.03, 2e6
D = (23e-12, 3e-12, -33e-12)


@eqx.filter_jit
def outputs(line, sensor, scan, r):
    """Stress, charge, current and voltage of the first element, and of the slow readouts."""
    stages = (sensor.stress(), sensor.charge(), sensor.current(scan), sensor.output(scan))
    return [line.operator(stage)(r) for stage in stages]


# One sinusoid on the periodic line.


@pytest.mark.parametrize("component", [0, 1], ids=["p", "q"])
@pytest.mark.parametrize(("n", "m"), [(64, 1), (64, 7), (64, 31), (63, 2), (63, 31), (64, 20)])
def test_one_sinusoid(n, m, component):
    """Amplitude and phase of every stress, of charge, current and voltage; odd and even lines."""
    cell, phase, angle, width, offset = 0.6 / n * 1e-2, 0.4, 0.5, 0.5e-3, 2e-4
    line = Periodic(n, cell, -1e-3)
    x, k = np.asarray(line.x), 2 * np.pi * m / (n * cell)
    traction = np.zeros((2, n))
    traction[component] = np.cos(k * x + phase) * np.sinc(k * cell / 2 / np.pi)
    film = Film(DEPTH, angle, width, effects=(StripAverage(width), Offset(offset)))
    sensor = Sensor([film], HalfSpace(NU), AMPLIFIERS["current"])
    sensor = eqx.tree_at(lambda s: s.amplifier.feedback_resistance_ohm, sensor, jnp.asarray(OHM))
    stress, charge, current, voltage = outputs(line, sensor, ConstantSpeed(SPEED), traction)

    wave = cf.cauchy_cosine(x, DEPTH, k, phase)
    expected = cf.stress(wave, DEPTH)[:, component]
    # Of each wave's own height, down to the round-off of a traction of 1 Pa.
    tolerance = 1e-12 * np.exp(-k * DEPTH) * (1 + k * DEPTH) + 2e-15
    np.testing.assert_allclose(stress[:3], expected, atol=tolerance, rtol=0)
    np.testing.assert_allclose(stress[3], NU * (expected[0] + expected[1]), atol=tolerance, rtol=0)

    area = width * 8e-3 * np.sin(k * width / 2) / (k * width / 2)
    at_film = cf.cauchy_cosine(x + offset, DEPTH, k, phase)
    density = cf.charge_density(cf.stress(at_film, DEPTH)[:, component], angle, D, NU)
    slope = cf.charge_density(cf.stress_slope(at_film, DEPTH)[:, component], angle, D, NU)
    full = np.exp(-k * DEPTH) * (1 + k * DEPTH) * width * 8e-3 * 60e-12
    atol = 1e-12 * full + 2e-15 * width * 8e-3 * 60e-12
    np.testing.assert_allclose(charge[0], area * density, atol=atol, rtol=0)
    atol_slope = atol * abs(SPEED) * k
    np.testing.assert_allclose(current[0], SPEED * area * slope, atol=atol_slope, rtol=0)
    np.testing.assert_allclose(voltage, OHM * current, rtol=1e-13)


def test_the_last_wavenumber_acts_by_its_real_part():
    """cos(pi j) stands for +k and -k at once: it gives sigma_x from p, and nothing from q."""
    line = Periodic(16, 2e-4)
    traction = np.zeros((2, 2, 16))
    alternating = (-1.0) ** np.arange(16)
    traction[0, 0], traction[1, 1] = alternating, alternating
    stage = full_sensor().stress()
    assert not jnp.imag(line.operator(stage).transfer[..., -1]).any()
    kappa = np.pi / 2e-4 * DEPTH
    expected = -(1 - kappa) * np.exp(-kappa) * alternating * np.pi / 2
    from_p, from_q = (apply(line, stage, jnp.asarray(r))[0] for r in traction)
    np.testing.assert_allclose(from_p, expected, atol=1e-15, rtol=0)
    np.testing.assert_allclose(from_q, 0.0, atol=1e-15)


# Hertz pressure with constant friction.

HALF_WIDTH, MU, WINDOW = 1.1e-3, 0.7, 16e-3
HERTZ = {
    "open": (Open, lambda x, z: cf.cauchy_hertz(x, z, HALF_WIDTH)),
    "periodic": (Periodic, lambda x, z: cf.cauchy_hertz_periodic(x, z, HALF_WIDTH, WINDOW)),
}


@eqx.filter_jit
def under_hertz(line, places):
    """Stress (place, 3, n) and voltage (place, n) of one element, contacts at `places`."""
    sensor = Sensor([Film(DEPTH, 0.5)], HalfSpace(NU))

    def one(place):
        r = TractionScene(0.0, MU, [Hertz(1.0, HALF_WIDTH, place)]).traction(line)
        voltage = sensor.operator(line, SCAN)(r)[0]
        return line.operator(sensor.stress())(r)[:3], voltage

    return jax.vmap(one)(places)


def hertz_by_closed_form(cauchy, x):
    both = np.array([1, MU])
    stress = np.einsum("scx,c->sx", cf.stress(cauchy(x, DEPTH), DEPTH), both)
    slope = np.einsum("scx,c->sx", cf.stress_slope(cauchy(x, DEPTH), DEPTH), both)
    return stress, 1e6 * 0.05 * 0.7e-3 * 8e-3 * cf.charge_density(slope, 0.5, D, NU)


@pytest.mark.parametrize("kind", quick(HERTZ, "open"))
def test_hertz_converges_at_second_order(kind):
    """Stress and voltage under p and q = mu p, the contact's edges lying anywhere in their cells.

    The error is the root mean square over places of the contact: at one place it depends on where
    in a cell the edge falls, and jumps from one grid to the next.
    """
    make, cauchy = HERTZ[kind]
    cells, errors = np.array([64, 108, 180, 300]), []
    for n in cells:
        line = make(int(n), WINDOW / n, -WINDOW / 2 + WINDOW / n / 2)
        places = np.linspace(0.05, 0.95, 7) * WINDOW / n
        ours = zip(*jax.device_get(under_hertz(line, places)), strict=True)
        truth = [hertz_by_closed_form(cauchy, np.asarray(line.x) - place) for place in places]
        each = [
            [largest_error(a, b) for a, b in zip(one, other, strict=True)]
            for one, other in zip(ours, truth, strict=True)
        ]
        errors.append(np.sqrt(np.mean(np.square(each), axis=0)))
    for name, error in zip(("stress", "voltage"), np.array(errors).T, strict=True):
        assert fitted_order(1 / cells, error) >= 1.9, name
        assert error[-1] < 3e-3, name


# What a line does with any stage.


@pytest.mark.full
@pytest.mark.parametrize("line", [LINES["open_even"], LINES["open_odd"]], ids=["even", "odd"])
def test_the_open_line_is_a_sum_over_cells_and_wraps_nothing(line):
    stage = full_sensor(AMPLIFIERS["current"]).output(SCAN)
    r = np.random.default_rng(0).normal(size=(2, line.n))
    lag = np.arange(line.n)[:, None] - np.arange(line.n)
    lags = jnp.arange(1 - line.n, line.n)
    kernel = np.asarray(eqx.filter_jit(stage.cell_response)(line.cell_m * lags, line.cell_m))
    expected = np.einsum("ecij,cj->ei", kernel[..., lag + line.n - 1], r)
    assert largest_error(apply(line, stage, jnp.asarray(r)), expected) < 1e-13


class Echoing(HalfSpace):
    """A half space that answers once more, far behind the load."""

    def strip_slope(self, x, depth_m, width_m):
        again = super().strip_slope(x + 0.08, depth_m, width_m)
        return super().strip_slope(x, depth_m, width_m) + again


STRIP = Film(0.75e-3, 0.5, effects=(SampleAverage(3, 4e-5), StripAverage(0.5e-3, 16)))
FAR_AWAY = {
    "near": Sensor([STRIP]),
    "a film far behind": Sensor([STRIP.with_effect(Offset(0.08))]),
    "a skin of one's own": Sensor([STRIP], Echoing()),
}


@pytest.mark.parametrize("sensor", FAR_AWAY.values(), ids=FAR_AWAY)
def test_responses_far_away_are_those_of_the_cells(sensor):
    """A long line's are taken from a series where it converges: the same to rounding, and their
    derivative after the depth."""
    n, cell = 2500, 5e-5

    def sensor_at(by):
        deeper = sensor.with_films(
            lambda film: eqx.tree_at(lambda f: f.depth_m, film, film.depth_m + by)
        )
        return deeper.output(SCAN)

    def by_line(by):
        operator = Open(n, cell).operator(sensor_at(by))
        return jnp.fft.irfft(operator.transfer, operator.length)[..., np.arange(1 - n, n)]

    def one_by_one(by):
        return sensor_at(by).cell_response(jnp.arange(1 - n, n) * cell, jnp.asarray(cell))

    ours, truth = (eqx.filter_jit(jax.jvp)(of, (0.0,), (1.0,)) for of in (by_line, one_by_one))
    for one, other in zip(ours, truth, strict=True):
        assert largest_error(one, other) < 1e-13


def test_the_open_line_has_no_lags_but_those_of_its_cells():
    """The gain at k = 0, by which it is told whether a mean is seen, is the sum over these."""
    n, line = 45, Open(45, 2e-4, -4.5e-3)
    operator = line.operator(Sensor([Film()]).output(ConstantSpeed(0.05)))
    ends = jnp.zeros((2, 2, n)).at[0, :, 0].set(1.0).at[1, :, -1].set(1.0)
    for c in range(2):
        first, last = (np.asarray(operator(end * (jnp.arange(2) == c)[:, None]))[0] for end in ends)
        gain = np.asarray(operator.transfer)[0, c, 0]
        size = np.abs(first).sum()
        np.testing.assert_allclose(gain, first.sum() + last.sum() - first[0], atol=1e-12 * size)


def test_the_periodic_line_wraps_around():
    line, stage = LINES["periodic_odd"], full_sensor().charge()
    r = np.random.default_rng(0).normal(size=(2, line.n))
    turned = apply(line, stage, jnp.asarray(np.roll(r, 17, axis=-1)))
    straight = apply(line, stage, jnp.asarray(r))
    assert largest_error(turned, np.roll(straight, 17, axis=-1)) < 1e-13


def test_only_the_periodic_line_is_circular():
    build = eqx.filter_jit(lambda line: line.operator(Sensor([Film()]).charge()))
    assert build(LINES["periodic_odd"]).is_circular
    assert not build(LINES["open_odd"]).is_circular


def test_both_lines_agree_far_from_the_ends():
    """Two discretisations of the same smooth traction, on a window sixty depths wide."""
    n, cell = 512, 45e-3 / 512
    both = [kind(n, cell, -22.5e-3) for kind in (Periodic, Open)]
    scene = TractionScene(0.0, 0.0, [Hertz(1.0, HALF_WIDTH, 0.0)])
    sensor = Sensor([Film(DEPTH, 0.0)])
    solve = eqx.filter_jit(lambda line: sensor.operator(line, SCAN)(scene.traction(line)))
    one, other = (solve(line)[0] for line in both)
    assert largest_error(one[192:320], other[192:320]) < 5e-3


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_differences_are_those_of_a_dense_matrix(line, order):
    eye = np.eye(line.n)
    step = np.roll(eye, 1, axis=1) - eye if isinstance(line, Periodic) else np.diff(eye, axis=0)
    dense = eye
    for _ in range(order):
        dense = step[: dense.shape[0] - isinstance(line, Open), : dense.shape[0]] @ dense
    r = np.random.default_rng(1).normal(size=(2, line.n))
    np.testing.assert_allclose(
        line.differences(jnp.asarray(r), order), r @ dense.T, atol=1e-13, rtol=0
    )


@pytest.mark.parametrize("n", [7, 8])
def test_half_spectrum(n):
    r = np.random.default_rng(2).normal(size=n)
    power = np.abs(np.fft.fft(r)) ** 2 / n
    weights = half_spectrum_weights(n)
    np.testing.assert_allclose(weights @ power[: n // 2 + 1], np.mean(power), rtol=1e-14)
    k = 2 * np.pi * np.fft.rfftfreq(n, 0.1)
    np.testing.assert_allclose(wavenumbers(n, 0.1), k, rtol=1e-15)
