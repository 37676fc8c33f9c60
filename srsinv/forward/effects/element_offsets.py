"""Elements that sit beside the sensor's origin: x(t) + offset_m, a factor exp(i k offset)."""

from typing import ClassVar

import numpy as np
from jaxtyping import Complex

from .. import film
from ..setup import Setup
from ._effect import Factor, Order
from ._reference import ReferenceSpectra


class ElementOffsets(Factor):
    """Every element sits where the sensor says, `offset_m`; without it all sit at the origin."""

    order: ClassVar[Order] = Order.FILM
    of_sensor: ClassVar[bool] = True

    def added(self, setup: Setup) -> Setup:
        # An element at the origin keeps its program.
        return setup.with_films(
            lambda each: (
                each.with_effect(film.Offset(each.offset_m)) if float(each.offset_m) else each
            )
        )

    def factor(self, reference: ReferenceSpectra) -> Complex[np.ndarray, "e k"]:
        offsets = np.array([float(each.offset_m) for each in reference.setup.sensor.elements])
        return np.exp(1j * np.outer(offsets, reference.k))
