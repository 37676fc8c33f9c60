"""Physical parameters of a sensor, as a measured kernel is fitted by them.

`gain_N`, `depth_m` (of all films), `tilt_deg` (of all), `shift_m` (of all, along x),
`angle_N_deg` and `offset_N_m` of element N, and of a layered skin `layer_N_thickness_m` and
`layer_N_modulus` (its Young's modulus over that stated); N from 1.
"""

import re
from collections.abc import Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...errors import echo, nearest, refuse
from ...forward.film import Film, Offset
from ...forward.layered import Layered
from ...forward.sensor import Sensor
from ...grid import as_real

# What is known before: standard deviations about the stated value. Wide: they end a search that
# the data do not.
GAIN, DEPTH, TILT_DEG, SHIFT_DEPTHS, LAYER = 0.5, 0.4, 15.0, 1.0, 0.5
LEAST, MOST = 0.3, 3.0  # of a stated length or modulus
_NAME = re.compile(
    r"gain_(\d+)|depth_m|tilt_deg|shift_m|angle_(\d+)_deg|offset_(\d+)_m"
    r"|layer_(\d+)_(?:thickness_m|modulus)"
)


def default_parameters(sensor: Sensor) -> tuple[str, ...]:
    """Gains, depth and tilt, and those of the layers where there are any."""
    names = [f"gain_{n}" for n in range(1, len(sensor.elements) + 1)]
    names += ["depth_m", "tilt_deg"]
    if isinstance(sensor.skin, Layered):
        layers = list(enumerate(sensor.skin.layers, 1))
        names += [f"layer_{n}_thickness_m" for n, each in layers if each.thickness_m is not None]
        names += [f"layer_{n}_modulus" for n, _ in layers[1:]]
    return tuple(names)


class Physics:
    """Parameters of these `names` about a sensor as it is stated.

    Raises `BadInput` for names that it has not.
    """

    def __init__(self, sensor: Sensor, names: Sequence[str]):
        self.sensor, self.names = sensor, tuple(names)
        own = [*default_parameters(sensor), "shift_m"]
        for name in self.names:
            found = _NAME.fullmatch(name)
            number = next((int(n) for n in found.groups() if n), 1) if found else 0
            is_layer = name.startswith("layer_")
            layers = sensor.skin.layers if isinstance(sensor.skin, Layered) else ()
            most = len(layers) if is_layer else len(sensor.elements)
            refuse(
                not 1 <= number <= most,
                f"kernel.parameters names {echo(name)}: {nearest(name, own)}choose from "
                f"{', '.join(own)}, angle_N_deg and offset_N_m.",
            )

    @property
    def stated(self) -> Float[np.ndarray, " c"]:
        """Their values as stated."""
        return np.array([self._stated(name) for name in self.names])

    @property
    def deviations(self) -> Float[np.ndarray, " c"]:
        """The standard deviations of what is known before."""
        return np.array([self._deviation(name) for name in self.names])

    def within(self, values: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
        """The values, lengths and moduli within a factor of those stated."""
        is_scale = np.array(
            [n == "depth_m" or n.startswith(("layer_", "gain_")) for n in self.names]
        )
        low, high = LEAST * self.stated, MOST * self.stated
        return np.where(is_scale, np.clip(values, low, high), values)

    def sensor_of(self, values: Float[np.ndarray, " c"]) -> tuple[Sensor, Float[np.ndarray, " e"]]:
        """The sensor of these values, and the gains of its elements."""
        known = dict(zip(self.names, map(float, values), strict=True))
        gains = np.array([
            known.get(f"gain_{n}", 1.0) for n in range(1, len(self.sensor.elements) + 1)
        ])  # fmt: skip
        films = [self._film(n, film, known) for n, film in enumerate(self.sensor.elements, 1)]
        sensor = eqx.tree_at(lambda s: s.elements, self.sensor, tuple(films))
        if isinstance(sensor.skin, Layered):
            sensor = eqx.tree_at(lambda s: s.skin, sensor, _layered(sensor.skin, known))
        return sensor, gains

    def _film(self, n: int, film: Film, known: Mapping[str, float]) -> Film:
        deeper = known.get("depth_m", float(self.sensor.depth_m)) - self.sensor.depth_m
        angle = np.deg2rad(known.get(f"angle_{n}_deg", float(np.rad2deg(film.angle_rad))))
        tilt = np.deg2rad(known.get("tilt_deg", 0.0))
        moved = eqx.tree_at(
            lambda f: (f.depth_m, f.angle_rad),
            film,
            (film.depth_m + deeper, as_real(angle + tilt)),
        )
        shift = known.get("shift_m", 0.0) + known.get(f"offset_{n}_m", 0.0)
        return moved.with_effect(Offset(shift))

    def _stated(self, name: str) -> float:
        if name == "depth_m":
            return float(self.sensor.depth_m)
        if name.startswith("angle_"):
            film = self.sensor.elements[int(name.split("_")[1]) - 1]
            return float(np.rad2deg(film.angle_rad))
        if name.endswith("_thickness_m"):
            assert isinstance(self.sensor.skin, Layered)
            thickness = self.sensor.skin.layers[int(name.split("_")[1]) - 1].thickness_m
            return float("nan") if thickness is None else float(thickness)
        return 1.0 if name.startswith(("gain_", "layer_")) else 0.0

    def _deviation(self, name: str) -> float:
        depth = float(self.sensor.depth_m)
        if name.startswith("gain_"):
            return GAIN
        if name == "depth_m":
            return DEPTH * depth
        if name.startswith("layer_"):
            return LAYER * self._stated(name)
        return TILT_DEG if name.endswith("_deg") else SHIFT_DEPTHS * depth


def _layered(skin: Layered, known: Mapping[str, float]) -> Layered:
    """The layers of these thicknesses and moduli."""
    for n, layer in enumerate(skin.layers, 1):
        thick, modulus = known.get(f"layer_{n}_thickness_m"), known.get(f"layer_{n}_modulus", 1.0)
        of = layer.thickness_m if thick is None else as_real(thick)
        changed = eqx.tree_at(
            lambda each: (each.thickness_m, each.youngs_modulus_Pa),
            layer,
            (of, layer.youngs_modulus_Pa * modulus),
            is_leaf=lambda leaf: leaf is None,
        )
        skin = eqx.tree_at(lambda s, at=n - 1: s.layers[at], skin, changed)
    return skin
