"""Model error: data of another sensor than the one assumed, over wavelengths."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from srsinv.jobs.analysis import deviation
from srsinv.report.outcome import Outcome, Section, Table

from srsinv import config
from srsinv.errors import refuse
from srsinv.forward.simulation import Simulation
from srsinv.inverse.estimate import COMPONENTS
from srsinv.inverse.line_problem import LineProblem
from srsinv.inverse.simulated import problem_of
from srsinv.parts import merged
from srsinv.progress import stage
from srsinv.report import figures
from srsinv.report.text import listed

ASSUMED = "as assumed"


def run(cfg: config.Config) -> Outcome:
    """The scene, and one sinusoid of p and of q after another, made by each true sensor and
    inverted as the assumed one.

    Raises `BadInput` for methods that are not one, a line that is not periodic, and refusals of the
    configuration's parts.
    """
    settings, methods = cfg["model_error"], config.methods(cfg)
    refuse(len(methods) != 1, f"method names {len(methods)}: give one, method=wiener.")
    line_kind, truths = cfg["grid"]["line"], settings["truths"]
    refuse(line_kind != "periodic", f"grid.line is {line_kind!r}: give periodic, as for sinusoids.")
    (method,) = methods.values()
    with config.precision(cfg):
        assumed, key = config.simulation(cfg), config.random_key(cfg)
        waves = _waves(assumed, settings)
        estimates, gains = {}, {}
        for name, changes in {ASSUMED: {}, **truths}.items():
            with stage(f"inverting as a half space: {name}"):
                true = config.simulation(merged(cfg, changes))
                signal = true.signal()
                mean_p_Pa = jnp.mean(assumed.traction(assumed.line)[0])
                problem = problem_of(assumed, signal, mean_p_Pa, key)
                estimates[name] = np.asarray(method(problem).value)
                gains[name] = _gains(true, problem, method, waves)
        truth = np.asarray(assumed.traction(assumed.line))
        wavelengths = 2 * np.pi / np.asarray(assumed.line.k)[waves]
    dataset = _dataset(assumed, truth, estimates, gains, wavelengths)
    metrics = _metrics(dataset)
    table = _table(dataset)
    words = (
        f"Assumed: half space, depth {1e3 * cfg['sensor']['depth_m']:g} mm, effects "
        f"{listed(cfg['effects'])}; method {', '.join(cfg['method'])}."
    )
    return Outcome(
        "Another sensor than the one that is assumed", metrics, dataset,
        _sections(dataset, table, words, truths), table,
    )  # fmt: skip


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


def _dataset(sim: Simulation, truth, estimates, gains, wavelengths) -> xarray.Dataset:
    cases = list(estimates)
    pairs = np.stack(list(gains.values()))
    return xarray.Dataset(
        {
            "traction": (("component", "x"), truth, {"units": "Pa"}),
            "estimate": (
                ("case", "component", "x"), np.stack(list(estimates.values())), {"units": "Pa"},
            ),
            "gain": (
                ("case", "component_out", "component_in", "wavelength"), np.abs(pairs),
                {"units": "1"},
            ),
            "phase": (
                ("case", "component_out", "component_in", "wavelength"), np.angle(pairs),
                {"units": "rad"},
            ),
        },
        {
            "case": ("case", cases, {"units": "1"}),
            "component": ("component", list(COMPONENTS), {"units": "1"}),
            "component_out": ("component_out", list(COMPONENTS), {"units": "1"}),
            "component_in": ("component_in", list(COMPONENTS), {"units": "1"}),
            "wavelength": ("wavelength", wavelengths, {"units": "m"}),
            "x": ("x", np.asarray(sim.line.x), {"units": "m"}),
        },
    )  # fmt: skip


def _errors(ds: xarray.Dataset) -> dict[str, dict[str, float]]:
    everywhere = np.ones(ds.sizes["x"], bool)
    truth = deviation(ds["traction"].values, everywhere)
    errors = {}
    for i, case in enumerate(ds["case"].values):
        off = deviation(ds["estimate"].values[i], everywhere) - truth
        size = np.linalg.norm(truth, axis=-1)
        errors[str(case)] = dict(zip(COMPONENTS, np.linalg.norm(off, axis=-1) / size, strict=True))
    return errors


def _metrics(ds: xarray.Dataset) -> dict[str, Any]:
    metrics = {}
    for case, errors in _errors(ds).items():
        tag = case.replace(" ", "_")
        metrics |= {f"error_{c}_{tag}": float(error) for c, error in errors.items()}
        own = ds["gain"].sel(case=case)
        for c in COMPONENTS:
            other = COMPONENTS[c == COMPONENTS[0]]
            gain = own.sel(component_out=c, component_in=c)
            leak = own.sel(component_out=other, component_in=c)
            metrics[f"gain_{c}_longest_{tag}"] = float(gain[0])
            metrics[f"leak_{c}_to_{other}_max_{tag}"] = float(leak.max())
    return metrics


def _table(ds: xarray.Dataset) -> Table:
    rows = []
    for case, errors in _errors(ds).items():
        gain = ds["gain"].sel(case=case)
        leak = [
            gain.sel(component_out=a, component_in=b).max() for a, b in (("q", "p"), ("p", "q"))
        ]
        rows.append((case, *(f"{errors[c]:.1%}" for c in COMPONENTS), *(float(v) for v in leak)))
    return Table(
        (
            "data made by",
            "error of p",
            "error of q",
            "p seen as q, at most",
            "q seen as p, at most",
        ),
        tuple(rows),
        "Errors of the scene's p and q less their means; of sinusoids, what one component of unit "
        "size puts into the other.",
    )


def _sections(
    ds: xarray.Dataset, table: Table, assumed: str, truths: Mapping[str, Any]
) -> tuple[Section, ...]:
    wavelength_mm = 1e3 * ds["wavelength"].values

    def recovered():
        parts = []
        for i, c in enumerate(COMPONENTS):
            lines = {"truth": deviation(ds["traction"].values[i], np.ones(ds.sizes["x"], bool))}
            lines |= {
                str(case): ds["estimate"].values[j, i] - ds["estimate"].values[j, i].mean()
                for j, case in enumerate(ds["case"].values)
            }
            scaled = {name: values / 1e3 for name, values in lines.items()}
            title = {"p": "Pressure less its mean", "q": "Shear less its mean"}[c]
            parts.append(figures.Panel(title=title, ylabel=f"{c} [kPa]", lines=scaled))
        return figures.panels(ds["x"].values, parts)

    def by_wavelength():
        shown = (
            ("p", "p", "p recovered of p"),
            ("q", "q", "q recovered of q"),
            ("q", "p", "q seen where there is p"),
            ("p", "q", "p seen where there is q"),
        )
        panels = {
            title: {
                str(case): ds["gain"].sel(case=case, component_out=out, component_in=into).values
                for case in ds["case"].values
            }
            for out, into, title in shown
        }
        return figures.stacked(wavelength_mm, panels, "wavelength [mm]", "gain [1]")

    return (
        Section(
            "The scene, recovered", ("All is inverted as the same ideal half space.",),
            {"recovered": recovered},
            {"recovered": "What is wrong with the sensor shows as p and q that look as sure as "
             "ever: no band of the estimate knows of it."},
            tables=(table,),
        ),
        Section(
            "Wavelength by wavelength",
            ("One sinusoid after another, without noise, of the scene's signal power: the size of "
             "what is recovered over what is there. At short wavelengths the filter gives up "
             "whatever the sensor.",),
            {"by_wavelength": by_wavelength},
            {"by_wavelength": "1 is right in the upper two panels, 0 in the lower two."},
        ),
        Section(
            "What was assumed",
            (assumed,),
            tables=(
                Table(("data made by", "differs in"),
                      tuple((name, str(changes)) for name, changes in truths.items())),
            ),
        ),
    )  # fmt: skip
