"""A load that drifts slowly while the finger slides."""

from typing import ClassVar

import numpy as np

from ..drift import LoadDrift as Drift
from ..setup import Setup
from ._effect import Effect, Order
from ._glance import Glance


class LoadDrift(Effect):
    """The load is 1 + `fraction` sin(2 pi t/`period_s`) times the nominal one, and traction and
    charge with it. Raises `BadInput` as the drift does."""

    order: ClassVar[Order] = Order.LOAD
    of_sensor: ClassVar[bool] = False
    drift: Drift

    def __init__(self, fraction, period_s):
        self.drift = Drift(fraction, period_s)

    def added(self, setup: Setup) -> Setup:
        return setup.recording(drift=self.drift)

    @property
    def swing(self) -> float:
        return 1 + abs(float(self.drift.fraction))

    def share(self, glance: Glance) -> float:
        fraction = abs(float(self.drift.fraction))
        if not glance.order or not fraction:
            return fraction
        # R_f d' Q, of all the charge there is: what the film feels of the mean load, too.
        per_second = fraction * 2 * np.pi / float(self.drift.period_s)
        stress = np.real(glance.stress[..., 0]) @ glance.background_Pa
        uniform = np.sum(glance.weights * stress, axis=-1)
        charge = glance.charge.copy()
        charge[:, 0] += uniform * glance.line.n
        factor = abs(glance.gain / glance.speed_m_per_s)
        return fraction + per_second * factor * glance.share(charge)
