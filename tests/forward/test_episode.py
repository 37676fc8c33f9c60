"""Contact episodes: the signal against the traction's own charge, the edge against a scene."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import ChargeReadout
from srsinv.forward.episode import (
    Episode,
    PassingEdge,
    Ramp,
    RecordedEpisode,
    sampled,
    slip_noise,
)
from srsinv.forward.film import Film, Offset
from srsinv.forward.filter import FirstOrder
from srsinv.forward.partial_slip import CylinderContact
from srsinv.forward.scene import SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Cylinder, Ridge, StepUp
from srsinv.grid import Periodic
from tests.refusals import refused
from tests.tiers import quick

SENSOR, RATE, LOAD, OHM = Sensor(), 5000.0, 20.0, 1e6
FINGER = CylinderContact(0.01, 0.6e-3)
TOUCH, PULL, RELEASE = Ramp(0.1003, 0.05), Ramp(0.3, 0.1), Ramp(0.6, 0.05)


def episode(**others):
    return Episode(FINGER, LOAD, TOUCH, PULL, release=RELEASE, **others)


def test_the_signal_is_the_change_of_charge_and_rest_is_silent():
    own = RecordedEpisode(episode(), SENSOR)
    signal = own.signal(RATE, 4000)
    charge = own.charge(np.arange(4000) / RATE)
    np.testing.assert_allclose(np.cumsum(signal, 1) / RATE, OHM * charge, atol=1e-12 * OHM * 1e-9)
    time = np.arange(4000) / RATE
    for start, end in ((0.0, 0.1), (0.151, 0.3), (0.48, 0.6), (0.66, 0.8)):
        assert np.abs(signal[:, (time > start) & (time < end)]).max() < 1e-8
    slow = Sensor(amplifier=ChargeReadout(1e9))
    np.testing.assert_allclose(
        RecordedEpisode(episode(), slow).signal(RATE, 4000), 1e9 * charge, rtol=1e-12, atol=1e-12
    )


def test_first_contact_between_two_samples_is_averaged():
    """So that samples half as often are the means of neighbours, whenever contact begins."""
    own = RecordedEpisode(episode(), SENSOR)
    often, seldom = (own.signal(rate, n) for rate, n in ((1e4, 2001), (5e3, 1001)))
    np.testing.assert_allclose(seldom[:, 1:], (often[:, 1::2] + often[:, 2::2])[:, :1000] / 2,
                               atol=1e-15)  # fmt: skip
    assert np.abs(seldom[:, 502]).max() > 1e-5


def test_the_shear_reaches_friction_times_load_and_follows_it():
    own = episode(friction=0.6, sliding_friction=0.4, drop_s=2e-3)
    time = np.array([0.2, 0.35, 0.3999, 0.4, 0.5, 0.63, 0.7])
    load, shear, mu, slips = own.forces(time)
    np.testing.assert_allclose(load[:5], LOAD)
    assert shear[0] == 0
    assert shear[1] == pytest.approx(0.6 * LOAD / 4)
    assert shear[2] == pytest.approx(0.6 * LOAD, rel=3e-3)
    np.testing.assert_allclose(shear[3:], (mu * load)[3:])
    assert (mu[3], mu[4]) == (pytest.approx(0.6), pytest.approx(0.4))
    assert slips.tolist() == [False] * 3 + [True] * 3 + [False]
    onsets = RecordedEpisode(own, SENSOR).onsets_s
    assert list(onsets) == ["first contact", "incipient slip", "full slip", "loss of contact"]
    np.testing.assert_allclose(list(onsets.values()), [0.1003, 0.3, 0.4, 0.6])


EDGES = {"ridge": Ridge(1e-5, 2e-4, 0.0, 2e-5), "step": StepUp(2e-5, 0.0, 2e-5)}


@pytest.mark.parametrize("name", quick(EDGES, "step"))
def test_an_edge_is_that_of_the_scene_at_rest(name):
    """At two places, on a line with the film beside the finger."""
    shape = EDGES[name]
    edge = PassingEdge(shape, 0.5, 0.05)
    added = edge.charge(SENSOR, FINGER, LOAD, 0.4)
    line = Periodic(4096, 1e-5, -2048e-5)
    charge = line.operator(SENSOR.charge())

    def under(*shapes):
        scene = SurfaceScene(LOAD / 0.04096, [Cylinder(0.01), *shapes], 0.4)
        return np.asarray(charge(scene.traction(line)))[:, 2048 - 60]

    size = np.abs(added(added.x)).max()
    for place in (0.3e-3, -0.2e-3):
        moved = eqx.tree_at(lambda each: each.position_m, shape, jnp.asarray(place))
        expected = under(moved) - under()
        assert np.abs(expected).max() > 0.1 * size
        np.testing.assert_allclose(added(0.5 - place / 0.05), expected, atol=1e-2 * size)
    assert np.abs(added(added.x[[0, -1]])).max() < 1e-6 * size


def test_an_element_with_an_offset_is_at_its_place():
    """A film that lies towards the finger responds as one at the origin to a nearer finger."""
    near = CylinderContact(0.01, 0.2e-3).charge(Sensor([Film()]), LOAD)
    moved = FINGER.charge(Sensor([Film().with_effect(Offset(0.4e-3))]), LOAD)
    forces = np.array([5.0, 20.0]), np.array([1.0, 8.0]), np.full(2, 0.5)
    np.testing.assert_allclose(moved(*forces), near(*forces), rtol=1e-8)


def test_filters_act_on_the_samples():
    lag = Sensor(filters=[FirstOrder(2e-3)])
    charge = np.append(np.zeros((2, 200)), np.full((2, 800), 1e-9), axis=1).cumsum(1)
    end = sampled(lag, charge, RATE)[:, -1]
    np.testing.assert_allclose(end, OHM * 1e-9 * RATE, rtol=1e-3)


def test_noise_of_sliding_has_its_rms_and_correlation_in_full_slip_alone():
    slips = np.zeros(200_000, bool)
    slips[1000:-1000] = True
    noise = slip_noise(jax.random.key(1), slips, 3e-6, 20.0, 2)
    assert not noise[:, ~slips].any()
    inside = noise[:, 2000:-2000]
    assert np.sqrt(np.mean(inside**2)) == pytest.approx(3e-6, rel=0.05)
    lag = np.mean(inside[:, 20:] * inside[:, :-20]) / np.mean(inside**2)
    assert lag == pytest.approx(np.exp(-1), abs=0.05)
    assert abs(np.corrcoef(inside)[0, 1]) < 0.1


def test_what_cannot_happen_is_refused():
    def made(*given, **others):
        return lambda: Episode(FINGER, LOAD, *given, **others)

    refused(made(TOUCH, Ramp(0.12, 0.1)), "order touch, pull, edge, release")
    refused(made(TOUCH, edge=PassingEdge(Ridge(1e-5, 2e-4), 0.5)), "give a pull")
    refused(made(TOUCH, friction=0.3, sliding_friction=0.4), "at most 0.3")
    refused(lambda: Ramp(0.0, 0.0), "duration_s")
    refused(lambda: Ramp(0.0, 1.0, 0.5), "exponent")
    refused(lambda: PassingEdge(Ridge(1e-5, 2e-4), 0.5, 0.0), "speed_m_per_s")
    high = PassingEdge(Ridge(5e-3, 2e-4), 0.5)
    refused(lambda: high.charge(SENSOR, FINGER, 0.1, 0.4), "lower edge")
    flat = PassingEdge(Ridge(0.0, 2e-4), 0.5)
    refused(lambda: flat.charge(SENSOR, FINGER, LOAD, 0.4), "flat")
    recorded = RecordedEpisode(episode(), SENSOR)
    refused(lambda: recorded.signal(-RATE, 100), "rate_hz")
    refused(lambda: recorded.signal(RATE, 0), "samples")


@pytest.mark.full
@pytest.mark.parametrize("at_s", [0.41, 0.59])
def test_an_edge_touches_in_full_slip_alone(at_s):
    early = episode(edge=PassingEdge(StepUp(1e-5), at_s))
    refused(lambda: RecordedEpisode(early, SENSOR).onsets_s, "not all in full slip")
