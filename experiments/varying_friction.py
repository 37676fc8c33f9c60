"""Friction that falls with pressure, under an inversion and a fit that take it as constant."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from jaxtyping import Float
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import BadInput, numbers, refuse
from srsinv.forward.simulation import response
from srsinv.forward.surface import Ridge
from srsinv.forward.varying_friction import MOST_EXPONENT, RubberFriction
from srsinv.inverse.estimate import Estimate, relative_error
from srsinv.inverse.simulated import problem_of
from srsinv.inverse.solved_contact import SolvedContact, cell_averages
from srsinv.progress import steps
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import significant

CONSTANT = 0.0  # the exponent of Coulomb's friction
FITTED = {"height_m": "m", "width_m": "m", "base_friction": "1"}
TENTH = 0.9  # of the friction at the nominal pressure, at the highest one


def run(cfg: config.Config) -> Result:
    """Traction and signal of a ridge with each exponent of friction, and what Wiener's filter with
    known friction and the fit of a ridge make of them.

    Raises `BadInput` for a scene that is not one ridge, methods that are not one, and exponents out
    of range.
    """
    wanted = f"exponents of the pressure, from 0 to {MOST_EXPONENT:g}"
    key = "varying_friction.exponents"
    exponents = numbers(key, cfg["varying_friction"]["exponents"], wanted, least=0,
                        most=MOST_EXPONENT)  # fmt: skip
    methods, features = config.methods(cfg), config.surface_features(cfg)
    refuse(len(methods) != 1, f"method names {len(methods)}: give one, method=wiener.")
    (method,) = methods.values()
    with config.precision(cfg):
        solved, key = SolvedContact(config.simulation(cfg)), config.random_key(cfg)
        ridge = solved.surface.only(Ridge)
        if ridge is None:
            raise BadInput("The scene is not one ridge: use scene=ridge.")
        of_tenth = _exponent_of(solved, TENTH)
        cases = sorted({CONSTANT, *exponents, of_tenth})
        tractions, signals, estimates, fits = [], [], [], []
        with steps("exponents", [(f"{each:.3g}", each) for each in cases]) as each_case:
            for _, exponent in each_case:
                fine = _traction(solved, exponent)
                sim = solved.sim
                signal = response(sim.sensor.output(sim.scan), sim.fine, fine, sim.refinement)
                mu, mean_p = float(solved.surface.base_friction), jnp.mean(fine[0])
                known = problem_of(sim, signal, mean_p, key, mu)
                tractions.append(cell_averages(fine, sim.refinement))
                signals.append(np.asarray(signal))
                estimates.append(np.asarray(method(known).value))
                fits.append(solved.fit(features, problem_of(sim, signal, mean_p, key)))
    data = _dataset(solved, np.array(cases), np.stack(tractions), np.stack(signals),
                    np.stack(estimates), fits, of_tenth)  # fmt: skip
    return Result(_title(data), data, sections(__file__, traction=draw_traction))


def _exponent_of(solved: SolvedContact, factor: float) -> float:
    """The exponent with which friction at the highest pressure is this factor of the nominal."""
    highest = float(solved.contact.pressure_Pa.max()) / float(solved.scene.nominal_pressure_Pa)
    return float(np.log(1 / factor) / np.log(highest))


def _traction(solved: SolvedContact, exponent: float) -> Any:
    """p and q on the finer line (2, n); on the open one less the background."""
    sim, scene = solved.sim, RubberFriction(solved.scene, exponent)
    whole = scene.traction(sim.fine, sim.scan.direction, solved.contact.pressure_Pa)
    level = jnp.where(jnp.any(sim.background), scene.background(sim.scan.direction), 0.0)
    return whole - level[:, None]


def _change(values: Float[np.ndarray, "case *any"]) -> Float[np.ndarray, " case"]:
    """Rms change from the first case, over its rms without the mean."""
    varying = values[0] - values[0].mean(axis=-1, keepdims=True)
    axes = tuple(range(1, values.ndim))
    return np.sqrt(np.sum((values - values[0]) ** 2, axis=axes)) / np.linalg.norm(varying)


def _dataset(solved: SolvedContact, cases, tractions, signals, estimates, fits: list[Estimate],
             of_tenth: float) -> xarray.Dataset:  # fmt: skip
    """Tractions and estimates (case, component, x), signals (case, element, x) and fits."""
    sim, scene, ridge = solved.sim, solved.scene, solved.surface.only(Ridge)
    highest = float(solved.contact.pressure_Pa.max()) / float(scene.nominal_pressure_Pa)
    end = "_exponent_{exponent}"
    variables: dict[str, tuple[Any, ...]] = {
        "traction": (("exponent", "component", "x"), tractions, "Pa"),
        "signal": (("exponent", "element", "x"), signals, sim.sensor.amplifier.unit),
        "friction_at_peak": ("exponent", highest**-cases, "1", f"friction_at_peak{end}"),
        "change_p": ("exponent", _change(tractions[:, 0]), "1", f"change_p{end}"),
        "change_q": ("exponent", _change(tractions[:, 1]), "1", f"change_q{end}"),
        "signal_change": ("exponent", _change(signals), "1", f"signal_change{end}"),
        "error_p": (
            "exponent",
            [relative_error(own[None, 0], true[None, 0])[0]
             for own, true in zip(estimates, tractions, strict=True)],
            "1", f"error_p{end}",
        ),
        "chi2_per_freedom": ("exponent", [each.chi2_per_freedom for each in fits], "1"),
    }  # fmt: skip
    truth = {name: float(getattr(ridge, name)) for name in ("height_m", "width_m")}
    truth["base_friction"] = float(scene.surface.base_friction)
    for name, unit in FITTED.items():
        values, errors = zip(*(each.parameters[name] for each in fits), strict=True)
        spread = np.array(errors, float)
        variables[name] = "exponent", np.array(values, float), unit, name + end
        variables[f"{name}_stderr"] = "exponent", spread, unit, f"{name}_stderr{end}"
        variables[f"{name}_off"] = "exponent", np.array(values, float) / truth[name] - 1, "1"
    variables |= scalars({"exponent_of_tenth": of_tenth, "peak_over_nominal": highest})
    return dataset(
        variables,
        {"exponent": (np.round(cases, 4), "1"), "component": (["p", "q"], "1"),
         "element": (sim.sensor.element_names, "1"), "x": (np.asarray(sim.line.x), "m")},
        nominal_pressure_Pa=float(scene.nominal_pressure_Pa), line=sim.line.kind,
        friction=truth["base_friction"], refinement=sim.refinement,
        height_m=truth["height_m"], width_m=truth["width_m"],
    )  # fmt: skip


def _title(data: xarray.Dataset) -> str:
    tenth = data.sel(exponent=round(float(data["exponent_of_tenth"]), 4))
    height, friction = (100 * float(tenth[f"{name}_off"]) for name in ("height_m", "base_friction"))
    return (
        f"Friction 10 % lower at the highest pressure moves a ridge's fitted height by "
        f"{significant(height, 2)} % and its friction by {significant(friction, 2)} %"
    )


def draw_traction(ds: xarray.Dataset) -> Figure:
    """Shear about the ridge, with each exponent."""
    within = (-3 * ds.attrs["width_m"], 3 * ds.attrs["width_m"])
    lines = {f"exponent {float(each):.2g}": ds["traction"].sel(component="q", exponent=each)
             for each in ds["exponent"].values}  # fmt: skip
    return plot.panels([plot.panel(lines, quantity="shear q", along="position", within=within)])
