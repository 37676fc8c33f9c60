"""From a resolved configuration to the objects it names."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import jax
from hydra.utils import instantiate

from ..errors import refuse
from ..forward.amplifier import Amplifier
from ..forward.describe import EFFECTS as EFFECTS
from ..forward.describe import elements
from ..forward.feature import Feature
from ..forward.noise import Noise
from ..forward.scan import ConstantSpeed
from ..forward.scene import Scene
from ..forward.sensor import Sensor
from ..grid import Line, Open, Periodic
from ..inverse.nonlinear import Solver
from ..inverse.tikhonov import Tikhonov
from ..inverse.wiener import Wiener

Config = Mapping[str, Any]
LINES = {"periodic": Periodic, "open": Open}


@contextmanager
def precision(cfg: Config) -> Iterator[None]:
    """Work in float64 or float32, as `cfg["precision"]` says."""
    name = cfg["precision"]
    refuse(name not in ("float64", "float32"), f"precision is {name!r}: give float64 or float32.")
    with jax.enable_x64(name == "float64"):
        yield


def make(node: Any) -> Any:
    """The object that a node's `_target_` names."""
    return instantiate(node, _convert_="all")


def line(cfg: Config, refinement: int = 1) -> Line:
    """The line of `grid`, its cells `refinement` times finer at the same first position."""
    grid = cfg["grid"]
    refuse(
        grid["line"] not in LINES,
        f"grid.line is {grid['line']!r}: give one of {', '.join(LINES)}.",
    )
    refuse(
        not (isinstance(grid["cells"], int) and grid["cells"] >= 3),
        f"grid.cells is {grid['cells']}: there are too few samples, give a whole number from 3.",
    )
    refuse(
        not grid["length_m"] > 0, f"grid.length_m is {grid['length_m']}: give a positive length."
    )
    refuse(
        not (isinstance(refinement, int) and refinement >= 1),
        f"grid.refinement is {refinement}: give a whole number from 1.",
    )
    cells = grid["cells"] * refinement
    return LINES[grid["line"]](cells, grid["length_m"] / cells, grid["start_m"])


def scene(cfg: Config) -> Scene:
    """The scene, its named pressures and frictions in order."""
    node = dict(cfg["scene"])
    for part in ("pressures", "frictions"):
        node[part] = list(node[part].values())
    return make(node)


def sensor(cfg: Config) -> Sensor:
    """Film elements in the skin, with the effects that are named, read by the amplifier."""
    films = elements(cfg["sensor"], cfg["effects"])
    return Sensor(films, skin=make(cfg["skin"]), amplifier=amplifier(cfg))


def amplifier(cfg: Config) -> Amplifier:
    """The amplifier; one from a recording has to be told its resistor."""
    node = cfg["amplifier"]
    refuse(
        node.get("feedback_resistance_ohm", 0) is None,
        "No feedback resistance is known: give amplifier.feedback_resistance_ohm in ohm.",
    )
    return make(node)


def scan(cfg: Config) -> ConstantSpeed:
    """How the finger moves."""
    refuse(
        cfg["scan"]["speed_m_per_s"] is None, "No speed is known: give scan.speed_m_per_s in m/s."
    )
    return make(cfg["scan"])


def noises(cfg: Config) -> tuple[Noise, ...]:
    """The named causes of noise."""
    return tuple(make(node) for node in cfg["noise"].values())


def features(cfg: Config) -> dict[str, Feature]:
    """The named features of traction: their sum is what is looked for."""
    return {name: make(node) for name, node in (cfg.get("feature") or {}).items()}


def solver(cfg: Config) -> Solver:
    """What minimises a fit's sum of squares."""
    return make(cfg["solver"])


def methods(cfg: Config) -> dict[str, Wiener | Tikhonov]:
    """The methods by the names that the page calls them."""
    refuse(not cfg["method"], "No method is named: give method=[wiener,tikhonov] or one of them.")
    return {name.replace("_", " ").capitalize(): make(node) for name, node in cfg["method"].items()}
