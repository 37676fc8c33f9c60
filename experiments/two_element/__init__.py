"""p and q recovered by two film elements over their angle, and by one with a wrong mu."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray

from srsinv import config
from srsinv.errors import refuse
from srsinv.forward.simulation import Simulation
from srsinv.inverse.estimate import COMPONENTS, deviation, relative_error
from srsinv.inverse.simulated import noisy_problem
from srsinv.progress import stage
from srsinv.report.data import dataset
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, significant

from .figures import against_angle, recovered


def run(cfg: config.Config) -> Result:
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
        sim.sensor.require_elements(2)
        truth = np.asarray(sim.traction(sim.line))
        with stage("sweeping the angle between two elements"):
            turned = [_turned(sim, angle) for angle in angles]
            swept = [_estimates(each, methods, keys) for each in turned]
        alone = eqx.tree_at(lambda s: s.sensor.elements, sim, sim.sensor.elements[:1])
        one = _estimates(alone, methods, keys, mu)[0]

    data = dataset(
        {
            **_errors(swept, one, truth),
            "traction": (("component", "x"), truth, "Pa"),
            "estimate": (("angle_shown", "estimator", "component", "x"),
                         np.stack([swept[angles.index(each)][0][:, 0] for each in shown]), "Pa"),
            "estimate_one_element": (("estimator", "component", "x"), one[:, 0], "Pa"),
        },
        {"estimator": (list(methods), "1"), "component": (list(COMPONENTS), "1"),
         "angle": (angles, "deg"), "angle_shown": (shown, "deg"),
         "x": (np.asarray(sim.line.x), "m")},
        assumed_friction=mu, line=sim.line.kind, refinement=sim.refinement,
        noise=", ".join(cfg["noise"]), effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    own = sections(__file__, against_angle=against_angle, recovered=recovered)
    return Result(_title(data), data, own)


def _title(data: xarray.Dataset) -> str:
    """The best method's errors, of the first angle shown."""
    angle = float(data["angle_shown"][0])
    two, one = (
        " and ".join(f"{significant(100 * each, 2)} %" for each in errors.min("estimator").values)
        for errors in (data["error_mean"].sel(angle=angle), data["error_one_element"])
    )
    return f"Two elements {angle:g}° apart recover p and q within {two}, one element within {one}"


def _turned(sim: Simulation, angle_deg: float) -> Simulation:
    """The simulation with its second element so far from the first: same shapes, nothing
    recompiles."""
    angle_rad = sim.sensor.elements[0].angle_rad + jnp.deg2rad(angle_deg)
    return eqx.tree_at(lambda s: s.sensor.elements[1].angle_rad, sim, angle_rad)


def _estimates(sim, methods, keys, friction=None) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard errors (method, seed, component, x) [Pa]."""
    problems = [noisy_problem(sim, key, friction) for key in keys]
    estimates = [[method(problem) for problem in problems] for method in methods.values()]
    both = np.array([[(each.value, each.stderr) for each in row] for row in estimates])
    return both[:, :, 0], both[:, :, 1]


def _errors(
    swept: Sequence[tuple[np.ndarray, np.ndarray]], one: np.ndarray, truth: np.ndarray
) -> dict[str, tuple[Any, ...]]:
    """Relative errors of the deviations from the mean over x, and their predictions from the
    standard errors; of one element the mean over the draws."""
    by, size = ("estimator", "component", "angle"), np.sqrt(np.mean(deviation(truth) ** 2, axis=-1))
    # (angle, method, seed, component) to (method, component, angle, seed)
    error = relative_error(np.stack([value for value, _ in swept]), truth)
    error = np.moveaxis(error, (1, 3, 0), (0, 1, 2))
    predicted = [np.sqrt(np.mean(stderr**2, axis=(1, 3))) / size for _, stderr in swept]
    return {
        "error": ((*by, "seed"), error, "1"),
        "error_mean": (by, error.mean(-1), "1", "error_{component}_{estimator}_at_{angle}_deg"),
        "error_predicted": (by, np.stack(predicted, axis=-1), "1"),
        "error_one_element": (by[:2], relative_error(one, truth).mean(axis=1), "1",
                              "error_{component}_{estimator}_one_element"),
    }  # fmt: skip
