"""Features of traction: families of load profiles with friction, to fit to a signal.

A feature names the parameters of its shape and their search ranges; its traction is p = amplitude
times a profile and q = mu p. The amplitude enters every signal linearly, and so does mu times it.
(Features of the surface itself, with a height, act through contact: see `surface_feature`.)
"""

import abc
import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..errors import BadInput, echo, is_number, number, of_kind, refuse
from ..grid import Scalar
from ..known import is_traced
from ..modules import with_fields
from .traction import Bars, Hertz, LineLoad, Pressure, Step, UniformStrip

if TYPE_CHECKING:  # a type checker would give a module's heirs an `__init__` of its fields
    from abc import ABC as _Module
else:
    from equinox import Module as _Module

MOST_STARTS = 50_000  # of one search: their signals take some 4 GB, and a minute

Range = tuple[float, float]
Shape = Mapping[str, Scalar]


@dataclasses.dataclass(frozen=True)
class ScanExtent:
    """The interval that the sensor scanned, and the film's depth, which sets the blur there."""

    start_m: float
    end_m: float
    depth_m: float

    @property
    def length_m(self) -> float:
        """Length [m], at least a depth."""
        return max(self.end_m - self.start_m, self.depth_m)


@dataclasses.dataclass(frozen=True)
class Axis:
    """One parameter of a shape: its default range, and start values dense enough for one to lie
    near every minimum."""

    default: Callable[[ScanExtent], Range]
    starts: Callable[[Range, ScanExtent], np.ndarray]
    limits: Range = (-math.inf, math.inf)


def _every_half_depth(within: Range, stretch: ScanExtent) -> np.ndarray:
    return np.linspace(*within, max(3, math.ceil(2 * (within[1] - within[0]) / stretch.depth_m)))


def _pitches(within: Range, stretch: ScanExtent) -> np.ndarray:
    """Start pitches, so close that over the scan's extent neighbours differ by half a turn."""
    low, high = 1 / within[1], 1 / within[0]
    return 1 / np.linspace(low, high, max(3, math.ceil(2 * (high - low) * stretch.length_m) + 1))


POSITION = Axis(lambda s: (s.start_m, s.end_m), _every_half_depth)
# A strip narrower than a tenth of the film's depth is not distinguished from a line.
_WIDTH = Axis(lambda s: (0.1 * s.depth_m, s.length_m), _every_half_depth, (0.0, math.inf))
_HALF_WIDTH = Axis(lambda s: (0.05 * s.depth_m, s.length_m / 2), _every_half_depth, (0.0, math.inf))
_PITCH = Axis(lambda s: (s.depth_m, max(s.length_m / 2, 2 * s.depth_m)), _pitches, (0.0, math.inf))
_DUTY = Axis(lambda _: (0.1, 0.9), lambda r, _: np.linspace(*r, 5)[1:4:2], (0.0, 1.0))
# Two turns, so that no phase lies on a bound.
_PHASE = Axis(
    lambda _: (-2 * math.pi, 2 * math.pi),
    lambda r, _: np.linspace(r[0] / 2, r[1] / 2, 6, endpoint=False),
)


class ShapeFamily(_Module):
    """Shapes that differ in parameters, each looked for in a range.

    `search_ranges`: ranges that are not the default, (name, (least, greatest)), given for each
    parameter as `position_range_m`, `width_range_m`, `duty_range` and so on. Fields that a
    family of your own declares are given by their names.
    """

    axes: ClassVar[Mapping[str, Axis]]
    search_ranges: tuple[tuple[str, Range], ...] = eqx.field(static=True)

    def ranges(self, stretch: ScanExtent) -> dict[str, Range]:
        """Search range of each parameter of the shape: as given, else the default."""
        default = {name: axis.default(stretch) for name, axis in self.axes.items()}
        return default | dict(self.search_ranges)

    @property
    def reported(self) -> tuple[str, ...]:
        """Names of the parameters of the shape, as they are reported."""
        return tuple(self.axes)

    def from_reported(self, values: Mapping[str, float]) -> dict[str, float]:
        """Parameters of the shape, of values by reported names."""
        return dict(values)

    def axis_starts(self, stretch: ScanExtent) -> dict[str, np.ndarray]:
        """Values of each parameter of the shape to start from. Raises `BadInput` for a family
        that defines none."""
        ranges = self.ranges(stretch)
        values = {name: axis.starts(ranges[name], stretch) for name, axis in self.axes.items()}
        for name, each in values.items():
            refuse(
                np.ndim(each) != 1 or not np.all(np.isfinite(each)) or not np.size(each),
                f"{type(self).__name__}.axes[{name!r}] tries {echo(each)}: give one or more "
                "numbers to start from.",
            )
        return values

    @property
    def is_straight_across(self) -> bool:
        """Whether the feature is known to be straight across the sliding direction."""
        return True

    def refuse_many(self, tried: Mapping[str, np.ndarray], stretch: ScanExtent, most: int) -> None:
        """Refuse a search of more than `most` combinations of tried values."""
        count = math.prod(map(len, tried.values()))
        refuse(
            count > most,
            f"A search for {type(self).__name__} over {stretch.length_m:.6g} m would try "
            f"{count} shapes, above the limit of {most}: check the positions for "
            f"outliers, or give narrower ranges ({', '.join(map(range_name, self.axes))}).",
        )

    def _take(self, given: Mapping[str, Any], also: str) -> None:
        """Take search ranges, refused where one is invalid, and the family's own fields, by their
        keys. `also`: the field that the kind has."""
        for name, axis in self.axes.items():
            of_kind(f"{type(self).__name__}.axes[{name!r}]", axis, Axis, "an Axis, as POSITION")
        names = {range_name(name): name for name in self.axes}
        own = [name for name in self._fields() if name not in ("search_ranges", also)]
        unknown = sorted(set(given) - {*names, *own})
        refuse(
            bool(unknown),
            f"feature has no key {unknown and unknown[0]!r}: {type(self).__name__} takes "
            f"{', '.join([*own, *names])} and {also}.",
        )
        self.search_ranges = tuple(
            (names[key], _range(key, each, self.axes[names[key]].limits))
            for key, each in given.items()
            if key in names and each is not None
        )
        for name in own:
            if name in given:
                setattr(self, name, given[name])

    def _fields(self) -> list[str]:
        return [field.name for field in dataclasses.fields(cast(Any, self))]

    def _with(self, **changed: Any) -> Any:
        """A copy that differs in these fields."""
        return with_fields(cast(Any, self), **changed)

    @property
    def anywhere(self) -> Any:
        """The same family with default search ranges."""
        return self._with(search_ranges=())


class Feature(ShapeFamily):
    """Base of features of traction: a family of load profiles to fit to a signal, with q = mu p.

    - `friction`: mu, of either sign, where it is known; None lets it be fitted.
    - `position_range_m`, `width_range_m`, ...: (least, greatest) of a parameter of `axes`, where it
      is searched; None: everywhere in the scan. They are kept in `search_ranges`.

    `axes` and `profile` are to be defined. Raises `BadInput` for a range that is none, or not of
    the feature's parameters.
    """

    is_of_surface: ClassVar[bool] = False  # acts on the skin by itself, not through contact
    amplitude: ClassVar[str] = "pressure_Pa"
    shear: ClassVar[str] = "shear_Pa"
    is_semi_infinite: ClassVar[bool] = False  # extends beyond the end of every window
    is_periodic: ClassVar[bool] = False
    friction: float | None = eqx.field(static=True)

    def __init__(self, friction: Any = None, **given: Any):
        if friction is not None:
            wanted = "a number, of either sign, or null to fit it"
            friction = float(number("feature.friction", friction, wanted))
        self.friction = friction
        self._take(given, "friction")

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter a signal linearly."""
        return (self.amplitude,) if self.friction is not None else (self.amplitude, self.shear)

    def starts(self, stretch: ScanExtent) -> dict[str, np.ndarray]:
        """Shapes to start from, one for each combination of tried values: (start,) by name.

        Raises `BadInput` for more than `MOST_STARTS`.
        """
        tried = self.axis_starts(stretch)
        self.refuse_many(tried, stretch, MOST_STARTS)
        rows = np.array(list(itertools.product(*tried.values())))
        return dict(zip(self.axes, rows.T, strict=True))

    @abc.abstractmethod
    def profile(self, shape: Shape) -> Pressure:
        """The profile of amplitude one."""

    def canonical(self, own: dict[str, Any]) -> dict[str, Any]:
        """Canonical form of equivalent parameters (shape and `amplitude`)."""
        return own


class LineFeature(Feature):
    """A load on one line, [N/m]: narrower than the film resolves."""

    amplitude: ClassVar[str] = "load_N_per_m"
    shear: ClassVar[str] = "shear_N_per_m"
    axes: ClassVar[Mapping[str, Axis]] = {"position_m": POSITION}

    def profile(self, shape: Shape) -> Pressure:
        return LineLoad(1.0, shape["position_m"])


class StripFeature(Feature):
    """A strip of uniform pressure with friction, to be fitted.

    - `friction`: mu in q = mu p, where it is known; None lets it be fitted.
    - `position_range_m`, `width_range_m` [m]: (least, greatest) that are searched; None: the scan,
      and from a tenth of the film's depth to the scan's length.

    A fit reports `position_m`, `width_m` [m], `pressure_Pa` [Pa] and `friction`. Raises `BadInput`
    for a range that is none, and for other keys.
    """

    axes: ClassVar[Mapping[str, Axis]] = {"position_m": POSITION, "width_m": _WIDTH}

    def profile(self, shape: Shape) -> Pressure:
        return UniformStrip(1.0, shape["width_m"], shape["position_m"])


class HertzFeature(Feature):
    """The pressure under a cylinder, P sqrt(1 - (x - x0)^2/a^2), P its greatest value."""

    axes: ClassVar[Mapping[str, Axis]] = {"position_m": POSITION, "half_width_m": _HALF_WIDTH}

    def profile(self, shape: Shape) -> Pressure:
        return Hertz(1.0, shape["half_width_m"], shape["position_m"])


class StepFeature(Feature):
    """A pressure that begins at a place and goes on to the end."""

    is_semi_infinite: ClassVar[bool] = True
    axes: ClassVar[Mapping[str, Axis]] = {"position_m": POSITION}

    def profile(self, shape: Shape) -> Pressure:
        return Step(1.0, shape["position_m"])


class GratingFeature(Feature):
    """Bars of pressure with a pitch, a duty (their fraction of it) and a phase, less their mean."""

    is_periodic: ClassVar[bool] = True
    axes: ClassVar[Mapping[str, Axis]] = {"pitch_m": _PITCH, "duty": _DUTY, "phase_rad": _PHASE}

    def profile(self, shape: Shape) -> Pressure:
        return Bars(1.0, shape["pitch_m"], shape["duty"], shape["phase_rad"])

    def canonical(self, own: dict[str, Any]) -> dict[str, Any]:
        """Gaps that pull are bars that press; a phase lies between -pi and pi."""
        pressure, duty, phase = own["pressure_Pa"], own["duty"], own["phase_rad"]
        if is_traced(own):
            pulls = pressure < 0
            phase = phase + math.pi * pulls
            turned = phase - 2 * math.pi * jnp.round(phase / (2 * math.pi))
            duty = jnp.where(pulls, 1 - duty, duty)
            return own | {"pressure_Pa": jnp.abs(pressure), "duty": duty, "phase_rad": turned}
        if pressure < 0:
            pressure, duty, phase = -pressure, 1 - duty, phase + math.pi
        turned = math.remainder(phase, 2 * math.pi)
        return own | {"pressure_Pa": pressure, "duty": duty, "phase_rad": turned}


def range_name(parameter: str) -> str:
    """Key of a parameter's search range: `width_m` has `width_range_m`."""
    stem, _, unit = parameter.rpartition("_")
    return f"{stem}_range_{unit}" if stem else f"{unit}_range"


def _range(name: str, given: Any, limits: Range) -> Range:
    pair = isinstance(given, list | tuple) and len(given) == 2 and all(map(is_number, given))
    if not pair or not given[0] < given[1] or not (limits[0] < given[0] and given[1] < limits[1]):
        room = "" if limits[0] == -math.inf else f" above {limits[0]:g}"
        room += "" if limits[1] == math.inf else f" and below {limits[1]:g}"
        raise BadInput(
            f"feature.{name} is {echo(given)}: give [least, greatest]{room} in SI units, or null "
            "to search everywhere."
        )
    return float(given[0]), float(given[1])
