"""Film and skin accelerometer on one finger: textures and events by either, and by both."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray
from jaxtyping import Bool

from srsinv import config
from srsinv.errors import mapping, number, numbers, refuse, whole
from srsinv.forward.skin_accelerometer import AXES, SkinAccelerometer
from srsinv.inverse.events.threshold import MOST_ALARMS
from srsinv.progress import stage
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed
from srsinv.targets import make

from .classify import CASES as SENSORS
from .classify import Classification, accuracies
from .events import DETECTORS, EVENTS, SIZES_PA, Detectors, least_sizes
from .figures import by_pressure, floors, probabilities, signals
from .scans import Bursts, Finger, Texture

NAME = "skin_acceleration"


def run(cfg: config.Config) -> Result:
    """Accuracy of classification, and detection of events, by film, accelerometer and both.

    Raises `BadInput` for a line that is not periodic, sets of textures that are none, and numbers
    out of range.
    """
    given = config.part(cfg, NAME)
    wanted = "positive pressures in Pa"
    pressures = numbers(f"{NAME}.pressures_Pa", given["pressures_Pa"], wanted, above=0)
    common = mapping(f"{NAME}.texture", given["texture"], "the keys of a texture")
    sets = mapping(f"{NAME}.sets", given["sets"], "sets of textures by name")
    refuse(not sets, f"{NAME}.sets is empty: give one or more sets of textures.")
    seed = config.seed(cfg)
    with config.precision(cfg):
        textures = {name: Texture.of_set(name, common, differs) for name, differs in sets.items()}
        finger = finger_of(cfg, given)
        classified, detectors = classification_of(finger, given), detectors_of(finger, given)
        right = {}
        for name, each in textures.items():
            with stage(f"sliding over textures: {name}"):
                pressed = {p: classified.pressed(each, p) for p in pressures}
                right[name] = classified.right(each, pressed, jax.random.key(seed))
        base = Texture.of(f"{NAME}.texture", common)
        middle = sorted(pressures)[len(pressures) // 2]
        pressed = finger.pressed(base, 0, middle, classified.surfaces, 0.0)
        power = finger.texture_power(pressed)
        probability = detectors.probability(finger, power, base.friction)
        example = finger.scans([base], pressed[None], middle, jax.random.key(seed))[:, 0, 0]
    every = np.stack(list(right.values()))
    data = dataset(
        {
            **_accuracy(every, seed),
            **_floors(finger, base.friction),
            "detection_probability": (("event", "detector", "size"), probability, "1"),
            "least_size": (("event", "detector"), least_sizes(probability, detectors.detection),
                           "Pa", "least_{event}_Pa_{detector}"),
            "film_signal": ("x", example[0], finger.sensor.amplifier.unit),
            "acceleration": ("x", example[-1], "m/s^2"),
            **scalars({"surfaces": classified.surfaces, "middle_pressure_Pa": middle}),
        },
        {"set": (list(sets), "1"), "sensors": (list(SENSORS), "1"),
         "pressure": (pressures, "Pa"), "event": (list(EVENTS), "1"),
         "detector": (list(DETECTORS), "1"), "size": (SIZES_PA, "Pa"),
         "reading": (["film", *(f"{axis} accelerometer" for axis in AXES)], "1"),
         "x": (np.asarray(finger.lines[0].x), "m")},
        stretch_m=classified.samples * float(finger.lines[0].cell_m),
        friction=base.friction, resonance_Hz=finger.resonance_Hz, rate_Hz=finger.rate_hz,
        speed_m_per_s=float(finger.scan.speed_m_per_s), refinement=finger.refinement,
        noise=", ".join(cfg["noise"]), effects_on=listed(cfg["effects"]),
        **detectors._asdict(), axis=finger.accelerometer.axis,
        amplitude_spread=classified.spread, shear_fraction=finger.bursts.shear_fraction,
    )  # fmt: skip
    plots = {"floors": floors, "signals": signals, "by_pressure": by_pressure,
             "probabilities": probabilities}  # fmt: skip
    return Result(_title(data), data, sections(__file__, **plots))


def _title(data: xarray.Dataset) -> str:
    """The set of textures that both sensors classify best over the better one alone."""
    best = str(data["set"].values[int(np.argmax(data["gain"].values))])
    one = data["accuracy"].sel(set=best)
    both, alone = (
        float(one.sel(sensors="both")),
        float(one.sel(sensors=["film", "accelerometer"]).max()),
    )
    return (
        f"Both sensors classify {100 * both:.0f} % of the textures in the set {best}, the better "
        f"one alone {100 * alone:.0f} %"
    )


def _accuracy(right: Bool[np.ndarray, "set case pressure texture surface"], seed: int):
    """Accuracies of every set with their intervals, and what both sensors gain."""
    pairs = [accuracies(each, seed) for each in right]
    value, gain = (np.stack(each) for each in zip(*pairs, strict=True))
    of = ("set", "sensors")
    return {
        "accuracy": (of, value[..., 0], "1", "accuracy_{set}_{sensors}"),
        "accuracy_low": (of, value[..., 1], "1"),
        "accuracy_high": (of, value[..., 2], "1"),
        "accuracy_at_pressure": ((*of, "pressure"), right.mean(axis=(3, 4)), "1"),
        "gain": ("set", gain[:, 0], "1", "gain_of_both_{set}"),
        "gain_low": ("set", gain[:, 1], "1", "gain_of_both_low_{set}"),
        "gain_high": ("set", gain[:, 2], "1", "gain_of_both_high_{set}"),
    }


def _floors(finger: Finger, friction: float) -> dict[str, tuple[Any, ...]]:
    """Amplitudes of pressure that equal the noise in a band of 1 Hz, and where they cross."""
    k, floor = finger.floors(friction)
    own = floor[1 + AXES.index(finger.accelerometer.axis)]
    film_leads = np.flatnonzero(floor[0] < own)  # NaN where the film has no signal
    crossing = 2 * np.pi / k[film_leads[-1]] if film_leads.size else np.inf
    wave = "wavelength"
    return {
        "noise_floor": (("reading", wave), floor[:, ::-1], "Pa"),
        wave: (wave, 2 * np.pi / k[::-1], "m"),
        **scalars({"crossing_wavelength_m": float(crossing)}),
    }


def finger_of(cfg: config.Config, given: Mapping[str, Any]) -> Finger:
    """The finger with both sensors. Raises `BadInput` for numbers out of range."""
    times, bursts = int(cfg["grid"]["refinement"]), given["bursts"]
    key, wanted = f"{NAME}.bursts.shear_fraction", "a number that is at least 0"
    share = float(number(key, bursts["shear_fraction"], wanted, least=0))
    return Finger.checked(
        (config.line(cfg), config.line(cfg, times)), times, config.sensor(cfg),
        SkinAccelerometer(**given["accelerometer"]), config.scan(cfg),
        make(cfg["skin"], "skin", "half_space"), config.noises(cfg),
        Bursts(share, float(bursts["patch_m"]), float(bursts["decay_s"])),
    )  # fmt: skip


def classification_of(finger: Finger, given: Mapping[str, Any]) -> Classification:
    """How scans are classified, by `skin_acceleration` of a configuration. Raises `BadInput` for
    numbers out of range."""
    line = finger.lines[0]
    cell = float(line.cell_m)
    wanted = "a positive length within the line"
    stretch = number(f"{NAME}.stretch_m", given["stretch_m"], wanted,
                     above=4 * cell, most=line.n * cell)  # fmt: skip
    wanted = "a whole number from 10"
    surfaces = whole(f"{NAME}.surfaces", given["surfaces"], wanted, least=10)
    bands = whole(f"{NAME}.bands", given["bands"], "a whole number from 2", least=2)
    spread = number(f"{NAME}.amplitude_spread", given["amplitude_spread"],
                    "a number that is at least 0", least=0)  # fmt: skip
    return Classification(finger, surfaces, float(spread), int(stretch / cell), bands)


def detectors_of(finger: Finger, given: Mapping[str, Any]) -> Detectors:
    """How events are detected, by `skin_acceleration` of a configuration. Raises `BadInput` for
    numbers out of range."""
    key, events, most = f"{NAME}.events", given["events"], MOST_ALARMS * finger.rate_hz
    wanted = f"a positive number, up to {most:g}"
    number(f"{key}.false_alarms_per_s", events["false_alarms_per_s"], wanted, above=0, most=most)
    for name in ("contact_s", "slip_s"):
        number(f"{key}.{name}", events[name], "a positive time in seconds", above=0)
    number(f"{key}.off_centre_m", events["off_centre_m"], "a length that is at least 0", least=0)
    wanted = "a probability, from 0.5 to below 1"
    number(f"{key}.detection", events["detection"], wanted, least=0.5, below=1)
    return Detectors(**{name: float(events[name]) for name in Detectors._fields})
