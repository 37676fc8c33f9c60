"""Straight features whose normal is turned from the sliding direction."""

from typing import ClassVar

import numpy as np
from jaxtyping import Array, Float

from ...errors import number
from ...grid import as_real
from ..oblique import turned, turned_scan
from ..setup import Setup
from ._effect import Effect, Order
from ._glance import Glance


class ObliqueFeatures(Effect):
    """The features' normal makes `angle_deg` with the sliding direction; the line runs along it.

    The film slides along the line at u cos(angle), averages over its length as sin(a)/a with
    a = k l sin(angle)/2, and feels the stress turned. Raises `BadInput` for an angle beyond 90.
    """

    order: ClassVar[Order] = Order.DIRECTION
    of_sensor: ClassVar[bool] = False
    angle_rad: Float[Array, ""]

    def __init__(self, angle_deg):
        wanted = "an angle from -90 to 90 degrees"
        key = "effects.oblique_features.angle_deg"
        self.angle_rad = as_real(number(key, angle_deg, wanted, least=-90, most=90) * np.pi / 180)

    def added(self, setup: Setup) -> Setup:
        return setup.but(
            sensor=turned(setup.sensor, self.angle_rad),
            scan=turned_scan(setup.scan, self.angle_rad),
        )

    def share(self, glance: Glance) -> float:
        angle = float(self.angle_rad)
        c, s = np.sin(np.pi / 2 - abs(angle)), np.sin(abs(angle))
        lengths = np.array([float(film.length_m) for film in glance.setup.sensor.elements])
        over = np.sinc(glance.k[None] * lengths[:, None] * s / (2 * np.pi))
        kept = (1 - c * over) * np.abs(glance.signal)
        # Stress that turns into other components, by s^2 and s.
        return glance.share(kept) + glance.share(2 * s**2 * np.abs(glance.read(glance.largest)))
