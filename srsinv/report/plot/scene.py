"""The scene and the sensor drawn to scale, with every sign."""

from dataclasses import dataclass

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .lettering import SIGN_CONVENTION
from .style import (
    MM_PER_M,
    SHADE,
    TRUTH,
    WIDTH_IN,
    colours,
    names_of,
    observed_anywhere,
    pressure_scale,
    short,
    stretches,
    styled,
    units_of,
)

_RUBBER, _SURFACE = "#f6efe6", "#dfe3e7"
_FILM = "#009e73"
_ARROW = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 12}
_LEFT_IN, _PLOT_IN = 0.9, WIDTH_IN - 1.1
_SIDE_IN, _ROW_IN, _PER_ROW = 1.95, 2.75, 3  # of the close-ups


@styled
def scene(dataset: xarray.Dataset) -> Figure:
    """Draw the finger's skin from the side: traction over the line, the sensor in it, and close up.

    - `dataset`: of a result: the elements' `element_depth`, `element_offset`, `element_width` [m]
      and `element_angle` [rad], and `traction` (component, x) [Pa] where it is known.

    z points up, into the finger, as in docs/explanation/physics/signs.md. Lengths along x and z
    have the same scale in the section and in the close-ups; only the film is drawn thicker than it
    is.
    """
    sensor = _Sensor.of(dataset)
    section_in = _section_height_in(dataset, sensor)
    section_top = 0.35
    below_top = section_top + section_in + 0.35
    close_ups_top = below_top + 2.4
    rows = -(-(len(sensor.names) + 1) // _PER_ROW)
    sheet = _Sheet(height_in=close_ups_top + rows * _ROW_IN)
    section = sheet.axes(section_top, section_in)
    _section(section, dataset, sensor)
    section.tick_params(labelbottom=False)
    below = sheet.axes(below_top, 1.45, sharex=section)
    draw_below = _pressure if "traction" in dataset else _samples
    draw_below(below, dataset)
    below.set(xlabel="position x [mm]", xlim=_view_mm(dataset, sensor))
    _close_ups(sheet, close_ups_top, sensor)
    return sheet.figure


@dataclass(frozen=True)
class _Sensor:
    """The film elements: names, and positions in mm and radians."""

    names: list[str]
    depth: np.ndarray
    offset: np.ndarray
    width: np.ndarray
    angle: np.ndarray

    @classmethod
    def of(cls, dataset: xarray.Dataset) -> "_Sensor":
        lengths = ("depth", "offset", "width")
        mm = {name: dataset[f"element_{name}"].values * MM_PER_M for name in lengths}
        return cls(names_of(dataset["element"]), **mm, angle=dataset["element_angle"].values)

    @property
    def reach(self) -> float:
        """The length scale of close-ups: the deepest film, or the widest."""
        return float(max(self.depth.max(), self.width.max() * 0.6))

    def ends(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """x and z [mm] of the ends of strip `i`, about the sensor's origin."""
        half = np.array([-1, 1]) * self.width[i] / 2
        along, down = np.cos(self.angle[i]), np.sin(self.angle[i])
        return self.offset[i] + half * along, self.depth[i] + half * down

    def axes_of(self, i: int) -> dict[str, np.ndarray]:
        """Unit vectors (x, z) of axis 1 and axis 3 of strip `i`.

        The response is the same for an axis and its opposite: 3 is drawn towards +x or +z, as the
        element's orientation is called.
        """
        c, s = np.cos(self.angle[i]), np.sin(self.angle[i])
        three = np.array([-s, c])
        return {"1": np.array([c, s]), "3": three * np.sign(three[np.argmax(np.abs(three))])}


@dataclass
class _Sheet:
    """A figure on which axes are placed in inches, so that both scales of a drawing agree."""

    height_in: float

    def __post_init__(self):
        self.figure = Figure(figsize=(WIDTH_IN, self.height_in))

    def axes(
        self,
        top: float,
        height: float,
        left: float = _LEFT_IN,
        width: float = _PLOT_IN,
        sharex: Axes | None = None,
    ) -> Axes:
        bottom = (self.height_in - top - height) / self.height_in
        place = (left / WIDTH_IN, bottom, width / WIDTH_IN, height / self.height_in)
        return self.figure.add_axes(place, sharex=sharex)


def _pressure(axes: Axes, dataset: xarray.Dataset) -> None:
    x, observed = dataset["x"].values, observed_anywhere(dataset)
    pressure = dataset["traction"].sel(component="p").values
    unit = pressure_scale(units_of(dataset["traction"]), pressure)
    colour = colours("p")["p"]
    for start, stop in stretches(x, ~observed):
        axes.axvspan(start * MM_PER_M, stop * MM_PER_M, color=SHADE, linewidth=0)
    axes.fill_between(x * MM_PER_M, pressure * unit.factor, color=colour, alpha=0.15)
    axes.plot(x * MM_PER_M, pressure * unit.factor, color=colour)
    axes.set_ylim(min(0.0, axes.get_ylim()[0]), None)
    shaded = "" if observed.all() else "; shaded: no samples"
    axes.set(title=f"Pressure on the skin along the whole line{shaded}", ylabel=unit.label("p"))


def _samples(axes: Axes, dataset: xarray.Dataset) -> None:
    elements = names_of(dataset["element"])
    for e, mask in enumerate(dataset["observed"].values):
        own = stretches(dataset["x"].values, mask)
        spans = [(MM_PER_M * left, MM_PER_M * (right - left)) for left, right in own]
        axes.broken_barh(spans, (e - 0.3, 0.6), color="#9aa5ae")
    axes.set_yticks(range(len(elements)), [short(element) for element in elements])
    axes.set_ylim(len(elements) - 0.4, -0.6)
    axes.set(title="Where each element has samples; the traction is not known", ylabel="element")


def _view_mm(dataset: xarray.Dataset, sensor: _Sensor) -> tuple[float, float]:
    """The whole line, and more where it is too short for the depth to fit the page."""
    whole = stretches(dataset["x"].values, np.ones(dataset.sizes["x"], bool))
    left, right = (MM_PER_M * end for end in whole[0])
    missing = max(0.0, 8.0 * sensor.reach - (right - left))
    return left - missing / 2, right + missing / 2


def _section_height_in(dataset: xarray.Dataset, sensor: _Sensor) -> float:
    left, right = _view_mm(dataset, sensor)
    return max(0.6, 2.6 * sensor.reach * _PLOT_IN / (right - left))


def _section(axes: Axes, dataset: xarray.Dataset, sensor: _Sensor) -> None:
    """The whole line with the skin below it; the axes' height makes x and z equal in scale."""
    left, right = _view_mm(dataset, sensor)
    height = _section_height_in(dataset, sensor) * (right - left) / _PLOT_IN
    _skin(axes, (left, right), (-0.3 * height, 0.7 * height))
    observed_mm = dataset["x"].values[observed_anywhere(dataset)] * MM_PER_M
    middle = (
        float((observed_mm[0] + observed_mm[-1]) / 2) if observed_mm.size else (left + right) / 2
    )
    for i in range(len(sensor.names)):
        x, z = sensor.ends(i)
        axes.plot(middle + x, z, color=_FILM, linewidth=2.0)
    speed = float(dataset.attrs["speed_m_per_s"])
    if abs(speed) > 0:
        beside = np.abs(sensor.offset).max() + sensor.width.max()
        along = np.array([beside, beside + 0.06 * (right - left)]) * np.sign(speed)
        start, end = np.stack([middle + along, np.full(2, 0.35 * height)], axis=1)
        _arrow(axes, start, end, TRUTH)
    axes.set(
        title=f"The finger from the side; the sensor, here at mid-scan, {_say_speed(speed)}",
        ylabel="z [mm]",
    )


def _say_speed(speed: float) -> str:
    if not np.isfinite(speed):
        return "slides at a speed that is not known"
    if speed == 0:
        return "rests"
    return f"slides towards {'+' if speed > 0 else '-'}x at {abs(speed) * 1e3:.4g} mm/s"


def _close_ups(sheet: _Sheet, top: float, sensor: _Sensor) -> None:
    """One square panel for the signs and one for each element."""
    step_in = (_PLOT_IN - _SIDE_IN) / (_PER_ROW - 1)
    for i in range(len(sensor.names) + 1):
        row, column = divmod(i, _PER_ROW)
        left = _LEFT_IN + column * step_in
        axes = sheet.axes(top + row * _ROW_IN, _SIDE_IN, left=left, width=_SIDE_IN)
        centre = 0.0 if i == 0 else float(sensor.offset[i - 1])
        reach = sensor.reach
        _skin(axes, (centre - 1.35 * reach, centre + 1.35 * reach), (-0.7 * reach, 2 * reach))
        if i == 0:
            _signs(axes, reach)
        else:
            _element(axes, sensor, i - 1)
        axes.set_xlabel("x about the sensor [mm]")
        axes.tick_params(labelleft=column == 0)
        if column == 0:
            axes.set_ylabel("depth z [mm]")


def _skin(axes: Axes, x_mm: tuple[float, float], z_mm: tuple[float, float]) -> None:
    axes.axhspan(0, z_mm[1], color=_RUBBER, zorder=0)
    axes.axhspan(z_mm[0], 0, facecolor=_SURFACE, zorder=0)
    axes.axhline(0, color="#8a7355", linewidth=1.5)
    axes.set(xlim=x_mm, ylim=z_mm)
    axes.grid(visible=False)


def _signs(axes: Axes, reach: float) -> None:
    palette = colours(("p", "q"))
    arrows = (  # text and its position; the arrow's start and end; all in close-up lengths
        ("p > 0", (-0.75, -0.36), (-0.85, -0.62), (-0.85, 0.0), palette["p"]),
        ("q > 0", (0.12, -0.36), (0.05, -0.16), (0.95, -0.16), palette["q"]),
        ("x", (-0.22, 0.5), (-0.9, 0.5), (-0.3, 0.5), TRUTH),
        ("z", (-0.94, 1.28), (-0.9, 0.5), (-0.9, 1.1), TRUTH),
    )
    for text, where, start, end, colour in arrows:
        _arrow(axes, reach * np.array(start), reach * np.array(end), colour)
        axes.text(where[0] * reach, where[1] * reach, text, color=colour, va="center")
    axes.text(
        0.97, 0.95, "tension is positive:\n" + SIGN_CONVENTION + "\nat z = 0",
        transform=axes.transAxes, ha="right", va="top", fontsize=8.5,
    )  # fmt: skip
    axes.text(1.3 * reach, 0.12 * reach, "the finger's skin", ha="right", va="bottom", fontsize=8.5)
    axes.set_title("Signs", fontsize=9)


def _element(axes: Axes, sensor: _Sensor, i: int) -> None:
    for other in range(len(sensor.names)):
        if other != i:
            axes.plot(*sensor.ends(other), color=_FILM, linewidth=3, alpha=0.2)
    axes.plot(*sensor.ends(i), color=_FILM, linewidth=4, solid_capstyle="butt")
    centre = np.array([sensor.offset[i], sensor.depth[i]])
    for name, direction in sensor.axes_of(i).items():
        _arrow(axes, centre, centre + 0.68 * sensor.reach * direction, TRUTH)
        x, z = centre + 0.8 * sensor.reach * direction
        axes.text(x, z, name, ha="center", va="center")
    axes.set_title(f"Element {sensor.names[i]}", fontsize=9)


def _arrow(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str) -> None:
    properties = {**_ARROW, "color": colour, "linewidth": 1.3}
    axes.annotate("", tuple(end), tuple(start), arrowprops=properties, zorder=5)
