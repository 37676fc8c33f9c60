"""Elements that sit beside the sensor's origin: x(t) + offset_m, a factor exp(i k offset)."""

from typing import ClassVar

import numpy as np
from jaxtyping import Complex

from ..forward.film import Film
from ..forward.scenario import Scenario
from ._effect import MultiplicativeEffect, Order
from ._reference import ReferenceSpectra


class ElementOffsets(MultiplicativeEffect):
    """Every element lies at the sensor's `offset_m`; without the effect all lie at the origin."""

    order: ClassVar[Order] = Order.FILM
    of_sensor: ClassVar[bool] = True

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_films(Film.in_place)

    def factor(self, reference: ReferenceSpectra) -> Complex[np.ndarray, "e k"]:
        offsets = np.array([float(each.offset_m) for each in reference.scenario.sensor.elements])
        return np.exp(1j * np.outer(offsets, reference.k))
