"""A drive whose speed ripples."""

from typing import ClassVar

import numpy as np

from ..pace import Ripple
from ..setup import Setup
from ._effect import Effect, Order
from ._glance import Glance
from ._paced import moved_share, paced


class SpeedRipple(Effect):
    """The speed is 1 + `fraction` cos(2 pi `frequency_hz` t) times the nominal one. Raises
    `BadInput` as the ripple does."""

    order: ClassVar[Order] = Order.MOTION
    of_sensor: ClassVar[bool] = False
    pace: Ripple

    def __init__(self, fraction, frequency_hz):
        self.pace = Ripple(fraction, frequency_hz)

    def added(self, setup: Setup) -> Setup:
        return paced(setup, self.pace)

    @property
    def swing(self) -> float:
        return 1 + float(self.pace.fraction)

    def share(self, glance: Glance) -> float:
        # A rate signal changes with the speed, and comes from where the sensor then is.
        fraction, frequency = float(self.pace.fraction), float(self.pace.frequency_hz)
        away = fraction * abs(glance.speed_m_per_s) / (2 * np.pi * frequency)
        return fraction * glance.order + (1 + fraction) * moved_share(glance, away)
