"""Signals of a rig over a known traction, by its gains, depth, angles and offsets."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ... import resolution
from ...compiled import compiled
from ...errors import refuse
from ...forward.film import Film
from ...forward.operator import POINTS, PositionInterpolation
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...grid import Open, as_real
from ..features.contact import cell_for
from ..features.model import FeatureModel
from ..problem import Problem

BLOCK = 256  # cells come in multiples of it: one program then serves most places of a feature
_OF_FILMS = "depth_", "angle_", "offset_"


@dataclass(frozen=True)
class KnownTraction:
    """The pressure's deviation from its background (n,) [Pa] on an open line, of a feature at
    `place_m`; the shear is mu times it."""

    line: Open
    pressure_Pa: Float[np.ndarray, " n"]
    place_m: float

    @classmethod
    def of(
        cls,
        problem: Problem,
        feature: Any,
        held: Mapping[str, float],
        nominal_pressure_Pa: float,
        place_m: float | None = None,
        finer: int = 1,
    ) -> "KnownTraction":
        """That of a feature of these parameters, on cells so many times finer than usual.

        `place_m`: where it lies; None: in the window's middle, from which it may be moved. The
        surface repeats with the window, so that what is moved is not quite what lies there.

        Raises `BadInput` where one of them is not held.
        """
        depth, window = float(problem.sensor.depth_m), problem.window
        place = (window.start_m + window.end_m) / 2
        names = [name for name in feature.axes if name != "position_m"]
        load = [] if feature.is_of_surface else [feature.amplitude]
        absent = [name for name in (*names, *load) if name not in held]
        refuse(
            bool(absent),
            f"{', '.join(absent)} of the feature must be known, as the data do not "
            "determine it beside the gain: give "
            f"fit.hold={{{', '.join(f'{each}: ...' for each in absent)}}}.",
        )
        refuse(
            bool(getattr(feature, "is_semi_infinite", False) or feature.axes.keys() >= {"pitch_m"}),
            f"{type(feature).__name__} has no position within the scan: calibrate on a "
            "ridge, a step of a surface, a line load or a strip load.",
        )
        if place_m is not None:
            place = float(np.clip(place_m, window.start_m, window.end_m))
        own = {name: float(held[name]) for name in (*names, *load)} | {"position_m": place}
        if feature.is_of_surface:
            cell = cell_for({"known": feature}, depth) / finer
            model = FeatureModel.on_window(
                problem.sensor, problem.motion, window, cell, nominal_pressure_Pa
            )
            own |= dict.fromkeys(feature.frictions, 0.0) | {"edge_length_m": feature.edge_m}
        else:
            cell = resolution.cell_m("load", depth) / finer
            model = FeatureModel.along(problem.sensor, problem.motion, cell)
            own |= {name: 0.0 for name in feature.linear if name not in load}
        model = model.with_features({"known": feature})
        params = model.loading.common() | {"known": own}
        pressure = np.asarray(model.traction(jax.tree.map(as_real, params)))[0]
        line = Open(model.line.n, float(model.line.cell_m), float(model.line.x[0]))
        known = cls(line, pressure, place)
        return known if place_m is None else known.moved_to(place_m)

    def over(self, start_m: float, end_m: float, cell_m: float) -> "KnownTraction":
        """The same on cells of this width, on a line that goes on, with nothing on it, to hold a
        stretch.

        Each step of the pressure from cell to cell is shared among the edges of the wider ones by
        the weights that interpolate between them. A film's signal is smooth in the place of a
        step, so that it stays the same to the eighth power of cell over depth, times 43.
        """
        own, first = float(self.line.cell_m), float(self.line.x[0])
        steps = np.diff(self.pressure_Pa, prepend=0.0, append=0.0)
        at = first + own * (np.arange(steps.size) - 0.5)
        start = min(start_m, at[0]) - POINTS * cell_m
        n = int(np.ceil((max(end_m, at[-1]) - start) / cell_m)) + POINTS
        n += -n % BLOCK
        shared = PositionInterpolation(Open(n + 1, cell_m, start), at).adjoint(as_real(steps)[None])
        line = Open(n, cell_m, start + cell_m / 2)
        return KnownTraction(line, np.cumsum(np.asarray(shared)[0])[:-1], self.place_m)

    def moved_to(self, place_m: float) -> "KnownTraction":
        """The same with its feature elsewhere."""
        start_m = float(self.line.x[0]) + place_m - self.place_m
        line = Open(self.line.n, float(self.line.cell_m), start_m)
        return KnownTraction(line, self.pressure_Pa, place_m)


class RigModel(eqx.Module):
    """Parameters of a rig to its signals (e, sample) along a motion over a known traction.

    The parameters are `gain_N`, `depth_m`, `position_m`, `base_friction`, and `angle_N_rad` and
    `offset_N_m` of the elements from the second on, N from 1; `offset` (e,) where the channels have
    a constant that is not known.
    """

    sensor: Sensor
    motion: Motion
    line: Open
    pressure_Pa: Float[Array, " n"]
    place_m: Float[Array, ""]
    directions: tuple[bool, ...] = eqx.field(static=True)
    free_offset: bool = eqx.field(static=True)

    @classmethod
    def on(cls, problem: Problem, known: KnownTraction) -> "RigModel":
        """That of a problem's sensor and motion."""
        motion = problem.motion
        traction = known.line, as_real(known.pressure_Pa), as_real(known.place_m)
        return cls(problem.sensor, motion, *traction, motion.directions, problem.has_free_offset)

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        gains = tuple(f"gain_{n + 1}" for n in range(len(self.sensor.elements)))
        return (*gains, *(("offset",) if self.free_offset else ()))

    @compiled
    def __call__(self, params: Mapping[str, Any]) -> Float[Array, "e sample"]:
        elements = range(len(self.sensor.elements))
        gain = jnp.stack([jnp.asarray(params[f"gain_{n + 1}"]) for n in elements])
        signal = gain[:, None] * self.unit_signal(params)
        return signal + params["offset"][:, None] if self.free_offset else signal

    def unit_signal(self, params: Mapping[str, Any]) -> Float[Array, "e sample"]:
        """The signals at gains of one."""
        shift = self.place_m - params["position_m"]
        motion = eqx.tree_at(lambda m: m.position_m, self.motion, self.motion.position_m + shift)
        operator = self.sensor.operator_along(self.line, motion, directions=self.directions)
        films = {n: as_real(each) for n, each in params.items() if n.startswith(_OF_FILMS)}
        transfer = _transfer(films, model=self)
        operator = eqx.tree_at(lambda o: o.field.transfer, operator, transfer)
        shear = params["base_friction"] * self.pressure_Pa
        turned = [
            jnp.stack([self.pressure_Pa, shear if direction else -shear])
            for direction in self.directions
        ]
        return operator(jnp.stack(turned) if len(self.directions) > 1 else turned[0])

    def transfer_of(self, films: Mapping[str, Any]) -> Complex[Array, "e c k"]:
        """The films' transfer along the line, at these depths, angles and offsets."""
        sensor = self.sensor_of({"depth_m": self.sensor.depth_m, **films})
        return sensor.operator_along(
            self.line, self.motion, directions=self.directions
        ).field.transfer

    def sensor_of(self, params: Mapping[str, Any]) -> Sensor:
        """The sensor of these parameters."""
        deeper = params["depth_m"] - self.sensor.depth_m

        def placed(number: int, film: Film) -> Film:
            angle, offset = params.get(f"angle_{number}_rad"), params.get(f"offset_{number}_m")
            film = eqx.tree_at(lambda f: f.depth_m, film, film.depth_m + deeper)
            if angle is not None:
                film = eqx.tree_at(lambda f: f.angle_rad, film, as_real(angle))
            if offset is not None:
                film = eqx.tree_at(lambda f: f.offset_m, film, as_real(offset))
            return film.in_place()

        films = [placed(n + 1, film) for n, film in enumerate(self.sensor.elements)]
        return eqx.tree_at(lambda s: s.elements, self.sensor, tuple(films))


# A kernel is thousands of numbers made of a few: its slopes are computed once and multiplied, as
# every direction of a fit would else go through the whole of it.
@eqx.filter_custom_jvp
def _transfer(films: Mapping[str, Array], model: RigModel) -> Complex[Array, "e c k"]:
    return model.transfer_of(films)


@_transfer.def_jvp
def _transfer_jvp(primals, tangents, model: RigModel):
    (films,), (moves,) = primals, tangents
    transfer = _transfer(films, model=model)
    moved = jnp.zeros_like(transfer)
    for name, move in moves.items():
        if move is not None:
            moved = moved + move * _slope(films, name, model)
    return transfer, moved


def _slope(films: Mapping[str, Array], name: str, model: RigModel) -> Complex[Array, "e c k"]:
    """The transfer's derivative by one of its numbers."""

    def along(value):
        return model.transfer_of({**films, name: value})

    return jax.jvp(along, (films[name],), (jnp.ones_like(films[name]),))[1]
