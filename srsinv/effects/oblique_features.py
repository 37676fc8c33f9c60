"""Straight features whose normal is turned from the sliding direction."""

from typing import ClassVar

import numpy as np
from jaxtyping import Array, Float

from ..errors import number
from ..forward.oblique import turned, turned_scan
from ..forward.scenario import Scenario
from ..grid import as_real
from ._effect import MultiplicativeEffect, Order
from ._reference import ReferenceSpectra


class ObliqueFeatures(MultiplicativeEffect):
    """The features' normal makes `angle_deg` with the sliding direction; the line runs along it.

    The film slides along the line at u cos(angle), averages over its length as sin(a)/a with a = k
    l sin(angle)/2, and responds to the stress turned. Raises `BadInput` for an angle beyond 90.
    """

    order: ClassVar[Order] = Order.DIRECTION
    is_exact: ClassVar[bool] = False
    of_sensor: ClassVar[bool] = False
    angle_rad: Float[Array, ""]

    def __init__(self, angle_deg):
        wanted = "an angle from -90 to 90 degrees"
        key = "effects.oblique_features.angle_deg"
        self.angle_rad = as_real(number(key, angle_deg, wanted, least=-90, most=90) * np.pi / 180)

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.replace(
            sensor=turned(scenario.sensor, self.angle_rad),
            scan=turned_scan(scenario.scan, self.angle_rad),
        )

    def factor(self, reference: ReferenceSpectra) -> Float[np.ndarray, "e k"]:
        angle = abs(float(self.angle_rad))
        lengths = np.array([float(film.length_m) for film in reference.scenario.sensor.elements])
        over = np.sinc(np.outer(lengths, reference.k) * np.sin(angle) / (2 * np.pi))
        return np.sin(np.pi / 2 - angle) * over

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        s = np.sin(abs(float(self.angle_rad)))
        less = (1 - self.factor(reference)) * reference.signal
        # Stress rotated into other components, by s^2 and s.
        turned = 2 * s**2 * np.abs(reference.read(reference.largest))
        return reference.relative_rms(less) + reference.relative_rms_of_modulus(turned)
