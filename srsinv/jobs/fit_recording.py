"""Fit of features to a recording: position, width, height or amplitude, and friction.

Features of traction, or features of a surface that act through contact.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray

from .. import config, examples
from ..errors import refuse
from ..inverse.diagnostics import direction_in_words
from ..inverse.estimate import COMPONENTS
from ..inverse.features.estimate import FeatureEstimate, contact_variables, probabilities
from ..inverse.features.method import FeatureFit
from ..inverse.features.window import FittedStretch, stretch_of
from ..inverse.nonlinear import PosteriorSamples, Solver, sample
from ..inverse.problem import Problem
from ..inverse.quality import Quality
from ..progress import stage
from ..recording import Recording
from ..recording.even import check_volts
from ..report.answers import answer_of, reported_parameters
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import quantity_with_error, unit_of
from . import _facts
from ._budget import budget_coordinates, budget_variables
from ._fit_settings import settings_of, surface_fit, traction_fit
from ._hum_free import hum_free_variables

EXAMPLE = examples.path("strip_two_element")
STRETCH = "stretch_start_m", "stretch_end_m"
# Parameters that a page's title names, and how.
IN_TITLE = {
    "height_m": "{} high",
    "width_m": "{} wide",
    "radius_m": "of radius {}",
    "angle_rad": "turned by {}",
    "friction": "friction {}",
    "base_friction": "friction {}",
}


@dataclass(frozen=True)
class FittedRecording:
    """The stretch of a recording that its fit goes by, every candidate that was fitted to it with
    the time [s] that it took, and the best one."""

    recording: Recording
    stretch: FittedStretch
    candidates: list[FeatureEstimate]
    times_s: list[float]
    best: FeatureEstimate

    @property
    def problem(self) -> Problem:
        """The problem of the stretch."""
        return self.stretch.problem


def run(cfg: config.Config) -> Result:
    """The job: fit every candidate, rank them, report the most probable one."""
    with config.precision(cfg):
        settings = settings_of(config.part(cfg, "fit"))
        surfaces = config.surface_features(cfg)
        features = surfaces or config.features(cfg)
        refuse(not features, "No feature is named: give feature=[strip_load] or a sum of several.")
        mu, first = config.friction(cfg), next(iter(config.part(cfg, "feature")))
        refuse(
            mu is not None,
            f"friction is {mu}, but here each feature has its own: leave it out, or give "
            f"it as feature.{first}.friction={mu}.",
        )
        solver, recording = config.solver(cfg), config.recording(cfg, str(EXAMPLE))
        check_volts(recording)
        straight = all(each.is_straight_across for each in features.values())
        problem = config.recorded_problem(cfg, recording, are_straight_across=straight)
        if surfaces:
            method = surface_fit(problem, recording.sidecar, surfaces, solver, settings)
        else:
            method = traction_fit(config.features(cfg), solver, settings)
        fitted = _fit(method, recording, problem, settings["select"])
        facts = {
            **_facts.of_recording(recording, problem, config.part(cfg, "recording").get("times")),
            **_facts.of_effects(config.part(cfg, "effects")),
            **_of_fit(fitted, solver),
        }
        data = _dataset(fitted, facts)
        if settings["samples"] and fitted.best.fit is not None:
            drawn = sample(fitted.best, draws=settings["samples"])
            data = data.assign(dataset(_samples(fitted.best, drawn), {}).data_vars)
        return Result(_title(fitted), data, sections("fit_recording", "assumed"))


# --- the fit ---------------------------------------------------------------------------------


def _fit(
    method: FeatureFit, recording: Recording, problem: Problem, select: bool
) -> FittedRecording:
    """All features together and nothing, or each of them and nothing, of which one is selected."""
    named = method.features
    sums = [{name: feature} for name, feature in named.items()] if select else [named]
    fits, times = [], []
    # Nothing comes last: the programs of the first search serve all.
    for features in [*sums, {}]:
        with stage(f"fitting {' + '.join(features) or 'noise alone'}"):
            start = time.perf_counter()
            fits.append(method.candidate(features, problem))
            times.append(time.perf_counter() - start)
    order = [-1, *range(len(sums))]
    candidates = [fits[i] for i in order]
    best = max(candidates, key=lambda each: each.log_evidence) if select else candidates[-1]
    stretch = stretch_of(problem, named)
    return FittedRecording(recording, stretch, candidates, [times[i] for i in order], best)


def _title(fitted: FittedRecording) -> str:
    best = fitted.best
    name = best.name.replace("_", " ")
    if best.quality is Quality.FAILED:
        return f"{fitted.recording.name}: the fit of {name} failed"
    remark = " (doubtful)" if best.quality is Quality.DOUBTFUL else ""
    if best.fit is None:
        return f"{fitted.recording.name}: noise alone explains the signal{remark}"
    if len(best.features) > 1:
        return f"{name.capitalize()} fitted to {fitted.recording.name}{remark}"
    said = [
        words.format(quantity_with_error(*best.parameters[key], unit_of(key)))
        for key, words in IN_TITLE.items()
        if key in best.parameters
    ]
    return f"{name.capitalize()} {', '.join(said)}{remark}"


def _of_fit(fitted: FittedRecording, solver: Solver) -> dict[str, Any]:
    """What the fit assumed, as attributes."""
    best, problem, model = fitted.best, fitted.problem, fitted.best.model
    facts: dict[str, Any] = {"is_fit": 1, "solver": type(solver).__name__}
    if fitted.stretch.is_part:
        facts |= dict(zip(STRETCH, fitted.stretch.window, strict=True))
    if best.levels is not None:
        facts |= {
            "noise_rms": _noise_rms(fitted),
            "noise_sliding_rms": best.levels.sliding_rms,
            "noise_sliding_correlation_m": best.levels.longest_m,
        }
    if "height" in model.loading.PROFILES:
        facts |= {
            **_facts.of_rig(problem.rig),
            "nominal_pressure_Pa": problem.nominal_pressure_Pa,
            "contact_window_m": float(model.line.cell_m * model.line.n),
            "cells": model.line.n,
            "cell_m": float(model.line.cell_m),
            "edges_m": [float(each.edge_m) for each in best.features.values() if each.has_edges],
        }
    return facts


def _noise_rms(fitted: FittedRecording) -> float:
    """The white noise per sample, as the best fit has it."""
    levels = fitted.best.levels
    known = fitted.problem.noise.rms
    return known if levels is None else levels.white_rms


# --- data ------------------------------------------------------------------------------------


def _dataset(fitted: FittedRecording, facts: Mapping[str, Any]) -> xarray.Dataset:
    best, problem, unit = fitted.best, fitted.problem, fitted.recording.signal_unit
    motion, along = problem.motion, ("element", "sample")
    averaged, places = hum_free_variables(
        problem.motion, problem.mains, float(problem.noise.rms), best.data, best.fitted, unit
    )
    variables: dict[str, tuple[Any, ...]] = {
        "time": ("sample", motion.time_s, "s"),
        "position": ("sample", motion.position_m, "m"),
        "speed": ("sample", motion.speed_m_per_s, "m/s"),
        "signal": (along, best.data, unit),
        "fitted_signal": (along, best.fitted, unit),
        "whitened_residual": (along, best.whitened, "1"),
        **averaged,
        **_profiles(best),
        **reported_parameters(best.parameters),
        **_asymmetric(best),
        **budget_variables(best, problem.rig),
        **_candidates(fitted),
        **answer_of(best),
        **scalars(_numbers(fitted)),
    }
    coordinates: dict[str, tuple[Any, ...]] = {
        "x": (np.asarray(best.model.scanned_line.x), "m"),
        "component": (list(COMPONENTS), "1"),
        "element": (problem.sensor.element_names, "1"),
        "reported": (list(best.parameters), "1"),
        **places,
        **budget_coordinates(best),
        "candidate": ([each.name.replace(" + ", "_and_") for each in fitted.candidates], "1"),
    }
    if best.fit is not None:
        names = list(best.fit.names)
        coordinates |= {"parameter": (names, "1"), "parameter_2": (names, "1")}
        dims = ("parameter", "parameter_2")
        variables["correlation"] = (dims, best.fit.correlation, "1")
    return dataset(variables, coordinates, signal_unit=unit, **facts)


def _asymmetric(best: FeatureEstimate) -> dict[str, tuple[Any, ...]]:
    """The intervals by profile likelihood that are not those of standard errors, if any."""
    if not (intervals := best.asymmetric):
        return {}
    ends = np.array([intervals.get(name, (np.nan, np.nan)) for name in best.parameters])
    return {
        f"profile_{what}": ("reported", own, "SI", f"{{reported!s}}_profile_{what}")
        for what, own in zip(("low", "high"), ends.T, strict=True)
    }


def _samples(best: FeatureEstimate, drawn: PosteriorSamples) -> dict[str, tuple[Any, ...]]:
    """What the posterior's samples say of each reported parameter."""
    moments = {"mean": drawn.mean, "std": drawn.std, "low": drawn.low, "high": drawn.high}
    checks = {"r_hat": drawn.r_hat, "ess_bulk": drawn.ess_bulk, "ess_tail": drawn.ess_tail}
    names = list(best.parameters)
    variables: dict[str, tuple[Any, ...]] = {
        f"sample_{what}": (
            "reported", [own[name] for name in names], "SI", f"{{reported!s}}_sample_{what}"
        )
        for what, own in moments.items()
    }  # fmt: skip
    variables |= {
        what: ("reported", [own[name] for name in names], "1") for what, own in checks.items()
    }
    return variables | {
        "samples_quality": ((), str(drawn.quality), "1", "samples_quality"),
        "samples_reasons": ((), " ".join(drawn.reasons), "1"),
    }


def _profiles(best: FeatureEstimate) -> dict[str, tuple[Any, ...]]:
    """What acts along the line, with its standard errors."""
    profiles = best.profiles()
    pairs = zip(*map(profiles.get, COMPONENTS), strict=True)
    value, stderr = (np.stack(each) for each in pairs)
    over = ("component", "x")
    own = {"estimate": (over, value, "Pa"), "estimate_stderr": (over, stderr, "Pa")}
    return contact_variables(profiles) | own


def _candidates(fitted: FittedRecording) -> dict[str, tuple[Any, ...]]:
    fits = fitted.candidates
    chi2 = [np.nan if fit.chi2_per_freedom is None else fit.chi2_per_freedom for fit in fits]
    evidence, probability = [fit.log_evidence for fit in fits], probabilities(fits)
    return {
        "log_evidence": ("candidate", evidence, "1", "log_evidence_{candidate!s}"),
        "probability": ("candidate", probability, "1", "probability_{candidate!s}"),
        "candidate_chi2": ("candidate", chi2, "1"),
        "candidate_quality": ("candidate", [str(fit.quality) for fit in fits], "1"),
        "candidate_first_call_s": ("candidate", fitted.times_s, "s"),
    }


def _numbers(fitted: FittedRecording) -> dict[str, Any]:
    best, unit = fitted.best, fitted.recording.signal_unit
    numbers: dict[str, Any] = {
        "feature": best.name,
        "samples": int(np.isfinite(best.data).sum()),
        f"noise_rms_{unit}": _noise_rms(fitted),
        "first_call_s": float(sum(fitted.times_s)),
        "chi2_per_freedom": best.chi2_per_freedom,
    }
    if fitted.stretch.is_part:
        numbers |= dict(zip(STRETCH, fitted.stretch.window, strict=True))
    if best.levels is not None:
        numbers |= {
            f"noise_sliding_rms_{unit}": best.levels.sliding_rms,
            "noise_sliding_correlation_m": best.levels.longest_m,
        }
    if best.fit is not None:
        numbers |= {
            "iterations": best.fit.stats["iterations"],
            "at_bound": ", ".join(best.fit.at_bound),
            "undetermined": "; ".join(map(direction_in_words, best.fit.undetermined)),
            "undetected_features": ", ".join(best.undetected),
        }
    return numbers
