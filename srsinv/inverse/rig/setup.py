"""A rig that is a little different from what is stated of it: one parameter after the other."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from ...forward.film import Film, LineEffect, Offset
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...forward.skin import HalfSpace
from ...forward.turned_skin import is_of_strip

# Of what is no part of the sensor, the field that a parameter is a factor on.
FACTORS = {"speed": "speed", "nominal_pressure_Pa": "nominal_pressure"}
OF_CONTACT = ("youngs_modulus_Pa", "nominal_pressure_Pa", "edge_length_m")


class Setup(NamedTuple):
    """What signals follow from: the sensor, factors on the stated speed of its motion and nominal
    pressure, and a change of the length [m] of a surface's edges."""

    sensor: Sensor
    speed: Any = 1.0
    nominal_pressure: Any = 1.0
    edge_length_by_m: Any = 0.0

    def motion(self, stated: Motion) -> Motion:
        """The motion at this speed, from where the stated one starts."""
        if isinstance(self.speed, float) and self.speed == 1.0:
            return stated
        start = stated.position_m[0]
        position = start + self.speed * (stated.position_m - start)
        return Motion(stated.time_s, position, self.speed * stated.speed_m_per_s)

    def changed(self, name: str, value: Any, by: Any, keeps_area: bool = False) -> "Setup":
        """The setup with the parameter `name`, of this `value`, changed `by` so much; `keeps_area`:
        a strip's width changes the mean over it, but not its charge."""
        if name == "edge_length_m":
            return self._replace(edge_length_by_m=self.edge_length_by_m + by)
        if name in FACTORS:
            field = FACTORS[name]
            return self._replace(**{field: getattr(self, field) * (1 + by / value)})
        return self._replace(sensor=_changed(self.sensor, name, value, by, keeps_area))


def number_of_films(sensor: Sensor) -> int:
    """How many films there are, each counted once where it is there for both ways."""
    return sum(not film.is_backward for film in sensor.elements)


def _changed(sensor: Sensor, name: str, value: Any, by: Any, keeps_area: bool) -> Sensor:
    if name in ("poisson_ratio", "youngs_modulus_Pa"):
        assert isinstance(sensor.skin, HalfSpace)
        return eqx.tree_at(lambda s: getattr(s.skin, name), sensor, replace_fn=lambda v: v + by)

    def depth(film: Film) -> Film:
        return eqx.tree_at(lambda f: f.depth_m, film, film.depth_m + by)

    def gain(film: Film) -> Film:  # by its length, which the charge is proportional to
        return eqx.tree_at(lambda f: f.length_m, film, film.length_m * (1 + by / value))

    def angle(film: Film) -> Film:
        return eqx.tree_at(lambda f: f.angle_rad, film, film.angle_rad + by * (np.pi / 180))

    def offset(film: Film) -> Film:
        if film.is_at_origin:
            return film.with_effect(Offset(by))
        return eqx.tree_at(lambda f: f.offset_m, film, film.offset_m + by)

    def strip(film: Film) -> Film:
        return _with_width_times(film, 1 + by / value, keeps_area)

    kinds: dict[str, Callable[[Film], Film]] = {
        "gain": gain, "angle": angle, "offset": offset, "strip": strip
    }  # fmt: skip
    if name == "depth_m":
        films = [depth(film) for film in sensor.elements]
    else:
        change = kinds[name.split("_")[0]]
        own = int(next(part for part in name.split("_") if part.isdigit())) - 1
        count = number_of_films(sensor)
        films = [
            change(film) if n % count == own else film for n, film in enumerate(sensor.elements)
        ]
    return eqx.tree_at(lambda s: s.elements, sensor, tuple(films))


def _with_width_times(film: Film, factor: Any, keeps_area: bool) -> Film:
    """The film with another width of its strip, in its area and where it averages over it."""

    def wider(effect: LineEffect) -> LineEffect:
        return effect.scaled(factor) if is_of_strip(effect) else effect

    film = eqx.tree_at(lambda f: f.width_m, film, film.width_m * factor)
    if keeps_area:
        film = eqx.tree_at(lambda f: f.length_m, film, film.length_m / factor)
    effects = tuple(map(wider, film.effects))
    return eqx.tree_at(lambda f: f.effects, film, effects)
