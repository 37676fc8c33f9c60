"""The profile from the pressure: what contact gives taken back, and its band against draws."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.shape_from_traction.shape import shape_band, shape_under
from srsinv.forward.contact import press
from srsinv.forward.noise import draw, exponential_spectrum
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Cylinder, Ridge, Surface
from srsinv.forward.traction import Hertz
from srsinv.grid import Periodic
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.spectral import solve
from srsinv.inverse.wiener import Exponential, SpectralPrior, Wiener
from tests.inverse.cases import make_line, make_operator

SKIN = HalfSpace()
E_STAR_PA = 7e5 / 0.75


@pytest.mark.parametrize("shape", [Ridge(40e-6, 6e-4), Cylinder(0.01)])
def test_takes_contact_back(shape):
    line = Periodic(512, 0.02 / 512, -0.01)
    height = Surface([shape]).height(line)
    contact = press(line, SKIN, height, 2e3)
    left = np.asarray(shape_under(line, SKIN, contact.pressure_Pa) - height)
    touching = np.asarray(contact.touching)
    assert 5 < touching.sum() < 500
    span = float(jnp.ptp(height))
    assert np.ptp(left[touching]) < 1e-9 * span
    # Elsewhere it is the skin over the gap.
    gap = left - left[touching].mean()
    np.testing.assert_allclose(gap, np.asarray(contact.gap_m), rtol=0, atol=1e-9 * span)


def test_hertz():
    """A parabola under the pressure of a cylinder; the repeated ones bend it by a little."""
    pressure, half_width, window = 2e4, 1e-3, 0.1
    line = Periodic(8192, window / 8192, -window / 2)
    w = np.asarray(shape_under(line, SKIN, Hertz(pressure, half_width).cell_average(line)))
    x = np.asarray(line.x)
    inside = np.abs(x) < 0.98 * half_width
    radius = E_STAR_PA * half_width / (2 * pressure)
    load = np.pi * half_width * pressure / 2
    others = 2 * load / (np.pi * E_STAR_PA) * np.pi**2 / (3 * window**2)
    expected = (others - 1 / radius) * x**2 / 2
    error = (w - expected)[inside]
    assert np.ptp(error) < 1e-3 * half_width**2 / (2 * radius)


def test_westergaard():
    """Partial contact with a wave, from the closed form's pressure."""
    amplitude, length, load_fraction = 5e-6, 2e-3, 0.5  # sin^2(pi a/L)
    line = Periodic(1024, length / 1024, -length / 2)
    nominal = load_fraction * np.pi * E_STAR_PA * amplitude / length
    fine = (np.arange(1024 * 64) + 0.5) / 64 - 0.5  # points within the cells
    phase = np.pi / length * (float(line.x[0]) + fine * float(line.cell_m))
    root = np.sqrt(np.maximum(load_fraction - np.sin(phase) ** 2, 0.0))
    p = (2 * nominal * np.cos(phase) * root / load_fraction).reshape(-1, 64).mean(axis=1)
    w = np.asarray(shape_under(line, SKIN, jnp.asarray(p)))
    x = np.asarray(line.x)
    inside = np.sin(np.pi * x / length) ** 2 < 0.98 * load_fraction
    error = (w - amplitude * np.cos(2 * np.pi * x / length))[inside]
    assert np.ptp(error) < 1e-4 * amplitude


def _draws(n: int, draws: int):
    """Tractions (draw, 2, n) from the filter's own spectra, their noisy signals (draw, 2, n), and
    the problem of the first."""
    line = make_line(n=n)
    forward = make_operator(line)
    noise = np.full(line.k.shape, 1e-6**2)

    @jax.jit
    def drawn():
        first, second = jax.random.split(jax.random.key(1))
        power = 1e3**2 * exponential_spectrum(line.k, line.cell_m, 1e-3).at[0].set(0.0)
        truth = draw(first, power, 2 * draws, n).reshape(draws, 2, n)
        added = draw(second, jnp.asarray(noise), 2 * draws, n).reshape(draws, 2, n)
        return truth, jax.vmap(forward)(truth) + added

    truth, signals = jax.device_get(drawn())
    noise[0] = np.inf  # of a mean
    return LineProblem(line, forward, signals[0], noise), truth, signals


METHOD = {path: Wiener(Exponential(1e3, 1e-3), Exponential(1e3, 1e-3), path=path)
          for path in ("spectral", "direct")}  # fmt: skip


@pytest.mark.full
def test_band_is_what_draws_scatter_by():
    n = 48
    problem, truth, signals = _draws(n, 2000)
    touching = jnp.asarray((np.arange(n) > 8) & (np.arange(n) < 30))
    method = METHOD["spectral"]
    profile, stderr = shape_band(problem.line, SKIN, method(problem), touching)

    @jax.jit
    def profiles(signals, truth):
        prior = SpectralPrior(jnp.stack([s.power(problem) for s in (method.p, method.q)]))

        def values(data):
            return solve(eqx.tree_at(lambda p: p.data, problem, data), prior).value[0]

        p = jax.vmap(values)(signals)
        w = shape_under(problem.line, SKIN, jnp.stack([p, truth[:, 0]]))
        return w - jnp.mean(w, axis=-1, keepdims=True, where=touching)

    w = np.asarray(profiles(signals, truth))
    np.testing.assert_allclose(w[0, 0], profile, rtol=1e-9, atol=1e-15)
    scatter = np.sqrt(np.mean(np.asarray(w[0] - w[1]) ** 2, axis=0))
    np.testing.assert_allclose(scatter, stderr, rtol=0.06)


@pytest.mark.full
def test_both_paths_have_the_same_band():
    problem, _, _ = _draws(48, 1)
    touching = jnp.asarray(np.arange(48) < 20)
    bands = [shape_band(problem.line, SKIN, method(problem), touching)
             for method in METHOD.values()]  # fmt: skip
    for one, other in zip(*bands, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-12)
