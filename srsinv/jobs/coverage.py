"""Efficiency (RMSE over the Cramer-Rao bound) and interval coverage of the feature fit.

For each feature its truth is simulated on finer cells, and every draw of the noise is fitted. The
errors are compared with the Cramer-Rao bound at the truth and with the fit's own standard errors. A
scene with a surface is a feature of height and friction, else features of traction are fitted.
"""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray

from .. import config
from ..errors import number, refuse, whole
from ..forward.feature import Feature
from ..inverse.features.fit import FeatureFitter
from ..inverse.features.model import scan_extent
from ..inverse.nonlinear import Solver
from ..progress import stage
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from .coverage_surface import known_shape, statistics_of_shape, window_given
from .judged import LEVELS, FitStatistics, Quantity, bounds_of, ratio_dB
from .simulated_features import (
    SampledScan,
    SyntheticScan,
    SyntheticTractionScan,
    known_noise,
    named,
    parameters,
    sample_rate,
    synthetic_scan,
    unit_of,
)

DRAWS, DRAWS_OF_A_SURFACE, LEAST_DRAWS = 400, 200, 8


def run(cfg: config.Config) -> Outcome:
    """The job: simulate, fit every draw, compare."""
    with config.precision(cfg):
        given, scene = cfg["coverage"], config.part(cfg, "scene")
        on_surface = "surfaces" in scene
        draws, rate_hz = _draws(given["draws"], on_surface), sample_rate("coverage", given)
        parts = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
        sampled = SampledScan("coverage", rate_hz, *parts)
        key, solver = config.random_key(cfg), config.solver(cfg)
        if on_surface:
            names, features = list(scene["surfaces"] or ()), config.surface_features(cfg)
            shape = known_shape(config.scene(cfg), names, features)
            window = window_given(given["window_m"])
            on, statistics = statistics_of_shape(shape, sampled, window, solver, key, draws)
        else:
            features = config.features(cfg)
            refuse(not features, "No feature is named: give feature=[strip_load] or several.")
            on = synthetic_scan(config.line(cfg), sampled)
            truths = {name: _truth(given["truth"], on, name, f) for name, f in features.items()}
            statistics = _each(on, features, truths, solver, key, draws)
    rows = [quantity for each in statistics.values() for quantity in each.quantities]
    data, table = _dataset(rows), _table(rows)
    assumed = (
        *_assumed(on, statistics, ", ".join(cfg["noise"])),
        ("precision, seed", f"{cfg['precision']}, {cfg['seed']}"),
    )
    worst = max(quantity.rmse / quantity.bound for quantity in rows)
    return Outcome(
        f"Feature fit over {draws} draws: error at most {worst:.3f} times the Cramer-Rao bound",
        _metrics(statistics, draws),
        data,
        _sections(statistics, data, table, draws, assumed),
        table,
    )


def _draws(given: Any, on_surface: bool) -> int:
    if given is None:
        return DRAWS_OF_A_SURFACE if on_surface else DRAWS
    wanted = f"a whole number from {LEAST_DRAWS}"
    return whole("coverage.draws", given, wanted, least=LEAST_DRAWS)


def _each(
    on: SyntheticTractionScan,
    features: Mapping[str, Feature],
    truths: Mapping[str, Mapping[str, float]],
    solver: Solver,
    key: jax.Array,
    draws: int,
) -> dict[str, FitStatistics]:
    """Fit statistics of every feature of traction."""
    keys = jax.random.split(key, len(features))
    fitter = FeatureFitter.along(on.sensor, on.motion, solver)
    statistics = {}
    for own, (name, feature) in zip(keys, features.items(), strict=True):
        with stage(f"fitting {draws} draws of {name}"):
            statistics[name] = _fit_statistics(on, fitter, name, feature, truths[name], own, draws)
    return statistics


def _truth(given: Any, on: SyntheticTractionScan, name: str, feature: Feature):
    """The simulated truth of a feature, checked against the fit's search ranges."""
    truth = named("coverage.truth", given, name, feature)
    ranges = feature.ranges(scan_extent(on.sensor, on.motion))
    for part, value in truth.items():
        key = f"coverage.truth.{name}.{part}"
        number(key, value)
        low, high = ranges.get(part, (-np.inf, np.inf))
        refuse(
            not low < value < high,
            f"{key} is {value}, but it is looked for from {low:.4g} to {high:.4g}: put it between.",
        )
    amplitude = feature.amplitude
    refuse(
        truth[amplitude] == 0,
        f"coverage.truth.{name}.{amplitude} is 0: there is nothing to fit, give another value.",
    )
    refuse(
        feature.friction is not None and feature.friction != truth["friction"],
        f"feature.{name}.friction is {feature.friction}, but coverage.truth.{name}.friction is "
        f"{truth['friction']}: give the same, or feature.{name}.friction=null.",
    )
    return truth


def _fit_statistics(
    on: SyntheticTractionScan,
    fitter: FeatureFitter,
    name: str,
    feature: Feature,
    truth,
    key,
    draws: int,
) -> FitStatistics:
    clean = on.signal(name, feature, parameters(feature, truth))
    rms = float(np.sqrt(np.mean(clean**2)))
    power = on.power(rms)
    ys = clean + on.noise(key, power, draws)
    model, fits = fitter.many(name, feature, ys, known_noise(power))
    read = [model.loading.report(model.features, fit) for fit in fits]
    bounds = cramer_rao(on, name, feature, truth, power)
    quantities = tuple(
        Quantity(
            name,
            part,
            float(truth[part]),
            bound,
            np.array([each[part][0] for each in read]),
            np.array([each[part][1] for each in read]),
        )
        for part, bound in bounds.items()
    )
    ratio = ratio_dB(rms, power, on.shape[1])
    return FitStatistics(quantities, sum(fit.converged for fit in fits), ratio)


def cramer_rao(
    on: SyntheticTractionScan,
    name: str,
    feature: Feature,
    truth: Mapping[str, float],
    power: np.ndarray,
) -> dict[str, float]:
    """The least standard deviation of each parameter, friction among them where it is fitted."""
    free = [part for part in truth if part != "friction" or feature.friction is None]

    def size(part: str) -> float:
        if part == feature.amplitude:
            return abs(truth[part])
        return float(on.sensor.depth_m) if part.endswith("_m") else 1.0

    def signal(given: Mapping[str, float]) -> np.ndarray:
        return on.signal(name, feature, parameters(feature, given))

    return bounds_of(on, signal, truth, {part: size(part) for part in free}, power)


# --- the page --------------------------------------------------------------------------------


def _metrics(statistics: dict[str, FitStatistics], draws: int) -> dict[str, Any]:
    metrics: dict[str, Any] = {"draws": draws}
    for name, each in statistics.items():
        metrics[f"{name}_converged"] = each.converged
        metrics[f"{name}_snr_dB"] = each.snr_dB
        for quantity in each.quantities:
            label = quantity.label
            metrics |= {
                f"{name}_bias_{quantity.name}": quantity.bias,
                f"{name}_rmse_{quantity.name}": quantity.rmse,
                f"{name}_bound_{quantity.name}": quantity.bound,
                f"{label}_rmse_over_crb": quantity.rmse / quantity.bound,
                f"{label}_stderr_over_crb": float(quantity.stderr.mean()) / quantity.bound,
            }
            for level in LEVELS:
                metrics[f"{label}_coverage_{100 * level:.0f}"] = quantity.coverage(level)
    return metrics


def _dataset(rows: list[Quantity]) -> xarray.Dataset:
    variables: dict[str, Any] = {
        "normalised_error": (("quantity", "draw"), [row.normalised for row in rows]),
        "rmse_over_crb": (("quantity",), [row.rmse / row.bound for row in rows]),
        "stderr_over_crb": (("quantity",), [row.stderr.mean() / row.bound for row in rows]),
        "coverage": (
            ("quantity", "level"),
            [[row.coverage(level) for level in LEVELS] for row in rows],
        ),
    }
    variables = {name: (*each, {"units": "1"}) for name, each in variables.items()}
    for row in rows:
        unit = {"units": unit_of(row.name)}
        variables |= {
            row.label: (("draw",), row.value, unit),
            f"{row.label}_stderr": (("draw",), row.stderr, unit),
            f"{row.label}_truth": ((), row.truth, unit),
            f"{row.label}_bound": ((), row.bound, unit),
        }
    return xarray.Dataset(
        variables,
        {
            "quantity": ("quantity", [row.label for row in rows], {"units": "1"}),
            "feature": ("quantity", [row.feature for row in rows], {"units": "1"}),
            "parameter": ("quantity", [row.name for row in rows], {"units": "1"}),
            "level": ("level", list(LEVELS), {"units": "1"}),
        },
        {"title": "Coverage of the feature fit"},
    )


def _table(rows: list[Quantity]) -> Table:
    headings = (f"inside {100 * level:.0f} %" for level in LEVELS)
    return Table(
        ("feature", "parameter", "truth", "unit", "bias", "rmse", "Cramer-Rao bound",
         "rmse / bound", "standard error / bound", *(f"{heading} [%]" for heading in headings)),
        tuple(
            (
                row.feature, row.name, row.truth, unit_of(row.name), row.bias, row.rmse, row.bound,
                round(row.rmse / row.bound, 3), round(float(row.stderr.mean()) / row.bound, 3),
                *(round(100 * row.coverage(level), 1) for level in LEVELS),
            )
            for row in rows
        ),
    )  # fmt: skip


def _sections(
    statistics: dict[str, FitStatistics],
    data: xarray.Dataset,
    table: Table,
    draws: int,
    assumed: tuple[tuple[str, str], ...],
) -> tuple[Section, ...]:
    binomial = 100 * np.sqrt(0.9 * 0.1 / draws)
    unconverged = {name: draws - each.converged for name, each in statistics.items()}
    return (
        Section(
            "Error against the bound, and intervals against their word",
            (
                "No unbiased estimate of these parameters from these data has a smaller standard "
                "deviation than the Cramer-Rao bound; it is computed from the simulation at the "
                "truth, apart from the fit.",
                f"With {draws} draws the share inside a 90 % interval scatters by "
                f"{binomial:.2g} % (one standard deviation), and a root mean squared error by "
                f"{100 / np.sqrt(2 * draws):.2g} %.",
                f"Fits that did not converge: {sum(unconverged.values())} of "
                f"{draws * len(statistics)}.",
            ),
            {"bound_and_coverage": lambda: figures.bound_and_coverage(data)},
            {
                "bound_and_coverage": "Bands: two standard deviations of what so many draws show "
                "of a fit that is exactly right."
            },
            (table,),
        ),
        Section(
            "Errors in units of their own standard error",
            ("They follow the unit normal where the standard errors are right.",),
            {"normalised_errors": lambda: figures.normalised_errors(data)},
            {
                "normalised_errors": "Each parameter's errors over all draws, each over the "
                "standard error that its own fit gave."
            },
        ),
        Section("What was assumed", tables=(Table(("what", "value"), assumed),)),
    )


def _assumed(
    on: SyntheticScan, statistics: dict[str, FitStatistics], noises: str
) -> tuple[tuple[str, str], ...]:
    elements, samples = on.shape
    x = np.asarray(on.motion.position_m)
    ratios = ", ".join(f"{name} {each.snr_dB:.3g} dB" for name, each in statistics.items())
    return (
        ("scan", f"{samples} samples of {elements} elements, "
         f"{1e6 * abs(x[1] - x[0]):.4g} um apart, at {float(on.scan.speed_m_per_s):.4g} m/s"),
        ("film depth", f"{1e3 * float(on.sensor.depth_m):.4g} mm"),
        ("simulation", on.cells),
        ("noise", f"{noises}, {on.known}: {ratios}"),
        ("start", on.start),
    )  # fmt: skip
