"""The low-pass filter before sampling: Butterworth, of any order from 1 to 8."""

from typing import ClassVar

from ..filter import Butterworth
from ..setup import Setup
from ._effect import Effect, Order
from ._filtered import filtered, filtered_share
from ._glance import Glance


class AntialiasFilter(Effect):
    """Half the power at `cutoff_hz`, 6 dB per octave and order above. Raises `BadInput` for a
    cut-off that is not positive and an order that is not from 1 to 8."""

    order: ClassVar[Order] = Order.ELECTRONICS
    of_sensor: ClassVar[bool] = True
    filter: Butterworth

    def __init__(self, cutoff_hz, filter_order=4):
        self.filter = Butterworth(cutoff_hz, filter_order)

    def added(self, setup: Setup) -> Setup:
        return filtered(setup, self.filter)

    def share(self, glance: Glance) -> float:
        return filtered_share(glance, self.filter)
