"""A hard outer layer: the stress at the film under a given load, and under a surface by contact."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray

from srsinv.errors import number, numbers
from srsinv.forward.layered import Layered
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.grid import Line
from srsinv.report.data import dataset

STRESSES = "sigma_x", "sigma_z"


def hard_skins(
    line: Line, scene: SurfaceScene, sensor: Sensor, scan: ConstantSpeed, given: Mapping[str, Any]
) -> xarray.Dataset:
    """Peaks over those of one material, for outer layers of each stiffness. Raises `BadInput` for
    settings out of range."""
    key, wanted = "skin_design.hard_thickness_m", "a positive thickness in metres"
    thick = number(key, given["hard_thickness_m"], wanted, above=0)
    key, wanted = "skin_design.load_width_m", "a positive length in metres"
    width = number(key, given["load_width_m"], wanted, above=0)
    key, wanted = "skin_design.modulus_ratios", "numbers that are positive"
    ratios = numbers(key, given["modulus_ratios"], wanted, above=0)
    soft = sensor.skin.surface_modulus_Pa
    assert soft is not None  # a half space's
    skins = [hardened(thick, soft, each) for each in [1.0, *ratios]]
    loaded = np.array([given_load(line, sensor, skin, width) for skin in skins])
    pressed = np.array([_pressed(line, scene, sensor, scan, skin) for skin in skins])
    (stress, contact), of_ratio = (each[1:] / each[0] for each in (loaded, pressed)), "ratio"
    pressure, below, signal = contact.T
    return dataset(
        {
            "given_stress": ((of_ratio, "stress"), stress, "1",
                             "given_load_{stress}_at_ratio_{ratio}"),
            "contact_pressure": (of_ratio, pressure, "1", "contact_pressure_at_ratio_{ratio}"),
            "contact_stress": (of_ratio, below, "1", "contact_stress_at_ratio_{ratio}"),
            "contact_signal": (of_ratio, signal, "1", "contact_signal_at_ratio_{ratio}"),
        },
        {"ratio": (ratios, "1"), "stress": (list(STRESSES), "1")},
        hard_thickness_m=thick, load_width_m=width,
    )  # fmt: skip


def hardened(thickness_m: float, modulus_Pa: float, ratio: float) -> Layered:
    """An incompressible half space under an outer layer that is `ratio` times as stiff."""
    inner = {"thickness_m": None, "youngs_modulus_Pa": modulus_Pa, "poisson_ratio": 0.5}
    outer = {"thickness_m": thickness_m, "youngs_modulus_Pa": ratio * modulus_Pa}
    return Layered([inner | outer, inner])


def given_load(line: Line, sensor: Sensor, skin: Layered, width_m: float) -> np.ndarray:
    """Greatest size of sigma_x and sigma_z at the film under a narrow strip of pressure."""
    stress = skin.strip_response(line.x, sensor.depth_m, jnp.asarray(width_m))
    return np.abs(np.asarray(stress)[:2, 0]).max(axis=-1)


def _pressed(
    line: Line, scene: SurfaceScene, sensor: Sensor, scan: ConstantSpeed, skin: Layered
) -> tuple[float, float, float]:
    """Greatest pressure and change of sigma_z at the film, less their means, and greatest signal on
    the scene's surface."""
    hard, contact = dataclasses.replace(sensor, skin=skin), scene.with_skin(skin)
    p = contact.pressure(line)
    traction = contact.traction(line, scan.direction, p)
    sigma_z = line.operator(hard.stress())(traction)[1]
    signal = hard.operator(line, scan)(traction)
    more = float(jnp.max(p) - jnp.mean(p)), float(jnp.abs(sigma_z - jnp.mean(sigma_z)).max())
    return *more, float(jnp.abs(signal).max())
