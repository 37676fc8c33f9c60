"""A Kalman filter with a fixed-lag smoother, cell by cell.

The filter's state is that of the state-space model (state_space.py), behind nuisance parameters:
each element's offset or drift, and the waves of mains. Beside it stands the traction of the last
cells, whose estimates improve with every cell that follows. A cell without a signal, or with more
noise than others, enters with its own noise. So one recursion serves all cells and noise levels.

The signals of a cell enter one after the other (Bierman 1977), which needs no matrix to be
factored. Everything is in units of the prior's standard deviations.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .state_space import StateSpace


class Measurement(NamedTuple):
    """The signals of one cell.

    - `signal` (e,), NaN where it is missing, and the variance `noise` (e,) of its white noise.
    - `off_centre` (e,): the mean place of the samples, in cells from the cell's centre.
    - `nuisance` (e, k): the signal of each nuisance parameter.
    - `growth` (k,): the variance that each nuisance parameter gains up to this cell.
    """

    signal: Float[np.ndarray, " e"]
    noise: Float[np.ndarray, " e"]
    off_centre: Float[np.ndarray, " e"]
    nuisance: Float[np.ndarray, "e k"]
    growth: Float[np.ndarray, " k"]


class Innovation(NamedTuple):
    """The differences (e,) of a cell's signals from their prediction, each element's from that of
    the elements before it too, and their variances (e,), noise included; NaN where a signal is
    missing."""

    value: Float[np.ndarray, " e"]
    variance: Float[np.ndarray, " e"]


@dataclasses.dataclass
class FixedLagSmoother:
    """The filter after a cell, and the traction of this and the `lag` cells before it.

    - `mean` (s,), `covariance` (s, s): of the nuisance parameters and the model's state.
    - `traction` (lag + 1, c), `variance` (lag + 1, c): of the cells, the newest at the end;
      `cross` (lag + 1, c, s): their covariance with `mean`.
    - `count`: how many of the cells have been passed.
    """

    mean: Float[np.ndarray, " s"]
    covariance: Float[np.ndarray, "s s"]
    traction: Float[np.ndarray, "cell c"]
    variance: Float[np.ndarray, "cell c"]
    cross: Float[np.ndarray, "cell c s"]
    count: int = 0

    @classmethod
    def starting(cls, model: StateSpace, lag: int, nuisances: int) -> "FixedLagSmoother":
        """Before the first cell of a pass, with so many nuisance parameters that are zero."""
        size, cells = nuisances + model.states, (lag + 1, model.components)
        covariance = np.zeros((size, size))
        covariance[nuisances:, nuisances:] = np.eye(model.states)
        return cls(
            np.zeros(size),
            covariance,
            np.zeros(cells),
            np.zeros(cells),
            np.zeros((*cells, size)),
        )

    @property
    def is_full(self) -> bool:
        """Whether the oldest of the cells has been passed."""
        return self.count == len(self.traction)

    def step(self, model: StateSpace, cell: Measurement) -> Innovation:
        """Pass one more cell; the oldest one leaves."""
        s, k, elements = self.mean.size, cell.growth.size, cell.signal.size
        components = self.traction.shape[1]
        matrix, noise = _prediction(model, cell)
        self.covariance[np.arange(k), np.arange(k)] += cell.growth
        # Of the next state, this cell's traction, and its signals.
        joint = matrix @ self.covariance @ matrix.T + noise
        mean = matrix @ self.mean
        others = self.cross[1:].reshape(-1, s) @ matrix.T
        traction, variance = self.traction[1:].flatten(), self.variance[1:].flatten()
        innovation = Innovation(np.full(elements, np.nan), np.full(elements, np.nan))
        for e in range(elements):
            if np.isnan(cell.signal[e]):
                continue
            i = s + components + e
            row, column = joint[i], others[:, i]
            left, size = cell.signal[e] - mean[i], row[i] + cell.noise[e]
            innovation.value[e], innovation.variance[e] = left, size
            share = row / size
            traction += column * (left / size)
            variance -= column**2 / size
            mean += share * left
            others -= column[:, None] * share
            joint = joint - row[:, None] * share
        own = slice(s, s + components)
        self.mean, self.covariance = mean[:s], (joint[:s, :s] + joint[:s, :s].T) / 2
        self.cross = np.concatenate([others[:, :s], joint[own, :s]]).reshape(self.cross.shape)
        self.traction = np.concatenate([traction, mean[own]]).reshape(self.traction.shape)
        # Without the white noise that the model adds to the traction.
        of_own = joint.diagonal()[own] - model.floor[:components]
        self.variance = np.concatenate([variance, of_own]).reshape(self.variance.shape)
        self.count = min(self.count + 1, len(self.traction))
        return innovation


def _prediction(
    model: StateSpace, cell: Measurement
) -> tuple[Float[np.ndarray, "row s"], Float[np.ndarray, "row row"]]:
    """Matrix and noise that give, from nuisance parameters and the state, the same of the next
    cell, then this one's traction, then its signals where they were sampled."""
    elements, k = cell.nuisance.shape
    rows = len(model.matrix) - elements
    matrix, noise = model.matrix[:rows], model.noise[:rows, :rows]
    if cell.off_centre.any():
        ahead = np.zeros((rows, elements))
        ahead[-elements:] = np.diag(cell.off_centre)
        across = model.noise[:rows, rows:] @ ahead.T
        matrix = matrix + ahead @ model.matrix[rows:]
        noise = noise + across + across.T + ahead @ model.noise[rows:, rows:] @ ahead.T
    if not k:
        return matrix, noise
    with_nuisance = np.zeros((k + rows, k + model.states))
    with_nuisance[:k, :k], with_nuisance[k:, k:] = np.eye(k), matrix
    with_nuisance[-elements:, :k] = cell.nuisance
    return with_nuisance, np.pad(noise, ((k, 0), (k, 0)))
