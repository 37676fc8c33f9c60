"""A quick look at a scene: enough to bound what an effect would change, without simulating it.

All is numpy, on one grid, with the half space's stress: one small program is compiled, whatever the
effects are.
"""

from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Inexact

from ...grid import Line, half_spectrum_weights
from ..setup import Setup


@dataclass(frozen=True)
class Glance:
    """A bare setup's signal, by wavenumber.

    - `setup`, `line`: what is looked at, without any effect.
    - `k` (k,) [rad/m]; `traction` (2, k): spectrum of p and q [Pa]; `background_Pa` (2,).
    - `stress` (e, 4, 2, k): stress at the films per traction; `weights` (e, 4): charge per stress.
    - `derivative` (k,), `gain`: of the readout, signal = gain * derivative * charge.
    """

    setup: Setup
    line: Line
    k: Float[np.ndarray, " k"]
    traction: Complex[np.ndarray, "2 k"]
    background_Pa: Float[np.ndarray, "2"]
    stress: Complex[np.ndarray, "e 4 2 k"]
    weights: Float[np.ndarray, "e 4"]
    gain: float
    charge: Complex[np.ndarray, "e k"] = field(init=False)
    signal: Complex[np.ndarray, "e k"] = field(init=False)

    def __post_init__(self):
        charge = np.einsum("es,esck,ck->ek", self.weights, self.stress, self.traction)
        object.__setattr__(self, "charge", charge)
        object.__setattr__(self, "signal", self.read(charge))

    def read(self, charge: Inexact[np.ndarray, "e k"]) -> Complex[np.ndarray, "e k"]:
        """The signal's spectrum from that of the charge."""
        order = self.setup.sensor.amplifier.order
        return self.gain * (1j * self.k) ** order * charge

    @property
    def largest(self) -> Float[np.ndarray, "e k"]:
        """The charge's spectrum if nothing cancelled: all stresses by their size."""
        size = np.abs(self.weights), np.abs(self.stress), np.abs(self.traction)
        return np.einsum("es,esck,ck->ek", *size)

    @property
    def speed_m_per_s(self) -> float:
        """Of the sliding."""
        return float(self.setup.scan.speed_m_per_s)

    @property
    def duration_s(self) -> float:
        """How long the sliding over the line takes."""
        return self.line.n * float(self.line.cell_m) / abs(self.speed_m_per_s)

    def rms(self, spectrum: Inexact[np.ndarray, "e k"]) -> float:
        """Root mean square over all elements and positions of a signal with this spectrum."""
        weights = half_spectrum_weights(self.line.n) / self.line.n
        return float(np.sqrt(np.mean(np.abs(spectrum) ** 2 @ weights)))

    def share(self, change: Inexact[np.ndarray, "e k"]) -> float:
        """What part of the signal a change of this spectrum is, rms over rms."""
        return self.rms(change) / max(self.rms(self.signal), np.finfo(float).tiny)

    def beyond(self, limit: float) -> float:
        """What part of the signal is beyond +-`limit`, rms over rms."""
        over = np.maximum(np.abs(np.fft.irfft(self.signal, self.line.n)) - limit, 0.0)
        size = self.rms(self.signal)
        return float(np.sqrt(np.mean(over**2)) / max(size, np.finfo(float).tiny))

    @property
    def lifts(self) -> bool:
        """Whether the skin lifts off somewhere."""
        p = np.fft.irfft(self.traction[0], self.line.n) + self.background_Pa[0]
        return bool(p.min() <= 1e-12 * p.max())


def glance(setup: Setup, line: Line) -> Glance:
    """A look at `setup`, which has a scene, on `line`."""
    k, traction, background, stress, weights, gain = map(np.asarray, _looked(setup, line))
    return Glance(setup, line, k, np.fft.rfft(traction), background, stress, weights, float(gain))


@eqx.filter_jit
def _looked(setup: Setup, line: Line):
    scene, sensor, scan = setup.scene, setup.sensor, setup.scan
    assert scene is not None
    background = scene.background(scan.direction)
    stress = [sensor.skin.transfer(line.k, film.depth_m) for film in sensor.elements]
    weights = [film.charge_per_stress() for film in sensor.elements]
    return (
        line.k,
        scene.traction(line, scan.direction) - background[:, None],
        background,
        jnp.stack(stress),
        jnp.stack(weights),
        sensor.amplifier.gain(scan.speed_m_per_s),
    )
