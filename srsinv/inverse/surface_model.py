"""The signal of features of a surface, pressed on and slid over: parameters to voltage."""

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.fft
from jaxtyping import Array, Float

from ..errors import number, refuse
from ..forward.contact import Contact, press, refuse_both_ways
from ..forward.operator import MotionOperator
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..forward.surface import Surface
from ..forward.surface_feature import SurfaceFeature
from ..grid import Line, Open, Periodic, as_real
from .cells import Window
from .estimate import averages
from .feature_model import operator_along

SurfaceFeatures = Mapping[str, SurfaceFeature]

CELLS_PER_EDGE = 5  # the contact beside an edge is then right to some 1e-4 of the signal
CELLS_PER_DEPTH = 256  # at least: edges jump by cells, which has to be less than is felt
MOVES = {"position_m", "width_m"}  # parameters that move edges
BLOCK = 256  # cells come in multiples of it: the contact starts on so much wider cells


def cell_for(features: SurfaceFeatures, depth_m: float) -> float:
    """How wide the cells may be."""
    edges = [feature.edge_length_m for feature in features.values() if feature.edge_length_m]
    return min([depth_m / CELLS_PER_DEPTH, *(edge / CELLS_PER_EDGE for edge in edges)])


class SurfaceModel(eqx.Module):
    """Parameters of surface features to the signal (element, sample) of a sensor along a motion.

    The surface repeats with a window, whose cells are the operator's line. Beyond an open line the
    traction is that of the plate, to which a rate has no response; on a periodic one, quicker to
    set up, everything repeats.

    Parameters are a tree: each feature's by its name, `base_friction`, `nominal_pressure_Pa`,
    `gain` (a factor on the signal), where the film's depth is to be found `depth_m`, and where each
    element has an unknown constant `offset`.
    """

    PROFILES: ClassVar[tuple[str, ...]] = ("p", "q", "height", "gap", "friction")
    sensor: Sensor
    motion: Motion
    operator: MotionOperator
    features: dict[str, SurfaceFeature]

    @classmethod
    def on_window(
        cls,
        sensor: Sensor,
        motion: Motion,
        window: Window,
        cell_m: float,
        kind: type[Open] | type[Periodic] = Open,
    ) -> "SurfaceModel":
        """The model of the bare plate on a window of cells of at most `cell_m`. Raises `BadInput`
        for a window that does not hold the scan."""
        x = np.asarray(motion.position_m)
        refuse(
            not (window.start_m <= x.min() and x.max() <= window.end_m),
            f"The contact window from {window.start_m:.6g} m to {window.end_m:.6g} m does not hold "
            f"the scan from {x.min():.6g} m to {x.max():.6g} m: give recording.contact_window_m "
            "as [start, end] around it.",
        )
        blocks = int(np.ceil(window.length_m / cell_m / BLOCK))
        n = BLOCK * int(cast(int, scipy.fft.next_fast_len(max(blocks, 1), real=True)))
        cell = window.length_m / n
        line, ways = kind(n, cell, window.start_m + cell / 2), motion.ways
        if len(ways) > 1:
            refuse_both_ways(sensor.skin)
        return cls(sensor, motion, operator_along(sensor, line, motion, None, ways), {})

    def with_features(self, features: SurfaceFeatures) -> "SurfaceModel":
        """The same sensor, motion and window with these features in place of its own."""
        return dataclasses.replace(self, features=dict(features))

    @property
    def free_offset(self) -> bool:
        """Whether each element has an unknown constant."""
        return self.sensor.amplifier.offset is None

    @property
    def line(self) -> Line:
        """The cells of the traction."""
        return self.operator.line

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        own = [f"{name}.{each}" for name, f in self.features.items() for each in f.frictions]
        return ("base_friction", *own, *(("offset",) if self.free_offset else ()))

    def surface(self, params: Any) -> Surface:
        """The surface of these parameters."""
        shapes = [feature.shape(params[name]) for name, feature in self.features.items()]
        return Surface(shapes, params["base_friction"])

    def contact(self, params: Any) -> Contact:
        """How the skin lies on it."""
        height = self.surface(params).height(self.line)
        return press(self.line, self.sensor.skin, height, params["nominal_pressure_Pa"])

    def traction(self, params: Any) -> Float[Array, "2 n"]:
        """p and q [Pa] beyond those on the bare plate, while sliding towards +x."""
        return self._tractions(params, self.contact(params), (True,))[0]

    def profiles(self, params: Any) -> Float[Array, "5 n"]:
        """p and q as [`traction`][] has them, height and gap [m] and friction, along the line."""
        surface = self.surface(params)
        contact, height = self.contact(params), surface.height(self.line)
        (p, q), *_ = self._tractions(params, contact, (True,))
        return jnp.stack([p, q, height, contact.gap_m, surface.friction(self.line)])

    def cell_traction(self, params: Any, line: Line) -> Float[Array, "2 m"]:
        """Averages of p and q [Pa] over the cells of any line, while sliding towards +x; zero
        beyond the window."""
        return averages(self.traction(params), self.line, line)

    def _tractions(
        self, params: Any, contact: Contact, ways: tuple[bool, ...]
    ) -> list[Float[Array, "2 n"]]:
        surface, nominal = self.surface(params), params["nominal_pressure_Pa"]
        pressure = contact.pressure_Pa

        def sliding(forward: bool):
            shear = surface.friction(self.line, forward) * pressure
            shear = shear - surface.base_friction * nominal
            return jnp.stack([pressure - nominal, shear if forward else -shear])

        return [sliding(forward) for forward in ways]

    @property
    def steps(self) -> dict[str, float]:
        """Steps for central differences in the parameters that move edges, by name.

        As an edge moves, so does the skin's contact on its steep flank, and the pressure's
        derivative is singular there: on a contact set that stays it depends on where the edge lies
        within its cell, by a tenth where cells are a fifth of the edge. It is steady over whole
        cells, by which both ends of a width move at these steps.
        """
        step = 2 * float(self.line.cell_m)
        return {
            f"{name}.{part}": step
            for name, feature in self.features.items()
            for part in MOVES & feature.axes.keys()
        }

    def __call__(self, params: Any) -> Float[Array, "e sample"]:
        return self._signal(jax.tree.map(as_real, params))  # Python's numbers would be compiled in

    @eqx.filter_jit
    def _signal(self, params: Any) -> Float[Array, "e sample"]:
        operator, ways = self.operator, self._each_way(params)
        if "depth_m" in params:
            operator = self._sensor_at(params["depth_m"]).operator_along(
                self.line, self.motion, ways=operator.ways
            )
        signal = params["gain"] * operator(jnp.stack(ways) if len(ways) > 1 else ways[0])
        return signal + params["offset"][:, None] if self.free_offset else signal

    def _each_way(self, params: Any) -> list[Float[Array, "2 n"]]:
        return self._tractions(params, self.contact(params), self.operator.ways)

    def _sensor_at(self, depth_m: Any) -> Sensor:
        """The sensor with its shallowest film at another depth, and the others with it."""
        moved = depth_m - self.sensor.depth_m
        depths = [film.depth_m + moved for film in self.sensor.elements]
        return eqx.tree_at(lambda s: [film.depth_m for film in s.elements], self.sensor, depths)

    @eqx.filter_jit
    def fields(self, params: Any) -> Float[Array, "part way e n"]:
        """What the amplifier reads along the line, before its gain over time: of no friction at
        all, then of one unit more of each parameter that is linear, in their order."""
        names = [name for name in self.linear if name != "offset"]

        def of(one: str | None):
            own = dict(params) | {"base_friction": as_real(one == "base_friction")}
            for name, feature in self.features.items():
                units = {f: as_real(one == f"{name}.{f}") for f in feature.frictions}
                own[name] = dict(own[name]) | units
            return jnp.stack([self.operator.field(traction) for traction in self._each_way(own)])

        frictionless = of(None)
        return jnp.stack([frictionless, *(of(name) - frictionless for name in names)])


def checked_pressure(given: Any) -> float:
    """The nominal pressure, refused where none is known."""
    refuse(
        given is None,
        "No nominal pressure is known, which a surface is pressed on with: give "
        "recording.nominal_pressure_Pa, the mean over the contact window.",
    )
    wanted = "a positive pressure in Pa"
    return float(number("recording.nominal_pressure_Pa", given, wanted, above=0))
