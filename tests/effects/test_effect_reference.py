"""The reference that screens effects: its contact, and what rounding makes of a change."""

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv import config
from srsinv.effects._reference import _pressure, reference
from srsinv.effects._reference_contact import pressure_under
from srsinv.effects._rounding import RoundedSignal
from srsinv.effects._signal_and_stress import signal_and_stress
from srsinv.forward.contact import press
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Periodic
from tests.effects.test_effects import configuration


@pytest.mark.full
@pytest.mark.parametrize("name", ["ridge", "tape", "rough"])
def test_the_reference_contact_is_accurate_to_one_per_cent(name):
    """Of the pressure's deviation behind the rubber over the film, |k| e^(-kz); where a profile
    touches everywhere, to round-off."""
    sim = config.simulation(configuration("effects=[]", f"scene={name}"))
    k = np.asarray(sim.line.k)
    transfer = k * np.exp(-k * 0.75e-3)
    looked, solved = (
        np.fft.rfft(each)
        for each in (_pressure(sim.scene, sim.line, k), sim.scene.pressure(sim.line))
    )
    off = np.linalg.norm(transfer * (looked - solved)) / np.linalg.norm(transfer * solved)
    assert off < (1e-2 if np.any(sim.scene.pressure(sim.line) == 0) else 1e-9)


def test_the_reference_contact_of_grazing_profiles():
    """Spikes of one cell, of which next to nothing touches; the load is kept."""
    sim = config.simulation(configuration("effects=[]", "scene=ridge"))
    k, height = np.asarray(sim.line.k), np.zeros(sim.line.n)
    height[[40, 90]] = 1e-4, 2e-4
    compliance = np.append(0.0, 2 / (9.3e5 * k[1:]))
    for load in (1e-6, 1.0, 1e3):
        p = pressure_under(height, load, compliance)
        solved = press(sim.line, HalfSpace(), jnp.asarray(height), load).pressure_Pa
        assert p.mean() == pytest.approx(load, rel=1e-12)
        assert np.all(p >= 0)
        assert np.abs(p - solved).max() < 0.05 * p.max()


STEP = 0.05
x = np.arange(512) / 512
SIGNALS = {
    "phases spread evenly": np.cos(2 * np.pi * 3.7 * x) + np.sin(2 * np.pi * 51.3 * x),
    "the same samples again and again": np.cos(2 * np.pi * 64 * x + 0.3),
    "level, next to a tie": 10.4999 * STEP + np.where(x < 0.1, 0.8, 0.0),
    "zero but for a peak": np.exp(-(((x - 0.5) / 0.02) ** 2)),
}
SHAPES = {
    "noise": np.random.default_rng(0).standard_normal(512),
    "level": np.ones(512),
    "wave": np.cos(2 * np.pi * 9 * x),
}


@pytest.fixture(scope="module")
def spectra():
    sim = config.simulation(configuration("effects=[]", "sensor=one_element"))
    return reference(sim.scenario, Periodic(512, 1.0 / 512))


@pytest.mark.parametrize("name", SIGNALS)
def test_rounding_makes_no_more_of_a_change_than_its_bound(name, spectra):
    samples, ratios = SIGNALS[name], []
    size = float(np.sqrt(np.mean(samples**2)))
    given = spectra.replace(simulated=np.fft.rfft(samples)[None], signal_rms=size)
    for change in np.geomspace(1e-5, 1, 20) * STEP:
        bound = size * RoundedSignal(given, STEP / size).bound(change / size)
        for shape in SHAPES.values():
            other = samples + change * shape / np.sqrt(np.mean(shape**2))
            moved = STEP * (np.round(other / STEP) - np.round(samples / STEP))
            rms = np.sqrt(np.mean(moved**2))
            # Where one sample is a thousand times unlikely to turn, one is let turn.
            assert rms <= max(bound, 1.01 * STEP / np.sqrt(512))
            ratios.append(bound / max(rms, change))
    # Nor is it far above where many samples turn.
    assert name != "phases spread evenly" or np.median(ratios) < 4


KINDS = {
    "strip": "strip_width",
    "electronics": "strip_width,element_offsets,film_angle,amplifier_bandwidth,antialias_filter",
    "skins": "strip_width,layered_skin,viscoelastic_skin",
    "oblique": "strip_width,layered_skin,oblique_features,antialias_filter",
}


CASES = [("open", "strip"), *(("periodic", kind) for kind in KINDS if kind != "strip")]


@pytest.mark.full
@pytest.mark.parametrize(("line", "kind"), CASES)
def test_the_signal_that_screens_is_the_simulated_one(line, kind):
    """And the stress at the films: in the factors' product as in the compiled program."""
    offset = "sensor.elements.upright.offset_m=3e-4"
    sim = config.simulation(configuration(f"effects=[{KINDS[kind]}]", f"grid.line={line}", offset))
    signal, stress = signal_and_stress(sim)
    compiled = np.asarray(sim.signal()), np.asarray(sim.response(sim.sensor.stress()))
    for own, wanted in zip((signal, stress.reshape(8, -1)), compiled, strict=True):
        np.testing.assert_allclose(own, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
