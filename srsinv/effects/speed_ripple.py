"""A drive whose speed ripples."""

from typing import ClassVar

import numpy as np

from ..forward.scenario import Scenario
from ..forward.speed_profile import RippleProfile
from ._effect import Effect, Order
from ._paced import displaced_bound, with_speed_profile
from ._reference import ReferenceSpectra


class SpeedRipple(Effect):
    """The speed is 1 + `fraction` cos(2 pi `frequency_hz` t) times the nominal one. Raises
    `BadInput` as the ripple does."""

    order: ClassVar[Order] = Order.MOTION
    of_sensor: ClassVar[bool] = False
    speed_profile: RippleProfile

    def __init__(self, fraction, frequency_hz):
        self.speed_profile = RippleProfile(fraction, frequency_hz)

    def apply(self, scenario: Scenario) -> Scenario:
        return with_speed_profile(scenario, self.speed_profile)

    @property
    def max_gain(self) -> float:
        return 1 + float(self.speed_profile.fraction)

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        # A rate signal changes with the speed and with the sensor's position: the mean square of
        # s(x + d(x)) - s(x) is at most d^2 s'^2/(1 - fraction), as |d'| <= fraction.
        fraction, frequency = (
            float(self.speed_profile.fraction),
            float(self.speed_profile.frequency_hz),
        )
        away = fraction * abs(reference.speed_m_per_s) / (2 * np.pi * frequency)
        slower = max(1 - fraction, np.finfo(float).tiny)
        displaced = displaced_bound(reference, away) / np.sqrt(slower)
        return fraction * reference.order + (1 + fraction * reference.order) * displaced
