"""Parts of the configuration from their own nodes, those of one group or of a few.

`srsinv.config` says which nodes of a configuration make which objects; here are the groups that
take more than one call of [`srsinv.targets.make`][]. All raise `BadInput` for nodes that are
invalid, by the key that the configuration has. None imports jax before it is called.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from .errors import choice, mapping, number, refuse, whole
from .resolution import MOST_CELLS
from .targets import PARTS, TARGET, check, class_of, make

if TYPE_CHECKING:  # most import jax
    from .effects import Effect
    from .forward.noise import Noise
    from .forward.scene import Scene
    from .forward.sensor import Sensor
    from .forward.surface_feature import SurfaceFeature
    from .grid import Line
    from .recording import Recording

Node = Mapping[str, Any]


def merged(node: Node, changes: Node) -> dict[str, Any]:
    """`node` with `changes` in depth; what names a class of its own replaces what was there."""
    both = dict(node)
    for key, value in changes.items():
        old, inside = both.get(key), isinstance(value, Mapping) and TARGET not in value
        both[key] = merged(old, value) if inside and isinstance(old, Mapping) else value
    return both


def varied(whole: Node, line: str, refinement: int, **changed: Any) -> dict[str, Any]:
    """A configuration on another kind of line, with another refinement; all of its effects act,
    unless a `tolerance` is among the other changes."""
    without = {name: value for name, value in whole.items() if name != "tolerance"}
    grid = {**whole["grid"], "line": line, "refinement": refinement}
    return {**without, "grid": grid, **changed}


def line(grid: Node, refinement: Any) -> Line:
    """The line of `grid`, its cells `refinement` times finer at the same first position."""
    from .grid import LINES

    kind = LINES[choice("grid.line", grid.get("line"), LINES)]
    wanted = f"a whole number from 3 to {MOST_CELLS}"
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


def sensor(sensor: Node, skin: Any, amplifier: Node) -> Sensor:
    """Film elements in their skin, read by the amplifier, whose resistor has to be known; without
    any effect, that of their offsets included."""
    from .forward.describe import elements
    from .forward.sensor import Sensor

    films, around = elements(sensor), make(skin, "skin", "skin")
    refuse(
        amplifier.get("feedback_resistance_ohm", 0) is None,
        "No feedback resistance is known: give amplifier.feedback_resistance_ohm in ohm.",
    )
    at_origin = [film.at_origin() for film in films]
    return Sensor(at_origin, skin=around, amplifier=make(amplifier, "amplifier", "amplifier"))


def with_facts(nodes: Node, sensor: Node, skin: Node) -> dict[str, Any]:
    """The nodes of a configuration, with these facts of the sensor and of a half space where they
    leave keys of its sensor, amplifier and skin open."""
    from .recording import merge

    described = merge(sensor, nodes["sensor"])
    stated = {key: value for key, value in nodes["skin"].items() if value is not None}
    taken = inspect.signature(class_of(nodes["skin"], "skin", "skin")).parameters
    amplifier, resistance = nodes["amplifier"], "feedback_resistance_ohm"
    if amplifier.get(resistance, 0) is None:
        amplifier = {**amplifier, resistance: described.get(resistance)}
    return {
        **nodes,
        "sensor": described,
        "skin": {key: value for key, value in skin.items() if key in taken} | stated,
        "amplifier": amplifier,
    }


def scene(scene: Node, skin: Any) -> Scene:
    """The scene, its named parts in order; one with a surface is in contact with the half space."""
    node = dict(scene)
    for kind in sorted({"pressures", "frictions", "surfaces"} & node.keys()):
        named = {} if node[kind] is None else mapping(f"scene.{kind}", node[kind])
        at = {f"scene.{kind}.{key}": each for key, each in named.items()}
        listed = {key: _profile_read(each, key) for key, each in at.items()}
        for key, each in listed.items():
            check(each, key, PARTS[kind])
        node[kind] = list(listed.values())
    if "surfaces" in node:
        check(skin, "skin", "skin")
        node["skin"] = skin
    return make(node, "scene", "scene")


def _profile_read(node: Any, at: str) -> Any:
    """A measured profile's node, at key `at`, with the columns of the file that it names."""
    from .recording import load_profile

    if not isinstance(node, Mapping) or "path" not in node:
        return node
    rest = {key: value for key, value in node.items() if key != "path"}
    return rest | load_profile(node["path"], f"{at}.path")


def effects(named: Node) -> dict[str, Effect]:
    """The named effects, in the order in which they are added."""
    import jax.numpy as jnp

    from .effects import NAMES

    for name in named:
        is_named = TARGET in mapping(f"effects.{name}", named[name])
        refuse(
            name not in NAMES and not is_named,
            f"There is no effect {name!r}: choose from {', '.join(NAMES)}.",
        )
        refuse(
            not is_named,
            f"effects.{name} has settings, but {name} is not among the effects: add it to "
            "effects=[...], or leave its settings out.",
        )
    precision = str(jnp.result_type(float))
    made = {name: _effect(name, node, precision) for name, node in named.items()}
    return dict(sorted(made.items(), key=lambda each: (each[1].order, each[0])))


def _effect(name: str, node: Node, precision: str) -> Effect:
    """The effect of a node. One of the package, made of the package's parts alone, is immutable and
    is made once of the same settings: `effects=auto` asks for all of them with every scene."""
    try:
        settings = json.dumps(node)
    except (TypeError, ValueError):  # objects, which only a program that a user writes gives
        settings = ""
    of_package = settings.count(f'"{TARGET}": "srsinv.')
    if of_package == 0 or of_package < settings.count(f'"{TARGET}"'):
        return make(node, f"effects.{name}", "effects")
    return _effect_of_package(name, settings, precision)


@lru_cache(maxsize=64)
def _effect_of_package(name: str, settings: str, precision: str) -> Effect:
    import jax

    del precision  # that of its numbers, which are arrays
    with jax.ensure_compile_time_eval():  # within a compiled program they are numbers, too
        return make(json.loads(settings), f"effects.{name}", "effects")


def effects_of_sensor(named: Node) -> dict[str, Effect]:
    """The named effects, in the order in which they are added; all have to be of the sensor."""
    made = effects(named)
    for name, effect in made.items():
        refuse(
            not effect.of_sensor,
            f"effects names {name}, which acts on simulated scenes, but this job takes "
            "effects of the sensor only: leave it out.",
        )
    return made


def effects_at_rest(named: Node) -> dict[str, Effect]:
    """The named effects, in the order in which they are added, of a sensor that does not slide."""
    from .effects import Order

    made = effects(named)
    for name, effect in made.items():
        refuse(
            effect.order in (Order.DIRECTION, Order.CONTACT, Order.MOTION, Order.LOAD),
            f"effects names {name}, which acts on sliding, but this job's sensor is at "
            "rest: leave it out.",
        )
    return made


def noises(named: Node) -> dict[str, Noise]:
    """The named causes of noise."""
    return {name: make(node, f"noise.{name}", "noise") for name, node in named.items()}


def coloured_noises(named: Node) -> dict[str, Noise]:
    """The named causes of noise but the white one, which have to be known without a signal."""
    coloured = noises({name: node for name, node in named.items() if name != "white"})
    for noise in coloured.values():
        refuse(
            noise.needs_noise_free_signal,
            "noise=snr needs a simulated signal, not a recording: give noise=[white], "
            "whose rms=null is estimated from the recording.",
        )
    return coloured


def stated_white_rms(named: Node, recording: Recording) -> list[float] | None:
    """The rms of the white noise as it is stated, of all elements or of each; None where it is to
    be taken from the recording."""
    white = named.get("white")
    given = None if white is None else mapping("white", white).get("rms")
    if given is None:
        return None
    refuse(
        bool(recording.sidecar.get("quiet_s")),
        "noise.white.rms and recording.quiet_s are both given: leave one of them out.",
    )
    wanted = "a positive number in the signal's unit, or null to estimate it from the recording"
    each = given if isinstance(given, list) else [given]
    return [number("noise.white.rms", one, wanted, above=0) for one in each]


def surface_features(named: Node) -> dict[str, SurfaceFeature]:
    """The named features of a surface, if any."""
    kinds: dict[str, Any] = {
        name: class_of(node, f"feature.{name}", "feature") for name, node in named.items()
    }
    on_surface = [name for name, kind in kinds.items() if kind.is_of_surface]
    if not on_surface:
        return {}
    refuse(
        len(on_surface) < len(named),
        f"feature names {', '.join(named)}, of which only {', '.join(on_surface)} is "
        "of a surface: name features of a surface or of traction, not both.",
    )
    return {name: make(node, f"feature.{name}", "surface_feature") for name, node in named.items()}
