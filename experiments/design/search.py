"""The best design in a box: descent by gradient from several starts, and a grid search beside it.

Both minimise the logarithm of the error, so that a step means the same at any size of it. The
descent is L-BFGS-B, with the gradient of jax. The grid search uses values alone: all designs of a
grid, then steps along the coordinates from the best of them, halved where none helps.
"""

import dataclasses
import itertools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float

from srsinv.compiled import compiled
from srsinv.errors import refuse
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Line

from .geometry import DesignSpace
from .tasks import Task

TOGETHER = 64  # designs computed at once; more takes more memory and no less time
PROBES = 6  # points at which a slope is looked for
EQUAL = 1e-6  # relative: errors closer than this count as the same
NO_EFFECT = 1e-9  # slope of log error over the whole range, 1e6 times its rounding
STEPS = 40  # of a descent that are drawn
FINEST_STEP = 1e-5  # of the range: where the grid search ends
MOST_STEPS = 2000  # of the grid search after the grid; it needs about a hundred

Point = Float[np.ndarray, " coordinate"]


class Criterion(eqx.Module):
    """log of the error that a task expects of the sensor at a point of a space, which slides over
    `line` in noise of the power `noise` (k,) in each element."""

    space: DesignSpace
    task: Task
    line: Line
    scan: ConstantSpeed
    noise: Float[Array, " k"]
    base: Float[np.ndarray, " coordinate"]
    is_active: Bool[np.ndarray, " coordinate"]

    @classmethod
    def checked(
        cls, space: DesignSpace, task: Task, line: Line, scan: ConstantSpeed, noise: Any
    ) -> "Criterion":
        """With the active coordinates found: those on which the error depends anywhere.

        Raises `BadInput` where it depends on none, and where it is not finite.
        """
        base = space.point(space.given)
        criterion = cls(space, task, line, scan, noise, base, np.ones(base.size, bool))
        signal = np.asarray(space.given.operator(line, scan).transfer)
        refuse(
            not np.any(signal) or not math.isfinite(criterion.value(base)),
            "The given films have no signal from the task's traction: give them piezoelectric "
            "constants other than 0.",
        )
        places = starts(base, PROBES, 0)
        steepest = np.max([np.abs(criterion.slope(each)[1]) for each in places], axis=0)
        active = {
            each.parameter.name
            for each, slope in zip(space.coordinates, steepest, strict=True)
            if slope > NO_EFFECT
        }
        free = [each.name for each in space.parameters]
        refuse(
            not active,
            f"design.free is {free}, on which the error does not depend: add depth to it.",
        )
        is_active = np.array([each.parameter.name in active for each in space.coordinates])
        return dataclasses.replace(criterion, is_active=is_active)

    @property
    def active(self) -> tuple[str, ...]:
        """The parameters on which the error depends."""
        pairs = zip(self.space.coordinates, self.is_active, strict=True)
        return tuple(dict.fromkeys(each.parameter.name for each, is_on in pairs if is_on))

    def completed(self, points: Float[np.ndarray, "*n active"]) -> np.ndarray:
        """Points from their active coordinates, the others being those of the given sensor."""
        whole = np.broadcast_to(self.base, (*points.shape[:-1], self.base.size)).copy()
        whole[..., self.is_active] = points
        return whole

    def of(self, sensor: Sensor) -> Float[Array, ""]:
        """The log error of any sensor."""
        transfer = sensor.operator(self.line, self.scan).transfer
        if self.line.n % 2 == 0:
            # Samples show one phase of the wave of two cells: an offset would act by it alone.
            transfer = transfer.at[..., -1].set(0.0)
        return jnp.log(self.task(transfer / jnp.sqrt(self.noise)))

    def __call__(self, point: Float[Array, " coordinate"]) -> Float[Array, ""]:
        return self.of(self.space.sensor(point))

    def slope(self, point: Point) -> tuple[float, Point]:
        """The log error and its gradient."""
        value, gradient = _slope(self, jnp.asarray(point, float))
        return float(value), np.asarray(gradient, float)

    def values(self, points: Float[np.ndarray, "n coordinate"]) -> Float[np.ndarray, " n"]:
        """The log errors of points."""
        short = -len(points) % TOGETHER
        padded = np.concatenate([points, np.repeat(points[:1], short, axis=0)])
        batches = padded.reshape(-1, TOGETHER, points.shape[1])
        found = [np.asarray(_values(self, jnp.asarray(each, float))) for each in batches]
        return np.concatenate(found)[: len(points)]

    def value(self, point: Point) -> float:
        """The log error of one point."""
        return self.slope(point)[0]


@compiled
def _slope(criterion: Criterion, point: Float[Array, " coordinate"]):
    return jax.value_and_grad(criterion)(point)


@compiled
def _values(criterion: Criterion, points: Float[Array, "n coordinate"]) -> Float[Array, " n"]:
    return jax.vmap(criterion)(points)


@compiled
def log_error(criterion: Criterion, sensor: Sensor) -> Float[Array, ""]:
    """The log error of a sensor outside the space."""
    return criterion.of(sensor)


class Descent(NamedTuple):
    """The best `point` of several starts, `begin`; the log errors at their `ends`, and along the
    first steps (start, step), repeated after the last one."""

    begin: Float[np.ndarray, "start coordinate"]
    point: Point
    value: float
    ends: Float[np.ndarray, " start"]
    paths: Float[np.ndarray, "start step"]
    evaluations: int


class GridSearch(NamedTuple):
    """The designs of a grid with `per` values of each coordinate, their log errors, the best of
    them, and the best `point` after steps of its own; `evaluations` of both together."""

    points: Float[np.ndarray, "design coordinate"]
    values: Float[np.ndarray, " design"]
    first: Point
    point: Point
    value: float
    per: int
    evaluations: int


def starts(given: Point, count: int, seed: int) -> np.ndarray:
    """The given point, and others spread over the box by a Latin hypercube."""
    sampler = scipy.stats.qmc.LatinHypercube(given.size, rng=np.random.default_rng(seed))
    return np.concatenate([given[None], sampler.random(count - 1)]) if count > 1 else given[None]


def descend(criterion: Criterion, begin: Float[np.ndarray, "start coordinate"]) -> Descent:
    """Descend from every start; of ends that are equal to a millionth the first one is taken."""
    points, paths, evaluations = [], [], 0
    for start in begin[:, criterion.is_active]:
        point, path, count = _descended(criterion, start)
        points.append(criterion.space.in_order(point))
        paths.append(path)
        evaluations += count
    ends = np.array([path[-1] for path in paths])
    best = int(np.flatnonzero(ends <= ends.min() + EQUAL)[0])
    steps = np.array([(path + path[-1:] * STEPS)[:STEPS] for path in paths])
    return Descent(begin, points[best], float(ends[best]), ends, steps, evaluations)


def _descended(criterion: Criterion, start: Point) -> tuple[Point, list[float], int]:
    """The end of a descent in the active coordinates, the log errors along it, and how many
    gradients it took."""
    is_active = criterion.is_active
    repeats = criterion.space.is_periodic[is_active]

    def slope(active: Point) -> tuple[float, Point]:
        value, gradient = criterion.slope(criterion.completed(active))
        return value, gradient[is_active]

    path = [slope(start)[0]]
    result: Any = scipy.optimize.minimize(
        slope, start, jac=True, method="L-BFGS-B",
        bounds=[(None, None) if each else (0.0, 1.0) for each in repeats],
        callback=lambda intermediate_result: path.append(float(intermediate_result.fun)),
        options={"maxiter": 500, "ftol": 1e-15, "gtol": 1e-9, "maxcor": 30},
    )  # fmt: skip
    return criterion.completed(result.x), [*path, float(result.fun)], int(result.nfev)


def search_grid(criterion: Criterion, most: int) -> GridSearch:
    """The best of up to `most` designs of a grid, then steps along its coordinates.

    Interchangeable elements are not permuted. Raises `BadInput` where two values of each
    coordinate make more designs.
    """
    least = _grid_size(criterion, 2)
    refuse(
        least > most,
        f"design.grid_designs is {most}, but two values of each free quantity make {least} "
        f"designs: give design.grid_designs={least}, or share more in design.shared.",
    )
    per = next(p for p in itertools.count(2) if _grid_size(criterion, p + 1) > most)
    points = criterion.completed(_grid(criterion, per))
    values = criterion.values(points)
    first, in_order = points[np.argmin(values)], criterion.space.in_order
    point, value, steps = _stepped(criterion, first, float(values.min()), 1 / (per - 1))
    return GridSearch(
        points, values, in_order(first), in_order(point), value, per, len(points) + steps
    )


def _split(criterion: Criterion) -> tuple[list[bool], list[bool], int]:
    """Whether each active coordinate of all elements repeats, and each of one element; the number
    of elements."""
    space = criterion.space
    active = [each for each in space.parameters if each.name in criterion.active]
    shared = [each.is_periodic for each in active if each.is_shared]
    own = [each.is_periodic for each in active if not each.is_shared]
    return shared, own, len(space.given.elements)


def _grid_size(criterion: Criterion, per: int) -> int:
    shared, own, elements = _split(criterion)
    each = per ** len(own)
    are_alike = criterion.space.are_alike
    rows = math.comb(each + elements - 1, elements) if are_alike else each**elements
    return per ** len(shared) * rows


def _grid(criterion: Criterion, per: int) -> Float[np.ndarray, "design active"]:
    """All designs with `per` values of each active coordinate, both ends of a range among them."""
    shared, own, elements = _split(criterion)

    def product(periodic: list[bool]) -> list[tuple[float, ...]]:
        ranges = [np.linspace(0, 1, per, endpoint=not repeats) for repeats in periodic]
        return list(itertools.product(*ranges))

    each = product(own)
    rows = (
        itertools.combinations_with_replacement(each, elements)
        if criterion.space.are_alike
        else itertools.product(each, repeat=elements)
    )
    flat = [tuple(itertools.chain.from_iterable(row)) for row in rows]
    return np.array([first + rest for first in product(shared) for rest in flat])


def _stepped(criterion: Criterion, point: Point, value: float, step: float):
    """Steps along single coordinates from a point, of half the size where none of them helps."""
    evaluations = 0
    moves = np.eye(point.size)[criterion.is_active]
    moves = np.concatenate([moves, -moves])
    for _ in range(MOST_STEPS):
        if step < FINEST_STEP:
            break
        tried = criterion.space.inside(point + step * moves)
        values = criterion.values(tried)
        evaluations += len(tried)
        if values.min() < value - 1e-12:
            point, value = tried[np.argmin(values)], float(values.min())
        else:
            step /= 2
    return point, value, evaluations
