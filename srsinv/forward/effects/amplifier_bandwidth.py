"""The amplifier's finite bandwidth, 1/(1 + i omega R_f C_f)."""

from typing import ClassVar

import numpy as np
from jaxtyping import Complex

from ...errors import number
from ..filter import FirstOrder
from ..setup import Setup
from ._effect import Factor, Order
from ._filtered import filter_factor, filtered
from ._glance import Glance


class AmplifierBandwidth(Factor):
    """A feedback resistor `resistance_ohm` beside the capacitance `capacitance_F` lags by their
    product. Raises `BadInput` for what is not positive."""

    order: ClassVar[Order] = Order.ELECTRONICS
    of_sensor: ClassVar[bool] = True
    filter: FirstOrder

    def __init__(self, resistance_ohm, capacitance_F):
        key = "effects.amplifier_bandwidth"
        number(f"{key}.resistance_ohm", resistance_ohm, "a positive resistance in ohm", above=0)
        number(f"{key}.capacitance_F", capacitance_F, "a positive capacitance in F", above=0)
        self.filter = FirstOrder(resistance_ohm * capacitance_F)

    def added(self, setup: Setup) -> Setup:
        return filtered(setup, self.filter)

    def factor(self, glance: Glance) -> Complex[np.ndarray, "e k"]:
        return filter_factor(glance, self.filter)

    def share(self, glance: Glance) -> float:
        return glance.share((self.factor(glance) - 1) * glance.signal)
