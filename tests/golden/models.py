"""Every operator, the contact, and the models of features, each a function of named numbers.

A model takes numbers by name, scalars and arrays, to an array or several.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier, IntegratedCurrent
from srsinv.forward.contact import press
from srsinv.forward.feature import (
    GratingFeature,
    HertzFeature,
    LineFeature,
    StepFeature,
    StripFeature,
)
from srsinv.forward.film import Film, Offset, Piezo, SampleAverage, StripAverage
from srsinv.forward.filter import Butterworth, FirstOrder
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.oblique import turned, turned_scan
from srsinv.forward.planar import Circle, ObliqueRidge, PathScan
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface_feature import RidgeFeature, TapeFeature
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import Open, Periodic
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.cells import Window

Numbers = Mapping[str, Any]
Model = Callable[[Numbers], Any]
CELLS = 32
LINES = {"periodic": Periodic, "open": Open}
SENSOR = {
    "cell_m": 1.9e-4, "speed_m_per_s": 0.05, "resistance_ohm": 1e6,
    "depth_m": 0.75e-3, "angle_rad": 0.4, "length_m": 8e-3, "strip_width_m": 0.7e-3,
    "offset_m": 2.5e-4, "spacing_m": 6e-5, "d1": 23e-12, "d2": 3e-12, "d3": -33e-12,
}  # fmt: skip
HALF_SPACE = {"poisson_ratio": 0.45}
ONE_FILM = {key: SENSOR[key] for key in ("cell_m", "depth_m", "angle_rad")}
LAYERS = {"thickness_m": 1.5e-3, "modulus_Pa": 7e5, "foam_modulus_Pa": 5e4}
CORE = LAYERS | {"foam_thickness_m": 5e-3}
LOAD = {"traction_Pa": 1e3 * np.random.default_rng(1).normal(size=(2, CELLS))}
LINE_X = 1.9e-4 * (np.arange(CELLS) - CELLS / 2)
TIME_S = np.arange(40) / 800
EVEN = Motion.from_speed(TIME_S, 0.05 + 0 * TIME_S, -1.2e-3)
UNEVEN = Motion.from_speed(TIME_S**1.1, 0.05 * (1 + 0.4 * np.sin(90 * TIME_S)), -1.2e-3)
BACK = Motion.from_speed(TIME_S, 0.07 * np.cos(60 * TIME_S + 0.1), -1e-3)


def sensor(v: Numbers, skin=None, amplifier=None, filters=()) -> Sensor:
    """Two elements, no two numbers of theirs alike."""
    piezo = Piezo(v["d1"], v["d2"], v["d3"])
    effects = (StripAverage(v["strip_width_m"]), Offset(v["offset_m"]))
    average = SampleAverage(2, v["spacing_m"])
    films = [
        Film(v["depth_m"], v["angle_rad"], v["strip_width_m"], v["length_m"], piezo, effects),
        Film(1.2 * v["depth_m"], 2 + v["angle_rad"], effects=(average,)),
    ]
    return Sensor(films, skin, amplifier or CurrentAmplifier(v["resistance_ohm"]), filters)


def half_space(v: Numbers) -> HalfSpace:
    return HalfSpace(v["poisson_ratio"])


def layers_on_a_half_space(v: Numbers) -> Layered:
    return Layered([Layer(v["thickness_m"], v["modulus_Pa"], 0.5),
                    Layer(None, v["foam_modulus_Pa"], 0.3)])  # fmt: skip


def layers_on_a_core(v: Numbers) -> Layered:
    return Layered([Layer(v["thickness_m"], v["modulus_Pa"], 0.5),
                    Layer(v["foam_thickness_m"], v["foam_modulus_Pa"], 0.3)])  # fmt: skip


def viscoelastic(v: Numbers) -> Viscoelastic:
    skin = HalfSpace(0.5, v["modulus_Pa"])
    return Viscoelastic(skin, v["fractions"], v["times_s"], v["speed_m_per_s"])


def line_of(v: Numbers, kind: str, n: int = CELLS):
    """Cells about the middle."""
    return LINES[kind](n, v["cell_m"], -v["cell_m"] * n / 2)


def operators(kind: str, skin=half_space) -> Model:
    """Stress at the films, the rate signal and its integral, which is the charge times a gain."""

    def model(v: Numbers):
        line, scan = line_of(v, kind), ConstantSpeed(v["speed_m_per_s"])
        own = sensor(v, skin(v))
        integrated = sensor(v, skin(v), IntegratedCurrent(v["resistance_ohm"]))
        stages = (own.stress(), own.output(scan), integrated.output(scan))
        return tuple(line.operator(stage)(v["traction_Pa"]) for stage in stages)

    return model


def signal(kind: str, skin) -> Model:
    """The rate signal of one film."""

    def model(v: Numbers):
        stage = Sensor([Film(v["depth_m"], v["angle_rad"])], skin(v)).output(ConstantSpeed())
        return line_of(v, kind).operator(stage)(v["traction_Pa"])

    return model


def filters(kind: str) -> Model:
    """At constant speed, along the line; on the open one a lag that is traced would need as many
    nodes as the longest."""
    lags = (FirstOrder(1e-3), Butterworth(150.0))

    def model(v: Numbers):
        film = Film(0.75e-3, 0.4, piezo=Piezo(v["d1"], v["d2"], v["d3"]))
        stage = Sensor([film], filters=lags).output(ConstantSpeed(0.05))
        return line_of(SENSOR, kind).operator(stage)(v["traction_Pa"])

    return model


def oblique(v: Numbers):
    """Features turned from the sliding direction."""
    own, scan = turned(sensor(v, half_space(v)), 0.5), turned_scan(ConstantSpeed(0.05), 0.5)
    return line_of(v, "periodic").operator(own.output(scan))(v["traction_Pa"])


def scanned(kind: str, motion: Motion, lag: bool = False, turns: bool = False) -> Model:
    """Along a motion; where it turns, with the shear turned."""

    def model(v: Numbers):
        own = (FirstOrder(v["time_s"]),) if lag else ()
        along = sensor(v, half_space(v), None, own).operator_along(line_of(v, kind), motion)
        forward = v["traction_Pa"]
        backward = jnp.array([[1.0], [-1.0]]) * forward
        return along(jnp.stack([forward, backward]) if turns else forward)

    return model


def differences(v: Numbers):
    """Of all orders on both lines."""
    lines = (line_of(SENSOR, kind) for kind in LINES)
    return tuple(line.differences(v["traction_Pa"], order) for line in lines for order in (0, 1, 2))


def circular(v: Numbers):
    """A ridge under a circle."""
    films = [Film(v["depth_m"], v["angle_rad"], effects=(StripAverage(v["strip_width_m"]),))]
    circle = Circle(v["radius_m"], v["speed_m_per_s"], 16)
    ridge = ObliqueRidge(v["ridge_rad"], v["distance_m"], 1.3, v["width_m"], v["friction"])
    return PathScan(Sensor(films), circle)(ridge)


def contact(v: Numbers):
    """Pressure and gap under a profile that lifts the skin."""
    skin = viscoelastic(v) if "fractions" in v else HalfSpace(0.5, v["modulus_Pa"])
    solution = press(Periodic(64, v["cell_m"]), skin, v["height_m"], v["pressure_Pa"])
    return solution.pressure_Pa, solution.gap_m


FEATURES = {
    "line": (LineFeature(), {"position_m": 3e-4, "load_N_per_m": 10.0, "shear_N_per_m": 3.0}),
    "strip": (
        StripFeature(),
        {"position_m": 3e-4, "width_m": 2e-3, "pressure_Pa": 5e3, "shear_Pa": 2e3},
    ),
    "hertz": (
        HertzFeature(),
        {"position_m": -2e-4, "half_width_m": 9e-4, "pressure_Pa": 5e3, "shear_Pa": -2e3},
    ),
    "step": (StepFeature(), {"position_m": 1e-4, "pressure_Pa": 5e3, "shear_Pa": 1e3}),
    "grating": (
        GratingFeature(),
        {"pitch_m": 9e-4, "duty": 0.4, "phase_rad": 1.0, "pressure_Pa": 5e3, "shear_Pa": 1e3},
    ),
}
SHORT_MOTION = Motion.from_speed(TIME_S[:24], 0.06 * (1 - 20 * TIME_S[:24]), -4e-4)
CHARGE_SENSOR = Sensor([Film(0.75e-3, 0.2), Film(0.9e-3, 1.6)], None, ChargeReadout(1e9))


def features() -> Model:
    """The signal and the traction of all features of traction together."""
    whole = FeatureModel.along(
        CHARGE_SENSOR, SHORT_MOTION, float(CHARGE_SENSOR.depth_m) / 8
    ).with_features({name: f for name, (f, _) in FEATURES.items()})

    def model(v: Numbers):
        params: dict[str, Any] = {"offset": v["offset"]}
        for name, (_, own) in FEATURES.items():
            params[name] = {part: v[f"{name}.{part}"] for part in own}
        return whole(params), whole.traction(params)

    return model


SURFACES = {
    "ridge": (RidgeFeature(4e-5), {"height_m": 3e-5, "width_m": 0.8e-3, "position_m": 4e-4}),
    "tape": (
        TapeFeature(4e-5),
        {
            "height_m": 5e-5, "width_m": 1.5e-3, "position_m": -2e-4,
            "friction_zone_length_m": 5e-4, "leading_edge_friction": 1.1,
            "trailing_edge_friction": 0.2,
        },
    ),
}  # fmt: skip
PLATE = {"nominal_pressure_Pa": 2e4, "gain": 1.1, "base_friction": 0.4, "depth_m": 0.8e-3}


def surface(name: str) -> Model:
    """The signal of a feature of a surface, through contact."""
    feature, own = SURFACES[name]
    plate = FeatureModel.on_window(
        Sensor(CHARGE_SENSOR.elements),
        SHORT_MOTION,
        Window(-3e-3, 3e-3),
        2.4e-5,
        2e4,
        kind=Periodic,
    )
    whole = plate.with_features({name: feature})

    def model(v: Numbers):
        params = {part: v[part] for part in PLATE}
        params[name] = {part: v[f"own_{part}"] for part in own} | {"edge_length_m": v["edge_m"]}
        return whole(params)

    return model


def _own(numbers: Numbers) -> dict[str, Any]:
    return {f"own_{name}": value for name, value in numbers.items()}


def _profile() -> np.ndarray:
    x = np.linspace(-1, 1, 64, endpoint=False)
    return 4e-5 * np.exp(-((x / 0.15) ** 2)) + 3e-6 * np.sin(9 * x + 1)


ALL = SENSOR | HALF_SPACE | LOAD
RELAXING = {"fractions": np.array([0.5, 0.5]), "times_s": np.array([1e-3, 1e-2]), "modulus_Pa": 7e5,
            "speed_m_per_s": 0.05}  # fmt: skip
CONTACT = {"height_m": _profile(), "pressure_Pa": 2e3, "modulus_Pa": 7e5, "cell_m": 1e-4}
CIRCLE = {"depth_m": 0.75e-3, "angle_rad": 0.4, "strip_width_m": 0.7e-3, "radius_m": 5e-3,
          "speed_m_per_s": 0.05, "ridge_rad": 0.7, "distance_m": 1e-3, "width_m": 5e-4,
          "friction": -0.4}  # fmt: skip
LAG = {"time_s": 1e-3}
PIEZO = {key: SENSOR[key] for key in ("d1", "d2", "d3")}
TRACED = {f"{name}.{part}": value for name, (_, own) in FEATURES.items()
          for part, value in own.items()} | {"offset": np.array([0.1, -0.2])}  # fmt: skip

PLATE_AND_EDGE = PLATE | {"edge_m": 4e-5}

# What makes the model, and its numbers.
MODELS: dict[str, tuple[Callable[[], Model], Numbers]] = {
    **{f"half_space_{kind}": (partial(operators, kind), ALL) for kind in LINES},
    **{f"layers_{kind}": (partial(signal, kind, layers_on_a_half_space), ONE_FILM | LOAD | LAYERS)
       for kind in LINES},
    "core_periodic": (partial(signal, "periodic", layers_on_a_core), ONE_FILM | LOAD | CORE),
    "viscoelastic": (partial(signal, "periodic", viscoelastic), ONE_FILM | LOAD | RELAXING),
    **{f"filters_{kind}": (partial(filters, kind), PIEZO | LOAD) for kind in LINES},
    "oblique": (lambda: oblique, ALL),
    "even_filtered": (partial(scanned, "periodic", EVEN, lag=True), ALL | LAG),
    "uneven_periodic": (partial(scanned, "periodic", UNEVEN), ALL),
    "uneven_open": (partial(scanned, "open", UNEVEN), ALL),
    "back_and_forth": (partial(scanned, "open", BACK, turns=True), ALL),
    "differences": (lambda: differences, LOAD),
    "circular": (lambda: circular, CIRCLE),
    "contact_elastic": (lambda: contact, CONTACT),
    "contact_lagging": (lambda: contact, CONTACT | RELAXING),
    "features": (features, TRACED),
    **{f"surface_{name}": (partial(surface, name), PLATE_AND_EDGE | _own(own))
       for name, (_, own) in SURFACES.items()},
}  # fmt: skip
