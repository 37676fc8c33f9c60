"""The comparison on a simulated scene: errors against the truth, over noise levels and draws."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray
from jaxtyping import Float

from ..errors import is_number, refuse
from ..forward.noise import Noise, SignalToNoise
from ..forward.simulation import Simulation
from ..inverse.estimate import COMPONENTS, Estimate
from ..inverse.features.method import FeatureFit
from ..inverse.line_problem import LineProblem
from ..inverse.method import Method
from ..inverse.nonlinear import Solver
from ..inverse.quality import Quality
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from . import contest
from .analysis import BAND_90, deviation, element_names
from .contest import Runs
from .recorded import Rows
from .simulate import assumed
from .simulation import noisy_problem

DRAWN = ("method", "snr", "seed")


@dataclass(frozen=True)
class SceneDraws:
    """Draws of white noise: `seeds` at each of the levels `snr_dB`, the first one from `seed`."""

    snr_dB: tuple[float, ...]
    seeds: int
    seed: int

    @classmethod
    def checked(cls, given: Mapping[str, Any], seed: int) -> "SceneDraws":
        """Those of `compare` in the configuration. Raises `BadInput` for levels that are not
        several numbers, each once, and for no draw."""
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
        return cls(tuple(levels), seeds, seed)


@dataclass(frozen=True)
class SceneComparison:
    """A simulated scene, and what is compared on it.

    - `sim`: the scene and its sensor; `noises`: the causes of noise beside the white one.
    - `friction`: mu where the inversions are to know that q = mu p.
    - `features`: the names of those that are fitted; `wrong_feature`: one that is absent, or none.
    - `effects`: the names of those that are on; `stated`: the friction, and the precision with the
      seed, as the page states them.
    """

    sim: Simulation
    draws: SceneDraws
    noises: Mapping[str, Noise]
    friction: float | None
    features: Sequence[str]
    wrong_feature: Any
    effects: Sequence[str]
    stated: tuple[Any, str]

    @property
    def wrong_name(self) -> str:
        """The kind of the absent feature."""
        return type(self.wrong_feature).__name__.removesuffix("Feature")

    def problems(self) -> list[LineProblem]:
        """One for each draw of each level."""
        return [
            noisy_problem(
                self.sim.with_noises((SignalToNoise(level), *self.noises.values())),
                jax.random.key(self.draws.seed + i),
                self.friction,
            )
            for level in self.draws.snr_dB
            for i in range(self.draws.seeds)
        ]


def on_scene(scene: SceneComparison, methods: Mapping[str, Method], solver: Solver) -> Outcome:
    """Every method at every noise level and draw, and one fit of a feature that is absent.

    Raises `BadInput` for a uniform scene.
    """
    sim = scene.sim
    refuse(
        not np.any(np.ptp(np.asarray(sim.traction(sim.line)), axis=-1)),
        "The scene is uniform, which a rate signal does not show: give it a pressure, as "
        "scene=strip does.",
    )
    problems = scene.problems()
    runs = contest.run_all(methods, problems)
    dataset = _dataset(scene, problems, runs)
    wrong = None
    if scene.wrong_feature is not None:
        fit = FeatureFit({"wrong": scene.wrong_feature}, solver)
        alone = contest.run_all({"A feature that is not there": fit}, problems)
        wrong = _dataset(scene, problems, alone)
    return Outcome(
        f"{', '.join(runs)} compared on a simulated scene",
        _metrics(dataset) | _wrong_metrics(wrong),
        dataset,
        _sections(scene, dataset, wrong, runs),
        _summary(dataset),
    )


# --- numbers ---------------------------------------------------------------------------------


def _dataset(
    scene: SceneComparison, problems: list[LineProblem], runs: Mapping[str, Runs]
) -> xarray.Dataset:
    sim, levels, seeds = scene.sim, scene.draws.snr_dB, scene.draws.seeds
    shape, cells = (len(levels), seeds), problems[0].observed_cells

    def each(get) -> np.ndarray:
        """(method, snr, seed, ...)"""
        rows = np.asarray([[get(each) for each in one.estimates] for one in runs.values()])
        return rows.reshape(len(runs), *shape, *rows.shape[2:])

    def data(get) -> np.ndarray:
        """(snr, seed, ...)"""
        rows = np.asarray([get(problem) for problem in problems])
        return rows.reshape(*shape, *rows.shape[1:])

    truth = np.asarray(sim.traction(sim.line))
    value, stderr = each(lambda f: f.value), each(lambda f: f.deviation(cells)[1])
    error, overall, inside = _scores(value, stderr, truth, cells)
    signal = data(lambda p: np.asarray(p.data + p.mean_signal))
    fitted = each(lambda f: f.fitted)
    rms = data(lambda p: p.noise_rms)[..., None, None]
    along, unit = ("component", "x"), sim.sensor.amplifier.unit
    observed = problems[0].is_observed.astype(np.int8)
    variables = {
        "traction": (along, truth, "Pa"),
        "signal": (("snr", "seed", "element", "x"), signal, unit),
        "observed": (("element", "x"), observed, "1"),
        "estimate": ((*DRAWN, *along), value, "Pa"),
        "estimate_stderr": ((*DRAWN, *along), stderr, "Pa"),
        "fitted_signal": ((*DRAWN, "element", "x"), fitted, unit),
        "whitened_residual": ((*DRAWN, "element", "x"), (signal - fitted) / rms, "1"),
        "error": ((*DRAWN, "component"), error, "1"),
        "error_overall": (DRAWN, overall, "1"),
        "coverage": ((*DRAWN, "component"), inside, "1"),
        "misfit": (DRAWN, each(lambda f: f.misfit), "1"),
        "converged": (DRAWN, each(lambda f: f.status == "converged").astype(np.int8), "1"),
        "quality": (DRAWN, each(lambda f: str(f.quality)), "1"),
        "log_evidence": (
            DRAWN, each(lambda f: getattr(f, "log_evidence", np.nan)), "1"
        ),
        "rank": (DRAWN, contest.ranks(overall), "1"),
        "first_call_s": (("method",), [one.first_call_s for one in runs.values()], "s"),
        "steady_call_s": (("method",), [one.steady_s for one in runs.values()], "s"),
    }  # fmt: skip
    coordinates = {
        "x": ("x", np.asarray(sim.line.x), {"units": "m"}),
        "snr": ("snr", [float(level) for level in levels], {"units": "dB"}),
        "seed": ("seed", scene.draws.seed + np.arange(seeds), {"units": "1"}),
        "component": ("component", list(COMPONENTS), {"units": "1"}),
        "method": ("method", list(runs), {"units": "1"}),
        "element": ("element", element_names(sim.sensor), {"units": "1"}),
    }
    return xarray.Dataset(
        {name: (dims, values, {"units": units}) for name, (dims, values, units) in
         variables.items()},
        coordinates,
        {"title": "Methods compared on a scene", "mean_unobserved": ",".join(COMPONENTS)},
    )  # fmt: skip


def _scores(
    value: Float[np.ndarray, "*draws 2 n"],
    stderr: Float[np.ndarray, "*draws 2 n"],
    truth: Float[np.ndarray, "2 n"],
    observed: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Relative error of p and of q, of both together, and the fraction of cells in the band.

    Of the deviation from the mean; q and p together by the norm of both.
    """
    true = deviation(truth, observed)
    wrong = deviation(value, observed) - true
    inside = np.abs(wrong) <= BAND_90 * stderr[..., observed]
    size, of_both = np.linalg.norm(true, axis=-1), np.linalg.norm(true)
    error = np.linalg.norm(wrong, axis=-1) / np.where(size > 0, size, np.nan)
    return error, np.linalg.norm(wrong, axis=(-2, -1)) / of_both, np.mean(inside, axis=-1)


def _metrics(ds: xarray.Dataset) -> dict[str, Any]:
    metrics: dict[str, Any] = {"seeds": ds.sizes["seed"], "cells": ds.sizes["x"]}
    for m, name in enumerate(ds["method"].values):
        key = _key(name)
        metrics[f"rank_mean_{key}"] = float(ds["rank"].values[m].mean())
        metrics[f"first_call_s_{key}"] = float(ds["first_call_s"].values[m])
        metrics[f"steady_call_s_{key}"] = float(ds["steady_call_s"].values[m])
        for s, level in enumerate(ds["snr"].values):
            at = f"{key}_{level:g}_dB"
            metrics[f"rank_mean_{at}"] = float(ds["rank"].values[m, s].mean())
            metrics[f"misfit_{at}"] = float(ds["misfit"].values[m, s].mean())
            quality = ds["quality"].values[m, s]
            for each in (Quality.DOUBTFUL, Quality.FAILED):
                metrics[f"{each}_{at}"] = int(np.sum(quality == each))
            metrics[f"not_converged_{at}"] = int((1 - ds["converged"].values[m, s]).sum())
            for c, component in enumerate(COMPONENTS):
                error = ds["error"].values[m, s, :, c]
                metrics[f"error_{component}_{at}"] = float(error.mean())
                metrics[f"error_{component}_spread_{at}"] = _sd(error)
                inside = ds["coverage"].values[m, s, :, c]
                metrics[f"coverage_{component}_{at}"] = float(inside.mean())
    return metrics


def _wrong_metrics(wrong: xarray.Dataset | None) -> dict[str, Any]:
    if wrong is None:
        return {}
    return {
        f"{name}_wrong_feature_{level:g}_dB": float(wrong[name].values[0, s].mean())
        for name in ("misfit", "error_overall")
        for s, level in enumerate(wrong["snr"].values)
    }


def _key(name: str) -> str:
    return name.lower().replace(" ", "_")


def _sd(values: np.ndarray) -> float | None:
    """Standard deviation over the draws, where there are several."""
    return float(values.std(ddof=1)) if values.size > 1 else None


# --- the page --------------------------------------------------------------------------------


def _percent(values: np.ndarray) -> str:
    """Mean and standard deviation over the draws."""
    sd = _sd(values)
    mean = f"{100 * values.mean():.3g}"
    return f"{mean} %" if sd is None else f"{mean} ± {100 * sd:.2g} %"


def _summary(ds: xarray.Dataset) -> Table:
    levels = [f"{level:g} dB" for level in ds["snr"].values]
    rows = []
    for m in np.argsort(ds["rank"].values.mean(axis=(1, 2)), kind="stable"):
        rank, error = ds["rank"].values[m], ds["error"].values[m]
        rows.append(
            (
                str(ds["method"].values[m]),
                f"{rank.mean():.2f} ({rank.min():g} to {rank.max():g})",
                *(_percent(error[s, :, c]) for s in range(len(levels)) for c in range(2)),
                1e3 * float(ds["steady_call_s"].values[m]),
                float(ds["first_call_s"].values[m]),
            )
        )
    heads = (f"{c} at {level}" for level in levels for c in COMPONENTS)
    return Table(
        ("method", "mean rank (range)", *heads, "steady [ms]", "first call [s]"),
        tuple(rows),
        f"Relative errors of the deviation from the mean, with their standard deviation over "
        f"{ds.sizes['seed']} draws of the noise; rank 1 has the least error of p and q together.",
    )


def _coverage_table(ds: xarray.Dataset, runs: Mapping[str, Runs]) -> Table:
    seeds = ds.sizes["seed"]
    said = tuple(
        f"{name}, {level:g} dB, draw {i + 1}: {' '.join(estimate.reasons)}"
        for name, one in runs.items()
        for s, level in enumerate(ds["snr"].values)
        for i, estimate in _first_not_good(one.estimates[s * seeds : (s + 1) * seeds])
    )
    rows = [
        (
            str(name),
            f"{level:g}",
            *(_percent(ds["coverage"].values[m, s, :, c]) for c in range(2)),
            float(ds["misfit"].values[m, s].mean()),
            *(int(np.sum(ds["quality"].values[m, s] == each)) for each in Quality),
        )
        for m, name in enumerate(ds["method"].values)
        for s, level in enumerate(ds["snr"].values)
    ]
    return Table(
        ("method", "SNR [dB]", "band covers p", "band covers q", "residual / noise, squared",
         *Quality),
        tuple(rows),
        "Of how many draws the method itself calls its answer good, doubtful or failed.",
        said,
    )  # fmt: skip


def _first_not_good(draws: list[Estimate]) -> list[tuple[int, Estimate]]:
    return [(i, estimate) for i, estimate in enumerate(draws) if estimate.reasons][:1]


def _pair_table(ds: xarray.Dataset) -> Table:
    names, rows = [str(name) for name in ds["method"].values], []
    for s, level in enumerate(ds["snr"].values):
        for pair in contest.pairs(ds["error_overall"].values[:, s]):
            spread = "-" if np.isinf(pair.spread) else f"{100 * pair.spread:.2g}"
            rows.append(
                (
                    f"{level:g}", names[pair.better], names[pair.worse],
                    f"{100 * pair.difference:.3g} ± {spread}",
                    f"{pair.wins} of {ds.sizes['seed']}",
                    "told apart" if pair.apart else "not told apart",
                )
            )  # fmt: skip
    return Table(
        ("SNR [dB]", "less error", "more error", "by, in % of the truth", "draws in which it is so",
         "verdict"),
        tuple(rows),
        "Differences on the same draws, mean ± standard deviation; told apart where the mean "
        "differs from 0 by Student's t at 95 %.",
    )  # fmt: skip


def _parameter_table(ds: xarray.Dataset, runs: Runs) -> Table:
    """Errors of the features' parameters at each level, beside the stated standard errors."""
    seeds, rows = ds.sizes["seed"], []
    for s, level in enumerate(ds["snr"].values):
        of_level = [each.parameters for each in runs.estimates[s * seeds : (s + 1) * seeds]]
        for name in of_level[0]:
            drawn = np.array([parameters[name] for parameters in of_level])
            spread = _sd(drawn[:, 0])
            rows.append(
                (
                    f"{level:g}", name, float(drawn[:, 0].mean()),
                    "-" if spread is None else spread,
                    float(np.sqrt(np.mean(drawn[:, 1] ** 2))),
                )
            )  # fmt: skip
    return Table(
        ("SNR [dB]", "parameter", "mean", "spread over draws", "standard error stated"),
        tuple(rows),
    )


def _wrong_table(ds: xarray.Dataset, wrong: xarray.Dataset) -> Table:
    right = list(ds["method"].values).index(contest.FEATURE_FIT)
    size = np.sqrt(np.mean(deviation(ds["traction"].values, np.ones(ds.sizes["x"], bool)) ** 2))
    rows = []
    for s, level in enumerate(ds["snr"].values):
        stated = np.sqrt(np.mean(wrong["estimate_stderr"].values[0, s] ** 2)) / size
        gain = ds["log_evidence"].values[right, s] - wrong["log_evidence"].values[0, s]
        rows.append(
            (
                f"{level:g}",
                f"{100 * stated:.2g} %",
                _percent(wrong["error_overall"].values[0, s]),
                _percent(ds["error_overall"].values[right, s]),
                _percent(wrong["coverage"].values[0, s, :, 0]),
                float(wrong["misfit"].values[0, s].mean()),
                float(ds["misfit"].values[right, s].mean()),
                float(gain.mean()),
            )
        )
    return Table(
        ("SNR [dB]", "error it states", "its true error", "right feature's", "its band covers p",
         "its residual / noise, squared", "right feature's residual", "log evidence for the right"),
        tuple(rows),
        "Errors of p and q together, relative to the truth.",
    )  # fmt: skip


def _sections(scene: SceneComparison, ds, wrong, runs) -> tuple[Section, ...]:
    methods = [str(name) for name in ds["method"].values]
    levels = [f"{level:g} dB" for level in ds["snr"].values]
    seeds = ds.sizes["seed"]
    parts = [
        Section(
            "What is compared",
            _words(scene.features, ds),
            {"scene_traction": lambda: figures.traction(ds)},
            {"scene_traction": "The truth: pressure and shear on the skin, less what is uniform."},
        ),
        Section(
            "Ranking",
            (
                "Every draw of the noise ranks the methods by their error of p and q together, 1 "
                "the best. A method that is better in the mean but not in every draw has a range.",
                *_verdicts(ds),
            ),
            {"ranking": lambda: figures.ranking(
                ds["rank"].values, methods, levels, "Rank at each signal-to-noise ratio"
            )},
            {"ranking": f"Mean rank over {seeds} draws, with the best and the worst."},
            (_pair_table(ds),),
        ),
        Section(
            "Errors and bands",
            (
                "A 90 % band is honest when about 90 % of the true values lie inside it. The "
                "inversions' bands assume a traction that is equally rough everywhere; this one is "
                "flat but for its edges, so they are wide where it is flat and narrow at the "
                "edges.",
                "The feature fit's band comes from a few parameters: all cells of a draw are "
                "inside or outside nearly together, so that its coverage is a mean over draws, "
                "and with few draws it scatters. In a cell that holds an edge it is only the "
                "first-order term. Where the noise is very low, "
                "what limits it are the cells that made the data, not the noise.",
            ),
            {"errors_against_noise": lambda: figures.errors_against_noise(
                ds["snr"].values, ds["error"].values, ds["coverage"].values, methods, COMPONENTS
            )},
            {"errors_against_noise": "Relative error and coverage over the signal-to-noise ratio."},
            (_coverage_table(ds, runs),),
        ),
        Section(
            "Recovered p and q",
            ("The first draw at each noise level. The mean is not in a rate signal and is taken "
             "out, of the truth too.",),
            {f"estimates_{level.replace(' ', '_')}": _estimates_at(ds, s)
             for s, level in enumerate(levels)},
            {f"estimates_{level.replace(' ', '_')}": f"p and q at {level}, with 90 % bands."
             for level in levels},
        ),
    ]  # fmt: skip
    if contest.FEATURE_FIT in runs:
        parts.append(
            Section(
                "The fitted feature",
                ("In SI units. The spread over the draws is what the stated standard error "
                 "predicts.",),
                tables=(_parameter_table(ds, runs[contest.FEATURE_FIT]),),
            )
        )  # fmt: skip
        if wrong is not None:
            parts.append(_wrong_section(scene.wrong_name, ds, wrong))
    parts.append(Section("What was assumed", tables=(Table(("what", "value"), _assumed(scene)),)))
    return tuple(parts)


def _estimates_at(ds: xarray.Dataset, level: int):
    return lambda: figures.estimates(ds.isel(snr=level, seed=0))


def _words(named: Sequence[str], ds: xarray.Dataset) -> tuple[str, ...]:
    features = " + ".join(named).replace("_", " ")
    about = {
        "Wiener": "Wiener takes p and q as rough everywhere, with a spectrum of given shape.",
        "Tikhonov": "Tikhonov prefers p and q with little slope; its weight is chosen by the "
        "configured rule. Both take any shape, and weigh short waves alike: where both levels are "
        "those that make the data likely, they differ little.",
        contest.FEATURE_FIT: f"The feature fit knows the shape ({features}) and looks for where, "
        "how wide, how strong and with what friction. Where the shape is right nothing can beat "
        "it; where it is wrong, see below.",
    }
    return (
        "A finger slides over the scene drawn below; film elements under its skin give a rate "
        f"signal. White noise is added at {len(ds['snr'])} levels, {ds.sizes['seed']} draws each, "
        "and every method gets the same signals and the same noise level, and recovers the "
        "pressure p(x) and the shear q(x).",
        *(text for name, text in about.items() if name in ds["method"].values),
    )


def _verdicts(ds: xarray.Dataset) -> tuple[str, ...]:
    """Ranking of the methods at each level, in words."""
    names = [str(name) for name in ds["method"].values]
    said = []
    for s, level in enumerate(ds["snr"].values):
        comparisons = contest.pairs(ds["error_overall"].values[:, s])
        together = [f"{names[p.better]} and {names[p.worse]}" for p in comparisons if not p.apart]
        order = np.argsort(ds["error_overall"].values[:, s].mean(axis=1), kind="stable")
        mean = 100 * ds["error_overall"].values[:, s].mean(axis=1)
        listed = ", then ".join(f"{names[m]} ({mean[m]:.3g} %)" for m in order)
        end = f"; {', '.join(together)} are not told apart" if together else ""
        said.append(f"At {level:g} dB: {listed}{end}.")
    return tuple(said)


def _wrong_section(name: str, ds: xarray.Dataset, wrong: xarray.Dataset) -> Section:
    return Section(
        "When the shape is wrong",
        (
            f"The same signals fitted with another feature, {name.lower()}, which the scene does "
            "not hold. The fit states a small error, as it knows of noise only; its true error is "
            "larger. What gives it away is the residual, in units of the noise and squared: 1 "
            "where noise alone is left. The more noise there is, the less of the mistake "
            "shows there; the log evidence (positive: the right feature is more probable) tells "
            "more.",
        ),
        {"estimates_wrong_feature": lambda: figures.estimates(
            xarray.concat([ds, wrong.assign_coords(method=[f"{name} (wrong)"])], "method",
                          data_vars="minimal")
            .isel(snr=-1, seed=0)
        )},
        {"estimates_wrong_feature": "At the highest signal-to-noise ratio, first draw."},
        (_wrong_table(ds, wrong),),
    )  # fmt: skip


def _assumed(scene: SceneComparison) -> Rows:
    levels = ", ".join(f"{level:g}" for level in scene.draws.snr_dB)
    noise = ", ".join([f"white at {levels} dB", *scene.noises])
    friction, numbers = scene.stated
    rows = assumed(scene.sim, noises=(), effects=scene.effects, friction=friction, numbers=numbers)
    rows = tuple((what, noise if what == "noise" else value) for what, value in rows)
    times = "one call a draw, weights chosen anew in each; steady is the median after the first"
    return (*rows, ("times", times))
