"""The low-pass filter before sampling: Butterworth, of any order from 1 to 8."""

from typing import ClassVar

import numpy as np
from jaxtyping import Complex

from ..filter import Butterworth
from ..setup import Setup
from ._effect import Factor, Order
from ._filtered import filter_factor, filtered
from ._glance import Glance


class AntialiasFilter(Factor):
    """Half the power at `cutoff_hz`, 6 dB per octave and order above. Raises `BadInput` for a
    cut-off that is not positive and an order that is not from 1 to 8."""

    order: ClassVar[Order] = Order.ELECTRONICS
    of_sensor: ClassVar[bool] = True
    filter: Butterworth

    def __init__(self, cutoff_hz, filter_order=4):
        self.filter = Butterworth(cutoff_hz, filter_order)

    def added(self, setup: Setup) -> Setup:
        return filtered(setup, self.filter)

    def factor(self, glance: Glance) -> Complex[np.ndarray, "e k"]:
        return filter_factor(glance, self.filter)

    def share(self, glance: Glance) -> float:
        return glance.share((self.factor(glance) - 1) * glance.signal)
