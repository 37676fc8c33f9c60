"""Envelopes of the finger's contact zone: against direct quadrature of kernel times envelope."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv import config
from srsinv.errors import BadInput
from srsinv.forward.envelope import FingerprintRidges, FoundationPatch, HertzPatch
from srsinv.forward.film import Film, SampleAverage
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scenario import Scenario
from srsinv.forward.scene import TractionScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.simulation import Simulation
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import LINES, Open, Periodic, as_real
from tests.effects.test_effects import configuration
from tests.forward.setups import derivatives
from tests.refusals import refused
from tests.tiers import hardest, quick

DEPTH, HALF, OFFSET, PITCH, PHASE = 0.75e-3, 3e-3, 3e-4, 4e-4, 0.4
FILM = Film(DEPTH, 0.3, offset_m=OFFSET)
K = np.array([0.0, 150.0, -700.0, 2500.0, 1.6e4, 5e4])
SHAPES = {
    "hertz": (HertzPatch, lambda s: np.sqrt(np.maximum(1 - s**2, 0))),
    "foundation": (FoundationPatch, lambda s: np.maximum(1 - s**2, 0)),
}
RIDGES = FingerprintRidges(0.5, PITCH, PHASE)


def line_load(x):
    """The film's charge under unit line loads of p and q at -x, by Johnson (1985), 2.1."""
    t = (x + OFFSET) / DEPTH
    from_p, from_q = (-2 / (np.pi * DEPTH * (1 + t**2) ** 2) * t**n for n in (0, 1))
    stress = np.array(
        [[each * t**2, each, each * t, (each * t**2 + each) / 2] for each in (from_p, from_q)]
    )
    return np.einsum("s,csx->cx", FILM.charge_per_stress(np), stress)


def direct(shape, kernel, k, low=-HALF, high=HALF):
    """The integral of kernel times envelope times exp(-ikx) by Gauss's rule over the angle."""
    nodes, weights = np.polynomial.legendre.leggauss(1200)
    first, last = np.arcsin(np.clip([low / HALF, high / HALF], -1, 1))
    angle = (first + last) / 2 + nodes * (last - first) / 2
    x = HALF * np.sin(angle)
    ridges = 1 + 0.5 * np.cos(-2 * np.pi * x / PITCH + PHASE)
    values = kernel(x) * shape(x / HALF) * ridges * HALF * np.cos(angle) * (last - first) / 2
    return (values * weights) @ np.exp(-1j * np.outer(x, k))


@pytest.mark.parametrize("name", quick(SHAPES, "hertz"))
def test_the_transfer_is_that_of_kernel_times_envelope(name):
    zone, shape = SHAPES[name]
    sensor = Sensor([FILM], envelopes=[RIDGES, zone(HALF)])
    transfer = np.asarray(jax.jit(lambda k: sensor.charge().transfer(k))(jnp.asarray(K)))[0]
    wanted = direct(shape, line_load, K)
    np.testing.assert_allclose(transfer, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("name", hardest(SHAPES, ["hertz"], []))
def test_the_response_to_a_cell_is_exact(name):
    """In the middle, at both edges, across one and beyond it."""
    zone, shape = SHAPES[name]
    sensor, cell = Sensor([FILM], envelopes=[RIDGES, zone(HALF)]), 2e-4
    x = np.array([0.0, -2.95e-3, 2.95e-3, 3.05e-3, 3.2e-3, -1e-3])

    @jax.jit
    def responses(cell_m):
        stages = (sensor.film_signal(as_real(1.0), order) for order in (0, 1))
        return [stage.cell_response(jnp.asarray(x), cell_m)[0] for stage in stages]

    charge, slope = map(np.asarray, responses(as_real(cell)))
    ends = np.array([x - cell / 2, x + cell / 2])
    wanted = [direct(shape, line_load, np.zeros(1), *end)[:, 0].real for end in ends.T]
    np.testing.assert_allclose(charge.T, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    below, above = (
        line_load(at) * shape(at / HALF) * (1 + 0.5 * np.cos(-2 * np.pi * at / PITCH + PHASE))
        for at in ends
    )
    np.testing.assert_allclose(slope, above - below, rtol=0, atol=1e-9 * np.abs(above).max())


LAYERS = [Layer(1.5e-3, 7e5, 0.5), Layer(5e-3, 5e4, 0.3)]
SKINS = {
    "layers": Layered(LAYERS),
    "viscoelastic layers": Viscoelastic(Layered(LAYERS), [0.5], [1e-3]),
}


@pytest.mark.parametrize("name", hardest(SKINS, [], ["layers"]))
def test_every_skin_has_its_kernel_in_the_zone(name):
    """By the inverse Fourier sum of the skin's transfer, which has no singular point."""
    film = Film(DEPTH, 0.3)
    sensor = Sensor([film], SKINS[name], envelopes=[RIDGES, HertzPatch(HALF)])
    waves = np.arange(1, 16000) * 4.0  # up to 48 over the depth; repeats after 1.5 m
    plain = np.asarray(Sensor([film], SKINS[name]).charge().transfer(jnp.asarray(waves)))[0]
    mean = np.asarray(Sensor([film], SKINS[name]).charge().transfer(jnp.zeros(1)))[0].real

    def kernel(x):
        turning = np.exp(1j * np.outer(waves, x))
        return 4.0 / np.pi * ((plain @ turning).real + mean / 2)

    wanted = direct(SHAPES["hertz"][1], kernel, K)
    transfer = np.asarray(sensor.charge().transfer(jnp.asarray(K)))[0]
    np.testing.assert_allclose(transfer, wanted, rtol=0, atol=1e-8 * np.abs(wanted).max())


def signal_of(sensor: Sensor, line: Any, scene: TractionScene) -> np.ndarray:
    sim = Simulation(Scenario(scene, sensor, ConstantSpeed(0.05)), line, line, 1)
    return np.asarray(sim.signal())


@pytest.mark.parametrize("line", [Periodic(64, 1e-4), Open(64, 1e-4)], ids=["periodic", "open"])
def test_a_smooth_surface_at_constant_load_gives_no_signal(line):
    sensor = Sensor(envelopes=[HertzPatch(2e-3), RIDGES])
    assert np.abs(signal_of(sensor, line, TractionScene(1e4, 0.5))).max() < 1e-20


def change(half_depths: float, zone: Any) -> float:
    """Relative rms change of a ridge's signal by a zone of so many depths."""
    sim = config.simulation(configuration("scene=ridge", "grid.cells=256"))
    sensor = sim.sensor.with_envelope(zone(half_depths * DEPTH))
    zoned = dataclasses.replace(sim, scenario=sim.scenario.replace(sensor=sensor))
    ideal = np.asarray(sim.signal())
    return float(np.linalg.norm(np.asarray(zoned.signal()) - ideal) / np.linalg.norm(ideal))


@pytest.mark.parametrize("name", hardest(SHAPES, [], ["hertz"]))
def test_the_wider_the_zone_the_nearer_is_the_infinite_model(name):
    zone = SHAPES[name][0]
    changes = [change(depths, zone) for depths in (2, 5, 10, 200)]
    assert changes == sorted(changes, reverse=True)
    assert changes[0] < 0.39
    assert changes[2] > 1e-3 > changes[3]


def test_samples_are_averaged_behind_the_zone():
    """And strips within it: where a strip has a zero the edge of the zone has none."""
    average, zone = SampleAverage(3, 2e-4), FoundationPatch(HALF)
    k = jnp.asarray([150.0, 2 * np.pi / float(FILM.width_m)])
    wide = FILM.with_strip_average()
    films = [FILM, FILM.with_effect(average), wide]
    stage = Sensor(films, envelopes=[zone]).charge()
    plain, averaged, strip = map(np.asarray, jax.jit(lambda k: stage.transfer(k))(k))
    factor = np.asarray(average.transfer(k))
    np.testing.assert_allclose(averaged, plain * factor, rtol=1e-9)
    infinite = np.asarray(Sensor([wide]).charge().transfer(k))[0]
    assert np.all(np.abs(strip[:, 1]) > 1e3 * np.abs(infinite[:, 1]))


@pytest.mark.parametrize("kind", hardest(["periodic", "open"], [], ["periodic"]))
def test_gradients_by_every_length(kind):
    """Forward and in reverse, against differences."""
    line = LINES[kind](32, 1e-4)
    r = jnp.asarray(np.random.default_rng(0).normal(size=(2, 32)))

    @jax.jit
    def signal(at):
        half, pitch, depth = at * 1e-3
        zone = HertzPatch(half, terms=32)
        sensor = Sensor([Film(depth, 0.3)], envelopes=[zone, FingerprintRidges(0.5, pitch)])
        return line.operator(sensor.current(ConstantSpeed(0.05)))(r).ravel()[::5]

    at = jnp.array([1.43, 0.4, 0.8])
    value, forward, reverse = derivatives(signal, at)
    steps = 1e-5 * np.eye(3)
    differences = np.stack([(signal(at + d) - signal(at - d)) / 2e-5 for d in steps], axis=-1)
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-9 * np.abs(forward).max())
    np.testing.assert_allclose(forward, differences, rtol=0, atol=1e-5 * np.abs(forward).max())
    assert np.isfinite(value).all()


def test_half_widths_under_a_load():
    """Johnson (1985), 4.43 and 4.59: the zone carries the load at the indentation's pressure."""
    solid = HertzPatch.under_load(12.5e-3, 100.0, 9.3e5)
    assert float(solid.half_width_m) == pytest.approx(np.sqrt(4 * 100 * 12.5e-3 / (np.pi * 9.3e5)))
    foam = FoundationPatch.under_load(12.5e-3, 60.0, 1.3e7)
    xi = np.linspace(-1, 1, 20001) * float(foam.half_width_m)
    pressure = 1.3e7 * (float(foam.half_width_m) ** 2 - xi**2) / (2 * 12.5e-3)
    assert np.trapezoid(pressure, xi) == pytest.approx(60.0, rel=1e-6)


def test_refusals():
    refused(lambda: Sensor(envelopes=[HertzPatch(1e-3), FoundationPatch(2e-3)]), "2 contact zones")
    refused(lambda: HertzPatch(-1e-3), "half_width_m", "-0.001")
    refused(lambda: FingerprintRidges(1.5, 4e-4), "modulation", "1.5")
    refused(lambda: config.effects(configuration(
        "effects=[finite_patch]", "effects.finite_patch.half_width_m=null",
        "effects.finite_patch.radius_m=0.0125",
    )), "half_width_m", "foundation_Pa_per_m")  # fmt: skip
    with pytest.raises(BadInput, match="at most pi/3"):
        config.simulation(configuration("effects=[finite_patch,oblique_features]",
                                        "effects.oblique_features.angle_deg=70"))  # fmt: skip
