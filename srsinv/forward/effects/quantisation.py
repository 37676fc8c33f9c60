"""Samples rounded to the levels of a converter."""

from typing import ClassVar

import numpy as np

from ..converter import Quantisation as Rounding
from ..setup import Setup
from ._effect import Effect, Order
from ._glance import Glance


class Quantisation(Effect):
    """2^`bits` levels from -`full_scale` to `full_scale`, in signal units; what is beyond stays at
    the ends. Raises `BadInput` as the converter does."""

    order: ClassVar[Order] = Order.RECORD
    of_sensor: ClassVar[bool] = False
    converter: Rounding

    def __init__(self, bits, full_scale):
        self.converter = Rounding(bits, full_scale)

    def added(self, setup: Setup) -> Setup:
        return setup.recording(converters=(*setup.recorder.converters, self.converter))

    def share(self, glance: Glance) -> float:
        size = max(glance.rms(glance.signal), np.finfo(float).tiny)
        beyond = glance.beyond(float(self.converter.full_scale))
        # Never more than half a step, which is what a signal below one step may lose.
        return beyond + float(self.converter.step) / 2 / size
