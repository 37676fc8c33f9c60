"""A load that drifts slowly while the finger slides."""

from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..forward.drift import SinusoidalLoad as Drift
from ..forward.scenario import Scenario
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class LoadDrift(Effect):
    """The load is 1 + `fraction` sin(2 pi t/`period_s`) times the nominal one, and traction and
    charge with it. Raises `BadInput` as the drift does."""

    order: ClassVar[Order] = Order.LOAD
    of_sensor: ClassVar[bool] = False
    drift: Drift

    def __init__(self, fraction, period_s):
        self.drift = Drift(fraction, period_s)

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_recorder(drift=self.drift)

    def load(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
        turn = 2 * np.pi / float(self.drift.period_s)
        return 1 + float(self.drift.fraction) * np.sin(turn * time_s + float(self.drift.phase_rad))

    @property
    def max_gain(self) -> float:
        return 1 + abs(float(self.drift.fraction))

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        fraction = abs(float(self.drift.fraction))
        if not reference.order or not fraction:
            return fraction
        # R_f d' Q, of the whole charge, the film's response to the mean load included.
        per_second = fraction * 2 * np.pi / float(self.drift.period_s)
        stress = np.real(reference.stress[..., 0]) @ reference.background_Pa
        uniform = np.sum(reference.weights * stress, axis=-1)
        charge = reference.charge.copy()
        charge[:, 0] += uniform * reference.line.n
        # What slows the sliding down weakens the signal, and not this: factors are 1 at k = 0 else.
        charge /= np.maximum(np.abs(reference.transfer_of_others[:, :1]), np.finfo(float).tiny)
        factor = abs(reference.gain / reference.speed_m_per_s)
        return fraction + per_second * factor * reference.relative_rms(charge)
