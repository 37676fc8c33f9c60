"""The optimum beside the given sensor and the grid's best, as a dataset."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import xarray
from jaxtyping import Float

from srsinv.forward.sensor import Sensor
from srsinv.report.data import dataset, scalars
from srsinv.report.text import listed

from .geometry import FIELDS, changed
from .optimum import flat_directions, gradient_error, tolerance
from .search import EQUAL, Criterion, Descent, GridSearch, Point, log_error
from .tasks import Task

PLACES = 81  # of a profile
CHECKED = 4  # starts at which the gradient is compared with differences
INSIDE = 0.02  # of the range, from a bound: differences take values on both sides
DESIGNS = ("given", "optimum", "grid")
UNITS = {"depth": "m", "width": "m", "angle": "deg", "offset": "m"}


class Study(NamedTuple):
    """All that was computed of an optimum.

    Errors of the `given` sensor, of the `optimum`, of as many given `films` as the optimum has, and
    of these `alone` with one quantity of the optimum each; profiles (coordinate, place) and reach
    (coordinate, 2) about the optimum, its slope and flat directions.
    """

    criterion: Criterion
    sensor: Sensor
    descent: Descent
    grid: GridSearch
    given: float
    optimum: float
    places: Float[np.ndarray, " place"]
    profiles: Float[np.ndarray, "coordinate place"]
    reach: Float[np.ndarray, "coordinate 2"]
    slope: Float[np.ndarray, " coordinate"]
    films: float
    alone: dict[str, float]
    flat: int
    gradient_error: float

    @classmethod
    def of(
        cls, criterion: Criterion, sensor: Sensor, descent: Descent, grid: GridSearch, growth: float
    ) -> "Study":
        """Compute what follows from the searches."""
        point, places = descent.point, np.linspace(0, 1, PLACES)
        value, slope = criterion.slope(point)
        paths, reach = tolerance(criterion, point, growth, places)
        checked = np.clip(descent.begin[:CHECKED], INSIDE, 1 - INSIDE)
        return cls(
            criterion, sensor, descent, grid,
            float(np.exp(log_error(criterion, sensor))), float(np.exp(value)),
            places, np.exp(paths), reach, slope,
            float(np.exp(log_error(criterion, criterion.space.given))), _alone(criterion, point),
            flat_directions(criterion, point), gradient_error(criterion, checked),
        )  # fmt: skip

    @property
    def gain_of_grid(self) -> float:
        """By how much, relative, the grid's best is better than the optimum."""
        return float(np.log(self.optimum) - self.grid.value)

    @property
    def is_at_bound(self) -> np.ndarray:
        """Which coordinates of the optimum lie on a face of the box."""
        point, space = self.descent.point, self.criterion.space
        return ~space.is_periodic & ((point <= 0) | (point >= 1)) & self.criterion.is_active

    def with_task(self, task: Task, which: str) -> float:
        """The error of another task, of the given sensor or of the optimum."""
        criterion = dataclasses.replace(self.criterion, task=task)
        best = criterion.space.sensor(self.descent.point)
        return float(np.exp(log_error(criterion, best if which == "optimum" else self.sensor)))


def _alone(criterion: Criterion, point: Point) -> dict[str, float]:
    """The error of the given films with one quantity of the optimum each."""
    own, best, alone = criterion.space.given, criterion.space.sensor(point), {}
    for name in criterion.active:
        field = FIELDS[name]
        films = tuple(
            changed(film, {field: getattr(other, field)})
            for film, other in zip(own.elements, best.elements, strict=True)
        )
        sensor = dataclasses.replace(own, elements=films)
        alone[name] = float(np.exp(log_error(criterion, sensor)))
    return alone


def design_dataset(study: Study, **further: float) -> xarray.Dataset:
    """The designs with their errors, tolerances and prices of bounds, and the profiles and descents
    that the page draws; `further` are metrics of a task."""
    task, descent, grid = study.criterion.task, study.descent, study.grid
    quantity, units = task.quantity, task.units
    end = "" if units == "1" else f"_{units}"
    variables: dict[str, tuple[Any, ...]] = {}
    coordinates: dict[str, tuple[Any, ...]] = {
        "design": (list(DESIGNS), "1"),
        "element": (np.arange(1, _elements(study) + 1), "1"),
        "side": (["less", "more"], "1"),
        "parameter": (list(study.criterion.active), "1"),
    }
    for name in FIELDS:
        variables |= _of_designs(study, name)
    for name in study.criterion.active:
        variables |= _of_parameter(study, name, quantity, units)
    errors = [study.given, study.optimum, float(np.exp(grid.value))]
    variables |= {
        "expected": ("design", errors, units, f"{quantity}_{{design}}{end}"),
        "alone": ("parameter", list(study.alone.values()), units,
                  f"{quantity}_{{parameter}}_alone{end}"),
        "path": (("start", "step"), np.exp(descent.paths), units),
        **scalars({
            "factor": study.given / study.optimum,
            f"{quantity}_given_films{end}": study.films,
            f"{quantity}_grid_point{end}": float(np.exp(grid.values.min())),
            "gain_of_grid": study.gain_of_grid,
            "gradient_difference": study.gradient_error,
            "flat_directions": study.flat,
            "starts_at_optimum": int(np.sum(descent.ends < descent.value + EQUAL)),
            "descent_evaluations": descent.evaluations,
            "grid_evaluations": grid.evaluations,
            "grid_values": grid.per,
            **further,
        }),
    }  # fmt: skip
    free = study.criterion.space.parameters
    return dataset(
        variables, coordinates, quantity=quantity, units_of_error=units, end_of_error=end,
        elements=len(study.criterion.space.given.elements), starts=len(descent.begin),
        given_elements=len(study.sensor.elements),
        shared=listed(each.name for each in free if each.is_shared),
        without_effect=listed(each.name for each in free if each.name not in study.alone),
    )  # fmt: skip


def _of_designs(study: Study, name: str) -> dict[str, tuple[Any, ...]]:
    """One quantity of every design and element."""
    space, grid = study.criterion.space, study.grid
    sensors = study.sensor, space.sensor(study.descent.point), space.sensor(grid.point)
    values = [[float(getattr(film, FIELDS[name])) for film in each.elements] for each in sensors]
    shown = np.array([_padded(study, row) for row in values])
    shown = np.rad2deg(shown) if name == "angle" else shown
    metric = f"{name}_{{design}}_{{element}}_{UNITS[name]}"
    return {name: (("design", "element"), shown, UNITS[name], metric)}


def _of_parameter(study: Study, name: str, quantity: str, units: str) -> dict[str, tuple[Any, ...]]:
    """Profile, tolerance, price of a bound and the grid of one active quantity, element by
    element."""
    space, grid = study.criterion.space, study.grid
    parameter = next(each for each in space.parameters if each.name == name)
    rows = [c for c, each in enumerate(space.coordinates) if each.parameter == parameter]
    if parameter.is_shared:
        rows = rows * len(space.given.elements)
    size, unit = np.rad2deg(1.0) if name == "angle" else 1.0, UNITS[name]
    low, span = size * parameter.low, size * parameter.span
    on_grid = grid.points[:, np.unique(rows)]
    places = np.unique(on_grid)
    least = [grid.values[(on_grid == at).any(axis=1)].min() for at in places]
    price = np.where(study.is_at_bound, study.slope * study.optimum / span, np.nan)
    return {
        f"{name}_place": (f"{name}_at", low + span * study.places, unit),
        f"{name}_profile": (("element", f"{name}_at"), _padded(study, study.profiles[rows]), units),
        f"{name}_tolerance": (("element", "side"), _padded(study, span * study.reach[rows]), unit,
                              f"{name}_tolerance_{{side}}_{{element}}_{unit}"),
        f"{name}_price": ("element", _padded(study, price[rows]), f"{units}/{unit}",
                          f"{quantity}_per_{name}_{{element}}"),
        f"{name}_grid_place": (f"{name}_on_grid", low + span * places, unit),
        f"{name}_grid_error": (f"{name}_on_grid", np.exp(least), units),
    }  # fmt: skip


def _elements(study: Study) -> int:
    """Elements of the larger one of the given sensor and the design."""
    return max(len(study.sensor.elements), len(study.criterion.space.given.elements))


def _padded(study: Study, rows: Any) -> np.ndarray:
    """Rows of a sensor's elements, with NaN for those that it lacks."""
    rows = np.asarray(rows, float)
    missing = np.full((_elements(study) - len(rows), *rows.shape[1:]), np.nan)
    return np.concatenate([rows, missing])
