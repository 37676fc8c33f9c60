"""Features of a surface: families of shapes to fit to a signal through contact.

A feature names its parameters and their search ranges. Frictions enter the signal linearly, heights
and lengths do not.
"""

import abc
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from ..errors import BadInput, echo, is_number, number, refuse
from ..grid import Scalar
from .feature import POSITION, Axis, Range, ScanExtent, ShapeFamily
from .shape import FOLLOWS, Shape, follows
from .surface import Cylinder, Ridge, StepDown, StepUp, Tape

LEAST_HEIGHT_M, GREATEST_HEIGHT_M = 1e-7, 1e-3
HEIGHTS = 7  # tried: the signal goes from linear in the height to independent of it


def _heights(within: Range, stretch: ScanExtent) -> np.ndarray:
    """Start heights by equal factors; where the range contains zero, of both signs."""
    low, high = within
    if low >= 0 or high <= 0:
        least, most = sorted((abs(low), abs(high)))
        tried = np.geomspace(max(least, most / 1e3), most, HEIGHTS + 2)[1:-1]
        return tried if high > 0 else -tried
    ends = (_heights((0.0, end), stretch) for end in (abs(low), high))
    below, above = ends
    return np.concatenate([-below, above])


def _widths(within: Range, stretch: ScanExtent) -> np.ndarray:
    """Start widths so close that every edge is within a quarter of a depth of a tried one."""
    low, high = within
    even = np.arange(1, int(2 * high / stretch.depth_m) + 1) * stretch.depth_m / 2
    narrow = stretch.depth_m * np.array([0.12, 0.25])
    tried = np.concatenate([narrow, even])
    inside = tried[(tried > low) & (tried < high)]
    return inside if inside.size else np.array([np.sqrt(low * high)])


def _middle(within: Range, stretch: ScanExtent) -> np.ndarray:
    del stretch
    return np.array([np.sqrt(max(within[0], 1e-2 * within[1]) * within[1])])


HEIGHT = Axis(lambda _: (LEAST_HEIGHT_M, GREATEST_HEIGHT_M), _heights)
WIDTH = Axis(lambda s: (0.02 * s.depth_m, s.length_m), _widths, (0.0, np.inf))
ZONE = Axis(lambda s: (0.1 * s.depth_m, 4 * s.depth_m), _middle, (0.0, np.inf))


def _edge_length(given: Any) -> float | None:
    wanted = "a positive length in metres, or null to take it from the sidecar"
    return None if given is None else float(number("feature.edge_length_m", given, wanted, above=0))


class SurfaceFeature(ShapeFamily):
    """Base of features of a surface: a family of shapes to fit to a signal through contact.

    - `edge_length_m` [m]: over which its edges rise; None where the recording's sidecar gives it.
    - `height_range_m`, `position_range_m`, ...: (least, greatest) of a parameter of `axes`, where
      it is searched; None: its default. They are kept in `search_ranges`.

    `axes` and `shape` are to be defined; `frictions` are the names of the parameters that enter
    linearly beside the plate's friction. Raises `BadInput` for a range that is none, or not of the
    feature's parameters.
    """

    is_of_surface: ClassVar[bool] = True
    has_edges: ClassVar[bool] = True  # which rise over a length that has to be known
    frictions: ClassVar[tuple[str, ...]] = ()
    edge_length_m: float | None = eqx.field(static=True)

    def __init__(self, edge_length_m: Any = None, **given: Any):
        self.edge_length_m = _edge_length(edge_length_m)
        self._take(given, "edge_length_m")

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter a signal linearly."""
        return self.frictions

    def with_edge(self, edge_length_m: Any) -> "SurfaceFeature":
        """The same feature with edges that rise over this length; itself where it has none."""
        return self._with(edge_length_m=_edge_length(edge_length_m)) if self.has_edges else self

    @property
    def edge_m(self) -> float:
        """The edge length; raises `BadInput` where it is not known."""
        if self.edge_length_m is None:
            raise BadInput(
                "The edge length is not known, and the data do not determine it beside the "
                "width: give the feature's edge_length_m, or feature.edge_length_m in the "
                "sidecar."
            )
        return self.edge_length_m

    @property
    def other_setting(self) -> str:
        """What else may be assumed of it where the motion turns, as a setting; nothing of most."""
        return ""

    @abc.abstractmethod
    def shape(self, own: Mapping[str, Scalar]) -> Shape:
        """The shape of these parameters: those of `axes`, of `frictions`, and `edge_length_m`."""


class RidgeFeature(SurfaceFeature):
    """A ridge: a raised strip on a plate, to be fitted through contact.

    - `edge_length_m` [m]: over which its edges rise, which data cannot tell from the width; None
      where the recording's sidecar gives it.
    - `height_range_m`, `width_range_m`, `position_range_m` [m]: (least, greatest) that are
      searched; None: heights from 1e-7 to 1e-3, and all of the scan. Negative heights are grooves.

    A fit reports `height_m`, `width_m`, `position_m` [m] and `base_friction`. Raises `BadInput` for
    a range that is none, and for other keys.
    """

    axes: ClassVar[Mapping[str, Axis]] = {
        "height_m": HEIGHT,
        "width_m": WIDTH,
        "position_m": POSITION,
    }

    def shape(self, own: Mapping[str, Scalar]) -> Shape:
        return Ridge(**own)


class TapeFeature(SurfaceFeature):
    """A tape on a plate: a raised strip whose two edges have a friction of their own, to be fitted
    (Howe 1993, Fig. 13).

    - `edge_length_m` [m] and ranges as of [`RidgeFeature`][]; `friction_zone_length_range_m` [m]:
      of the length over which an edge's friction acts.
    - `friction_follows`: whether an edge's friction goes with the "motion" (leading or trailing) or
      with the "edge" where the motion turns.

    A fit reports `leading_edge_friction`, `trailing_edge_friction` and `friction_zone_length_m`
    beside a ridge's parameters. Raises `BadInput` for another word, and as `RidgeFeature` does.
    """

    axes: ClassVar[Mapping[str, Axis]] = {
        "height_m": HEIGHT,
        "width_m": WIDTH,
        "position_m": POSITION,
        "friction_zone_length_m": ZONE,
    }
    frictions: ClassVar[tuple[str, ...]] = ("leading_edge_friction", "trailing_edge_friction")
    friction_follows: str = eqx.field(static=True)

    def __init__(self, edge_length_m: Any = None, friction_follows: Any = FOLLOWS[0], **given: Any):
        self.friction_follows = follows(friction_follows)
        super().__init__(edge_length_m, **given)

    @property
    def other_setting(self) -> str:
        (other,) = set(FOLLOWS) - {self.friction_follows}
        return f"friction_follows={other}"

    def shape(self, own: Mapping[str, Scalar]) -> Shape:
        return Tape(**own, friction_follows=self.friction_follows)


class StepUpFeature(SurfaceFeature):
    """A step up, to the end of the window, its edge with a friction of its own."""

    axes: ClassVar[Mapping[str, Axis]] = {
        "height_m": HEIGHT,
        "position_m": POSITION,
        "friction_zone_length_m": ZONE,
    }
    frictions: ClassVar[tuple[str, ...]] = ("edge_friction",)

    def shape(self, own: Mapping[str, Scalar]) -> Shape:
        return StepUp(**own)


class StepDownFeature(SurfaceFeature):
    """A step down, from the beginning of the window, its edge with a friction of its own."""

    axes: ClassVar[Mapping[str, Axis]] = StepUpFeature.axes
    frictions: ClassVar[tuple[str, ...]] = ("edge_friction",)

    def shape(self, own: Mapping[str, Scalar]) -> Shape:
        return StepDown(**own)


LEAST_RADIUS_M, GREATEST_RADIUS_M = 1e-6, 1e-2
RADII = 4  # tried: the signal is nearly linear in the radius
# Above 0, where the derivative of the angle by its squared sine is infinite.
LEAST_SINE_SQUARED = 1e-10
GREATEST_ANGLE_DEG = 75.0
ANGLE_STEP_DEG = 7.5  # of angles that are tried


def _radii(within: Range, stretch: ScanExtent) -> np.ndarray:
    del stretch
    return np.geomspace(max(within[0], within[1] / 100), within[1], RADII + 2)[1:-1]


def _sines_squared(within: Range, stretch: ScanExtent) -> np.ndarray:
    """Those of angles in equal steps."""
    del stretch
    low, high = np.degrees(np.arcsin(np.sqrt(within)))
    steps = max(1, round((high - low) / ANGLE_STEP_DEG))
    middles = low + (np.arange(steps) + 0.5) * (high - low) / steps
    return np.sin(np.radians(middles)) ** 2


RADIUS = Axis(lambda _: (LEAST_RADIUS_M, GREATEST_RADIUS_M), _radii, (0.0, np.inf))
SINE_SQUARED = Axis(
    lambda _: (LEAST_SINE_SQUARED, math.sin(math.radians(GREATEST_ANGLE_DEG)) ** 2),
    _sines_squared,
    (0.0, 1.0),
)


class CylinderFeature(SurfaceFeature):
    """A rigid cylinder that the skin touches alone, its axis turned in the plane of the skin, to be
    fitted (Fearing and Binford 1991, by stress-rate signals).

    - `angle_deg`: from the sliding direction to the normal of its axis, where it is known, from 0
      to below 90; None fits it. 0: the axis is across the sliding direction.
    - `angle_range_deg`, `radius_range_m`, `position_range_m`: (least, greatest) that are searched;
      None: angles up to 75, radii from 1e-6 to 1e-2, and all of the scan.

    A fit reports `radius_m`, `position_m` [m], where the scan crosses the axis, `angle_rad` and
    `base_friction`. A straight scan has the same signal at both signs of the angle, so that it is
    the size of the angle which is reported. The fit's parameter is its squared sine, in which the
    signal is smooth at 0. Raises `BadInput` for an angle or a range that is none.
    """

    has_edges: ClassVar[bool] = False
    angle_deg: float | None = eqx.field(static=True)

    def __init__(self, angle_deg: Any = None, angle_range_deg: Any = None, **given: Any):
        if angle_deg is not None:
            wanted = "an angle from 0 to below 90 degrees, or null to fit it"
            angle_deg = float(number("feature.angle_deg", angle_deg, wanted, least=0, below=90))
        self.angle_deg = angle_deg
        super().__init__(None, **given)
        if angle_range_deg is not None:
            refuse(
                angle_deg is not None,
                "feature.angle_deg and feature.angle_range_deg are both given: leave one out.",
            )
            own = "sine_squared", _sine_squared_range(angle_range_deg)
            self.search_ranges = (*self.search_ranges, own)

    @property
    def axes(self) -> Mapping[str, Axis]:  # pyright: ignore[reportIncompatibleVariableOverride]
        known = {"radius_m": RADIUS, "position_m": POSITION}
        return known if self.angle_deg is not None else known | {"sine_squared": SINE_SQUARED}

    @property
    def reported(self) -> tuple[str, ...]:
        return tuple("angle_rad" if name == "sine_squared" else name for name in self.axes)

    @property
    def is_straight_across(self) -> bool:
        return self.angle_deg == 0

    def from_reported(self, values: Mapping[str, float]) -> dict[str, float]:
        own = dict(values)
        if "angle_rad" in own:
            own["sine_squared"] = max(math.sin(own.pop("angle_rad")) ** 2, LEAST_SINE_SQUARED)
        return own

    def shape(self, own: Mapping[str, Scalar]) -> Shape:
        return Cylinder(own["radius_m"], own["position_m"])


def _sine_squared_range(given: Any) -> Range:
    pair = isinstance(given, list | tuple) and len(given) == 2 and all(map(is_number, given))
    refuse(
        not pair or not 0 <= given[0] < given[1] < 90,
        f"feature.angle_range_deg is {echo(given)}: give [least, greatest] from 0 to below 90 "
        "degrees, or null to search up to 75.",
    )
    low, high = (math.sin(math.radians(each)) ** 2 for each in given)
    return max(low, LEAST_SINE_SQUARED), high
