"""Profile under the finger, from the estimated pressure: the inverse of contact."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from srsinv.jobs.analysis import BAND_90, in_metrics
from srsinv.report.figures import shape as draw
from srsinv.report.outcome import Outcome, Section, Table

from srsinv import config
from srsinv.errors import mapping, refuse
from srsinv.inverse.method import Method
from srsinv.inverse.quality import Quality
from srsinv.inverse.shape import shape_band, shape_under
from srsinv.inverse.solved_contact import SolvedContact, smoothed_truth
from srsinv.progress import stage

_OF_THE_SCENE = ("contact", "recovery", "quality", "warnings")


def run(cfg: config.Config) -> Outcome:
    """For each scene the recovered profile with its band, against the true one in contact.

    Raises `BadInput` for invalid scenes, or scenes without surfaces, and more than one method.
    """
    scenes = mapping("shape_from_traction.scenes", cfg["shape_from_traction"]["scenes"])
    refuse(not scenes, "shape_from_traction.scenes names none: give one or more, each a scene.")
    with config.precision(cfg):
        methods = config.methods(cfg)
        refuse(len(methods) != 1, f"method names {len(methods)}: give one, method=[wiener].")
        method = next(iter(methods.values()))
        key, profiles = config.random_key(cfg), {}
        for name, node in scenes.items():
            with stage(f"recovering the profile: {name}"):
                solved = SolvedContact(config.simulation({**cfg, "scene": node}))
                profiles[name] = _recover(solved, method, key)
        line, depth_m = config.line(cfg), float(config.sensor(cfg).depth_m)
    assumed = (
        f"Half space, E* known; the mean pressure known; {line.kind} line; noise: "
        f"{', '.join(cfg['noise'])}; method: {', '.join(cfg['method'])}. The data come from cells "
        f"{cfg['grid']['refinement']} times finer than those of the estimate. Which cells touch is "
        "taken from the truth, to compare on."
    )

    metrics: dict[str, Any] = {}
    rows = []
    for name, ds in profiles.items():
        metrics |= {f"{key}_{name}": value for key, value in _judge(ds).items()}
        metrics |= {f"{key}_{name}": ds.attrs[key] for key in _OF_THE_SCENE}
        keys = ("height_range_m", "rms_error_m", "rms_unresolved_m", "rms_exact_pressure_m")
        sizes = (f"{1e6 * metrics[f'{key}_{name}']:.3g}" for key in keys)
        rows.append((name, *sizes, f"{metrics[f'coverage_{name}']:.0%}"))
    dataset = xarray.concat(list(profiles.values()), "scene", combine_attrs="drop_conflicts")
    dataset = dataset.assign_coords(scene=("scene", list(profiles), {"units": "1"}))
    table = Table(
        ("surface", "height in contact, range [um]", "rms error [um]",
         "of it, what the sensor does not resolve [um]", "from the exact pressure [um]",
         "90 % band covers"),
        tuple(rows),
        "Within the contact, less the mean over it.",
        tuple(
            f"{name}: {ds.attrs['quality']}. {ds.attrs['warnings']}"
            for name, ds in profiles.items()
            if ds.attrs["quality"] != Quality.GOOD
        ),
    )  # fmt: skip
    return Outcome(
        "The profile inside the contact, from the recovered pressure",
        metrics, dataset, _sections(dataset, depth_m, assumed), table,
    )  # fmt: skip


def _recover(solved: SolvedContact, method: Method, key) -> xarray.Dataset:
    """One scene: p estimated from the signal, and the profile from that."""
    sim, problem = solved.sim, solved.problem(key)
    estimate = method(problem).with_warnings(solved.contact.warnings)
    line, skin, p = sim.line, solved.scene.skin, solved.traction()
    touching = np.asarray(solved.contact.touching)[:: sim.refinement]
    shape, stderr = shape_band(line, skin, estimate, jnp.asarray(touching))
    smoothed = smoothed_truth(p, estimate, problem.forward.is_circular)
    on_surface = np.asarray(solved.surface.height(sim.fine) + solved.contact.gap_m)
    shapes = {
        "shape": np.asarray(shape),
        "shape_resolved": np.asarray(shape_under(line, skin, jnp.asarray(smoothed[0]))),
        "shape_exact_pressure": np.asarray(shape_under(line, skin, jnp.asarray(p[0]))),
        "height": np.asarray(solved.surface.height(line)),
        "skin": on_surface[:: sim.refinement],
    }
    level = shapes["height"][touching].mean()
    shapes["skin"] = shapes["skin"] - level
    for key in ("shape_resolved", "shape_exact_pressure", "height"):
        shapes[key] = shapes[key] - shapes[key][touching].mean()
    lengths = {key: ("x", values, {"units": "m"}) for key, values in shapes.items()}
    pressures = {
        "pressure": p[0],
        "pressure_resolved": smoothed[0],
        "pressure_estimate": np.asarray(estimate.value[0]),
        "pressure_estimate_stderr": np.asarray(estimate.stderr[0]),
    }
    return xarray.Dataset(
        lengths
        | {key: ("x", values, {"units": "Pa"}) for key, values in pressures.items()}
        | {
            "shape_stderr": ("x", np.asarray(stderr), {"units": "m"}),
            "touching": ("x", touching.astype(np.int8), {"units": "1"}),
        },
        {"x": ("x", np.asarray(line.x), {"units": "m"})},
        {"contact": solved.contact.status, "recovery": estimate.status} | in_metrics(estimate),
    )


def _judge(ds: xarray.Dataset) -> dict[str, float]:
    """Errors of the recovered profile in contact."""
    touching = ds["touching"].values == 1
    height = ds["height"].values[touching]
    error = {
        key: ds[key].values[touching] - height
        for key in ("shape", "shape_resolved", "shape_exact_pressure")
    }
    rms = {key: float(np.sqrt(np.mean(e**2))) for key, e in error.items()}
    inside = np.abs(error["shape"]) <= BAND_90 * ds["shape_stderr"].values[touching]
    return {
        "height_range_m": float(np.ptp(height)),
        "rms_error_m": rms["shape"],
        "rms_unresolved_m": rms["shape_resolved"],
        "rms_exact_pressure_m": rms["shape_exact_pressure"],
        "rms_predicted_m": float(np.sqrt(np.mean(ds["shape_stderr"].values[touching] ** 2))),
        "coverage": float(inside.mean()),
        "contact_fraction": float(touching.mean()),
    }


def _sections(ds: xarray.Dataset, depth_m: float, assumed: str) -> tuple[Section, ...]:
    return (
        Section(
            "Recovered profiles",
            ("The skin is displaced by w(k) = 2/(E* |k|) p(k), and where it touches w is the "
             "profile, up to a constant. Long waves of p count most: those that the sensor "
             "passes best, but for the longest, which a rate does not feel.",
             f"At {1e3 * depth_m:g} mm depth the film feels a wave of p as (1 + kz) e^(-kz): "
             "what is much shorter than the depth is lost, and the edges come back rounded."),
            {"shapes": lambda: draw.shapes(ds)},
            {"shapes": "Left: the surface, the skin on it, and the profile from the noisy signal, "
             "which is to be compared where the skin touches (shaded). Right: its error there, "
             "with the method's 90 % band. Dotted: what would come back without noise, so that "
             "what is left is what the depth takes."},
        ),
        Section(
            "Pressure",
            (),
            {"pressures": lambda: draw.pressures(ds)},
            {"pressures": "The pressure that the profiles come from. Its peaks at sharp edges are "
             "lost; the profile loses less, as it takes p over |k|."},
        ),
        Section(
            "What was assumed",
            (assumed,
             "The band is the method's own: noise and the waves that the assumed spectra leave "
             "open. A sharp ridge is no draw from such spectra."),
        ),
    )  # fmt: skip
