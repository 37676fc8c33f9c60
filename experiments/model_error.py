"""Model error: data of another sensor than the one assumed, over wavelengths."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import refuse
from srsinv.forward.simulation import Simulation
from srsinv.inverse.estimate import COMPONENTS, deviation
from srsinv.inverse.line_problem import LineProblem
from srsinv.inverse.simulated import problem_of
from srsinv.parts import merged
from srsinv.progress import stage
from srsinv.report.plot.stages import QUANTITIES, X, method_looks
from srsinv.report.plot.style import TRUTH
from srsinv.report.result import Result, dataset
from srsinv.report.section import sections
from srsinv.report.text import listed, significant

ASSUMED = "as assumed"
GAINS = {  # by component out and in, the upper two 1 if all is right, the lower two 0
    ("p", "p"): "p recovered of p",
    ("q", "q"): "q recovered of q",
    ("q", "p"): "q recovered where there is p",
    ("p", "q"): "p recovered where there is q",
}


def run(cfg: config.Config) -> Result:
    """The scene, and one sinusoid of p and of q after another, made by each true sensor and
    inverted as the assumed one.

    Raises `BadInput` for methods that are not one, a line that is not periodic, and refusals of the
    configuration's parts.
    """
    settings, methods = cfg["model_error"], config.methods(cfg)
    refuse(len(methods) != 1, f"method names {len(methods)}: give one, method=wiener.")
    line_kind, truths = cfg["grid"]["line"], {ASSUMED: {}, **settings["truths"]}
    refuse(line_kind != "periodic", f"grid.line is {line_kind!r}: give periodic, as for sinusoids.")
    ((name, method),) = methods.items()
    with config.precision(cfg):
        assumed, key = config.simulation(cfg), config.random_key(cfg)
        waves = _waves(assumed, settings)
        traction = assumed.traction(assumed.line)
        sims, estimates, gains = [], [], []
        for case, changes in truths.items():
            with stage(f"inverting as the assumed sensor: {case}"):
                true = config.simulation(merged(cfg, changes))
                problem = problem_of(assumed, true.signal(), jnp.mean(traction[0]), key)
                estimates.append(np.asarray(method(problem).value))
                gains.append(_gains(true, problem, method, waves))
                sims.append(true)
    used = [listed(merged(cfg, changes)["effects"]) for changes in truths.values()]
    variables = _variables(np.asarray(traction), np.stack(estimates), np.stack(gains))
    data = dataset(
        {**variables, **_sensors(sims), "effects": ("case", used, "1")},
        {"case": (list(truths), "1"), "component": (list(COMPONENTS), "1"),
         "other": ("component", COMPONENTS[::-1], "1"),
         "component_out": (list(COMPONENTS), "1"), "component_in": (list(COMPONENTS), "1"),
         "wavelength": (2 * np.pi / np.asarray(assumed.line.k)[waves], "m"),
         "x": (np.asarray(assumed.line.x), "m")},
        method=name,
    )  # fmt: skip
    return Result(
        _title(data), data, sections(__file__, recovered=recovered, by_wavelength=by_wavelength)
    )


def _title(data: xarray.Dataset) -> str:
    """The case and component with the largest error, beside the assumed sensor."""
    error = data["error"]
    worst = error.isel(error.argmax(...))
    other, own = (
        significant(100 * float(each), 3)
        for each in (worst, error.sel(case=ASSUMED, component=worst["component"]))
    )
    return (
        f"{worst['component'].item()} is off by {other} % with data of another sensor "
        f"({worst['case'].item()}), by {own} % with those of the assumed one"
    )


def _waves(sim: Simulation, settings: Mapping[str, Any]) -> np.ndarray:
    """Numbers of whole waves on the line, nearest to the given wavelengths."""
    first, last = settings["wavelengths_m"]
    refuse(
        not 0 < first < last,
        f"model_error.wavelengths_m is {[first, last]}: give the shortest and the longest in m.",
    )
    wanted = sim.line.n * float(sim.line.cell_m) / np.geomspace(last, first, settings["points"])
    return np.unique(np.clip(np.round(wanted).astype(int), 1, sim.line.n // 2 - 1))


def _gains(true: Simulation, problem: LineProblem, method, waves: np.ndarray) -> np.ndarray:
    """(component out, component in, wave): complex amplitude recovered per unit of true one."""
    line = true.line
    respond = true.sensor.operator(line, true.scan)
    size = np.sqrt(np.mean(np.asarray(problem.data) ** 2))
    gains = np.zeros((2, 2, waves.size), complex)
    for j, m in enumerate(waves):
        wave = np.cos(2 * np.pi * m * np.arange(line.n) / line.n)
        for c in range(2):
            traction = np.zeros((2, line.n))
            traction[c] = wave
            data = respond(jnp.asarray(traction))
            scale = size / np.sqrt(np.mean(np.asarray(data) ** 2))
            wave_problem = LineProblem(
                line, problem.forward, scale * data, problem.noise, known_mean_Pa=(0.0, None)
            )
            spectrum = np.fft.rfft(np.asarray(method(wave_problem).value))[:, m] / scale
            gains[:, c, j] = spectrum / np.fft.rfft(wave)[m]
    return gains


def _variables(truth, estimates, gains) -> dict[str, tuple[Any, ...]]:
    """Recovered traction with its relative error less the means, and the gains of sinusoids."""
    by, pairs = ("case", "component"), ("case", "component_out", "component_in", "wavelength")
    wrong = np.linalg.norm(deviation(estimates) - deviation(truth), axis=-1)
    size = np.abs(gains)
    own = np.einsum("abbw->abw", size)[..., 0]
    leak = size.max(axis=-1)[:, [1, 0], [0, 1]]
    return {
        "traction": (("component", "x"), truth, "Pa"),
        "estimate": ((*by, "x"), estimates, "Pa"),
        "error": (by, wrong / np.linalg.norm(deviation(truth), axis=-1), "1",
                  "error_{component}_{case}"),
        "gain": (pairs, size, "1"),
        "phase": (pairs, np.angle(gains), "rad"),
        "gain_longest": (by, own, "1", "gain_{component}_longest_{case}"),
        "leak": (by, leak, "1", "leak_{component}_to_{other}_max_{case}"),
    }  # fmt: skip


def _sensors(sims: list[Simulation]) -> dict[str, tuple[Any, ...]]:
    """What the sensors may differ in: skin, depth and angle of the first film, effects."""
    films = [sim.sensor.elements[0] for sim in sims]
    turned = np.rad2deg([float(film.angle_rad - films[0].angle_rad) for film in films])
    return {
        "skin": ("case", [sim.sensor.skin.words for sim in sims], "1"),
        "depth": ("case", [float(film.depth_m) for film in films], "m"),
        "turned": ("case", turned, "deg"),
    }


def recovered(ds: xarray.Dataset) -> Figure:
    """p and q less their means, recovered from the data of each sensor."""
    looks, truth = method_looks([str(each) for each in ds["case"].values]), ds["traction"].values
    parts = []
    for c, component in enumerate(COMPONENTS):
        curves = [plot.Curve(deviation(truth[c]), "truth", look={"color": TRUTH})]
        for (case, look), values in zip(looks.items(), ds["estimate"].values, strict=True):
            curves.append(plot.Curve(deviation(values[c]), case, look=look))
        up = plot.PanelAxis(f"{component} less its mean", "Pa")
        parts.append(plot.Panel(curves, X, up, ds["x"].values, QUANTITIES[component].capitalize()))
    return plot.panels(parts, height_in=2.6)


def by_wavelength(ds: xarray.Dataset) -> Figure:
    """The size of what is recovered of a sinusoid, over its wavelength."""
    looks = method_looks([str(each) for each in ds["case"].values])
    across, up = (
        plot.PanelAxis("wavelength", "m", is_log=True),
        plot.PanelAxis("gain", limits=(0, None)),
    )
    parts = []
    for (out, into), title in GAINS.items():
        own = ds["gain"].sel(component_out=out, component_in=into).values
        curves = [
            plot.Curve(values, case, look=look)
            for (case, look), values in zip(looks.items(), own, strict=True)
        ]
        parts.append(plot.Panel(curves, across, up, ds["wavelength"].values, title))
    return plot.panels([parts[:2], parts[2:]])
