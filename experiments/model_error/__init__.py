"""Model error: data of another sensor than the one assumed, over wavelengths."""

from collections.abc import Collection
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray

from srsinv import config
from srsinv.errors import mapping, number_range, refuse, whole
from srsinv.forward.sensor import Sensor
from srsinv.inverse.estimate import COMPONENTS, relative_error
from srsinv.inverse.simulated import problem_of
from srsinv.parts import merged
from srsinv.progress import stage
from srsinv.report.data import dataset
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, significant

from .figures import by_wavelength, recovered
from .wave_response import wave_response, whole_waves

ASSUMED = "as assumed"
Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result:
    """The scene, and one sinusoid of p and of q after another, made by each true sensor and
    inverted as the assumed one.

    Raises `BadInput` for methods that are not one, a line that is not periodic, and refusals of the
    configuration's parts.
    """
    settings, methods = cfg["model_error"], config.methods(cfg)
    refuse(len(methods) != 1, f"method names {len(methods)}: give one, method=wiener.")
    line_kind, wanted = cfg["grid"]["line"], "wavelengths in metres"
    first, last = number_range(
        "model_error.wavelengths_m", settings["wavelengths_m"], wanted, above=0
    )
    points = whole("model_error.points", settings["points"], "a whole number from 2", least=2)
    wavelengths = np.geomspace(last, first, points)
    refuse(
        line_kind != "periodic",
        f"grid.line is {line_kind!r}, but sinusoids need a periodic line: give grid.line=periodic.",
    )
    ((name, method),) = methods.items()
    changes = {ASSUMED: {}, **mapping("model_error.truths", settings["truths"])}
    true = {case: merged(cfg, each) for case, each in changes.items()}
    sensors, estimates, responses = [], [], []
    with config.precision(cfg):
        assumed, key = config.simulation(cfg), config.random_key(cfg)
        line, traction = assumed.line, assumed.traction(assumed.line)
        waves = whole_waves(line, wavelengths)
        for case, own in true.items():
            with stage(f"inverting as the assumed sensor: {case}"):
                sim = config.simulation(own)
                problem = problem_of(assumed, sim.signal(), jnp.mean(traction[0]), key)
                operator = sim.sensor.operator(line, sim.scan)
                sensors.append(sim.sensor)
                estimates.append(np.asarray(method(problem).value))
                responses.append(wave_response(method, problem, operator, waves))
    components = list(COMPONENTS), "1"
    data = dataset(
        _recovered(np.asarray(traction), np.stack(estimates), np.stack(responses))
        | _sensors(sensors)
        | {"effects": ("case", [listed(own["effects"]) for own in true.values()], "1")},
        {"case": (list(true), "1"), "component": components, "component_out": components,
         "component_in": components, "other": ("component", COMPONENTS[::-1], "1"),
         "wavelength": (2 * np.pi / np.asarray(line.k)[waves], "m"),
         "x": (np.asarray(line.x), "m")},
        method=name,
    )  # fmt: skip
    shown = sections(__file__, recovered=recovered, by_wavelength=by_wavelength)
    return Result(_title(data), data, shown)


def _recovered(truth: np.ndarray, estimates: np.ndarray, responses: np.ndarray) -> Variables:
    """The scene's traction with its estimates (case, component, x), and the responses to sinusoids
    (case, component out, component in, wave)."""
    by, pairs = ("case", "component"), ("case", "component_out", "component_in", "wavelength")
    size = np.abs(responses)
    longest, leak = size[..., 0][:, [0, 1], [0, 1]], size.max(axis=-1)[:, [1, 0], [0, 1]]
    return {
        "traction": (("component", "x"), truth, "Pa"),
        "estimate": ((*by, "x"), estimates, "Pa"),
        "error": (by, relative_error(estimates, truth), "1", "error_{component}_{case}"),
        "gain": (pairs, size, "1"),
        "phase": (pairs, np.angle(responses), "rad"),
        "gain_longest": (by, longest, "1", "gain_{component}_longest_{case}"),
        "leak": (by, leak, "1", "leak_{component}_to_{other}_max_{case}"),
    }


def _sensors(sensors: Collection[Sensor]) -> Variables:
    """What the sensors may differ in: skin, depth and angle of the first film."""
    films = [sensor.elements[0] for sensor in sensors]
    turned = np.rad2deg([float(film.angle_rad - films[0].angle_rad) for film in films])
    return {
        "skin": ("case", [sensor.skin.words for sensor in sensors], "1"),
        "depth": ("case", [float(film.depth_m) for film in films], "m"),
        "turned": ("case", turned, "deg"),
    }


def _title(data: xarray.Dataset) -> str:
    """The case and component with the largest error, beside the assumed sensor."""
    error = data["error"]
    worst = error.isel(error.argmax(...))
    own = error.sel(case=ASSUMED, component=worst["component"])
    percent, of_assumed = (significant(100 * float(each), 3) for each in (worst, own))
    return (
        f"{worst['component'].item()} has an error of {percent} % with data of another sensor "
        f"({worst['case'].item()}) and of {of_assumed} % with data of the assumed one"
    )
