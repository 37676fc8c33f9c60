"""p and q resolved by two film elements, over their angle; and by one with a wrong mu."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray
from srsinv.jobs.analysis import deviation
from srsinv.report.figures import curves
from srsinv.report.outcome import Outcome, Section, Table

from srsinv import config
from srsinv.errors import refuse
from srsinv.inverse.simulated import noisy_problem
from srsinv.progress import stage
from srsinv.report import figures
from srsinv.report.text import listed

COMPONENTS = ("p", "q")


def run(cfg: config.Config) -> Outcome:
    """Errors of p and q over angles and draws of noise, with their predictions.

    Raises `BadInput` for a shown angle that is not swept, or no draw of noise.
    """
    settings = cfg["two_element"]
    angles, shown, mu = (settings[k] for k in ("angles_deg", "shown_deg", "assumed_friction"))
    refuse(
        not set(shown) <= set(angles),
        f"two_element.shown_deg is {shown}: give some of two_element.angles_deg, {angles}.",
    )
    refuse(settings["seeds"] < 1, f"two_element.seeds is {settings['seeds']}: give at least 1.")
    keys = [jax.random.key(config.seed(cfg) + i) for i in range(settings["seeds"])]
    with config.precision(cfg):
        sim, methods = config.simulation(cfg), config.methods(cfg)
        elements = len(sim.sensor.elements)
        refuse(elements != 2, f"sensor has {elements} elements: give 2, use sensor=two_element.")
        truth = np.asarray(sim.traction(sim.line))
        first = sim.sensor.elements[0].angle_rad
        with stage("sweeping the angle between two elements"):
            swept = [
                _estimates(_turned(sim, first + jnp.deg2rad(angle)), methods, keys)
                for angle in angles
            ]
        alone = eqx.tree_at(lambda s: s.sensor.elements, sim, sim.sensor.elements[:1])
        one = _estimates(alone, methods, keys, mu)

    # (angle, method, seed, component, x) to (method, component, angle, seed)
    error = np.moveaxis(_relative(np.stack([e[0] for e in swept]), truth), (1, 3, 0), (0, 1, 2))
    size = np.sqrt(np.mean(_deviation(truth) ** 2, axis=-1))
    predicted = np.stack([np.sqrt(np.mean(e[1] ** 2, axis=(1, 3))) / size for e in swept])
    of_one = _relative(one[0], truth).mean(axis=1)  # (method, component)
    drawn = [angles.index(angle) for angle in shown]
    dataset = xarray.Dataset(
        {
            "error": (("method", "component", "angle", "seed"), error, {"units": "1"}),
            "error_predicted": (
                ("method", "component", "angle"),
                np.moveaxis(predicted, 0, -1),
                {"units": "1"},
            ),
            "error_one_element": (("method", "component"), of_one, {"units": "1"}),
            "traction": (("component", "x"), truth, {"units": "Pa"}),
            "estimate": (
                ("angle_shown", "method", "component", "x"),
                np.stack([swept[a][0][:, 0] for a in drawn]),
                {"units": "Pa"},
            ),
            "estimate_one_element": (
                ("method", "component", "x"), one[0][:, 0], {"units": "Pa"}
            ),
        },
        {
            "method": ("method", list(methods), {"units": "1"}),
            "component": ("component", list(COMPONENTS), {"units": "1"}),
            "angle": ("angle", angles, {"units": "deg"}),
            "angle_shown": ("angle_shown", shown, {"units": "deg"}),
            "x": ("x", np.asarray(sim.line.x), {"units": "m"}),
        },
    )  # fmt: skip
    assumed = (
        f"Half space; {sim.line.kind} line; noise: {', '.join(cfg['noise'])}; effects on: "
        f"{listed(cfg['effects'])}. The data come from cells {sim.refinement} times finer than "
        "those of the estimate."
    )
    mean = error.mean(axis=-1)
    rows, metrics = [], {}
    for m, name in enumerate(methods):
        for c, component in enumerate(COMPONENTS):
            for a, angle in enumerate(angles):
                metrics[f"error_{component}_{name.lower()}_at_{angle:g}_deg"] = float(mean[m, c, a])
            metrics[f"error_{component}_{name.lower()}_one_element"] = float(of_one[m, c])
            at = {f"{angles[a]:g}": mean[m, c, a] for a in drawn}
            cells = [f"{e:.1%}" for e in (*at.values(), of_one[m, c])]
            rows.append((name, component, *cells))
    heads = [f"error at {angle:g} deg" for angle in shown]
    return Outcome(
        "Two elements tell p from q: error against the angle between them",
        metrics,
        dataset,
        _sections(dataset, mu, assumed),
        Table(("method", "component", *heads, f"one element, mu = {mu:g}"), tuple(rows)),
    )


def _turned(sim, angle_rad):
    """The simulation with its second element at `angle_rad`: same shapes, nothing recompiles."""
    return eqx.tree_at(lambda s: s.sensor.elements[1].angle_rad, sim, angle_rad)


def _estimates(sim, methods, keys, friction=None) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard errors (method, seed, component, x) [Pa]."""
    problems = [noisy_problem(sim, key, friction) for key in keys]
    estimates = [[method(problem) for problem in problems] for method in methods.values()]
    value, stderr = (
        [[getattr(e, k) for e in row] for row in estimates] for k in ("value", "stderr")
    )
    return np.asarray(value), np.asarray(stderr)


def _deviation(values: np.ndarray) -> np.ndarray:
    return deviation(values, np.ones(values.shape[-1], bool))


def _relative(value: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Norm of the deviation's error over that of the truth, over x."""
    wrong = np.linalg.norm(_deviation(value) - _deviation(truth), axis=-1)
    return wrong / np.linalg.norm(_deviation(truth), axis=-1)


def _sections(ds: xarray.Dataset, mu: float, assumed: str) -> tuple[Section, ...]:
    methods = [str(name) for name in ds["method"].values]

    def against_angle():
        titles = {f"Relative error of {name}": c for c, name in enumerate(COMPONENTS)}
        panels = {
            title: {
                name: (100 * ds["error"].values[m, c], 100 * ds["error_predicted"].values[m, c])
                for m, name in enumerate(methods)
            }
            for title, c in titles.items()
        }
        levels = {
            title: {f"one element, mu = {mu:g}": 100 * ds["error_one_element"].values[:, c].min()}
            for title, c in titles.items()
        }
        label = "angle between the two elements [deg]"
        return curves.with_spread(ds["angle"].values, panels, levels, label, "error [%]")

    def recovered():
        panels = [
            figures.Panel(
                title=f"{name}, less its mean, elements {angle:g}° apart",
                ylabel=f"{name} [kPa]",
                lines={"truth": _deviation(ds["traction"].values)[c] / 1e3}
                | {
                    method: _deviation(ds["estimate"].values)[a, m, c] / 1e3
                    for m, method in enumerate(methods)
                },
            )
            for c, name in enumerate(COMPONENTS)
            for a, angle in enumerate(ds["angle_shown"].values)
        ]
        return figures.panels(ds["x"].values, panels)

    return (
        Section(
            "Error against angle",
            (f"The second element is turned away from the first; noise stays at the same "
             f"signal-to-noise ratio. {ds.sizes['seed']} draws of noise for every angle.",),
            {"against_angle": against_angle},
            {"against_angle": "Dots: mean over the draws, with the least and the greatest; dashed: "
             "predicted from each method's standard error. Nearly parallel elements feel nearly "
             "the same, and noise takes over. Dotted: the better method with the first element "
             f"alone and q = {mu:g} p, where the true friction steps: no noise level mends that."},
        ),
        Section(
            "Recovered p and q",
            ("One draw of the noise. The mean is not in a rate signal and is taken out.",),
            {"recovered": recovered},
            {"recovered": "Edges are rounded by the film's depth at any angle; at the smaller "
             "one the noise's ripples grow, and most in q."},
        ),
        Section(
            "What was assumed",
            (assumed,
             "The predicted error is that of each method's Gaussian model, whose traction is "
             "rough everywhere; this scene is flat between its edges, so Wiener's meets less."),
        ),
    )  # fmt: skip
