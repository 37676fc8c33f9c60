"""The prior precision of the traction, and scores of a prior given the data.

Wiener's filter and Tikhonov's method minimise |N^(-1/2) (m - G r)|^2 + |P^(1/2) r|^2 and differ in
P alone: the inverse traction spectrum, or a weighted derivative penalty. The minimiser is the
posterior mean of the Gaussian model, and (G^H N^-1 G + P)^-1 its covariance.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ...grid import Line
from ..estimate import Numbers


class Prior(eqx.Module):
    """Base of Gaussian priors: a precision P [1/Pa^2] of the traction, one spectrum for each
    component.

    `root` and `apply` are to be defined.
    """

    @abc.abstractmethod
    def root(self, line: Line) -> Float[Numbers, "c k"]:
        """P^(1/2) at line.k, the line taken as periodic."""

    @abc.abstractmethod
    def apply(self, line: Line, r: Float[Numbers, "c n"]) -> Float[Numbers, "c n"]:
        """P r on the line as it is."""

    def differences(self, line: Line) -> tuple[int, Float[Numbers, " c"]] | None:
        """Where P is a weighted sum of squared differences of neighbouring cells: their order, and
        the weight of each component's [1/Pa^2]. None where it is no such sum."""
        del line
        return None


def squared_differences(
    r: Float[np.ndarray, "c n"], order: int, wraps: bool
) -> Float[np.ndarray, "c n"]:
    """The sum of squared differences of this order as a map: D^T D r, in numpy."""

    def differences(r: np.ndarray) -> np.ndarray:
        return np.roll(r, -1, axis=-1) - r if wraps else r[:, 1:] - r[:, :-1]

    def transpose(d: np.ndarray) -> np.ndarray:
        if wraps:
            return np.roll(d, 1, axis=-1) - d
        zero = np.zeros((len(d), 1), d.dtype)
        return np.concatenate([zero, d], axis=-1) - np.concatenate([d, zero], axis=-1)

    for _ in range(order):
        r = differences(r)
    for _ in range(order):
        r = transpose(r)
    return r


class Score(NamedTuple):
    """Terms of a rule's criterion for a prior of precision P: scalars, or one number for each prior
    of a batch. r is the solution, C its posterior covariance, and all weights move together where a
    derivative is by their common logarithm, log w.

    - `residual`: the whitened residual's sum of squares; `freedom`: the effective number of fitted
      parameters; `log_evidence`: up to a constant, of the nearest periodic model where the path
      takes that.
    - `seminorm`: r^T P r. `pull`: (P r)^T C P r, half the residual's derivative by log w.
    - `movement`: |C P r|^2 less its mean, the square of the solution's derivative by log w.
    - `periodogram` (k,): the whitened residual's power, summed over elements.
    """

    residual: Float[Array, "..."]
    freedom: Float[Array, "..."]
    log_evidence: Float[Array, "..."]
    seminorm: Float[Array, "..."]
    pull: Float[Array, "..."]
    movement: Float[Array, "..."]
    periodogram: Float[Array, "... k"]


class Solution(NamedTuple):
    """The traction's deviation from its known mean, as a path finds it.

    - `resolved_dof`: effective degrees of freedom of each component, the trace of its resolution.
    - `condition`: the condition number of the path's system.
    - `rig_errors` (j, c, n): what the rig's errors make of the value (line/rig_bands.py), where the
      path finds them itself; not in `stderr` and `covariance`.
    """

    value: Float[Numbers, "c n"]
    stderr: Float[Numbers, "c n"]
    covariance: Numbers
    averaging: Float[Numbers, "c c n"]
    resolved_dof: Float[Numbers, " c"]
    condition: Float[Numbers, ""]
    rig_errors: Float[Numbers, "j c n"] | None = None
