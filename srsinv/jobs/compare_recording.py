"""The comparison on a recording, without a truth: methods are scored on held-out samples.

The recording's cells are split into two halves, every other one to each: over a depth there are
several cells, so that either half determines the same traction, with independent noise. A method's
fit to one half is compared with the samples of the other.
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float, Int

from ..forward.sensor import Sensor
from ..inverse.estimate import COMPONENTS
from ..inverse.line_problem import LineProblem
from ..inverse.method import Method
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from . import contest
from .analysis import BAND_90, deviation, element_names, in_metrics, notes_on
from .cells import RecordingProblem
from .contest import Runs

ROUNDING = 1e-9  # of the range: values that differ by less are the same but for rounding
WELL = 1.2  # mean square of the whitened residual, up to which noise explains it
PARTS = ("all", "even cells", "odd cells")
DRAWN = ("method", "part")


def on_recording(
    loaded: RecordingProblem, methods: Mapping[str, Method], features: Collection[str]
) -> Outcome:
    """Every method on the whole recording and on its two halves; `features`: the names of those
    whose sum is fitted."""
    title, whole = loaded.recording.name, loaded.problem
    problems = whole, *contest.split_odd_even(whole)
    runs = contest.run_all(methods, problems)
    dataset = _dataset(title, loaded.sensor, problems, loaded.recording.signal_unit, runs)
    return Outcome(
        f"{title}: {', '.join(runs)} compared",
        _metrics(dataset, runs),
        dataset,
        _sections(features, dataset, runs, loaded.assumed, whole),
        _summary(dataset, runs),
    )


# --- numbers ---------------------------------------------------------------------------------


def _dataset(
    title: str,
    sensor: Sensor,
    problems: tuple[LineProblem, LineProblem, LineProblem],
    unit: str,
    runs: Mapping[str, Runs],
) -> xarray.Dataset:
    whole, even, odd = problems
    observed = whole.observed_cells

    def each(get) -> np.ndarray:
        """(method, part, ...)"""
        return np.asarray([[get(each) for each in one.estimates] for one in runs.values()])

    value = each(lambda f: f.value)
    stderr = np.stack(
        [
            [
                contest.stderr_that_holds(estimate, problem.observed_cells)
                for estimate, problem in zip(one.estimates, problems, strict=True)
            ]
            for one in runs.values()
        ]
    )
    fitted = each(lambda f: f.fitted)
    signal = np.where(whole.is_observed, np.asarray(whole.data + whole.mean_signal), np.nan)
    holdout = [
        [
            contest.holdout_chi2(one.estimates[1], odd),
            contest.holdout_chi2(one.estimates[2], even),
        ]
        for one in runs.values()
    ]
    moved = deviation(value[:, 1], observed) - deviation(value[:, 2], observed)
    along, samples = ("component", "x"), ("element", "x")
    p = deviation(value[:, 0, 0], observed)
    apart = np.linalg.norm(p[:, None] - p[None], axis=-1)
    variables = {
        "signal": (samples, signal, unit),
        "observed": (samples, whole.is_observed.astype(np.int8), "1"),
        "estimate": ((*DRAWN, *along), value, "Pa"),
        "estimate_stderr": ((*DRAWN, *along), stderr, "Pa"),
        "fitted_signal": ((*DRAWN, *samples), fitted, unit),
        "whitened_residual": (
            (*DRAWN, *samples), (signal - fitted) / whole.noise_rms, "1"
        ),
        "misfit": (DRAWN, each(lambda f: f.misfit), "1"),
        "holdout_chi2": (("method", "half"), holdout, "1"),
        "rank": (("method", "half"), contest.ranks(np.asarray(holdout)), "1"),
        "repeatability": (
            ("method", "component"), np.sqrt(np.mean(moved**2, axis=-1)) / 2, "Pa"
        ),
        "stderr_rms": (
            ("method", "component"), np.sqrt(np.mean(stderr[:, 0][..., observed] ** 2, axis=-1)),
        "Pa" ),
        "peak_position": (
            ("method", "component"),
            np.asarray(whole.line.x)[observed][_peak(value[:, 0][..., observed])], "m",
        ),
        "difference_of_p": (
            ("method", "other"), apart / (np.linalg.norm(p, axis=-1) + 1e-300)[None], "1"
        ),
        "converged": (DRAWN, each(lambda f: f.status == "converged").astype(np.int8), "1"),
        "quality": (DRAWN, each(lambda f: str(f.quality)), "1"),
        "first_call_s": (("method",), [one.first_call_s for one in runs.values()], "s"),
        "steady_call_s": (("method",), [one.steady_s for one in runs.values()], "s"),
    }  # fmt: skip
    coordinates = {
        "x": ("x", np.asarray(whole.line.x), {"units": "m"}),
        "part": ("part", list(PARTS), {"units": "1"}),
        "component": ("component", list(COMPONENTS), {"units": "1"}),
        "method": ("method", list(runs), {"units": "1"}),
        "other": ("other", list(runs), {"units": "1"}),
        "half": ("half", list(PARTS[1:]), {"units": "1"}),
        "element": ("element", element_names(sensor), {"units": "1"}),
    }
    return xarray.Dataset(
        {name: (dims, np.asarray(values), {"units": units})
         for name, (dims, values, units) in variables.items()},
        coordinates,
        {"title": title, "mean_unobserved": ",".join(COMPONENTS)},
    )  # fmt: skip


def _peak(values: Float[np.ndarray, "... x"]) -> Int[np.ndarray, "..."]:
    """Where the values are largest: in the middle, where several are but for rounding."""
    top, spread = values.max(axis=-1, keepdims=True), np.ptp(values, axis=-1, keepdims=True)
    is_top = values >= top - ROUNDING * spread
    last = values.shape[-1] - 1 - np.argmax(is_top[..., ::-1], axis=-1)
    return (np.argmax(is_top, axis=-1) + last) // 2


def _metrics(ds: xarray.Dataset, runs: Mapping[str, Runs]) -> dict[str, Any]:
    metrics: dict[str, Any] = {"cells": ds.sizes["x"]}
    for m, (name, one) in enumerate(runs.items()):
        key = name.lower().replace(" ", "_")
        metrics |= {f"{what}_{key}": said for what, said in in_metrics(one.estimates[0]).items()}
        metrics[f"misfit_{key}"] = float(ds["misfit"].values[m, 0])
        metrics[f"holdout_chi2_{key}"] = float(ds["holdout_chi2"].values[m].mean())
        metrics[f"rank_mean_{key}"] = float(ds["rank"].values[m].mean())
        metrics[f"converged_{key}"] = bool(ds["converged"].values[m].all())
        metrics[f"first_call_s_{key}"] = float(ds["first_call_s"].values[m])
        metrics[f"steady_call_s_{key}"] = float(ds["steady_call_s"].values[m])
        for c, component in enumerate(COMPONENTS):
            of = {
                f"{component}_peak_position_m": "peak_position",
                f"{component}_repeatability_Pa": "repeatability",
                f"{component}_stderr_rms_Pa": "stderr_rms",
            }
            metrics |= {
                f"{what}_{key}": float(ds[variable].values[m, c]) for what, variable in of.items()
            }
    return metrics


# --- the page --------------------------------------------------------------------------------


def _summary(ds: xarray.Dataset, runs: Mapping[str, Runs]) -> Table:
    holdout, rank = ds["holdout_chi2"].values, ds["rank"].values
    rows = [
        (
            str(ds["method"].values[m]),
            f"{rank[m].mean():.2g} ({rank[m].min():g} to {rank[m].max():g})",
            float(holdout[m].mean()),
            float(np.ptp(holdout[m]) / 2),
            float(ds["misfit"].values[m, 0]),
            *(1e3 * float(ds["peak_position"].values[m, c]) for c in range(2)),
            1e3 * float(ds["steady_call_s"].values[m]),
            float(ds["first_call_s"].values[m]),
            str(ds["quality"].values[m, 0]),
        )
        for m in np.argsort(holdout.mean(axis=1), kind="stable")
    ]
    return Table(
        ("method", "mean rank (range)", "held-out samples", "±", "fitted samples",
         "highest p at x [mm]", "highest q at x [mm]", "steady [ms]", "first call [s]",
         "quality"),
        tuple(rows),
        "Samples: mean square of what the method leaves of them, in units of the noise: 1 where "
        "only noise is left. Unseen: fitted to one half of the cells, judged on the other, both "
        "ways (±: half the difference).",
        notes_on(_worth(runs)),
    )  # fmt: skip


def _worth(runs: Mapping[str, Runs]) -> list[dict[str, Any]]:
    """Quality of each method's answer from all samples."""
    wholes = {name: one.estimates[0] for name, one in runs.items()}
    return [
        {"method": name, "quality": estimate.quality, "reasons": estimate.reasons}
        for name, estimate in wholes.items()
    ]


def _repeat_table(ds: xarray.Dataset) -> Table:
    rows = [
        (
            str(name), component, float(ds["repeatability"].values[m, c]),
            float(ds["stderr_rms"].values[m, c]), BAND_90 * float(ds["stderr_rms"].values[m, c]),
        )
        for m, name in enumerate(ds["method"].values)
        for c, component in enumerate(COMPONENTS)
    ]  # fmt: skip
    return Table(
        ("method", "component", "half the halves' difference [Pa]", "standard error stated [Pa]",
         "half-width of the 90 % band [Pa]"),
        tuple(rows),
        "Rms over the scan, of the deviation from the mean.",
    )  # fmt: skip


def _agreement_table(ds: xarray.Dataset) -> Table:
    names = [str(name) for name in ds["method"].values]
    values = ds["difference_of_p"].values
    rows = [
        (name, *("-" if m == o else f"{values[m, o]:.1%}" for o in range(len(names))))
        for m, name in enumerate(names)
    ]
    return Table(
        ("p by", *(f"against {name}" for name in names)),
        tuple(rows),
        "Norm of the difference over the scan, relative to the method that heads the column.",
    )


def _sections(features: Collection[str], ds, runs, rows, whole: LineProblem) -> tuple[Section, ...]:
    methods = [str(name) for name in ds["method"].values]
    whole_of = ds.isel(part=0)
    parts = [
        Section(
            "What is compared",
            (
                "A finger slid over a surface while its film elements were recorded. Each method "
                "recovers the pressure p(x) and the shear q(x) from the same samples and the same "
                "noise level. Nobody knows the truth here, so a method is judged by what it says "
                "of samples that it was not given: every other cell is held back, and then the "
                "other way around.",
                *_verdicts(ds, runs),
            ),
        ),
        Section(
            "Recovered p and q",
            (
                *notes_on(_worth(runs)),
                "With 90 % bands, less the mean over the scan, which a rate signal does not show. "
                "A feature fit's band is small because it stands on a few parameters: it is the "
                "error if the surface is of that shape, and says nothing of whether it is.",
            ),
            {"estimates": lambda: figures.estimates(whole_of)},
            {"estimates": "p and q by all methods over each other, from all samples."},
            (_agreement_table(ds),),
        ),
        Section(
            "What is left of the signal",
            (
                "The recorded signal with what each method explains of it, and what it leaves, in "
                "units of the noise: a pattern there is something that the method cannot say.",
            ),
            {
                "signals": lambda: figures.signals(whole_of),
                "residual": lambda: figures.residual(whole_of),
            },
            {"signals": "Signal and fits.", "residual": "What is left, in units of the noise."},
        ),
        Section(
            "Ranking",
            ("By the held-out samples; two halves are two draws, and cannot give more than a first "
             "impression of the spread.",),
            {"ranking": lambda: figures.ranking(
                ds["rank"].values[:, None], methods, ["held-out samples"],
                "Rank over the two halves"
            )},
            {"ranking": "Mean rank, with the best and the worst."},
            (_pair_table(ds), _repeat_table(ds)),
        ),
    ]  # fmt: skip
    if contest.FEATURE_FIT in runs:
        parts.append(_feature_section(features, runs[contest.FEATURE_FIT]))
    means = tuple((f"mean of {c}", words) for c, words in whole.mean_statement().items())
    parts.append(Section("What was assumed", tables=(Table(("what", "value"), (*rows, *means)),)))
    return tuple(parts)


def _verdicts(ds: xarray.Dataset, runs: Mapping[str, Runs]) -> tuple[str, ...]:
    """Verdicts on the residuals, in words."""
    said = []
    for m, (name, one) in enumerate(runs.items()):
        misfit = float(ds["misfit"].values[m, 0])
        holdout = float(ds["holdout_chi2"].values[m].mean())
        if holdout <= WELL:
            verdict = "noise alone explains what it leaves"
        elif misfit <= WELL:
            verdict = "what is more than noise there is its error with half of the samples"
        else:
            verdict = (
                "more than noise is left: what it assumes does not hold everywhere on this scan"
            )
        bad = [
            reconstruction.status
            for reconstruction in one.estimates[1:]
            if reconstruction.status != "converged"
        ]
        warning = f" From one half of the samples: {bad[0]}." if bad else ""
        said.append(
            f"{name}: {misfit:.3g} times the noise's power is left of the samples it saw, "
            f"{holdout:.3g} of those it did not; {verdict}.{warning}"
        )
    return tuple(said)


def _pair_table(ds: xarray.Dataset) -> Table:
    names = [str(name) for name in ds["method"].values]
    rows = tuple(
        (
            names[pair.better], names[pair.worse], f"{pair.difference:.3g} ± {pair.spread:.2g}",
            f"{pair.wins} of 2", "told apart" if pair.apart else "not told apart",
        )
        for pair in contest.pairs(ds["holdout_chi2"].values)
    )  # fmt: skip
    return Table(
        ("less left of held-out samples", "more left", "by", "halves in which it is so", "verdict"),
        rows,
        "In units of the noise's power, mean ± standard deviation over the halves; told apart by "
        "Student's t at 95 %, which two halves seldom allow.",
    )


def _feature_section(features: Collection[str], one: Runs) -> Section:
    names = " + ".join(features).replace("_", " ")
    whole, *parts = [each.parameters for each in one.estimates]
    rows = tuple(
        (name, value, stderr, *(part[name][0] for part in parts))
        for name, (value, stderr) in whole.items()
    )
    return Section(
        "The fitted feature",
        (f"{names}, in SI units: from all samples, and from either half.",),
        tables=(Table(("parameter", "value", "standard error", *PARTS[1:]), rows),),
    )
