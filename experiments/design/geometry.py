"""Film geometries as points of a box: what is free of each element, and the sensor of a point.

A point has one coordinate for each free number, from 0 at the least value to 1 at the greatest. The
angle of a film repeats after 180 degrees, as S11 and S33 have cos^2, sin^2 and sin cos of it.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from srsinv.errors import choice, echo, number_range, refuse
from srsinv.forward.film import MOST_OFFSET_M, Film, StripAverage
from srsinv.forward.sensor import Sensor
from srsinv.forward.turned_skin import is_of_strip

FIELDS = {"depth": "depth_m", "width": "width_m", "angle": "angle_rad", "offset": "offset_m"}
CELLS_IN_DEPTH = 2  # cells in the depth of the shallowest film, at least
HALF_TURN_DEG = 180.0
ANGLE_DECIMALS = 8  # of a half turn: 2e-6 degrees, the accuracy of an optimum


class Parameter(NamedTuple):
    """A free quantity of the films, in the unit of its field: its range, whether all elements share
    one value, and whether it repeats after the range."""

    name: str
    low: float
    high: float
    is_shared: bool
    is_periodic: bool = False

    @property
    def span(self) -> float:
        return self.high - self.low


class Coordinate(NamedTuple):
    """One coordinate of the box: its parameter, and the element, None for all."""

    parameter: Parameter
    element: int | None

    @property
    def words(self) -> str:
        name = self.parameter.name
        return name if self.element is None else f"{name} {self.element + 1}"


class DesignSpace(eqx.Module):
    """The sensors that differ from `given` in the free quantities of their films.

    - `given`: the sensor, with as many elements as are designed.
    - `parameters`: the free quantities, the others are the given ones.
    """

    given: Sensor
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates in their order: shared ones first, then element by element."""
        shared = [Coordinate(each, None) for each in self.parameters if each.is_shared]
        own = [each for each in self.parameters if not each.is_shared]
        elements = range(len(self.given.elements))
        return (*shared, *(Coordinate(each, e) for e in elements for each in own))

    @property
    def is_periodic(self) -> np.ndarray:
        """Which coordinates repeat."""
        return np.array([each.parameter.is_periodic for each in self.coordinates], bool)

    def quantities(self, point: Float[Any, " coordinate"]) -> dict[str, list[Any]]:
        """The value of every free quantity for each element."""
        count, values = len(self.given.elements), {}
        for at, (parameter, element) in enumerate(self.coordinates):
            value = parameter.low + parameter.span * point[at]
            of = values.setdefault(parameter.name, [value] * count)
            if element is not None:
                of[element] = value
        return values

    def sensor(self, point: Float[Any, " coordinate"]) -> Sensor:
        """The sensor of a point, in which every strip averages over its own width."""
        values = self.quantities(point)
        films = [
            changed(film, {FIELDS[name]: value[e] for name, value in values.items()})
            for e, film in enumerate(self.given.elements)
        ]
        return dataclasses.replace(self.given, elements=tuple(films))

    def point(self, sensor: Sensor) -> Float[np.ndarray, " coordinate"]:
        """The point of a sensor; one beyond the box is moved to its face."""
        at = []
        for parameter, element in self.coordinates:
            values = [float(getattr(film, FIELDS[parameter.name])) for film in sensor.elements]
            value = np.mean(values) if element is None else values[element]
            at.append((value - parameter.low) / parameter.span)
        return self.inside(np.array(at))

    def inside(self, points: Float[np.ndarray, "*n coordinate"]) -> np.ndarray:
        """The points, cut off at the faces of the box, or taken back into it by whole periods; an
        angle of 180 degrees but for rounding is one of 0."""
        wrapped = np.round(points, ANGLE_DECIMALS) % 1.0
        return np.where(self.is_periodic, wrapped, np.clip(points, 0.0, 1.0))

    @property
    def are_alike(self) -> bool:
        """Whether elements are interchangeable: the same in everything that is not free."""
        nothing = {FIELDS[each.name]: 1.0 for each in self.parameters}
        first, *others = (changed(film, nothing) for film in self.given.elements)
        return all(bool(eqx.tree_equal(first, other)) for other in others)

    def in_order(self, point: Float[np.ndarray, " coordinate"]) -> np.ndarray:
        """The same design inside the box, its elements by increasing angle where they are
        interchangeable, or by their first own quantity where no angle is free."""
        point = self.inside(point)
        shared = sum(each.is_shared for each in self.parameters)
        own = [each.name for each in self.parameters if not each.is_shared]
        if not own or not self.are_alike:
            return point
        rows = point[shared:].reshape(-1, len(own))
        key = rows[:, own.index("angle") if "angle" in own else 0]
        return np.concatenate([point[:shared], rows[np.argsort(key, kind="stable")].ravel()])


def changed(film: Film, fields: Mapping[str, Any]) -> Film:
    """The film with other fields, averaging over its own width if it did over its width before."""
    film = dataclasses.replace(film, **fields)
    average = StripAverage.at_depth(film.width_m, film.depth_m)
    effects = tuple(average if is_of_strip(each) else each for each in film.effects)
    return dataclasses.replace(film, effects=effects)


def with_elements(sensor: Sensor, count: int) -> Sensor:
    """The sensor with so many elements, its own one after another."""
    films = tuple(sensor.elements[e % len(sensor.elements)] for e in range(count))
    return dataclasses.replace(sensor, elements=films)


def parameters(settings: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The free quantities of the experiment's settings.

    Raises `BadInput` for names that are not quantities of a film, and for ranges that do not
    increase or do not fit the quantity.
    """
    ranges = {
        "depth": _lengths("depth_m", settings["depth_m"], above=0.0),
        "width": _lengths("width_m", settings["width_m"], above=0.0),
        "angle": _angles(settings["angle_deg"]),
        "offset": _lengths(
            "offset_m", settings["offset_m"], least=-MOST_OFFSET_M, most=MOST_OFFSET_M
        ),
    }
    free = _names("free", settings["free"])
    refuse(not free, f"design.free is []: give one or more of {', '.join(FIELDS)}.")
    shared = _names("shared", settings["shared"])
    return tuple(
        Parameter(name, low, high, name in shared, name == "angle" and high - low >= np.pi)
        for name, (low, high) in ranges.items()
        if name in free
    )


def check_cells(space: DesignSpace, cell_m: float, length_m: float) -> None:
    """Refuse cells that do not resolve the waves which reach the shallowest film: exp(-kz) is 0.002
    at the shortest wave of cells half as wide as the depth."""
    depths = [float(film.depth_m) for film in space.given.elements]
    free = [each.low for each in space.parameters if each.name == "depth"]
    least = min(free or depths)
    cells = int(np.ceil(CELLS_IN_DEPTH * length_m / least))
    refuse(
        CELLS_IN_DEPTH * cell_m > least * (1 + 1e-9),
        f"The cells are {cell_m:g} m wide, too wide for a film {least:g} m deep: give "
        f"grid.cells={cells} or more.",
    )


def _lengths(key: str, ends: Any, **bounds: float) -> tuple[float, float]:
    wanted = "lengths in metres" if "least" in bounds else "positive lengths in metres"
    return number_range(f"design.{key}", ends, wanted, **bounds)


def _angles(ends: Any) -> tuple[float, float]:
    low, high = number_range("design.angle_deg", ends, "angles in degrees", least=-360, most=360)
    # Films more than half a turn apart are others of the same half turn.
    return float(np.deg2rad(low)), float(np.deg2rad(min(high, low + HALF_TURN_DEG)))


def _names(key: str, given: Any) -> list[str]:
    name = f"design.{key}"
    refuse(not isinstance(given, list), f"{name} is {echo(given)}: give a list of names.")
    return [choice(f"{name}[{at}]", each, list(FIELDS)) for at, each in enumerate(given)]
