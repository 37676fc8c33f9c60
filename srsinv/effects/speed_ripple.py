"""A drive whose speed ripples."""

import numpy as np

from ..forward.speed_profile import RippleProfile
from ._motion import displaced_bound
from ._reference import ReferenceSpectra
from .general import SpeedProfileEffect


class SpeedRipple(SpeedProfileEffect[RippleProfile]):
    """The speed is 1 + `fraction` cos(2 pi `frequency_hz` t) times the nominal one. Raises
    `BadInput` as the ripple does."""

    def __init__(self, fraction, frequency_hz):
        self.speed_profile = RippleProfile(fraction, frequency_hz)

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
