"""The comparison on a simulated scene: errors against the truth, over noise levels and draws."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray
from matplotlib.figure import Figure

from .. import plot
from ..errors import is_number, refuse
from ..forward.noise import Noise, SignalToNoise
from ..forward.simulation import Simulation
from ..inverse.estimate import (
    COMPONENTS,
    Estimate,
    deviation,
    overall_error,
)
from ..inverse.features.method import FeatureFit
from ..inverse.line.problem import LineProblem
from ..inverse.quality import Quality
from ..inverse.simulated import noisy_problem
from ..report.data import dataset, key_of, scalars
from ..report.result import Result
from ..report.section import sections
from ._statistics import differences, ranks
from .estimates import Answers, Variables, estimate_coordinates, estimate_variables, score_variables
from .monte_carlo import (
    FEATURE_FIT,
    computed,
    fit_variables,
    parameter_coordinates,
    parameter_draws,
    simulate_and_fit,
)

DRAWN = ("snr", "seed")
BY = ("estimator", *DRAWN)


@dataclass(frozen=True)
class SceneComparison:
    """A simulated scene and the draws of its noise.

    - `snr_dB`: levels of the white noise; `seeds`: of the draws at each level.
    - `noises`: the causes of noise beside the white one.
    - `friction`: mu where the inversions are to know that q = mu p.
    """

    sim: Simulation
    snr_dB: Sequence[float]
    seeds: range
    noises: Mapping[str, Noise]
    friction: float | None

    @property
    def shape(self) -> tuple[int, int]:
        """(level, draw)."""
        return len(self.snr_dB), len(self.seeds)

    def problems(self) -> list[LineProblem]:
        """One for each draw of each level."""
        noisy = [
            self.sim.with_noises((SignalToNoise(level), *self.noises.values()))
            for level in self.snr_dB
        ]
        return [
            noisy_problem(sim, jax.random.key(seed), self.friction)
            for sim in noisy
            for seed in self.seeds
        ]


def levels_and_seeds(given: Mapping[str, Any], seed: int) -> tuple[list[float], range]:
    """The noise levels [dB] and the draws' seeds of `compare` in the configuration, from `seed` on.

    Raises `BadInput` for levels that are not several numbers, each once, and for no draw.
    """
    levels, seeds = given["snr_dB"], given["seeds"]
    numbers = isinstance(levels, list) and all(map(is_number, levels))
    refuse(
        not numbers or not levels or len(set(levels)) < len(levels),
        f"compare.snr_dB is {levels}: give one number or more in dB, each once, as [20,40].",
    )
    refuse(
        not (isinstance(seeds, int) and seeds >= 1),
        f"compare.seeds is {seeds!r}: give a whole number from 1.",
    )
    return levels, range(seed, seed + seeds)


def on_scene(
    scene: SceneComparison,
    methods: Mapping[str, Callable[[LineProblem], Estimate]],
    wrong: FeatureFit | None,
    facts: Mapping[str, Any],
) -> Result:
    """Every method at every noise level and draw, and one fit of a feature that is absent.

    Raises `BadInput` for a uniform scene.
    """
    refuse(
        not np.any(np.ptp(np.asarray(scene.sim.traction(scene.sim.line)), axis=-1)),
        "The scene is uniform, which gives no rate signal: give it a pressure, as scene=strip has.",
    )
    problems = scene.problems()
    truth, cells = np.asarray(scene.sim.traction(scene.sim.line)), problems[0].observed_cells
    answers = simulate_and_fit(problems, methods, scene.shape).mapped(
        lambda estimate: estimate.against(truth, cells)
    )
    own = _of_methods(scene, problems, answers)
    overall = own["error_overall"][1]
    levels = [differences(overall[:, s], list(methods)) for s in range(overall.shape[1])]
    pairs = {
        name: (("snr", "pair"), np.stack([level[name][1] for level in levels]), "1")
        for name in levels[0]
    }
    variables = own | _means(own) | pairs
    variables["reasons_first"] = (("estimator", "snr"), _first_reasons(answers), "1")
    variables |= scalars({"seeds": len(scene.seeds), "cells": scene.sim.line.n})
    if FEATURE_FIT in methods:
        variables |= _of_parameters(answers)
    if wrong is not None:
        alone = simulate_and_fit(problems, {"Absent feature": computed(wrong)}, scene.shape)
        variables |= _of_wrong(own, _of_methods(scene, problems, alone), list(methods))
        facts = {**facts, "wrong_feature": " + ".join(wrong.features)}
    coordinates = estimate_coordinates(problems[0], list(methods)) | {
        **parameter_coordinates(answers),
        "snr": ([float(level) for level in scene.snr_dB], "dB"),
        "seed": (list(scene.seeds), "1"),
    }
    data = dataset(variables, coordinates, mean_unobserved=",".join(COMPONENTS), **facts)
    page = sections("compare_scene", "assumed", absent_feature=absent_feature)
    return Result(_title(data), data, page)


def _title(data: xarray.Dataset) -> str:
    error = data["error_overall"].mean("seed").values
    first, second = np.argsort(data["rank_mean"].values, kind="stable")[:2]
    names, top = data["estimator"].values, int(np.argmax(data["snr"].values))
    best = int(np.sum(error.argmin(axis=0) == first))
    level, ends = data["snr"].values[top], 100 * error[[first, second], top]
    return (
        f"{names[first]} has the smallest error of p and q at {best} of {error.shape[1]} noise "
        f"levels: {ends[0]:.2g} % at {level:g} dB, {names[second]} {ends[1]:.2g} %"
    )


# --- numbers ---------------------------------------------------------------------------------


def _of_methods(
    scene: SceneComparison, problems: Sequence[LineProblem], answers: Answers[Estimate]
) -> Variables:
    """Every answer, and its scores against the truth."""
    sim, shape, cells = scene.sim, scene.shape, problems[0].observed_cells
    unit, samples = sim.sensor.amplifier.unit, ("element", "x")

    def data(get: Callable[[LineProblem], Any]) -> np.ndarray:
        rows = np.asarray([get(problem) for problem in problems])
        return rows.reshape(*shape, *rows.shape[1:])

    own = estimate_variables(answers, DRAWN, (unit, "Pa"), cells) | fit_variables(answers, DRAWN)
    truth = np.asarray(sim.traction(sim.line))
    overall = overall_error(own["estimate"][1], truth, cells)
    signal = data(lambda problem: np.asarray(problem.data + problem.mean_signal))
    return own | {
        "traction": (("component", "x"), truth, "Pa"),
        "signal": ((*DRAWN, *samples), signal, unit),
        "observed": (samples, problems[0].is_observed.astype(np.int8), "1"),
        **score_variables(answers, DRAWN, truth, cells),
        "error_overall": (BY, overall, "1"),
        "rank": (BY, ranks(overall), "1"),
    }


def _means(own: Variables) -> Variables:
    """What the scores are over the draws."""
    error, inside, misfit, rank, quality, converged = (
        own[name][1] for name in ("error", "coverage", "misfit", "rank", "quality", "converged")
    )
    at, of = ("estimator", "snr"), "{component}_{estimator}_{snr}_dB"
    counts = {key_of(each): np.sum(quality == each, axis=2) for each in Quality}
    return {
        "error_mean": ((*at, "component"), error.mean(axis=2), "1", f"error_{of}"),
        "error_spread": ((*at, "component"), _spread(error, 2), "1",
                         "error_{component}_spread_{estimator}_{snr}_dB"),
        "coverage_mean": ((*at, "component"), inside.mean(axis=2), "1", f"coverage_{of}"),
        "misfit_mean": (at, misfit.mean(axis=2), "1", "misfit_{estimator}_{snr}_dB"),
        "rank_mean": ("estimator", rank.mean(axis=(1, 2)), "1", "rank_mean_{estimator}"),
        "rank_mean_at": (at, rank.mean(axis=2), "1", "rank_mean_{estimator}_{snr}_dB"),
        "good": (at, counts.pop("good"), "1"),
        **{name: (at, count, "1", name + "_{estimator}_{snr}_dB")
           for name, count in counts.items()},
        "not_converged": (at, np.sum(1 - converged, axis=2), "1",
                          "not_converged_{estimator}_{snr}_dB"),
    }  # fmt: skip


def _first_reasons(answers: Answers[Estimate]) -> np.ndarray:
    """(method, level): why the first draw that is not good is not, empty where all are."""
    reasons = answers.each(lambda each: " ".join(each.reasons))
    first = np.argmax(reasons != "", axis=-1)
    return np.take_along_axis(reasons, first[..., None], -1)[..., 0]


def _of_parameters(answers: Answers[Estimate]) -> Variables:
    """The fitted features' parameters over the draws of each level."""
    value, stderr = np.moveaxis(parameter_draws(answers), -1, 0)
    at = ("snr", "parameter")
    return {
        "parameter_mean": (at, value.mean(axis=1), "SI"),
        "parameter_spread": (at, _spread(value, 1), "SI"),
        "parameter_stated": (at, np.sqrt(np.mean(stderr**2, axis=1)), "SI"),
    }


def _of_wrong(own: Variables, wrong: Variables, names: list[str]) -> Variables:
    """The fit of a feature that is not in the scene; its evidence beside that of those that are."""
    value, stderr, overall, inside, misfit, evidence = (
        wrong[name][1][0] for name in
        ("estimate", "estimate_stderr", "error_overall", "coverage", "misfit", "log_evidence")
    )  # fmt: skip
    truth = deviation(own["traction"][1])
    stated = np.sqrt(np.mean(stderr**2, axis=(1, 2, 3)) / np.mean(truth**2))
    along = (*DRAWN, "component", "x")
    variables: Variables = {
        "absent_estimate": (along, value, "Pa"),
        "absent_estimate_stderr": (along, stderr, "Pa"),
        "absent_stated": ("snr", stated, "1"),
        "absent_coverage": ("snr", inside[..., 0].mean(axis=1), "1"),
        "absent_misfit": ("snr", misfit.mean(axis=1), "1", "misfit_wrong_feature_{snr}_dB"),
        "absent_error": ("snr", overall.mean(axis=1), "1", "error_overall_wrong_feature_{snr}_dB"),
    }
    if FEATURE_FIT in names:
        gain = own["log_evidence"][1][names.index(FEATURE_FIT)] - evidence
        variables["evidence_gain"] = ("snr", gain.mean(axis=1), "1")
    return variables


def _spread(values: np.ndarray, axis: int) -> np.ndarray:
    """Standard deviation over the draws, NaN of one."""
    if values.shape[axis] == 1:
        return np.full(np.delete(values.shape, axis), np.nan)
    return values.std(axis=axis, ddof=1)


# --- plot ------------------------------------------------------------------------------------


def absent_feature(ds: xarray.Dataset) -> Figure:
    """The fits of the right feature and of the absent one, at the least noise, first draw."""
    own = ds.isel(snr=int(np.argmax(ds["snr"].values)), seed=0)
    both = {
        key: xarray.concat(
            [own[key].sel({"estimator": FEATURE_FIT}, drop=True), own[f"absent_{key}"].rename(key)],
            "estimator",
        )
        for key in ("estimate", "estimate_stderr")
    }
    names = [FEATURE_FIT, f"{ds.attrs['wrong_feature']} (absent)"]
    return plot.estimates(own.drop_dims("estimator").assign(both).assign_coords(estimator=names))
