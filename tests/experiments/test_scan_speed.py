"""A sine wave in full contact with rubber that relaxes, against closed forms."""

import numpy as np
import pytest

import srsinv
from experiments.scan_speed import asymmetry, pressed_at
from srsinv.forward.film import Film
from srsinv.forward.scene import SurfaceScene, TractionScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import SineWave
from srsinv.forward.viscoelastic import Viscoelastic
from tests.refusals import refused

LINE = srsinv.Periodic(256, 5e-5, -6.4e-3)
HEIGHT, WAVELENGTH, NOMINAL = 2e-6, 3.2e-3, 2e4
CREST, K = 3e-4, 2 * np.pi / WAVELENGTH


@pytest.mark.parametrize("speed", [0.01, 0.1])
def test_a_sine_wave_in_full_contact(speed):
    """p = nominal + E* k h/2 (m' cos kx - m'' sin kx): odd over even m''/m', and the friction of
    the lag E* k^2 h^2 m''/4 over the nominal pressure."""
    skin = Viscoelastic(HalfSpace(), [0.5, 0.5], [1e-3, 1e-2])
    sensor = Sensor([Film()], skin)
    scene = SurfaceScene(NOMINAL, [SineWave(HEIGHT, WAVELENGTH, CREST)], 0.4)
    p, _, friction, height = pressed_at(LINE, scene, sensor, speed)
    turn = 1j * K * speed * np.array([1e-3, 1e-2])
    m, plane = 1 + 0.5 * np.sum(turn / (1 + turn)), 7e5 / 0.75
    x = np.asarray(LINE.x) - CREST
    full = NOMINAL + plane * K * HEIGHT / 2 * (m.real * np.cos(K * x) - m.imag * np.sin(K * x))
    cell = np.sinc(K * 5e-5 / 2 / np.pi)  # averages of p over the cells
    np.testing.assert_allclose(p - NOMINAL, cell * (full - NOMINAL), atol=1e-9 * NOMINAL)
    assert asymmetry(p[None], height)[0] == pytest.approx(m.imag / m.real, rel=1e-9)
    work = plane * (K * HEIGHT) ** 2 * m.imag / 4 / NOMINAL
    assert friction == pytest.approx(work * cell, rel=1e-9)


def test_what_has_no_contact_or_no_lag_is_refused():
    scene = SurfaceScene(NOMINAL, [SineWave(HEIGHT, WAVELENGTH)], 0.4)
    one = Sensor([Film()], Viscoelastic(HalfSpace(), [0.5], [1e-3]))
    refused(lambda: pressed_at(LINE, TractionScene(), one, 0.05), "no surface", "scene=ridge")
    refused(lambda: pressed_at(LINE, scene, Sensor([Film()]), 0.05), "elastic")
    refused(lambda: pressed_at(LINE, scene, Sensor(), 0.05), "2 elements")
