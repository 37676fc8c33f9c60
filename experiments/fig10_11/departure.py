"""How the sensor that is simulated departs from the one that theory knows."""

import dataclasses
from typing import Any, ClassVar

import numpy as np

from srsinv.effects import Effect, Order
from srsinv.errors import number
from srsinv.forward.film import Film, Piezo, StripAverage
from srsinv.forward.scenario import Scenario


class Departure(Effect):
    """All films turned by `tilt_deg`, averaging over `blur_m` more, with `gain` times the charge.

    Raises `BadInput` for numbers that cannot be.
    """

    order: ClassVar[Order] = Order.FILM
    of_sensor: ClassVar[bool] = True
    tilt_deg: float
    blur_m: float
    gain: float

    def __init__(self, tilt_deg: Any = 0.0, blur_m: Any = 0.0, gain: Any = 1.0):
        wanted = "an angle in degrees"
        self.tilt_deg = float(number("truth.tilt_deg", tilt_deg, wanted, least=-360, most=360))
        self.blur_m = float(number("truth.blur_m", blur_m, "a length in metres from 0", least=0))
        wanted = "a number other than 0"
        self.gain = float(number("truth.gain", gain, wanted, above=0))

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_films(self._changed)

    def _changed(self, film: Film) -> Film:
        piezo = film.piezo
        film = dataclasses.replace(
            film,
            angle_rad=film.angle_rad + np.deg2rad(self.tilt_deg),
            piezo=Piezo(*(self.gain * float(d) for d in (piezo.d1, piezo.d2, piezo.d3))),
        )
        if not self.blur_m:
            return film
        return film.with_effect(StripAverage.at_depth(self.blur_m, float(film.depth_m)))
