"""Conformal bands: standard errors scaled by what passes over known surfaces show of them.

The bands of a method hold where its model of the sensor holds. Where a depth or a gain is wrong by
more than its tolerance, or the skin is no half space, bands are too narrow. Passes over surfaces of
known traction measure by how much, and split conformal prediction (Papadopoulos et al. 2002; Vovk,
Gammerman and Shafer 2005; Lei et al. 2018) turns that into a guarantee that needs no model.

The cells of a pass are not exchangeable, but passes are. So the score of a pass is one number: the
multiple of the standard error within which a `share` of its cells lies. Of K passes and a further
one that is exchangeable with them, the score of the further one is at most the k-th least of the K
with probability k / (K + 1) or more.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..errors import BadInput, number, of_kind, refuse
from ..grid import as_real
from ..numerics import BAND_90
from ..recording.known_passes import check_count
from .constrained_estimate import ConstrainedEstimate
from .estimate import COMPONENTS, Estimate, TractionEstimate, deviation
from .line.problem import LineProblem
from .method import Method
from .problem import Problem


class Conformal(Method):
    """A method whose standard errors of p and of q are multiplied by a factor each, so that its
    90 % bands hold what passes over known surfaces show. Make one by
    [`of_passes`][srsinv.Conformal.of_passes].

    - `method`: what inverts. `factor_p`, `factor_q`: on its standard errors.

    Every other cell, and every other scan, has the same factors. Raises `BadInput` for factors that
    are not above zero; in a call for an estimate whose bands are not normal.
    """

    method: Method
    factor_p: Float[Array, ""]
    factor_q: Float[Array, ""]

    def __init__(self, method: Any, factor_p: Any, factor_q: Any):
        self.method = of_kind("method", method, Method, "a method, such as srsinv.Wiener()")
        wanted = "a positive factor"
        self.factor_p = as_real(number("factor_p", factor_p, wanted, above=0))
        self.factor_q = as_real(number("factor_q", factor_q, wanted, above=0))

    @classmethod
    def of_passes(
        cls,
        method: Method,
        passes: Sequence[tuple[Problem | LineProblem, Any]],
        *,
        confidence: float = 0.9,
        share: float = 0.9,
    ) -> "Conformal":
        """Calibrate the bands of `method` on passes over known surfaces.

        - `passes`: the problem of each pass, and its traction (2, n) [Pa] on the line that the
          estimate has, `problem.to_grid().line`. p and q count as deviations from their means.
        - `confidence`: the probability, over these passes and a further one, that the bands of the
          further one hold a `share` of its cells. It is met for p and for q, each by itself.

        Raises `BadInput` for fewer passes than the confidence needs (9 for 0.9), for a traction of
        another shape, and for a pass whose estimate has no bands.
        """
        wanted = "a number between 0 and 1"
        number("confidence", confidence, wanted, above=0, below=1)
        number("share", share, wanted, above=0, below=1)
        check_count(len(passes), confidence)
        scores = np.array([_score(method(problem), truth, share) for problem, truth in passes])
        # With rounding of (K + 1) times a decimal fraction left aside.
        k = math.ceil((len(passes) + 1) * confidence - 1e-9)
        p, q = np.sort(scores, axis=0)[k - 1] / BAND_90
        return cls(method, p, q)

    def __call__(self, problem: Problem | LineProblem) -> Estimate:
        """The estimate of `method` with its standard errors multiplied; its stats have the
        factors."""
        return widened(self.method(problem), (float(self.factor_p), float(self.factor_q)))

    @property
    def chooses_prior(self) -> bool:
        return self.method.chooses_prior

    def spectra(self, problem: LineProblem) -> Float[Array, "c k"] | None:
        return self.method.spectra(problem)


def widened(estimate: Estimate, factors: tuple[float, float]) -> TractionEstimate:
    """The estimate with the errors of p and of q multiplied by these factors."""
    if not isinstance(estimate, TractionEstimate) or isinstance(estimate, ConstrainedEstimate):
        raise BadInput(
            f"The bands of {type(estimate).__name__} are not those of a standard error in each "
            "cell: give Wiener or Tikhonov without a constraint."
        )
    each = np.array(factors)
    own = each[: 1 if estimate.friction is not None else 2]
    covariance, rig_errors = estimate.covariance, estimate.rig_errors
    if covariance is not None and covariance.ndim == 3:
        covariance = covariance * (own[:, None] * own)[..., None]
    elif covariance is not None:
        by_unknown = np.repeat(own, covariance.shape[0] // own.size)
        covariance = covariance * (by_unknown[:, None] * by_unknown)
    if estimate.friction is not None:  # q = mu p: one error
        each = np.array([factors[0], factors[0]])
    return dataclasses.replace(
        estimate,
        stderr=estimate.stderr * each[:, None],
        covariance=covariance,
        rig_errors=None if rig_errors is None else rig_errors * own[:, None],
        stats={**estimate.stats, "conformal_factor_p": each[0], "conformal_factor_q": each[1]},
    )


def _score(estimate: Estimate, truth: Any, share: float) -> Float[np.ndarray, "2"]:
    """The multiple of the standard error within which a `share` of the scanned cells lies, of p and
    of q; infinite where there is no answer."""
    truth = np.asarray(truth, float)
    shape = np.shape(estimate.value)
    refuse(
        truth.shape != shape or not np.isfinite(truth).all(),
        f"The traction of a pass has the shape {truth.shape}: give finite p and q in each cell of "
        f"the estimate's line, {shape}.",
    )
    refuse(
        not estimate.has_bands,
        "The estimate of a pass has no bands, which the passes are to calibrate: give a method "
        "with standard errors.",
    )
    if not estimate.status.is_answer:
        return np.full(len(COMPONENTS), np.inf)
    cells = np.any(np.isfinite(np.asarray(estimate.whitened)), axis=0)
    value, stderr = estimate.deviation(cells)
    wrong = np.abs(deviation(value, cells) - deviation(truth, cells))
    size = np.maximum(np.asarray(stderr)[:, cells], np.finfo(float).tiny)
    return np.quantile(wrong / size, share, axis=-1, method="higher")
