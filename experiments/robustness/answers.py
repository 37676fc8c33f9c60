"""The answers to faulty recordings as a dataset, and what they come to."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray

from srsinv.inverse.estimate import COMPONENTS
from srsinv.inverse.quality import Quality
from srsinv.jobs.trials import Row
from srsinv.report.data import dataset, scalars

HINDSIGHT = "best in hindsight"  # in place of a method
MOST_RATIO = 1.5  # of an error over that of the best weights: up to here little is lost
LEAST_COVERAGE = 0.5  # of 90 % bands: below it a good answer misleads
HOPELESS = 0.5  # error of the best weights, beyond which there is no answer to be found
REFUSED = "refused"
NO_ANSWER = (str(Quality.FAILED), REFUSED)


def answers(
    rows: Sequence[Row],
    scenes: Sequence[str],
    faults: Sequence[str],
    methods: Sequence[str],
    draws: int,
    **attributes: Any,
) -> xarray.Dataset:
    """The dataset of `rows`; NaN, and no words, where a fault makes no sense in a scene."""
    by, size = ("scene", "fault", "draw", "estimator"), (len(scenes), len(faults), draws)
    best = np.full((*size, 2), np.nan)
    error, coverage = (np.full((*size, len(methods), 2), np.nan) for _ in range(2))
    quality, reasons = (np.full((*size, len(methods)), "", object) for _ in range(2))
    for row in rows:
        at = scenes.index(row["scene"]), faults.index(row["fault"]), int(row["draw"])
        if row["method"] == HINDSIGHT:
            best[at] = row.get("error", [np.nan] * 2)
            continue
        own = *at, methods.index(row["method"])
        if "failure" in row:
            quality[own], reasons[own] = REFUSED, row["failure"]
        else:
            error[own], coverage[own] = row["error"], row["coverage"]
            quality[own], reasons[own] = row["quality"], row["reasons"]
    total, least = (np.sqrt(np.mean(each**2, axis=-1)) for each in (error, best))
    ratio = total / least[..., None]
    of_each = {"ratio": ratio, "quality": quality, "coverage": coverage.min(axis=-1), "best": least}
    return dataset(
        {
            "error": ((*by, "component"), error, "1"),
            "best_error": ((*by[:-1], "component"), best, "1"),
            "best_error_of_both": (by[:-1], least, "1"),
            "ratio": (by, ratio, "1"),
            "coverage": ((*by, "component"), coverage, "1"),
            "answer_quality": (by, quality.astype(str), "1"),
            "said": (by, reasons.astype(str), "1"),
            **_shares(**of_each),
            **scalars({
                "faults": len(set(faults) - {"none"}),
                "recordings": int(np.sum(quality[..., 0] != "")),
            }),
        },
        {"scene": (list(scenes), "1"), "fault": (list(faults), "1"),
         "draw": (np.arange(draws), "1"), "estimator": (list(methods), "1"),
         "component": (list(COMPONENTS), "1")},
        most_ratio=MOST_RATIO, least_coverage=LEAST_COVERAGE, hopeless=HOPELESS, **attributes,
    )  # fmt: skip


def _shares(
    ratio: np.ndarray, quality: np.ndarray, coverage: np.ndarray, best: np.ndarray
) -> dict[str, tuple[Any, ...]]:
    """Of each method: counts and shares among all recordings, and medians."""
    tried = quality != ""
    fails = np.isin(quality, NO_ANSWER)
    within = tried & ~fails & (ratio <= MOST_RATIO)
    misleads = (quality == Quality.GOOD) & (coverage < LEAST_COVERAGE)
    of = {
        "no_answer": fails,
        "within": within,
        "good": quality == Quality.GOOD,
        "misleading": misleads,
        "needless_no_answer": fails & (best <= HOPELESS)[..., None],
    }
    number = tried.sum(axis=(0, 1, 2))
    shares = {
        f"{name}_share": ("estimator", each.sum(axis=(0, 1, 2)) / number, "1",
                          f"{name}_share_{{estimator}}")
        for name, each in of.items()
    }  # fmt: skip
    counts = {
        name: ("estimator", of[name].sum(axis=(0, 1, 2)), "1") for name in ("no_answer", "within")
    }
    middle = {
        f"{name}_median": ("estimator", _medians(each), "1", f"{name}_median_{{estimator}}")
        for name, each in {"ratio": ratio, "coverage": coverage}.items()
    }
    return shares | counts | middle


def _medians(each: np.ndarray) -> np.ndarray:
    """Over all recordings, of each method, NaN where there is none."""
    rows = each.reshape(-1, each.shape[-1]).T
    known = [row[np.isfinite(row)] for row in rows]
    return np.array([np.median(row) if row.size else np.nan for row in known])


def title(data: xarray.Dataset) -> str:
    """What the first method makes of all recordings."""
    first = data.isel(estimator=0)
    return (
        f"{first['estimator'].item()} stays within {MOST_RATIO:g} times the best error for "
        f"{int(first['within'])} of {int(data['recordings'])} recordings with and without faults; "
        f"{int(first['no_answer'])} have no answer"
    )
