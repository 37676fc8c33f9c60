"""A strip's charge is the mean over its width along x, sin(kw/2)/(kw/2)."""

from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..forward.film import Film
from ..forward.scenario import Scenario
from ._effect import MultiplicativeEffect, Order
from ._reference import ReferenceSpectra


class StripWidth(MultiplicativeEffect):
    """Every element averages over its width in the sensor (docs/explanation/physics/film.md)."""

    order: ClassVar[Order] = Order.FILM
    of_sensor: ClassVar[bool] = True

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_films(Film.with_strip_average)

    def factor(self, reference: ReferenceSpectra) -> Float[np.ndarray, "e k"]:
        widths = np.array([float(each.width_m) for each in reference.scenario.sensor.elements])
        return np.sinc(np.outer(widths, reference.k) / (2 * np.pi))
