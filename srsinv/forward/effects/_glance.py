"""A quick look at a scene: enough to bound what an effect would change, without simulating it.

All is numpy, on one grid, with the half space's stress and contact: beside the traction or a
surface's height, which a simulation needs too, next to nothing is compiled.
"""

import dataclasses
import math
from dataclasses import dataclass, field

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Complex, Float, Inexact

from ...grid import Line, Periodic, half_spectrum_weights
from ..scene import SurfaceScene, deviation
from ..setup import Setup
from ..skin import HalfSpace, half_space_stress
from ._contact import pressure_under

TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class Glance:
    """A bare setup's signal, by wavenumber.

    - `setup`, `line`: what is looked at, without any effect.
    - `k` (k,) [rad/m]; `traction` (2, k): spectrum of p and q [Pa]; `background_Pa` (2,).
    - `stress` (e, 4, 2, k): stress at the films per traction; `weights` (e, 4): charge per stress.
    - `gain`, `order`: of the readout.
    - `passed` (e, k): what other effects let pass of a change; `size`: the signal's rms with all of
      them and the one that is looked at; `peak`: how far noise may take a sample; `swing`: by what
      factor others may raise it.
    - `interval_s`: the shortest between samples. `measured` (e, k): the signal's spectrum, where
      more is known than the half space's.
    """

    setup: Setup
    line: Line
    k: Float[np.ndarray, " k"]
    traction: Complex[np.ndarray, "2 k"]
    background_Pa: Float[np.ndarray, "2"]
    stress: Complex[np.ndarray, "e 4 2 k"]
    weights: Float[np.ndarray, "e 4"]
    gain: float
    order: int
    passed: Inexact[np.ndarray, "e k"]
    interval_s: float
    charge: Complex[np.ndarray, "e k"] = field(init=False)
    signal: Complex[np.ndarray, "e k"] = field(init=False)
    measured: Complex[np.ndarray, "e k"] | None = None
    size: float = 0.0
    peak: float = 0.0
    swing: float = 1.0

    def __post_init__(self):
        charge = np.einsum("es,esck,ck->ek", self.weights, self.stress, self.traction)
        object.__setattr__(self, "charge", charge)
        signal = self.read(charge) if self.measured is None else self.measured
        object.__setattr__(self, "signal", signal)
        if not self.size:
            object.__setattr__(self, "size", self.size_within(self.passed, math.inf))

    def but(self, **changed) -> "Glance":
        """The same look with other parts."""
        return dataclasses.replace(self, **changed)

    def heard(
        self, signal: Float[np.ndarray, "e n"], passed: Inexact[np.ndarray, "e k"]
    ) -> "Glance":
        """A look at the signal (e, n) with effects of which the factors let this pass: traction is
        raised as the signal is."""
        some = np.fft.rfft(signal) * (self.line.n / signal.shape[1])
        measured = np.zeros_like(self.signal)
        measured[:, : some.shape[1]] = some
        raised = max(1.0, self.rms(measured) / max(self.rms(passed * self.signal), TINY))
        background = raised * self.background_Pa
        return self.but(
            traction=raised * self.traction, background_Pa=background, measured=measured
        )

    def size_within(self, passed: Inexact[np.ndarray, "e k"], rail: float) -> float:
        """Rms of the signal of which this passes, its samples cut at +-`rail`."""
        samples = np.clip(np.fft.irfft(passed * self.signal, self.line.n), -rail, rail)
        return max(float(np.sqrt(np.mean(samples**2))), TINY)

    def read(self, charge: Inexact[np.ndarray, "e k"]) -> Complex[np.ndarray, "e k"]:
        """The signal's spectrum from that of the charge."""
        return self.gain * (1j * self.k) ** self.order * charge

    @property
    def largest(self) -> Float[np.ndarray, "e k"]:
        """The charge's spectrum if nothing cancelled: all stresses by their size."""
        size = np.abs(self.weights), np.abs(self.stress), np.abs(self.traction)
        return np.einsum("es,esck,ck->ek", *size)

    @property
    def speed_m_per_s(self) -> float:
        """Of the sliding."""
        return float(self.setup.scan.speed_m_per_s)

    def rms(self, spectrum: Inexact[np.ndarray, "e k"]) -> float:
        """Root mean square over all elements and positions of a signal with this spectrum."""
        weights = half_spectrum_weights(self.line.n) / self.line.n
        return float(np.sqrt(np.mean(np.abs(spectrum) ** 2 @ weights)))

    def share(self, change: Inexact[np.ndarray, "e k"]) -> float:
        """What part of the signal a change of this spectrum is, rms over rms."""
        return self.rms(self.passed * change) / self.size

    def anywhere(self, fraction: float) -> float:
        """What part of the signal a change by this fraction of it is, at whatever wavenumber it
        comes back: through partial contact, which is not linear."""
        return fraction * self.rms(self.signal) / self.size

    def beyond(self, limit: float) -> float:
        """What part of the signal is beyond +-`limit`, rms over rms, noise at its peak added."""
        samples = np.fft.irfft(self.passed * self.signal, self.line.n)
        over = np.maximum(self.swing * np.abs(samples) + self.peak - limit, 0.0)
        return float(np.sqrt(np.mean(over**2)) / self.size)

    @property
    def lifts(self) -> bool:
        """Whether the skin lifts off somewhere."""
        p = np.fft.irfft(self.traction[0], self.line.n) + self.background_Pa[0]
        return bool(p.min() <= 1e-12 * p.max())


def glance(setup: Setup, line: Line) -> Glance:
    """A look at `setup`, which has a scene, on `line`.

    The traction's program is the one that a simulation on the same line has.
    """
    scene, sensor, direction = setup.scene, setup.sensor, setup.scan.direction
    assert scene is not None
    assert isinstance(sensor.skin, HalfSpace), "a look is without effects"
    # All that can be is numpy: what is run once takes longer to compile.
    k = 2 * np.pi * np.fft.rfftfreq(line.n, np.asarray(line.cell_m))
    nu = np.asarray(sensor.skin.poisson_ratio)
    films = [jax.tree.map(np.asarray, film) for film in sensor.elements]
    stress = np.stack([half_space_stress(np, k, film.depth_m, nu) for film in films])
    weights = np.stack([film.charge_per_stress(np) for film in films])
    background, gain = map(np.asarray, _background_and_gain(setup))
    periodic = isinstance(line, Periodic)
    p = _pressure(scene, line, k) if isinstance(scene, SurfaceScene) else None
    traction = np.asarray(deviation(scene, line, direction, periodic, p))
    spectrum = np.fft.rfft(traction - background[:, None] if periodic else traction)
    all_of_it = np.ones((len(films), k.size))
    readout = float(gain), sensor.amplifier.order
    interval = float(line.cell_m) / max(abs(float(setup.scan.speed_m_per_s)), TINY)
    return Glance(
        setup, line, k, spectrum, background, stress, weights, *readout, all_of_it, interval
    )


def _pressure(scene: SurfaceScene, line: Line, k) -> Float[np.ndarray, " n"]:
    skin = jax.tree.map(float, scene.skin)
    mean = np.sinc(k * np.asarray(line.cell_m) / (2 * np.pi))
    at_centres = 2 / (skin.contact_modulus_Pa * k[1:] * mean[1:])
    height = np.asarray(scene.height(line))
    return pressure_under(height, float(scene.nominal_pressure_Pa), np.append(0.0, at_centres))


@eqx.filter_jit
def _background_and_gain(setup: Setup):
    scene, scan = setup.scene, setup.scan
    assert scene is not None
    gain = setup.sensor.amplifier.gain(scan.speed_m_per_s)
    return scene.background(scan.direction), gain
