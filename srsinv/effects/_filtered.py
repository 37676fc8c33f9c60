"""Base class of the two filter effects."""

import dataclasses
from typing import ClassVar

import jax
import numpy as np
from jaxtyping import Complex

from ..forward.filter import Filter
from ..forward.scenario import Scenario
from ._effect import MultiplicativeEffect, Order
from ._reference import ReferenceSpectra


class Filtered(MultiplicativeEffect):
    """A further filter behind the amplifier."""

    order: ClassVar[Order] = Order.ELECTRONICS
    of_sensor: ClassVar[bool] = True
    filter: Filter

    def apply(self, scenario: Scenario) -> Scenario:
        sensor = scenario.sensor
        return scenario.replace(
            sensor=dataclasses.replace(sensor, filters=(*sensor.filters, self.filter))
        )

    def factor(self, reference: ReferenceSpectra) -> Complex[np.ndarray, "e k"]:
        by = jax.tree.map(float, self.filter)
        return by.response(reference.k * reference.speed_m_per_s, np)[None] * np.ones_like(
            reference.transfer_of_others
        )
