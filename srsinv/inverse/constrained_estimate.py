"""The estimate under a constraint: draws of the traction in place of a covariance."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..errors import of_kind
from ..grid import Line
from ..numerics import BAND_90
from ..views import ViewData
from .estimate import TractionEstimate, deviation, overlap

ENDS = (0.05, 0.95)  # of a 90 % band


class ConstrainedEstimate(TractionEstimate):
    """An estimate whose errors are not normal: its bands are quantiles of draws.

    - `draws` (draw, 2, n): p and q [Pa] of the posterior, every one of them admissible. `stderr` is
      their standard deviation, zero where all are alike.
    """

    draws: Float[np.ndarray, "draw 2 n"] = dataclasses.field(kw_only=True)

    @property
    def band(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = band_of(self.draws)
        return low, high

    def view_data(self) -> ViewData:
        data = super().view_data()
        ends = zip(("estimate_low", "estimate_high"), self.band, strict=True)
        along = ("component", "x")
        variables = {name: (along, values, "Pa") for name, values in ends}
        return data._replace(variables={**data.variables, **variables})

    def on(self, line: Line) -> "ConstrainedEstimate":
        of_kind("line", line, Line, "a line, such as Open(256, 1.5e-4)")
        weights = overlap(self.line, line)
        value, draws = (np.asarray(each) @ weights.T for each in (self.value, self.draws))
        return dataclasses.replace(
            self, line=line, value=value, draws=draws, stderr=draws.std(axis=0), averaging=None,
            are_cells=False,
        )  # fmt: skip

    def deviation(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, draws = np.asarray(self.value), np.asarray(self.draws)
        means = draws[..., cells].mean(axis=-1, keepdims=True)
        low, high = band_of(draws - means)
        # Of a normal error that has a band as wide.
        stderr = (high - low) / (2 * BAND_90)
        return value - value[:, cells].mean(axis=-1, keepdims=True), stderr

    def coverage(
        self, truth: Float[Any, "2 n"], cells: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, "2"]:
        draws = np.asarray(self.draws)
        low, high = band_of(draws - draws[..., cells].mean(axis=-1, keepdims=True))
        true, slack = deviation(truth, cells), 1e-6 * np.max(np.abs(np.asarray(truth)))
        is_inside = (true >= low[:, cells] - slack) & (true <= high[:, cells] + slack)
        return np.asarray(is_inside.mean(axis=-1))

    def z_rms(
        self, truth: Float[Any, "2 n"], cells: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, "2"]:
        # By the rms standard error: many cells have none, as all draws are zero there.
        value, stderr = self.deviation(cells)
        wrong = deviation(value, cells) - deviation(truth, cells)
        size = np.sqrt(np.mean(stderr[:, cells] ** 2, axis=-1))
        error = np.sqrt(np.mean(wrong**2, axis=-1))
        return np.where(error > 0, error / np.maximum(size, np.finfo(float).tiny), 0.0)


def band_of(draws: Float[np.ndarray, "draw *row"]) -> Float[np.ndarray, "2 *row"]:
    """The ends of the 90 % band of draws, which a further draw is within in 90 % of all cases."""
    return np.quantile(draws, ENDS, axis=0, method="weibull")
