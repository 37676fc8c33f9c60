"""Whether bands and intervals are calibrated: ranks of truths that are drawn from their prior."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import whole
from srsinv.progress import steps
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections

from .figures import held_passes, histograms
from .methods import BROKEN, ranked_methods
from .passes import ConformalStudy
from .ranks import RankTest, count_band

LEAST_DRAWS = 20
REJECTED = 1e-3  # p-value below which ranks are not uniform
BAND = 0.99  # probability that all bins of uniform ranks keep within the band


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
        methods = ranked_methods(cfg)
        ranks, draws = {}, {}
        with steps(f"ranks of {len(methods)} methods", methods) as each:
            for i, method in enumerate(each):
                rng = np.random.default_rng([config.seed(cfg), i])
                draws[method.label] = quick if method.is_quick else slow
                ranks[method.label] = method.ranks(rng, draws[method.label])
        passes = ConformalStudy.of(cfg, settings["conformal"])()
    rows = [(m, q, values) for m, of in ranks.items() for q, values in of.items()]
    tests = [RankTest.of(values, bins) for *_, values in rows]
    data = _dataset(rows, tests, bins, passes)
    shown = sections(__file__, histograms=histograms, held_passes=held_passes)
    return Result(_title(data), data, shown)


def _dataset(rows, tests: list[RankTest], bins: int, passes: Mapping[str, Any]) -> xarray.Dataset:
    """The tests of all ranks (row), and the conformal study."""
    draws = [values.size for *_, values in rows]
    density = np.array([test.counts * bins / n for test, n in zip(tests, draws, strict=True)])
    bands = np.array([count_band(n, bins, BAND) for n in draws]) * bins / np.array(draws)[:, None]
    names = [f"{method}_{q}" for method, q, _ in rows]
    uniform = [test.p_value >= REJECTED for test in tests]
    broken = [BROKEN in method for method, *_ in rows]
    off = [m for (m, *_), u, b in zip(rows, uniform, broken, strict=True) if not u and not b]
    caught = all(not u for u, b in zip(uniform, broken, strict=True) if b)
    return dataset(
        {
            "density": (("row", "bin"), density, "1"),
            "density_least": ("row", bands[:, 0], "1"),
            "density_most": ("row", bands[:, 1], "1"),
            "chi2": ("row", [test.chi2 for test in tests], "1", "{row}_chi2"),
            "p_value": ("row", [test.p_value for test in tests], "1", "{row}_p_value"),
            "coverage": ("row", [test.coverage for test in tests], "1", "{row}_coverage_90"),
            "draws": ("row", draws, "1"),
            "is_uniform": ("row", np.array(uniform, np.int8), "1"),
            "is_broken": ("row", np.array(broken, np.int8), "1"),
            "verdict": ("row", ["uniform" if each else "not uniform" for each in uniform], "1"),
            **passes,
            **scalars({
                "methods_not_calibrated": len(set(off)),
                "names_not_calibrated": ", ".join(dict.fromkeys(off)),
                "broken_is_caught": int(any(broken) and caught),
            }),
        },
        {
            "row": (names, "1"),
            "method": ("row", [method for method, *_ in rows], "1"),
            "quantity": ("row", [q for _, q, _ in rows], "1"),
            "bin": ((np.arange(bins) + 0.5) / bins, "1"),
            "component": (["p", "q"], "1"),
        },
        level=BAND,
        rejected=REJECTED,
    )  # fmt: skip


def _title(data: xarray.Dataset) -> str:
    own = data.isel(row=data["is_broken"].values == 0)
    count = len(set(own["method"].values.tolist()))
    good = own.isel(row=own["is_uniform"].values == 1)
    off = data["names_not_calibrated"].item()
    left = f"; not those of {off}" if off else ""
    if not good.sizes["row"]:
        return f"The bands of none of {count} methods are calibrated"
    low, high = (100 * float(each) for each in (good["coverage"].min(), good["coverage"].max()))
    return (
        f"{count - int(data['methods_not_calibrated'])} of {count} methods are calibrated: their "
        f"90 % bands hold {low:.0f} to {high:.0f} % of the truths{left}"
    )
