"""Features of a surface: they load the skin through its contact with the surface.

The signal of a solved contact is off by 1e-5 to 3e-5 of its rms on the cells of a fit (six random
ridges against cells an eighth as wide), and by a fifth to two fifths of that on half as wide ones:
these show whether the cells matter to a fit.
"""

import dataclasses
import itertools
from collections.abc import Collection, Iterator, Mapping
from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import check_name, number, refuse
from ...forward.contact import Contact, press
from ...forward.feature import ScanExtent
from ...forward.operator import MotionOperator
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...forward.surface import Surface
from ...grid import Line, as_real
from ...numerics import shared_count
from ...resolution import cell_m
from ..estimate import averages
from ..nonlinear import Fit, Optimistix, Solver
from ..rig.setup import OF_CONTACT, Setup
from .identifiability import limited_by_bounds, undetected_features
from .loading import Features, Loading, Normal, Range, Strengths, Traction, TrialShapes

CELLS_PER_EDGE = 5  # the contact beside an edge is then right to some 1e-4 of the signal
MOVES = {"position_m", "width_m"}  # parameters that move edges
PLACE = "position_m"
MOST_SHIFTED = 1_000_000  # shapes at all places: their search takes some minutes
AT_ONCE = 64  # shapes whose signals are held at the same time
LEAST_EDGE = 2.0  # cells: the sharpest edge in the search
# Prior standard deviation of a friction: far beyond any, so as not to pull.
ANY_FRICTION = 10.0
REACH = {  # search ranges of known quantities once freed, as factors
    "edge_length_m": 20.0,
    "depth_m": 3.0,
    "gain": 10.0,
    "nominal_pressure_Pa": 10.0,
}
KNOWN = tuple(REACH)
# Fraction of the signal within which its derivative jumps: cells touch and part one by one.
ROUNDING = 1e-4
# The same beside facts of the rig, some of which move a fit far and its signal hardly: it ends
# within 0.05 standard errors of the minimum.
FACTS_ROUNDING = 5e-4


class ContactLoading(Loading):
    """The traction is that of the skin, pressed on the features' surface with a nominal pressure,
    and sliding over it.

    - `sensor`, `motion`: the skin, and what the signal would be with the film at another depth.
    - `stated_depth_m`: the shallowest film's, as it is known.
    - `also`: names of `KNOWN` to fit beside heights, lengths and frictions. `gain` is a factor on
      the signal, `depth_m` the shallowest film's depth.
    """

    PROFILES: ClassVar[tuple[str, ...]] = ("p", "q", "height", "gap", "friction")
    FACTS: ClassVar[tuple[str, ...]] = OF_CONTACT
    LINEAR: ClassVar[tuple[str, ...]] = ("base_friction",)
    ARE_FEW: ClassVar[bool] = False
    sensor: Sensor
    motion: Motion
    stated_depth_m: Float[Array, ""] = eqx.field(converter=as_real)
    nominal_pressure_Pa: Float[Array, ""] = eqx.field(converter=as_real)
    also: tuple[str, ...] = eqx.field(static=True, default=())

    # --- the model ---

    def surface(self, features: Features, params: Any) -> Surface:
        """The surface of these parameters."""
        shapes = [feature.shape(params[name]) for name, feature in features.items()]
        return Surface(shapes, params["base_friction"])

    def contact(self, line: Line, features: Features, params: Any) -> Contact:
        """How the skin lies on the surface of these parameters, whatever its friction, which would
        be one more number to differentiate by."""
        smooth = params | {"base_friction": 0.0}
        for name, feature in features.items():
            smooth[name] = {**params[name], **dict.fromkeys(feature.frictions, 0.0)}
        surface = self.surface(features, smooth)
        given = line, surface, self.sensor.skin, params["nominal_pressure_Pa"]
        numbers, form = eqx.partition(given, eqx.is_array)
        leaves, tree = jax.tree.flatten(numbers)
        return _pressed(tree, form, *leaves)

    def tractions(
        self, line: Line, features: Features, params: Any, directions: tuple[bool, ...]
    ) -> list[Traction]:
        surface = self.surface(features, params)
        contact = self.contact(line, features, params)
        return self._sliding(line, surface, contact, params, directions)

    def _sliding(
        self,
        line: Line,
        surface: Surface,
        contact: Contact,
        params: Any,
        directions: tuple[bool, ...],
    ) -> list[Traction]:
        nominal, pressure = params["nominal_pressure_Pa"], contact.pressure_Pa

        def sliding(forward: bool):
            shear = surface.friction(line, forward) * pressure
            shear = shear - surface.base_friction * nominal
            return jnp.stack([pressure - nominal, shear if forward else -shear])

        return [sliding(forward) for forward in directions]

    def cell_traction(self, line: Line, features: Features, params: Any, onto: Line) -> Traction:
        return averages(self.tractions(line, features, params, (True,))[0], line, onto)

    def profiles(self, line: Line, features: Features, params: Any) -> Float[Array, "profile n"]:
        surface = self.surface(features, params)
        contact, height = self.contact(line, features, params), surface.height(line)
        (p, q), *_ = self._sliding(line, surface, contact, params, (True,))
        return jnp.stack([p, q, height, contact.gap_m, surface.friction(line)])

    def operator(self, operator: MotionOperator, features: Features, params: Any) -> MotionOperator:
        if "depth_m" not in params:
            return operator
        sensor = self.sensor_at(params)
        return sensor.operator_along(operator.line, self.motion, directions=operator.directions)

    def sensor_at(self, params: Any) -> Sensor:
        """The sensor with its films at the depth that is fitted, if it is."""
        if "depth_m" not in params:
            return self.sensor
        # The shallowest film is at this depth, and the others move with it.
        change_m = params["depth_m"] - self.sensor.depth_m
        depths = [film.depth_m + change_m for film in self.sensor.elements]
        return eqx.tree_at(lambda s: [film.depth_m for film in s.elements], self.sensor, depths)

    def at(self, sensor: Sensor, motion: Motion) -> "ContactLoading":
        return dataclasses.replace(self, sensor=sensor, motion=motion)

    @property
    def freed(self) -> tuple[str, ...]:
        return self.also

    def params_at(self, features: Features, params: Any, setup: Setup) -> Any:
        changed = dict(params)
        if "nominal_pressure_Pa" not in self.also:
            pressure = setup.nominal_pressure * self.nominal_pressure_Pa
            changed["nominal_pressure_Pa"] = pressure
        if "edge_length_m" not in self.also:
            for name in (name for name, feature in features.items() if feature.has_edges):
                edge = params[name]["edge_length_m"] + setup.edge_length_by_m
                changed[name] = {**params[name], "edge_length_m": edge}
        return changed

    def gain(self, params: Any) -> Any:
        return params["gain"]

    def steps(self, line: Line, features: Features) -> dict[str, float]:
        """Steps in the parameters that move edges.

        As an edge moves, so does the skin's contact on its steep flank, and the pressure's
        derivative is singular there: on a contact set that stays it depends on where the edge lies
        within its cell, by a tenth where cells are a fifth of the edge. It is steady over whole
        cells, by which both ends of a width move at these steps.
        """
        step = 2 * float(line.cell_m)
        return {
            f"{name}.{part}": step
            for name, feature in features.items()
            for part in MOVES & feature.axes.keys()
        }

    # --- the search ---

    def trial_shapes(
        self, model: Any, feature: Any, stretch: ScanExtent, given: Mapping[str, float]
    ) -> Iterator[TrialShapes]:
        """Contact is solved once per shape, and its signal shifted to every place: a surface that
        repeats gives the same traction wherever its feature lies. Raises `BadInput` for more than
        `MOST_SHIFTED`."""
        whole = feature.axes.keys() <= given.keys()
        columns = feature.axis_starts(stretch)
        if not whole:
            columns |= {name: np.array([given[name]]) for name in columns.keys() & given.keys()}
        feature.refuse_many(columns, stretch, MOST_SHIFTED)
        places = columns.pop(PLACE)
        if len(model.operator.directions) > 1:
            # One way, some friction makes up for a wrong place; there and back it turns with the
            # motion, and wide ridges with an edge beyond the scan would do better than one beside.
            halves = np.arange(2 * len(places) - 1) / 2
            places = np.interp(halves, np.arange(len(places)), places)
        shapes = np.array(list(itertools.product(*columns.values()))).reshape(-1, len(columns))
        if whole:
            shapes = np.vstack([shapes, [given[name] for name in columns]])
            places = np.append(places, given[PLACE])
        # Filled up to rounds of one size: any other would be compiled, too.
        size = min(shared_count(len(shapes)), AT_ONCE)
        rounds = -(-len(shapes) // size)
        filled = shapes[np.minimum(np.arange(rounds * size), len(shapes) - 1)]
        alone = model.with_features({"one": feature})
        shifted = _Shifting(alone)
        for start, some in enumerate(np.split(filled, rounds)):
            count = min(size, len(shapes) - start * size)
            named = dict(zip(columns, some.T, strict=True))
            fields = self._unit_fields(alone, feature, named)
            for place in places:
                signals = shifted(fields, place)[:count]
                at = {name: column[:count] for name, column in named.items()}
                at[PLACE] = np.full(count, place)
                yield TrialShapes(at, signals[:, 0], signals[:, 1:])

    def _unit_fields(
        self, model: Any, feature: Any, shapes
    ) -> Float[np.ndarray, "start part e cell"]:
        """`_fields`, with the cells of all directions one after the other."""
        line = model.line
        # Edges sharper than a cell would be sampled or missed as a whole.
        edge = max(feature.edge_m, float(line.cell_m))
        rest = {
            "nominal_pressure_Pa": self.nominal_pressure_Pa,
            "edge_length_m": as_real(edge),
            PLACE: as_real(float(line.x[line.n // 2])),
        }
        shapes = {k: as_real(v) for k, v in shapes.items()}
        fields = np.asarray(_fields(model.filled, shapes, rest))
        by_element = fields.swapaxes(2, 3)
        return by_element.reshape(*by_element.shape[:3], -1)

    # --- the fit ---

    def common(self) -> dict[str, Any]:
        """Parameters of the plate alone."""
        plate = {
            "base_friction": 0.0,
            "nominal_pressure_Pa": float(self.nominal_pressure_Pa),
            "gain": 1.0,
        }
        return plate | ({"depth_m": self._depth_m} if "depth_m" in self.also else {})

    @property
    def _depth_m(self) -> float:
        return float(self.stated_depth_m)

    def begun(self, feature: Any) -> dict[str, float]:
        edge = {"edge_length_m": feature.edge_m} if feature.has_edges else {}
        return dict.fromkeys(feature.frictions, 0.0) | edge

    def bounds(self, line: Line, features: Features, stretch: ScanExtent) -> dict[str, Range]:
        bounds: dict[str, Range] = {}
        for name, feature in features.items():
            for part, within in feature.ranges(stretch).items():
                bounds[f"{name}.{part}"] = within
            if "edge_length_m" in self.also:
                # Cells do not resolve sharper ones, nor their derivative.
                low, high = _range_around("edge_length_m", feature.edge_m)
                low = max(low, LEAST_EDGE * float(line.cell_m))
                bounds[f"{name}.edge_length_m"] = low, high
        whole = {**self.common(), "depth_m": self._depth_m}
        return bounds | {
            name: _range_around(name, whole[name]) for name in self.also if name in whole
        }

    def priors(self, name: str, feature: Any, reach: Any, search: Strengths) -> dict[str, Normal]:
        del reach, search
        return {f"{name}.{part}": (0.0, ANY_FRICTION) for part in feature.frictions}

    def common_priors(self) -> dict[str, Normal]:
        return dict.fromkeys(self.LINEAR, (0.0, ANY_FRICTION))

    def solver(self, solver: Solver | None, has_facts: bool = False) -> Solver:
        return (solver or Optimistix()).tolerating(FACTS_ROUNDING if has_facts else ROUNDING)

    def values(self, features: Features, params: Any) -> dict[str, float]:
        read: dict[str, float] = {}
        for name, feature in features.items():
            prefix, own = f"{name}_" if len(features) > 1 else "", params[name]
            for part in (*feature.axes, *feature.frictions, "edge_length_m"):
                if part in own:
                    read[prefix + part] = float(own[part])
        common = (name for name in ("base_friction", *KNOWN) if name in params)
        return read | {name: float(params[name]) for name in common}

    def report(self, features: Features, fit: Fit) -> dict[str, tuple[float, float]]:
        """Each free parameter, its error infinite for those on a bound and those correlated with
        them, and for all where the features are not detected."""
        missed = undetected_features(features, fit)
        unsure = frozenset(fit.names) if missed else limited_by_bounds(fit)

        def error(own: str) -> float:
            return np.inf if own in unsure else float(self.part_of(fit.stderr, own))

        return {
            name: (float(self.part_of(fit.value, own)), error(own))
            for name, own in self.reported(features, fit.names).items()
        }

    @staticmethod
    def reported(features: Features, free: Collection[str]) -> dict[str, str]:
        """Names in a fit of the free parameters, by the name that each is reported by."""
        prefixes = {name: f"{name}_" if len(features) > 1 else "" for name in features}
        each = {
            prefixes[name] + part: f"{name}.{part}"
            for name, feature in features.items()
            for part in (*feature.axes, *feature.frictions, "edge_length_m")
        }
        each |= {part: part for part in ("base_friction", *KNOWN) if part not in each}
        return {name: own for name, own in each.items() if own in free}

    @staticmethod
    def part_of(params: Any, own: str) -> Any:
        """The parameter of this name in a fit's tree."""
        name, _, part = own.rpartition(".")
        return params[name][part] if name else params[part]


def cell_for(features: Features, depth_m: float) -> float:
    """How wide the cells may be."""
    if not any(feature.has_edges for feature in features.values()):
        return cell_m("load", depth_m)
    edges = [feature.edge_length_m for feature in features.values() if feature.edge_length_m]
    return min([cell_m("contact", depth_m), *(edge / CELLS_PER_EDGE for edge in edges)])


def _range_around(name: str, value: float) -> Range:
    return value / REACH[name], value * REACH[name]


def _solved(tree, form, leaves) -> Contact:
    line, surface, skin, nominal = eqx.combine(jax.tree.unflatten(tree, leaves), form)
    return press(line, skin, surface.height(line), nominal)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _pressed(tree, form, *leaves) -> Contact:
    """The contact of a line, a surface, a skin and a nominal pressure, from their numbers."""
    return _solved(tree, form, leaves)


@partial(_pressed.defjvp, symbolic_zeros=True)
def _pressed_jvp(tree, form, primals, tangents):
    """By the derivatives after the few numbers that the contact depends on. Each of them is a
    system of equations, and there are fewer than parameters of a rig that is not exactly known."""
    moving = [i for i, each in enumerate(tangents) if not isinstance(each, SymbolicZero)]
    at, unravel = ravel_pytree([primals[i] for i in moving])
    along, _ = ravel_pytree([tangents[i] for i in moving])

    def contact(numbers):
        leaves = list(primals)
        for i, own in zip(moving, unravel(numbers), strict=True):
            leaves[i] = own
        return _solved(tree, form, leaves)

    reached, push = jax.linearize(contact, at)
    each = jax.vmap(push)(jnp.eye(at.size, dtype=at.dtype))
    return reached, jax.tree.map(lambda rows: jnp.tensordot(along, rows, 1), each)


@compiled
def _fields(model: Any, shapes, rest) -> Float[Array, "start part way e n"]:
    """What the amplifier reads along the line, before its gain over time, of the model's only
    feature: of no friction at all, then of one unit more of each parameter that is linear."""
    ((name, feature),) = model.features.items()
    names = [each for each in model.linear if each != "offset"]
    pressure = {"nominal_pressure_Pa": rest["nominal_pressure_Pa"]}
    own = {k: v for k, v in rest.items() if k not in pressure}

    def of(shape, one: str | None):
        units = {part: as_real(one == f"{name}.{part}") for part in feature.frictions}
        base = {"base_friction": as_real(one == "base_friction")}
        tractions = model.tractions(pressure | base | {name: shape | own | units})
        return jnp.stack([model.operator.field(traction) for traction in tractions])

    def at(shape):
        frictionless = of(shape, None)
        return jnp.stack([frictionless, *(of(shape, each) - frictionless for each in names)])

    return jax.lax.map(at, shapes)


class _Shifting:
    """The signals of a feature elsewhere than in the line's middle."""

    def __init__(self, model: Any):
        line, operator, motion = model.line, model.operator, model.loading.motion
        onwards = np.asarray(model.first(motion.direction)) >= 0
        x = np.asarray(line.x)
        self._gain, self._n = np.asarray(model.first(operator.gain)), line.n
        self._direction = np.array([operator.directions.index(bool(each)) for each in onwards])
        self._from_middle = np.asarray(model.first(motion.position_m)) + float(x[line.n // 2])
        self._start_m, self._cell_m = float(x[0]), float(line.cell_m)

    def __call__(self, fields, place: float) -> Float[np.ndarray, "start part e sample"]:
        """Those of `fields` (start, part, e, direction and cell) for a feature at `place` [m]."""
        at = (self._from_middle - place - self._start_m) / self._cell_m
        first = np.floor(at).astype(int)
        low, high = (
            fields.take(self._direction * self._n + cell % self._n, axis=-1)
            for cell in (first, first + 1)
        )
        return self._gain * (low + (at - first) * (high - low))


def checked_pressure(given: Any) -> float:
    """The nominal pressure, refused where none is known."""
    refuse(
        given is None,
        "The nominal pressure on the surface is not known: give "
        "recording.nominal_pressure_Pa, the mean over the contact window, or simulate on a "
        "periodic line.",
    )
    wanted = "a positive pressure in Pa"
    return float(number("recording.nominal_pressure_Pa", given, wanted, above=0))


def checked_names(features: Features, also: tuple[str, ...]) -> tuple[str, ...]:
    """Those of `KNOWN` among the names, refused where one is of no parameter."""
    own = [part for each in features.values() for part in (*each.axes, *each.linear)]
    for name in also:
        check_name("fit.free", name, dict.fromkeys((*KNOWN, "base_friction", *own)))
    return tuple(name for name in also if name in KNOWN)


COARSE = 2e-4  # of a signal's rms: the error of the cells is less
NOTICED = 0.2  # standard errors by which cells may move a parameter


def cells_may_show(fit: Fit) -> bool:
    """Whether the signal is so strong beside its noise that an error of `COARSE` may be noticed:
    by any parameter at most that of the whole signal, in units of the noise."""
    return COARSE * float(np.linalg.norm(fit.whitened_signal())) > NOTICED


def are_noticed(moves: Float[np.ndarray, " m"], fit: Fit) -> bool:
    """Whether these moves of a fit's parameters exceed `NOTICED` standard errors."""
    return bool(np.any(np.abs(moves) > NOTICED * np.sqrt(np.diag(fit.covariance))))
