"""Uncertainty budget of a fit: which part of each standard error comes from where.

The facts c of the rig are fitted beside the parameters z, as numbers of variance one a priori. The
error of both together is P (J^T n + e), with P their covariance, n the whitened noise and e, of
variance one in each direction, how far the facts are from what is stated. So direction j adds
P_zj^2 to the variance of z, and the noise all that is left: the parts add up in squares, exactly.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..nonlinear import Fit
from ..rig.error import CALIBRATION, NOISE, contradiction

STEP = 1e-3  # of a move, in differences of what is derived from the parameters

Read = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Budget:
    """The `parts` of the standard error of each parameter by their source; `left`: the variance
    that the fit leaves of each fact, of 1 beforehand."""

    parts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    left: Mapping[str, float] = field(default_factory=dict)

    def reduced(self, name: str, source: str, factor: float) -> float:
        """The standard error of a parameter once one fact is known better by a factor."""
        parts, more = self.parts[name], factor**2 - 1
        squares = sum(part**2 for part in parts.values())
        gone = parts[source] ** 2 * more / (1 + more * self.left[source])
        return float(np.sqrt(max(squares - gone, 0.0)))


def rows_of(fit: Fit, name: str) -> np.ndarray:
    """Where the numbers of an array `name` are among the free parameters."""
    return np.array([i for i, each in enumerate(fit.names) if each.partition("[")[0] == name], int)


def names_of_facts(sources: tuple[str, ...]) -> dict[str, str]:
    """The names of facts that are fitted, in place of their numbers; of what a calibration left no
    direction is one fact."""
    every = enumerate(sources)
    return {f"calibration[{i}]": source for i, source in every if source != CALIBRATION}


def budget_of(
    fit: Fit,
    read: Read,
    report: Callable[[Fit], Read],
    sources: tuple[str, ...],
    others: Mapping[str, np.ndarray],
) -> Budget:
    """The budget of each parameter that was `read`, empty where no error has any part but the
    noise.

    `report` reads the parameters from a fit; `sources` (j,) are those of the directions that the
    rig's errors were fitted in; `others` by their source: moves (m, k) that are in what was read
    and not in the errors of the fit. NaN where a standard error is infinite.
    """
    own = rows_of(fit, "calibration")
    moves = [(source, fit.covariance[:, i]) for source, i in zip(sources, own, strict=True)]
    moves += [(source, move) for source, each in others.items() for move in each.T]
    if not moves:
        return Budget()
    squares = {name: dict.fromkeys([source for source, _ in moves], 0.0) for name in read}
    for source, move in moves:
        if np.isfinite(move).all() and move.any():
            above, below = (report(fit.moved(sign * STEP * move)) for sign in (1, -1))
            for name in read:
                part = (above[name][0] - below[name][0]) / (2 * STEP)
                squares[name][source] += part**2
    left = {source: float(fit.covariance[i, i]) for source, i in zip(sources, own, strict=True)}
    return Budget({name: _parts(read[name][1], squares[name]) for name in read}, left)


def _parts(stderr: float, squares: Mapping[str, float]) -> dict[str, float]:
    if not np.isfinite(stderr):
        return dict.fromkeys((NOISE, *squares), np.nan)
    left = max(stderr**2 - sum(squares.values()), 0.0)
    return {NOISE: float(np.sqrt(left)), **{k: float(np.sqrt(v)) for k, v in squares.items()}}


def contradicted(fit: Fit, sources: tuple[str, ...]) -> tuple[str, ...]:
    """A warning on facts that the data contradict: found further from what is stated than their
    errors and those of the fit explain."""
    own = rows_of(fit, "calibration")
    if not len(own) or not np.isfinite(fit.covariance[np.ix_(own, own)]).all():
        return ()
    found = np.asarray(fit.value["calibration"], float)
    return contradiction(found, np.diag(fit.covariance)[own], sources)
