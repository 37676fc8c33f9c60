"""Textures and events by film, skin accelerometer and both, over variations (an hour).

The sets of textures are those of configs/experiment/skin_acceleration.yaml, with 100 surfaces of
each texture under three pressures: 300 surfaces and 900 scans a set. A surface is classified by
others alone, and intervals are of 90 %, by bootstrap over surfaces.
"""

from functools import cache, lru_cache
from typing import Any

import jax
import numpy as np

from experiments.skin_acceleration import NAME, classification_of, detectors_of, finger_of
from experiments.skin_acceleration.classify import CASES, Classification, accuracies
from experiments.skin_acceleration.events import DETECTORS, EVENTS, least_sizes
from experiments.skin_acceleration.scans import Texture
from srsinv.jobs.trials import Row
from tests.claims.study import Study
from tests.jobs.run import composed

SURFACES, SEED = 100, 3
OWN = f"{NAME}.accelerometer"
VARIATIONS = {
    "nominal": (),
    "resonance halved": (f"{OWN}.stiffness_N_per_m=250",),
    "resonance doubled": (f"{OWN}.stiffness_N_per_m=4000",),
    "accelerometer noise times 10": (f"{OWN}.noise_density_m_per_s2_per_rtHz=0.049",),
    "film noise times 10": ("noise.johnson.temperature_K=30000",),
    "normal axis": (f"{OWN}.axis=normal",),
    "two films": ("sensor=two_element",),
    "film 0.3 mm deep": ("sensor.depth_m=0.0003",),
    "amplitudes scatter by 0.5": (f"{NAME}.amplitude_spread=0.5",),
    "amplitudes scatter by 1": (f"{NAME}.amplitude_spread=1",),
}
SETS = ("coarse", "fine", "friction", "bursts", "mixed")
EVENT = "events"


@cache
def _cfg(variation: str) -> dict[str, Any]:
    overrides = (f"experiment={NAME}", f"{NAME}.surfaces={SURFACES}", *VARIATIONS[variation])
    return composed(*overrides)


def measured(what: str, variation: str) -> Row:
    """Accuracies of a set of textures, or the least events, by every set of sensors."""
    cfg = _cfg(variation)
    return _events(cfg) if what == EVENT else _accuracies(cfg, what)


def _accuracies(cfg: dict[str, Any], name: str) -> Row:
    given = cfg[NAME]
    classified = classification_of(finger_of(cfg, given), given)
    textures = Texture.of_set(name, given["texture"], given["sets"][name])
    pressed = _pressed(name, classified.spread)
    right = classified.right(textures, pressed, jax.random.key(SEED))
    value, gain = accuracies(right, SEED)
    mean = right.mean(axis=(2, 3))
    return {
        **{case: value[i].tolist() for i, case in enumerate(CASES)},
        "gain": gain.tolist(),
        "by_pressure": {case: mean[i].tolist() for i, case in enumerate(CASES)},
    }


@lru_cache(1)
def _pressed(name: str, spread: float) -> dict[float, np.ndarray]:
    """Contact with every surface of a set, which no variation of the sensors changes."""
    cfg = _cfg("nominal")
    given = cfg[NAME]
    classified: Classification = classification_of(finger_of(cfg, given), given)
    textures = Texture.of_set(name, given["texture"], given["sets"][name])
    own = classified._replace(spread=spread)
    return {pressure: own.pressed(textures, pressure) for pressure in given["pressures_Pa"]}


def _events(cfg: dict[str, Any]) -> Row:
    given = cfg[NAME]
    finger = finger_of(cfg, given)
    detectors = detectors_of(finger, given)
    texture = Texture.of(NAME, given["texture"])
    middle = sorted(given["pressures_Pa"])[1]
    power = finger.texture_power(finger.pressed(texture, 0, middle, SURFACES, 0.0))
    least = least_sizes(detectors.probability(finger, power, texture.friction), detectors.detection)
    return {
        event: dict(zip(DETECTORS, row.tolist(), strict=True))
        for event, row in zip(EVENTS, least, strict=True)
    }


def cases() -> list[Row]:
    """Set by set, as variations share the surfaces."""
    return [{"what": each, "variation": name} for each in (*SETS, EVENT) for name in VARIATIONS]


def rests_on(what: str, variation: str) -> Row:
    """The configuration of a case: the nominal one, and what is varied."""
    own = dict(_cfg("nominal")[NAME])
    sets = own.pop("sets")
    return {"overrides": list(VARIATIONS[variation]), "own": own, "set": sets.get(what)}


STUDY = Study("skin_acceleration", measured, cases, rests_on=rests_on)
