"""Whether bands and intervals are calibrated: ranks of truths that are drawn from their prior."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import whole
from srsinv.inverse.estimate import COMPONENTS
from srsinv.progress import steps
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, without_unit

from .figures import held_passes, histograms
from .methods import BROKEN, ranked_methods
from .passes import ConformalStudy
from .ranks import Ranks, RankTest

LEAST_DRAWS = 20
REJECTED = 1e-3  # p-value below which ranks are not uniform
Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result:
    """Ranks of every method over draws, their chi-square, and conformal bands of a wrong rig.

    Raises `BadInput` for too few draws, unknown methods, and refusals of the configuration's parts.
    """
    settings = cfg["calibration_of_bands"]
    wanted = f"a whole number from {LEAST_DRAWS}"
    quick, slow = (
        whole(f"calibration_of_bands.{key}", settings[key], wanted, least=LEAST_DRAWS)
        for key in ("draws", "slow_draws")
    )
    bins = whole("calibration_of_bands.bins", settings["bins"], "a whole number from 4", least=4)
    with config.precision(cfg):
        methods, study = ranked_methods(cfg), ConformalStudy.of(cfg, settings["conformal"])
        ranks: dict[str, Mapping[str, Ranks]] = {}
        with steps(f"ranks of {len(methods)} methods", methods) as each:
            for i, method in enumerate(each):
                rng = np.random.default_rng([config.seed(cfg), i])
                ranks[method.label] = method.ranks(rng, quick if method.is_quick else slow)
        passes = study()
        sensor = config.sensor(cfg)
    facts = {
        **settings["prior"],
        "elements": len(sensor.elements),
        "depth_m": float(sensor.depth_m),
        "cells": cfg["grid"]["cells"],
        "effects_on": listed(cfg["effects"]),
        "noises": listed(cfg["noise"]),
    }
    data = _dataset(ranks, bins, passes).assign_attrs(facts)
    shown = sections(__file__, histograms=histograms, held_passes=held_passes)
    return Result(_title(data), data, shown)


def _dataset(
    ranks: Mapping[str, Mapping[str, Ranks]], bins: int, passes: Variables
) -> xarray.Dataset:
    """The tests of all quantities (row) and of all methods, and the conformal study."""
    rows = [(method, name, values) for method, of in ranks.items() for name, values in of.items()]
    tests = [RankTest.of(values, bins) for *_, values in rows]
    quantities = np.array([len(of) for of in ranks.values()])
    ends = np.cumsum(quantities)[:-1]
    p_values, coverage = (
        np.split(np.array(each), ends)
        for each in ([t.p_value for t in tests], [t.coverage for t in tests])
    )
    # Of the least of several p-values, by Bonferroni's inequality.
    of_method = np.minimum(1.0, quantities * np.array([each.min() for each in p_values]))
    is_broken = np.array([BROKEN in method for method in ranks])
    is_uniform = of_method >= REJECTED
    draws = [next(iter(of.values())).size for of in ranks.values()]
    own = ~is_broken
    held = sum(n * float(each.sum()) for n, each, o in zip(draws, coverage, own, strict=True) if o)
    all_draws = int(np.sum(np.array(draws) * quantities * own))
    return dataset(
        {
            "density": (("row", "bin"), [test.density for test in tests], "1"),
            "band": (("row", "end"), [test.band for test in tests], "1"),
            "p_value_of_quantity": ("row", [test.p_value for test in tests], "1"),
            "coverage_of_quantity": ("row", [test.coverage for test in tests], "1"),
            "draws": ("method", draws, "1"),
            "quantities": ("method", [", ".join(map(_words, of)) for of in ranks.values()], "1"),
            "p_value": ("method", of_method, "1", "p_value_{method}"),
            "coverage": ("method", [each.mean() for each in coverage], "1", "coverage_{method}"),
            "is_broken": ("method", is_broken.astype(np.int8), "1"),
            "verdict": ("method", np.where(is_uniform, "uniform", "not uniform"), "1"),
            **passes,
            **scalars({
                "methods": int(own.sum()),
                "methods_calibrated": int(np.sum(own & is_uniform)),
                "coverage_of_all": held / max(all_draws, 1),
                "truths": all_draws,
                "broken_is_found": int(bool(np.all(~is_uniform[is_broken]) and is_broken.any())),
            }),
        },
        {
            "method": (list(ranks), "1"),
            "row": ([f"{method}: {_words(name)}" for method, name, _ in rows], "1"),
            "of_method": ("row", [method for method, *_ in rows], "1"),
            "words": ("row", [_words(name) for _, name, _ in rows], "1"),
            "bin": ((np.arange(bins) + 0.5) / bins, "1"),
            "component": (list(COMPONENTS), "1"),
            "end": (["least", "most"], "1"),
        },
        rejected=REJECTED,
    )  # fmt: skip


def _words(quantity: str) -> str:
    """A quantity's name without its unit."""
    return without_unit(quantity).replace("_", " ")


def _title(data: xarray.Dataset) -> str:
    count, good = int(data["methods"]), int(data["methods_calibrated"])
    held = f"{100 * float(data['coverage_of_all']):.1f} % of {int(data['truths']):,} truths"
    return f"The bands of {good} of {count} methods are calibrated: 90 % bands hold {held}"
