"""Reference spectra of a scene: they bound the change by an effect, without simulating it.

All is numpy, on one grid, with the half space's stress and contact: beside the traction or a
surface's height, which a simulation needs too, little is compiled.
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Complex, Float, Inexact

from ..compiled import compiled
from ..errors import refuse
from ..forward.scan import Motion
from ..forward.scenario import Scenario
from ..forward.scene import SurfaceScene, deviation
from ..grid import Line, Periodic, half_spectrum_weights
from ._reference_contact import pressure_under

TINY = np.finfo(float).tiny
NO_PRESSURE = 1e-12  # of the highest one, below which a cell does not touch
# Cells per bin of the sample count: the signal varies little within a bin, and a slow sampling
# still has samples in it.
CELLS_A_BIN = 8
# Spectra that follow from the rest, and the parts that they do not depend on.
SPECTRA = {"film_stress", "charge", "signal", "largest", "_half_space_stress", "_friction"}
BESIDE_SIGNAL = {
    "transfer_of_others", "interval_s", "sample_weight", "signal_rms", "noise_peak",
    "max_gain_of_others",
}  # fmt: skip


@dataclass(frozen=True)
class ReferenceSpectra:
    """The signal of a scenario without effects, by wavenumber.

    - `scenario`, `line`: without any effect.
    - `k` (k,) [rad/m]; `traction` (2, k): spectrum of p and q [Pa]; `background_Pa` (2,).
    - `stress` (e, 4, 2, k): stress at the films per traction; `weights` (e, 4): charge per stress.
    - `gain`, `order`: of the readout.
    - `transfer_of_others` (e, k): the factors of the other effects. `signal_rms`: with all of them
      and the effect in question; `noise_peak`: of the noise of any; `max_gain_of_others`: by what
      factor they may raise the signal for a while.
    - `interval_s`: the shortest between samples. `sample_weight` (n,): a cell's part of all
      samples, and of the mean square, 1 at constant speed.
    - `simulated` (e, k), `simulated_stress` (e, 4, k): spectra of the signal and of the stress at
      the films with the effects that stay on, where they were simulated.
    - `named`: all effects that are screened, in the order in which they are added.
    """

    scenario: Scenario
    line: Line
    k: Float[np.ndarray, " k"]
    traction: Complex[np.ndarray, "2 k"]
    background_Pa: Float[np.ndarray, "2"]
    stress: Complex[np.ndarray, "e 4 2 k"]
    weights: Float[np.ndarray, "e 4"]
    gain: float
    order: int
    transfer_of_others: Inexact[np.ndarray, "e k"]
    interval_s: float
    sample_weight: Float[np.ndarray, " n"]
    simulated: Complex[np.ndarray, "e k"] | None = None
    simulated_stress: Complex[np.ndarray, "e 4 k"] | None = None
    signal_rms: float = 0.0
    noise_peak: float = 0.0
    max_gain_of_others: float = 1.0
    named: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        if not self.signal_rms:
            rms = self.saturated_rms(self.transfer_of_others, math.inf)
            object.__setattr__(self, "signal_rms", rms)

    def replace(self, **changed) -> "ReferenceSpectra":
        """The same reference with other parts; spectra that do not change are not computed anew."""
        made = dataclasses.replace(self, **changed)
        if changed.keys() <= BESIDE_SIGNAL:
            known = {name: each for name, each in vars(self).items() if name in SPECTRA}
            vars(made).update(known)
        return made

    @cached_property
    def film_stress(self) -> Complex[np.ndarray, "e 4 k"]:
        """The stress at the films [Pa]."""
        return self._half_space_stress if self.simulated_stress is None else self.simulated_stress

    @cached_property
    def charge(self) -> Complex[np.ndarray, "e k"]:
        """The films' charge, without any effect."""
        return np.einsum("es,esk->ek", self.weights, self._half_space_stress)

    @cached_property
    def signal(self) -> Complex[np.ndarray, "e k"]:
        """The signal."""
        return self.read(self.charge) if self.simulated is None else self.simulated

    @cached_property
    def _half_space_stress(self) -> Complex[np.ndarray, "e 4 k"]:
        return np.einsum("esck,ck->esk", self.stress, self.traction)

    def with_signal(
        self,
        signal: Float[np.ndarray, "e n"],
        stress: Float[np.ndarray, "e 4 n"],
        transfer: Inexact[np.ndarray, "e k"],
    ) -> "ReferenceSpectra":
        """The reference with the signal (e, n), and the stress at the films (e, 4, n), simulated
        with effects whose factors make up `transfer`: traction is raised as the signal is."""
        simulated = self._spectrum(signal)
        raised = max(1.0, self.rms(simulated) / max(self.rms(transfer * self.signal), TINY))
        return self.replace(
            traction=raised * self.traction,
            background_Pa=raised * self.background_Pa,
            simulated=simulated,
            simulated_stress=transfer[:, None] * self._spectrum(stress),
        )

    def _spectrum(self, samples: Float[np.ndarray, "... n"]) -> Complex[np.ndarray, "... k"]:
        """Spectrum on this line of samples on one with the same window and wider cells."""
        some = np.fft.rfft(samples) * (self.line.n / samples.shape[-1])
        more = self.k.size - some.shape[-1]
        return np.concatenate([some, np.zeros((*some.shape[:-1], more))], axis=-1)

    def with_motion(self, motion: Motion, load: Float[np.ndarray, " sample"]) -> "ReferenceSpectra":
        """The reference sampled along `motion`, under a load that varies by the factor `load`."""
        width = CELLS_A_BIN * float(self.line.cell_m)
        count = -(-self.line.n // CELLS_A_BIN)
        away = (
            np.asarray(motion.position_m) - float(self.line.start_m) + float(self.line.cell_m) / 2
        )
        at = np.floor(away / width).astype(int) % count
        factor = (np.asarray(motion.speed_m_per_s) / self.speed_m_per_s) ** self.order * load
        square = np.bincount(at, factor**2, count) * count / factor.size
        return self.replace(sample_weight=np.repeat(square, CELLS_A_BIN)[: self.line.n])

    def saturated_rms(self, transfer: Inexact[np.ndarray, "e k"], limit: float) -> float:
        """Rms of the signal behind this transfer, its samples cut at +-`limit`."""
        samples = np.clip(np.fft.irfft(transfer * self.signal, self.line.n), -limit, limit)
        return max(self._weighted(samples), TINY)

    def read(self, charge: Inexact[np.ndarray, "e k"]) -> Complex[np.ndarray, "e k"]:
        """The signal's spectrum from that of the charge."""
        return self.gain * (1j * self.k) ** self.order * charge

    @cached_property
    def largest(self) -> Float[np.ndarray, "e k"]:
        """The charge's spectrum if nothing cancelled: all stresses by their size."""
        size = np.abs(self.weights), np.abs(self.stress), np.abs(self.traction)
        return np.einsum("es,esck,ck->ek", *size)

    @property
    def has_contact(self) -> bool:
        """Whether its pressure is that of a contact, which changes with the skin."""
        scene = self.scenario.scene
        return scene is not None and scene.pressed is not None

    @property
    def speed_m_per_s(self) -> float:
        """Sliding speed."""
        return float(self.scenario.scan.speed_m_per_s)

    def rms(self, spectrum: Inexact[np.ndarray, "e k"]) -> float:
        """Root mean square over all elements and samples of a signal with this spectrum."""
        return self._weighted(np.fft.irfft(spectrum, self.line.n))

    def relative_rms(self, change: Inexact[np.ndarray, "e k"]) -> float:
        """Relative rms of a change with this spectrum, behind the other effects."""
        return self.rms(self.transfer_of_others * change) / self.signal_rms

    def relative_difference(
        self, one: Inexact[np.ndarray, "e k"], other: Inexact[np.ndarray, "e k"]
    ) -> float:
        """The difference of two signals behind the other effects, over the smaller one and what
        saturation leaves of it."""
        raised = max(1.0, self.rms(self.transfer_of_others * self.signal) / self.signal_rms)
        return raised * self.rms(one - other) / max(min(map(self.rms, (one, other))), TINY)

    def relative_rms_of_modulus(self, modulus: Float[np.ndarray, "e k"]) -> float:
        """Bound on `relative_rms` for a change known by the modulus of its spectrum alone: it may
        lie where most samples are."""
        weights = half_spectrum_weights(self.line.n) / self.line.n
        square = np.mean(np.abs(self.transfer_of_others * modulus) ** 2 @ weights)
        return float(np.sqrt(square * self.sample_weight.max())) / self.signal_rms

    def relative_excess(self, limit: float) -> float:
        """Relative rms of the signal's excess beyond +-`limit`, the noise's peak added."""
        samples = np.fft.irfft(self.transfer_of_others * self.signal, self.line.n)
        over = self.max_gain_of_others * np.abs(samples) + self.noise_peak - limit
        return self._weighted(np.maximum(over, 0.0)) / self.signal_rms

    def relative_contact_change(self, ratio: Inexact[np.ndarray, " k"]) -> float:
        """A bound on the relative rms of the change where the skin's compliance becomes `ratio`
        (k,) times its own, Re ratio > 0.

        Where the skin touches everywhere before and after, pressure goes as 1/ratio. Elsewhere two
        contacts under one load differ by d with

            |d|_C <= |(C' - C) p|_(1/C),  C = Re C',

        p the pressure before and C' the compliance after, as the gaps of both are complementary
        (strong monotonicity of a variational inequality, Kinderlehrer and Stampacchia 1980). The
        signal of d is at most the largest of |T|/sqrt(C) times that.
        """
        p = np.fft.irfft(self.traction[0], self.line.n) + self.background_Pa[0]
        change = (1 / ratio - 1) * self.traction[0]
        if min(p.min(), (p + np.fft.irfft(change, self.line.n)).min()) > NO_PRESSURE * p.max():
            rubbing = np.fft.rfft(self._friction * np.fft.irfft(change, self.line.n))
            both = np.stack([change, rubbing])
            charge = np.einsum("es,esck,ck->ek", self.weights, self.stress, both)
            return self.relative_rms(self.read(charge))
        k, own = self.k[1:], ratio[1:]
        softness = np.real(own) / k  # over that of a half space at k = 1
        off = np.abs(own - 1) / k / np.sqrt(softness) * np.abs(self.traction[0, 1:])
        per_p, per_q = np.moveaxis(np.einsum("es,esck->eck", self.weights, self.stress), 1, 0)
        highest = self.read(np.abs(per_p) + np.abs(self._friction).max() * np.abs(per_q))
        passed = np.mean(np.abs(self.transfer_of_others * highest) ** 2, axis=0)[1:] / softness
        square = off**2 @ (half_spectrum_weights(self.line.n) / self.line.n)[1:]
        return float(np.sqrt(passed.max() * square * self.sample_weight.max())) / self.signal_rms

    @cached_property
    def _friction(self) -> Float[np.ndarray, " n"]:
        """Friction q/p [1] in contact, 0 outside."""
        p, q = np.fft.irfft(self.traction, self.line.n) + self.background_Pa[:, None]
        touching = p > NO_PRESSURE * p.max()
        return np.divide(q, p, out=np.zeros_like(q), where=touching)

    def _weighted(self, samples: Float[np.ndarray, "e n"]) -> float:
        return float(np.sqrt(np.mean(self.sample_weight * samples**2)))


def reference(scenario: Scenario, line: Line) -> ReferenceSpectra:
    """Reference spectra of `scenario`, which has a scene and no effects, on `line`.

    The traction's program is the one that a simulation on the same line has.
    """
    scene, sensor, direction = scenario.scene, scenario.sensor, scenario.scan.direction
    assert scene is not None
    refuse(
        any(film.turn_rad is not None for film in sensor.elements),
        "The sensor has elements turned in the plane, for which the size of effects is not "
        "bounded: name the effects, as effects=[strip_width], or give sensor=two_element.",
    )
    # In numpy as far as possible: what runs once takes longer to compile.
    k = 2 * np.pi * np.fft.rfftfreq(line.n, np.asarray(line.cell_m))
    films = [jax.tree.map(np.asarray, film) for film in sensor.elements]
    stress = np.stack([sensor.skin.transfer_once(k, float(film.depth_m)) for film in films])
    weights = np.stack([film.charge_per_stress(np) for film in films])
    background, gain = map(np.asarray, _background_and_gain(scenario))
    periodic = isinstance(line, Periodic)
    contact = scene.pressed
    p = None if contact is None else _pressure(contact, line, k)
    traction = np.asarray(deviation(scene, line, direction, periodic, p))
    spectrum = np.fft.rfft(traction - background[:, None] if periodic else traction)
    readout = float(gain), sensor.amplifier.order
    interval = float(line.cell_m) / max(abs(float(scenario.scan.speed_m_per_s)), TINY)
    return ReferenceSpectra(
        scenario, line, k, spectrum, background, stress, weights, *readout,
        np.ones((len(films), k.size)), interval, np.ones(line.n),
    )  # fmt: skip


def _pressure(scene: SurfaceScene, line: Line, k) -> Float[np.ndarray, " n"]:
    mean = np.sinc(k * np.asarray(line.cell_m) / (2 * np.pi))
    # A skin that lags is taken without its lag.
    at_centres = np.abs(scene.skin.compliance_once(k[1:])) / mean[1:]
    height = np.asarray(scene.height(line))
    return pressure_under(height, float(scene.nominal_pressure_Pa), np.append(0.0, at_centres))


@compiled
def _background_and_gain(scenario: Scenario):
    scene, scan = scenario.scene, scenario.scan
    assert scene is not None
    gain = scenario.sensor.amplifier.at_speed(scan.speed_m_per_s)
    return scene.background(scan.direction), gain
