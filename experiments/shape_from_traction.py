"""Profile under the finger, from the estimated pressure: the inverse of contact."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import mapping, refuse
from srsinv.inverse.estimate import BAND_90, Estimate
from srsinv.inverse.method import Method
from srsinv.inverse.shape import shape_band, shape_under
from srsinv.inverse.solved_contact import SolvedContact, smoothed_truth
from srsinv.progress import stage
from srsinv.report.plot.style import SHADE, TRUTH, stretches
from srsinv.report.result import Result, dataset
from srsinv.report.section import sections
from srsinv.report.text import quantity

LEAST_M, AROUND = 3e-3, 3.0  # drawn on each side: at least, and in half-widths of the contact
SURFACE, DOTTED = {"color": TRUTH}, {"color": TRUTH, "linestyle": ":", "linewidth": 1.8}
RECOVERED, SKIN = {"color": "#009e73"}, {"color": "#d55e00", "linestyle": "--"}
Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result:
    """For each scene the recovered profile with its band, against the true one in contact.

    Raises `BadInput` for invalid scenes, or scenes without surfaces, and more than one method.
    """
    scenes = mapping("shape_from_traction.scenes", cfg["shape_from_traction"]["scenes"])
    refuse(not scenes, "shape_from_traction.scenes names none: give one or more, each a scene.")
    recovered, estimates, contacts = {}, {}, []
    with config.precision(cfg):
        methods = config.methods(cfg)
        refuse(len(methods) != 1, f"method names {len(methods)}: give one, method=[wiener].")
        (method,) = methods.values()
        for name, node in scenes.items():
            with stage(f"recovering the profile: {name}"):
                solved = SolvedContact(config.simulation({**cfg, "scene": node}))
                recovered[name], estimates[name] = _recover(solved, method, config.random_key(cfg))
                contacts.append(str(solved.contact.status))
        line, depth_m = config.line(cfg), float(config.sensor(cfg).depth_m)

    variables = {
        name: (("scene", *dims), np.stack([each[name][1] for each in recovered.values()]), *rest)
        for name, (dims, _, *rest) in next(iter(recovered.values())).items()
    }
    data = dataset(
        variables | _answers(contacts, list(estimates.values())),
        {"scene": (list(scenes), "1"), "x": (np.asarray(line.x), "m")},
        depth_m=depth_m,
        line=line.kind,
        noise=", ".join(cfg["noise"]),
        method=", ".join(cfg["method"]),
        refinement=int(cfg["grid"]["refinement"]),
    )  # fmt: skip
    rms = zip(scenes, data["rms_error"].values, strict=True)
    parts = [f"{1e6 * error:.2g} µm rms ({name.replace('_', ' ')})" for name, error in rms]
    title = f"Profiles within the contact, from the pressure: right to {', '.join(parts)}"
    return Result(title, data, sections(__file__, shapes=shapes, pressures=pressures))


def _answers(contacts: list[str], estimates: list[Estimate]) -> Variables:
    """How contact and estimate of each scene ended, and the quality of the estimate."""
    words = {
        "contact": contacts,
        "recovery": [str(each.status) for each in estimates],
        "quality": [str(each.quality) for each in estimates],
        "warnings": [" ".join(each.warnings) or "none" for each in estimates],
    }
    reasons = [" ".join(each.reasons) for each in estimates]
    return {"reasons": ("scene", reasons, "1")} | {
        name: ("scene", each, "1", f"{name}_{{scene}}") for name, each in words.items()
    }


def _recover(solved: SolvedContact, method: Method, key) -> tuple[Variables, Estimate]:
    """One scene: p estimated from the signal, the profile from that, and its errors in contact."""
    sim, problem = solved.sim, solved.problem(key)
    estimate = method(problem).with_warnings(solved.contact.warnings)
    line, skin, p = sim.line, solved.scene.skin, solved.traction()
    touching = np.asarray(solved.contact.touching)[:: sim.refinement]
    shape, stderr = (np.asarray(v) for v in shape_band(line, skin, estimate, jnp.asarray(touching)))
    smoothed = smoothed_truth(p, estimate, problem.forward.is_circular)
    height = np.asarray(solved.surface.height(line))
    on_surface = np.asarray(solved.surface.height(sim.fine) + solved.contact.gap_m)
    # Heights are less their mean over the contact; the skin's is the surface's there.
    resolved, exact = (
        _less_mean(shape_under(line, skin, jnp.asarray(each)), touching)
        for each in (smoothed[0], p[0])
    )
    lengths = {
        "shape": shape,
        "shape_resolved": resolved,
        "shape_exact_pressure": exact,
        "height": _less_mean(height, touching),
        "skin": on_surface[:: sim.refinement] - height[touching].mean(),
        "shape_stderr": stderr,
    }
    pressures = {
        "pressure": p[0],
        "pressure_resolved": smoothed[0],
        "pressure_estimate": np.asarray(estimate.value[0]),
        "pressure_estimate_stderr": np.asarray(estimate.stderr[0]),
    }
    variables: Variables = {name: (("x",), each, "m") for name, each in lengths.items()}
    variables |= {name: (("x",), each, "Pa") for name, each in pressures.items()}
    variables["touching"] = (("x",), touching.astype(np.int8), "1")
    return variables | _errors(lengths, touching), estimate


def _less_mean(values, touching: np.ndarray) -> np.ndarray:
    values = np.asarray(values)
    return values - values[touching].mean()


def _errors(lengths: Mapping[str, np.ndarray], touching: np.ndarray) -> Variables:
    """Errors of the recovered profile in contact."""
    inside = {name: values[touching] for name, values in lengths.items()}
    height, stderr = inside["height"], inside["shape_stderr"]

    def rms(values) -> float:
        return float(np.sqrt(np.mean(values**2)))

    covered = np.abs(inside["shape"] - height) <= BAND_90 * stderr
    sizes = {
        "height_range": (np.ptp(height), "m"),
        "rms_error": (rms(inside["shape"] - height), "m"),
        "rms_unresolved": (rms(inside["shape_resolved"] - height), "m"),
        "rms_exact_pressure": (rms(inside["shape_exact_pressure"] - height), "m"),
        "rms_predicted": (rms(stderr), "m"),
        "coverage": (covered.mean(), "1"),
        "contact_fraction": (touching.mean(), "1"),
    }
    return {
        name: ((), value, unit, f"{name}_m_{{scene}}" if unit == "m" else f"{name}_{{scene}}")
        for name, (value, unit) in sizes.items()
    }


def shapes(ds: xarray.Dataset) -> Figure:
    """For each scene surface, skin and the profile from the signal; beside it the error in the
    contact with its band."""
    rows = []
    for name in ds["scene"].values:
        own = ds.sel(scene=name)
        x, touching = own["x"].values, own["touching"].values == 1
        across, contact, near = _about_the_contact(x, touching)
        height, half = own["height"].values, BAND_90 * own["shape_stderr"].values
        heights = [
            plot.Curve(own["skin"].values, "skin", look=SKIN, in_view=near),
            plot.Curve(height, "surface", look=SURFACE, in_view=False),
            plot.Curve(own["shape"].values, "recovered", look=RECOVERED, in_view=near),
            plot.Curve(own["shape_resolved"].values, "without noise", look=DOTTED, in_view=near),
        ]
        error, missed = (
            np.where(touching, own[key].values - height, np.nan)
            for key in ("shape", "shape_resolved")
        )
        band = np.where(touching, -half, np.nan), np.where(touching, half, np.nan)
        errors = [
            plot.Curve(0 * error, "", band=band, look={**RECOVERED, "linewidth": 0.0},
                       band_label="90 % band"),
            plot.Curve(error, "recovered", look=RECOVERED),
            plot.Curve(missed, "without noise", look=DOTTED),
        ]  # fmt: skip
        title = str(name).replace("_", " ").capitalize()
        height_axis, error_axis = (plot.PanelAxis(each, "m") for each in ("height", "error"))
        rows.append([
            plot.Panel(heights, across, height_axis, x, title, contact),
            plot.Panel(errors, across, error_axis, x, "Error in contact", contact),
        ])  # fmt: skip
    return plot.panels(rows, widths=(3, 2), height_in=2.6)


def pressures(ds: xarray.Dataset) -> Figure:
    """For each scene the true and the recovered deviation of p from its mean."""
    rows = []
    for name in ds["scene"].values:
        own = ds.sel(scene=name)
        x, touching = own["x"].values, own["touching"].values == 1
        across, contact, near = _about_the_contact(x, touching)
        p, resolved, value = (
            own[key].values - own[key].values.mean()
            for key in ("pressure", "pressure_resolved", "pressure_estimate")
        )
        half = BAND_90 * own["pressure_estimate_stderr"].values
        is_cut = p.max() > 1.5 * (value + half)[near].max()
        remark = f"; the truth reaches {quantity(p.max(), 'Pa', digits=2)}" if is_cut else ""
        curves = [
            plot.Curve(p, "truth", look={**SURFACE, "linewidth": 0.9}, in_view=near & (not is_cut)),
            plot.Curve(value, "p", band=(value - half, value + half), band_label="90 % band",
                       in_view=near),
            plot.Curve(resolved, "truth, as resolved", look=DOTTED, in_view=near),
        ]  # fmt: skip
        title = str(name).replace("_", " ").capitalize() + remark
        rows.append(plot.Panel(curves, across, plot.PanelAxis("p - mean", "Pa"), x, title, contact))
    return plot.panels(rows, height_in=2.2)


def _about_the_contact(x: np.ndarray, touching: np.ndarray):
    """The axis about the contact in the middle, marks of all contact, and a mask of what is
    drawn."""
    spans = stretches(x, touching)
    inner = [max(abs(left), abs(right)) for left, right in spans if left < 0 < right]
    reach = min(max(LEAST_M, AROUND * max(inner, default=0.0)), float(x[-1]))
    look = {"color": SHADE, "alpha": 0.6, "zorder": 0}
    marks = [
        plot.Mark(max(left, -reach), "contact", until=min(right, reach), look=look)
        for left, right in spans if left < reach and right > -reach
    ]  # fmt: skip
    return plot.PanelAxis("position x", "m", limits=(-reach, reach)), marks, np.abs(x) <= reach
