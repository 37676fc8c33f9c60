"""The low-pass filter before sampling: Butterworth, of any order from 1 to 8."""

from ..forward.filter import Butterworth
from .general import FilterEffect


class AntialiasFilter(FilterEffect):
    """Half the power at `cutoff_hz`, 6 dB per octave and order above. Raises `BadInput` for a
    cut-off that is not positive and an order that is not from 1 to 8."""

    def __init__(self, cutoff_hz, filter_order=4):
        self.filter = Butterworth(cutoff_hz, filter_order)
