"""A small state-space model of traction and signal, from their joint covariance.

The film's signal depends on traction far ahead of it and far behind. But of all that was passed, a
few dozen numbers determine nearly everything that can be said of what comes: the leading canonical
variables of past and future (Akaike 1975). They are the state. Its transition, outputs and
innovations are regressions between the true process's random variables, so that the model is
stationary and its covariances are positive whatever is left out.

The past enters by features: each cell on its own near the sensor, polynomials over blocks that
lengthen with the distance farther away.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ...numerics import root_of
from .covariance import JointCovariance

# White noise that the model takes each signal to have at least, as a fraction of its standard
# deviation: noise of less is treated as so much. It bounds the number of states.
LEAST_NOISE = 1e-4
# The same for the traction, as a fraction of its prior's least power: bands are wider by half that.
LEAST_ROUGHNESS = 1e-3
CANONICAL = 1e-4  # canonical correlations below this are left out
DEGREE, GROWTH = 8, 4  # polynomials in a block, and the distance over its length


class StateSpace(NamedTuple):
    """x' = A x + w, z = C x + v: x the state, x' that of the next cell, z the traction, the signals
    and their slopes of this one, as a [`JointCovariance`][] has them.

    - `matrix` (m + z, m): A above C. `noise` (m + z, m + z): the covariance of (w, v).
    - `floor` (z,): the variance of white noise that z has in the model beyond that of the process.
    - `traction_Pa` (c,) [Pa], `signal` (e,): the units of traction and signal, as the
      [`JointCovariance`][] has them.

    A stationary state has the covariance 1.
    """

    matrix: Float[np.ndarray, "row m"]
    noise: Float[np.ndarray, "row row"]
    floor: Float[np.ndarray, " z"]
    traction_Pa: Float[np.ndarray, " c"]
    signal: Float[np.ndarray, " e"]

    @property
    def states(self) -> int:
        """The number of states."""
        return self.matrix.shape[1]

    @property
    def components(self) -> int:
        """The number of unknown components."""
        return self.traction_Pa.size

    def reversed(self) -> "StateSpace":
        """The same process in the other order of the cells, where slopes have the other sign: the
        regression of a state, and of z beside it, on the next state."""
        m = self.states
        sign = np.ones(len(self.matrix) - m)
        sign[-self.signal.size :] = -1
        before, output = self.matrix[:m].T, self.matrix[m:]
        ahead = (self.matrix[:m] @ output.T + self.noise[:m, m:]) * sign
        size = (output @ output.T + self.noise[m:, m:]) * sign * sign[:, None]
        matrix, noise = _regression(before, ahead.T, output.T * sign, size)
        return self._replace(matrix=matrix, noise=noise)

    def covariances(self, lags: int) -> Float[np.ndarray, "z z lag"]:
        """The model's covariances E z_a(j + lag) z_b(j), without the floor's."""
        m = self.states
        transition, output = self.matrix[:m], self.matrix[m:]
        values = [output @ output.T + self.noise[m:, m:] - np.diag(self.floor)]
        ahead = transition @ output.T + self.noise[:m, m:]
        for _ in range(lags):
            values.append(output @ ahead)
            ahead = transition @ ahead
        return np.stack(values, axis=-1)


def state_space(covariance: JointCovariance, memory: int, nearest: int) -> StateSpace:
    """The model of a process whose covariances reach `memory` cells at least twice; each of the
    `nearest` cells is a feature of its own."""
    values = covariance.values
    outputs, elements = values.shape[0], covariance.signal.size
    channels = outputs - elements  # slopes follow from the signals, and are no features
    blocks = features(memory, nearest)
    size = len(blocks)
    floor = np.zeros(outputs)
    floor[covariance.components : channels] = LEAST_NOISE**2
    floor[: covariance.components] = LEAST_ROUGHNESS * covariance.least_power
    lag = np.arange(memory)

    def at(a: int, b: int, lags: np.ndarray) -> np.ndarray:
        return np.where(lags >= 0, values[a, b][np.abs(lags)], values[b, a][np.abs(lags)])

    def toeplitz(a: int, b: int, offset: int) -> np.ndarray:
        """Of the features of covariances at the lags offset + row - column."""
        ends = at(a, b, offset + lag), at(a, b, offset - lag)
        return blocks @ scipy.linalg.matmul_toeplitz(ends, blocks.T)

    def hankel(a: int, b: int) -> np.ndarray:
        """Of those at the lags 1 + row + column."""
        ends = values[a, b][memory + lag], values[a, b][memory - lag]
        return blocks @ scipy.linalg.matmul_toeplitz(ends, blocks.T[::-1])

    def every(block) -> np.ndarray:
        return np.block([[block(a, b) for b in range(channels)] for a in range(channels)])

    white = np.repeat(floor[:channels], size)
    # Rows of the past are the cells before this one, backwards; of the future this one and on.
    past = every(lambda a, b: toeplitz(b, a, 0)) + np.diag(white)
    future = every(lambda a, b: toeplitz(a, b, 0)) + np.diag(white)
    shifted = blocks @ np.eye(memory, k=-1) @ blocks.T
    onwards = every(lambda a, b: toeplitz(b, a, -1)) + np.kron(np.diag(floor[:channels]), shifted)

    roots = np.linalg.cholesky(past), np.linalg.cholesky(future)
    among = scipy.linalg.solve_triangular(roots[1], every(hankel), lower=True)
    among = scipy.linalg.solve_triangular(roots[0], among.T, lower=True).T
    _, canonical, axes = np.linalg.svd(among)
    m = max(int(np.sum(canonical > CANONICAL)), 1)
    to_state = scipy.linalg.solve_triangular(roots[0].T, axes[:m].T).T

    def with_state(start: int) -> np.ndarray:
        """The covariance of this cell's z with the features of a past that ends `start` before."""
        rows = [[blocks @ values[a, b][start + lag] for b in range(channels)]
                for a in range(outputs)]  # fmt: skip
        return np.block(rows).reshape(outputs, -1)

    transition = to_state @ onwards @ to_state.T
    output = with_state(1) @ to_state.T
    own = with_state(0) + np.kron(np.diag(floor)[:, :channels], blocks[:, 0])
    ahead = to_state @ own.T
    matrix, noise = _regression(transition, output, ahead, values[..., 0] + np.diag(floor))
    return StateSpace(matrix, noise, floor, covariance.traction_Pa, covariance.signal)


def _regression(
    transition: Float[np.ndarray, "m m"],
    output: Float[np.ndarray, "z m"],
    ahead: Float[np.ndarray, "m z"],
    size: Float[np.ndarray, "z z"],
) -> tuple[Float[np.ndarray, "row m"], Float[np.ndarray, "row row"]]:
    """The matrix and the noise of the regressions of x' and z on a state x of covariance 1: A, C,
    the covariance of x' with z, and that of z."""
    cross = ahead - transition @ output.T
    noise = np.block([
        [np.eye(len(transition)) - transition @ transition.T, cross],
        [cross.T, size - output @ output.T],
    ])  # fmt: skip
    root = root_of(noise)  # without what rounding makes negative
    return np.concatenate([transition, output]), root @ root.T


def features(memory: int, nearest: int) -> Float[np.ndarray, "feature cell"]:
    """Orthonormal features of so many cells of the past, the nearest one first."""
    rows, start = [], 0
    while start < memory:
        length = 1 if start < nearest else max(DEGREE, start // GROWTH)
        length = min(length, memory - start)
        degree = min(DEGREE, length) - 1
        places = np.linspace(-1, 1, length) if length > 1 else np.zeros(1)
        basis, _ = np.linalg.qr(np.polynomial.legendre.legvander(places, degree))
        rows.append(np.pad(basis.T, ((0, 0), (start, memory - start - length))))
        start += length
    return np.concatenate(rows)
