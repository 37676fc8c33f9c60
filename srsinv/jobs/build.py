"""Construction of objects from a resolved configuration."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from inspect import signature
from typing import Any

import jax

from ..config import PARTS, Config, check, class_of, make, precision_name, seed
from ..effects import NAMES, Effect
from ..errors import choice, mapping, number, refuse, whole
from ..forward.amplifier import Amplifier
from ..forward.describe import elements
from ..forward.feature import Feature
from ..forward.noise import Noise
from ..forward.scan import ConstantSpeed
from ..forward.scenario import Scenario
from ..forward.scene import Scene
from ..forward.sensor import Sensor
from ..forward.surface_feature import SurfaceFeature
from ..grid import Line, Open, Periodic
from ..inverse.method import Method
from ..inverse.nonlinear import Solver
from ..recording import load_profile

LINES = {"periodic": Periodic, "open": Open}
MOST_CELLS = 2**24  # beyond, the arrays over a line take gigabytes each


@contextmanager
def precision(cfg: Config) -> Iterator[None]:
    """Work in float64 or float32, by `cfg["precision"]`."""
    with jax.enable_x64(precision_name(cfg) == "float64"):
        yield


def part(cfg: Config, name: str) -> Mapping[str, Any]:
    """The mapping `cfg[name]`; null means an empty one."""
    node = cfg.get(name)
    return {} if node is None else mapping(name, node)


def line(cfg: Config, refinement: Any = 1) -> Line:
    """The line of `grid`, its cells `refinement` times finer at the same first position."""
    grid = part(cfg, "grid")
    kind = LINES[choice("grid.line", grid.get("line"), LINES)]
    wanted = f"a whole number from 3 (fewer samples are too few) to {MOST_CELLS}"
    cells = whole("grid.cells", grid.get("cells"), wanted, least=3, most=MOST_CELLS)
    length = number("grid.length_m", grid.get("length_m"), "a positive length in metres", above=0)
    start = number("grid.start_m", grid.get("start_m"), "a position in metres")
    cells *= whole("grid.refinement", refinement, "a whole number from 1", least=1)
    refuse(
        cells > MOST_CELLS,
        f"grid.refinement is {refinement}, which makes {cells} cells: give one that makes at most "
        f"{MOST_CELLS}.",
    )
    return kind(cells, length / cells, start)


def scenario(cfg: Config) -> Scenario:
    """The scenario, with the named effects."""
    return _applied(effects(cfg), ideal(cfg).replace(noises=noises(cfg)))


def ideal(cfg: Config) -> Scenario:
    """The scenario without noise and effects."""
    motion, sensor = scan(cfg), _sensor(cfg)
    whole = Scenario(_scene(cfg), sensor, motion)
    return whole.with_skin(sensor.skin.sliding_at(motion.speed_m_per_s))


def scene(cfg: Config) -> Scene:
    """The scene, for a job that takes effects of the sensor alone."""
    built = _sensor_scenario(cfg).scene
    assert built is not None
    return built


def sensor(cfg: Config) -> Sensor:
    """Film elements in their skin, read by the amplifier, for a job that takes effects of the
    sensor alone."""
    return _sensor_scenario(cfg).sensor


def with_effects(cfg: Config, scenario: Scenario) -> Scenario:
    """A scenario of a sensor with the named effects, which have to be of the sensor."""
    refuse(
        "tolerance" in cfg,
        "effects=auto decides by a simulated scene, which this job does not take: name the effects "
        "of the sensor, as effects=[strip_width,layered_skin].",
    )
    named = effects(cfg)
    for name, effect in named.items():
        refuse(
            not effect.of_sensor,
            f"effects names {name}, which acts on a simulated scene and its recording; this job "
            "takes effects of the sensor alone: leave it out.",
        )
    return _applied(named, scenario)


def _applied(named: Mapping[str, Effect], scenario: Scenario) -> Scenario:
    for name, effect in named.items():
        refuse(
            effect.is_defined_in(scenario),
            f"effects names {name}, and skin defines another one ({scenario.sensor.skin.words}): "
            "leave the effect out, or take skin=half_space.",
        )
        scenario = effect.apply(scenario)
    return scenario


def effects(cfg: Config) -> dict[str, Effect]:
    """The named effects, in the order in which they are added."""
    named = part(cfg, "effects")
    for name in named:
        is_named = "_target_" in mapping(f"effects.{name}", named[name])
        refuse(
            name not in NAMES and not is_named,
            f"There is no effect {name!r}: effects holds any of {', '.join(NAMES)}.",
        )
        refuse(
            not is_named,
            f"effects.{name} has settings, and {name} is not among the effects: name it in "
            "effects=[...] too, or leave its settings out.",
        )
    made = {name: make(node, f"effects.{name}", "effects") for name, node in named.items()}
    return dict(sorted(made.items(), key=lambda each: (each[1].order, each[0])))


def effects_rows(cfg: Config) -> tuple[tuple[str, str], ...]:
    """Rows of a page: which effects are on and off."""
    on = part(cfg, "effects")
    off = [name for name in NAMES if name not in on]
    return (("effects on", ", ".join(on) or "none"), ("effects off", ", ".join(off) or "none"))


def _sensor_scenario(cfg: Config) -> Scenario:
    return with_effects(cfg, ideal(cfg))


def _sensor(cfg: Config) -> Sensor:
    films = elements(part(cfg, "sensor"))
    return Sensor(films, skin=make(cfg["skin"], "skin", "skin"), amplifier=amplifier(cfg))


def skin_node(node: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """The node of a skin, what it leaves at null from what is `known` of a half space."""
    given = {key: value for key, value in node.items() if value is not None}
    taken = signature(class_of(node, "skin", "skin")).parameters
    return {key: known[key] for key in known if key in taken} | given


def _scene(cfg: Config) -> Scene:
    """The scene, its named parts in order; one with a surface is in contact with the half space."""
    node = dict(part(cfg, "scene"))
    kinds = ("pressures", "frictions", "surfaces")
    for name in sorted({*kinds} & node.keys()):
        named = {} if node[name] is None else mapping(f"scene.{name}", node[name])
        at = {f"scene.{name}.{key}": each for key, each in named.items()}
        listed = {key: _profile_read(each, key) for key, each in at.items()}
        for key, each in listed.items():
            check(each, key, PARTS[name])
        node[name] = list(listed.values())
    if "surfaces" in node:
        check(cfg["skin"], "skin", "skin")
        node["skin"] = cfg["skin"]
    return make(node, "scene", "scene")


def _profile_read(node: Any, at: str) -> Any:
    """A measured profile's node, at key `at`, with the columns of the file that it names."""
    if not isinstance(node, Mapping) or "path" not in node:
        return node
    rest = {key: value for key, value in node.items() if key != "path"}
    return rest | load_profile(node["path"], f"{at}.path")


def amplifier(cfg: Config) -> Amplifier:
    """The amplifier; for a recording its resistor has to be given."""
    node = part(cfg, "amplifier")
    refuse(
        node.get("feedback_resistance_ohm", 0) is None,
        "No feedback resistance is known: give amplifier.feedback_resistance_ohm in ohm.",
    )
    return make(node, "amplifier", "amplifier")


def scan(cfg: Config) -> ConstantSpeed:
    """The scan at constant speed."""
    node = part(cfg, "scan")
    refuse(
        node.get("speed_m_per_s", 0) is None, "No speed is known: give scan.speed_m_per_s in m/s."
    )
    return make(node, "scan", "scan")


def friction(cfg: Config) -> float | None:
    """mu in q = mu p; None leaves p and q apart."""
    given = cfg["friction"]
    wanted = "a number, of either sign, or null to keep p and q apart"
    return None if given is None else float(number("friction", given, wanted))


def random_key(cfg: Config) -> jax.Array:
    """The key of all random numbers."""
    return jax.random.key(seed(cfg))


def noises(cfg: Config) -> tuple[Noise, ...]:
    """The named causes of noise."""
    named = part(cfg, "noise")
    return tuple(make(node, f"noise.{name}", "noise") for name, node in named.items())


def features(cfg: Config) -> dict[str, Feature]:
    """The named features of traction, to be fitted as a sum."""
    named = part(cfg, "feature")
    return {name: make(node, f"feature.{name}", "traction_feature") for name, node in named.items()}


def surface_features(cfg: Config) -> dict[str, SurfaceFeature]:
    """The named features of a surface, if any, to be fitted as a sum."""
    named = part(cfg, "feature")
    kinds: dict[str, Any] = {
        name: class_of(node, f"feature.{name}", "feature") for name, node in named.items()
    }
    on_surface = [name for name, kind in kinds.items() if kind.is_of_surface]
    if not on_surface:
        return {}
    refuse(
        len(on_surface) < len(named),
        f"feature names {', '.join(named)}: features of a surface ({', '.join(on_surface)}) act "
        "through contact and those of traction do not, so that no sum holds both: name one kind.",
    )
    return {name: make(node, f"feature.{name}", "surface_feature") for name, node in named.items()}


def solver(cfg: Config) -> Solver:
    """The solver of nonlinear fits."""
    return make(cfg["solver"], "solver", "solver")


def methods(cfg: Config) -> dict[str, Method]:
    """The methods by their names on the page."""
    named = part(cfg, "method")
    refuse(not named, "No method is named: give method=[wiener,tikhonov] or one of them.")
    return {
        name.replace("_", " ").capitalize(): make(node, f"method.{name}", "method")
        for name, node in named.items()
    }
