"""Efficiency (RMSE over the Cramer-Rao bound) and interval coverage of the feature fit.

For each feature its truth is simulated on finer cells, and every draw of the noise is fitted. The
errors are compared with the Cramer-Rao bound at the truth and with the fit's own standard errors. A
scene with a surface is a feature of height and friction, else features of traction are fitted.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
import xarray
from jaxtyping import Float

from .. import config
from ..errors import echo, is_number, number, refuse, whole
from ..forward.feature import Feature
from ..inverse.features.fit import FeatureFitter
from ..inverse.features.model import scan_extent
from ..inverse.features.synthetic import (
    FittedDraw,
    KnownFeature,
    KnownLoad,
    KnownShape,
    SampledScan,
    SceneShape,
    SyntheticScan,
)
from ..inverse.gridding.cells import Window
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import unit_of, without_unit
from . import _facts
from ._features import of_feature, sample_rate
from ._statistics import coverage
from .estimates import Variables
from .monte_carlo import simulate_and_fit

DRAWS, DRAWS_OF_A_SURFACE, LEAST_DRAWS = 400, 200, 8
LEVELS = (0.68, 0.90, 0.95)


def run(cfg: config.Config) -> Result:
    """The job: simulate, fit every draw, compare."""
    with config.precision(cfg):
        given, scene = cfg["coverage"], config.part(cfg, "scene")
        on_surface = "surfaces" in scene
        draws = given["draws"]
        if draws is None:
            draws = DRAWS_OF_A_SURFACE if on_surface else DRAWS
        else:
            wanted = f"a whole number from {LEAST_DRAWS}"
            draws = whole("coverage.draws", draws, wanted, least=LEAST_DRAWS)
        rate_hz = sample_rate("coverage", given)
        parts = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
        sampled = SampledScan("coverage", rate_hz, *parts)
        key, solver = config.random_key(cfg), config.solver(cfg)
        if on_surface:
            names, features = list(scene["surfaces"] or ()), config.surface_features(cfg)
            shape = SceneShape.of(config.scene(cfg), names, features, _angle(given["angle_deg"]))
            cases = [KnownShape.in_window(shape, sampled, _window(given["window_m"]), solver)]
            keys = [key]
        else:
            features = config.features(cfg)
            refuse(not features, "No feature is named: give feature=[strip_load] or several.")
            on = SyntheticScan.along(config.line(cfg), sampled)
            truths = {name: _truth(given["truth"], on, name, f) for name, f in features.items()}
            fitter = FeatureFitter.along(on.sensor, on.motion, solver)
            cases = [KnownLoad(on, name, truths[name], f, fitter) for name, f in features.items()]
            keys = list(jax.random.split(key, len(cases)))
        fits = simulate_and_fit(
            list(zip(cases, keys, strict=True)),
            {f"Fit of {draws} draws": lambda case: case[0].fit_draws(case[1], draws)},
        )
        (fitted,) = fits.of.values()
        facts = {
            **_facts.of_scan(cases[0].on, cfg["noise"]),
            "precision_and_seed": f"{cfg['precision']}, {cfg['seed']}",
            "fit_cells": cases[0].fitter.model.line.n,
            "is_surface": int(on_surface),
        }
        data = _dataset(cases, fitted, facts)
    held = 100 * data["coverage"].sel(level=0.9)
    title = (
        f"Feature fit over {data.sizes['draw']} draws: error at most "
        f"{float(data['rmse_over_crb'].max()):.3g} times the Cramér–Rao bound, 90 % intervals hold "
        f"the truth in {float(held.min()):.3g} to {float(held.max()):.3g} %"
    )
    return Result(title, data, sections("coverage", "assumed_scan"))


# --- settings --------------------------------------------------------------------------------


def _window(given: Any) -> Window:
    pair = isinstance(given, list | tuple) and len(given) == 2 and all(map(is_number, given))
    refuse(
        not pair or not given[0] < given[1],
        f"coverage.window_m is {echo(given)}: give [start, end] in metres.",
    )
    return Window(float(given[0]), float(given[1]))


def _angle(given: Any) -> float | None:
    wanted = "an angle above 0 and below 90 degrees, or null for a known angle of 0"
    key = "coverage.angle_deg"
    return None if given is None else float(number(key, given, wanted, above=0, below=90))


def _truth(given: Any, on: SyntheticScan, name: str, feature: Feature) -> Mapping[str, float]:
    """The simulated truth of a feature, checked against the fit's search ranges."""
    truth = of_feature("coverage.truth", given, name, feature)
    ranges = feature.ranges(scan_extent(on.sensor, on.motion))
    for part, value in truth.items():
        key = f"coverage.truth.{name}.{part}"
        number(key, value)
        low, high = ranges.get(part, (-np.inf, np.inf))
        refuse(
            not low < value < high,
            f"{key} is {value}: give a value within the search range, from {low:.4g} to "
            f"{high:.4g}.",
        )
    amplitude = feature.amplitude
    refuse(
        truth[amplitude] == 0,
        f"coverage.truth.{name}.{amplitude} is 0, which leaves nothing to fit: give another value.",
    )
    refuse(
        feature.friction is not None and feature.friction != truth["friction"],
        f"feature.{name}.friction is {feature.friction}, but "
        f"coverage.truth.{name}.friction is {truth['friction']}: give both the same "
        f"value, or feature.{name}.friction=null.",
    )
    return truth


# --- numbers ---------------------------------------------------------------------------------


def _dataset(
    cases: Sequence[KnownFeature], fitted: Sequence[Sequence[FittedDraw]], facts: Mapping[str, Any]
) -> xarray.Dataset:
    bounds = [case.bounds() for case in cases]
    rows = [(c, part) for c, bound in enumerate(bounds) for part in bound]
    names, parameters = [cases[c].name for c, _ in rows], [part for _, part in rows]
    truth = np.array([float(cases[c].truth[part]) for c, part in rows])
    bound = np.array([bounds[c][part] for c, part in rows])
    drawn = np.array([[draw.parameters[part] for draw in fitted[c]] for c, part in rows])
    value, stderr = drawn[..., 0], drawn[..., 1]
    wrong = errors(parameters, value, truth)
    held = np.stack([coverage(wrong / stderr, level) for level in LEVELS], axis=-1)
    rmse, each = np.sqrt(np.mean(wrong**2, axis=-1)), "quantity"
    converged = [sum(draw.is_converged for draw in draws) for draws in fitted]
    variables: Variables = {
        "normalised_error": ((each, "draw"), wrong / stderr, "1"),
        "truth": (each, truth, "SI"),
        "bias": (each, wrong.mean(axis=-1), "SI", "{feature!s}_bias_{parameter!s}"),
        "rmse": (each, rmse, "SI", "{feature!s}_rmse_{parameter!s}"),
        "bound": (each, bound, "SI", "{feature!s}_bound_{parameter!s}"),
        "rmse_over_crb": (each, rmse / bound, "1", "{quantity!s}_rmse_over_crb"),
        "stderr_over_crb": (each, stderr.mean(axis=-1) / bound, "1",
                            "{quantity!s}_stderr_over_crb"),
        "coverage": ((each, "level"), held, "1", "{quantity!s}_coverage_{percent}"),
        "converged": ("case", converged, "1", "{case!s}_converged"),
        "snr": ("case", [case.snr_dB for case in cases], "dB", "{case!s}_snr_dB"),
        **scalars({"draws": value.shape[1]}),
    }  # fmt: skip
    for i, (name, part) in enumerate(zip(names, parameters, strict=True)):
        own = f"{name}_{part}"
        unit = unit_of(own)
        variables |= {
            own: ("draw", value[i], unit),
            f"{own}_stderr": ("draw", stderr[i], unit),
            f"{own}_truth": ((), truth[i], unit),
            f"{own}_bound": ((), bound[i], unit),
        }
    return dataset(variables, _coordinates(names, parameters, cases), **facts)


def _coordinates(
    names: list[str], parameters: list[str], cases: Sequence[KnownFeature]
) -> Variables:
    each, words = "quantity", [without_unit(part) for part in parameters]
    labels = [f"{name}: {part}".replace("_", " ") for name, part in zip(names, words, strict=True)]
    return {
        each: ([f"{a}_{b}" for a, b in zip(names, parameters, strict=True)], "1"),
        "feature": (each, names, "1"),
        "parameter": (each, parameters, "1"),
        "unit": (each, [unit_of(part) for part in parameters], "1"),
        "words": (each, words, "1"),
        "label": (each, labels, "1"),
        "level": (list(LEVELS), "1"),
        "percent": ("level", [round(100 * level) for level in LEVELS], "1"),
        "case": ([case.name for case in cases], "1"),
    }


def errors(
    parameters: Sequence[str],
    value: Float[np.ndarray, "quantity draw"],
    truth: Float[np.ndarray, " quantity"],
) -> Float[np.ndarray, "quantity draw"]:
    """Deviations from the truth, of phases within half a turn."""
    wrong = value - truth[:, None]
    is_phase = np.array([part.endswith("_rad") for part in parameters])[:, None]
    return np.where(is_phase, np.angle(np.exp(1j * wrong)), wrong)
