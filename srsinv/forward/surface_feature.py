"""Features of a surface: families of shapes to fit to a signal through contact.

A feature names its parameters and their search ranges. Frictions enter the signal linearly, heights
and lengths do not.
"""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from ..errors import BadInput, number
from ..grid import Scalar
from .feature import POSITION, Axis, Range, ScanExtent, ShapeFamily
from .shape import FOLLOWS, Shape, follows
from .surface import Ridge, StepDown, StepUp, Tape

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
        """The same feature with edges that rise over this length."""
        return self._with(edge_length_m=_edge_length(edge_length_m))

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
