"""Stick-slip: patches of skin that stick and snap back, bursts of shear at random times."""

from typing import ClassVar

import numpy as np

from ..errors import number
from ..forward.scenario import Scenario
from ..forward.snap_back import SnapBackNoise as Bursts
from ._effect import NoiseEffect, Order
from ._reference import ReferenceSpectra

LOG_RARITY = 9.2  # odds of 1e-4 that the bursts of a passage are louder than their bound
PEAK = 5.0  # times its rms, which a Gaussian amplitude is beyond once in two million


class SnapBack(NoiseEffect):
    """Noise of bursts: `rate_hz` of them a second in a contact of `contact_m` around the film, each
    on a patch of `patch_m`, of rms shear `shear_Pa` that decays over `decay_s`.

    Raises `BadInput` for negative numbers, and lengths and times that are not
    positive; a rate of 0 is none.
    """

    order: ClassVar[Order] = Order.RECORD
    of_sensor: ClassVar[bool] = False
    rate_hz: float
    shear_Pa: float
    patch_m: float
    decay_s: float
    contact_m: float

    def __init__(self, rate_hz, shear_Pa, patch_m, decay_s, contact_m):
        def checked(name, value, above):
            wanted = "a positive number, in SI units" if above else "a number from 0, in SI units"
            bound = {"above": 0} if above else {"least": 0}
            return float(number(f"effects.snap_back.{name}", value, wanted, **bound))

        self.rate_hz, self.shear_Pa = (
            checked("rate_hz", rate_hz, 0),
            checked("shear_Pa", shear_Pa, 0),
        )
        self.patch_m, self.decay_s = checked("patch_m", patch_m, 1), checked("decay_s", decay_s, 1)
        self.contact_m = checked("contact_m", contact_m, 1)

    def apply(self, scenario: Scenario) -> Scenario:
        if not self.rate_hz:
            return scenario
        bursts = Bursts.recorded_by(
            scenario.sensor, self.rate_hz, self.shear_Pa, self.patch_m, self.decay_s, self.contact_m
        )
        return scenario.replace(noises=(*scenario.noises, bursts))

    def noise(self, reference: ReferenceSpectra) -> ReferenceSpectra | None:
        if not self.rate_hz:
            return None
        # Campbell: a mean of rate * decay/2 bursts at a time, each of the mean square charge that
        # a patch gives over the contact; Parseval: the integral of a kernel's square along the line
        # is that of |F|^2 over 2 pi.
        patch = self.patch_m * np.sinc(reference.k * self.patch_m / (2 * np.pi))
        shear = np.stack([0 * patch, patch]).astype(complex)
        one = reference.replace(
            simulated=None, simulated_stress=None, scenario=reference.scenario.replace(scene=None),
            traction=shear, background_Pa=np.zeros(2), gain=1.0, order=0,
            transfer_of_others=np.ones_like(reference.transfer_of_others),
            sample_weight=np.ones_like(reference.sample_weight),
        )  # fmt: skip
        square = np.mean(np.trapezoid(np.abs(one.charge) ** 2, reference.k) / np.pi)
        reading = abs(reference.gain) * self.shear_Pa
        rms = reading * np.sqrt(self.rate_hz * self.decay_s / 2 * square / self.contact_m)
        rms = rms * self._loudest(one)
        if reference.order:
            # Of the difference of two samples, over what is slid between them.
            between = abs(reference.speed_m_per_s) * reference.interval_s
            rms = rms * np.sqrt(-2 * np.expm1(-reference.interval_s / self.decay_s)) / between
            reading = reading / between
        at_most = np.trapezoid(np.abs(one.charge), reference.k).max() / np.pi
        together = PEAK * np.sqrt(1 + self.rate_hz * self.decay_s)
        scale = rms / max(one.rms(one.signal), np.finfo(float).tiny)
        return one.replace(traction=scale * shear, noise_peak=float(together * reading * at_most))

    def _loudest(self, one: ReferenceSpectra) -> float:
        """The rms of the few bursts of one passage over the expected one, at most, but for odds of
        exp(-`LOG_RARITY`).

        Their energy has the mean N <g^2> and the variance 3 N <g^4>, g a patch's charge over the
        contact and amplitudes Gaussian: that of a chi-square of nu = 2/3 N <g^2>^2/<g^4> degrees of
        freedom, which is nu + 2 sqrt(nu L) + 2 L at most (Laurent and Massart 2000).
        """
        cell, n = float(one.line.cell_m), one.line.n
        energy = np.mean(np.fft.irfft(one.charge, n) ** 2, axis=0)
        spread = np.sum(energy) ** 2 / np.sum(energy**2) * cell / self.contact_m
        passage_s = n * cell / abs(one.speed_m_per_s)
        rare = LOG_RARITY / (2 / 3 * self.rate_hz * passage_s * min(spread, 1.0))
        return float(np.sqrt(1 + 2 * np.sqrt(rare) + 2 * rare))
