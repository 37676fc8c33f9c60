"""Two methods to invert a scan with a fixed delay, compared on one small case.

    python -m benchmarks.live_filters

Both know the covariances of traction and signal. A finite filter multiplies the signals of the last
cells by fixed weights. These hold for one noise level and cells without gaps. `srsinv.Live` uses
a state-space model with a fixed-lag smoother instead. The reference is the exact posterior given
all signals so far. One large Cholesky factor gives it for every cell.

Signals and tractions are in units of their standard deviations. The command takes 25 s.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # times are those of one core

import timeit
from collections import defaultdict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.linalg as sl

from srsinv import Sensor, Wiener
from srsinv.inverse.live.covariance import JointCovariance, joint_covariance
from srsinv.inverse.live.smoother import FixedLagSmoother, Measurement
from srsinv.inverse.live.state_space import StateSpace, state_space
from srsinv.inverse.wiener import Exponential

DEPTH = 8  # cells in the depth of the films
CELL_M = 0.75e-3 / DEPTH
MEMORY, LAG = 64 * DEPTH, 4 * DEPTH  # cells of both methods, and that a cell waits
LEARNED = 2 * MEMORY  # cells of the past that the model has features of, as in `Live`
N = 2 * MEMORY  # cells of a scan
NEWEST = np.arange(MEMORY - 1, N)  # with each of these, the cell that is LAG before is finished
LEVEL, FACTOR = 1e-4, 10.0  # variance of the noise, 40 dB; unequal cells differ by up to FACTOR
MISSING, RUN = 0.03, 20  # fraction of the cells that are missing, and cells of one longer gap
BANK_DB = 60  # range of a bank of filters, a decibel apart, for the level of each element
DRAWS = 8  # scans of each case
SPEED_M_PER_S = 0.05
WINDOW_M, LAGS = 40e-3, (0, 1, 2, 4, 8)  # to both sides, and the lags [depths], of the delay's cost


class CellPosterior(NamedTuple):
    """Posterior means and standard errors (cell, c) of p and q in the finished cells."""

    mean: np.ndarray
    stderr: np.ndarray


class Covariances:
    """Matrices over cells from covariances (z, z, lag) of p, q and the signals of two elements."""

    def __init__(self, values: np.ndarray):
        self.lags = values.shape[-1] - 1
        self.values = np.concatenate([values[..., :0:-1].swapaxes(0, 1), values], axis=-1)

    def of_signals(self, noise: np.ndarray) -> np.ndarray:
        """Of the signals (2 n, 2 n) with noise of these variances (n, 2)."""
        cells = np.arange(len(noise))
        lag = self.lags + cells[:, None] - cells
        matrix = self.values[2:, 2:, lag].transpose(2, 0, 3, 1).reshape(noise.size, noise.size)
        return matrix + np.diag(noise.ravel())

    def with_signals(self, cells: np.ndarray, n: int) -> np.ndarray:
        """Of the traction in these cells with the signals of n cells (cell, c, 2 n)."""
        lag = self.lags + cells[:, None] - np.arange(n)
        return self.values[:2, 2:, lag].transpose(2, 0, 3, 1).reshape(-1, 2, 2 * n)


def exact(covariances: Covariances, signal: np.ndarray, noise: np.ndarray) -> CellPosterior:
    """The posterior given all signals (n, 2) so far, NaN where missing, with noise of these
    variances (n, 2). A corner of the factor of all cells is the factor of the first ones."""
    is_known = np.isfinite(signal).ravel()
    root = np.linalg.cholesky(covariances.of_signals(noise)[np.ix_(is_known, is_known)])
    across = covariances.with_signals(NEWEST - LAG, N)[..., is_known]
    white = sl.solve_triangular(root, signal.ravel()[is_known], lower=True)
    parts = sl.solve_triangular(root, across.reshape(-1, white.size).T, lower=True)
    parts = parts.T.reshape(across.shape)
    so_far = np.arange(NEWEST.size), slice(None), np.cumsum(is_known)[2 * NEWEST + 1] - 1
    explained = np.cumsum(parts**2, axis=-1)[so_far]
    return CellPosterior(np.cumsum(parts * white, axis=-1)[so_far], np.sqrt(1 - explained))


class FiniteFilter:
    """Weights (c, 2 memory) of the signals in the last cells, and their standard errors (c,)."""

    def __init__(self, covariances: Covariances, level: float):
        factor = sl.cho_factor(covariances.of_signals(np.full((MEMORY, 2), level)))
        across = covariances.with_signals(np.array([MEMORY - 1 - LAG]), MEMORY)[0]
        self.weights = np.ascontiguousarray(sl.cho_solve(factor, across.T).T)
        self.stderr = np.sqrt(1 - np.sum(self.weights * across, axis=1))

    def __call__(self, signal: np.ndarray) -> CellPosterior:
        """The answer for signals (n, 2) without gaps."""
        flat = signal.ravel()
        mean = [self.weights @ flat[2 * (j + 1 - MEMORY) : 2 * (j + 1)] for j in NEWEST.tolist()]
        return CellPosterior(np.array(mean), np.tile(self.stderr, (len(mean), 1)))


def smoothed(model: StateSpace, signal: np.ndarray, noise: np.ndarray) -> CellPosterior:
    """The answer of the state-space model for signals (n, 2), NaN where missing, with noise of
    these variances (n, 2)."""
    smoother = FixedLagSmoother.starting(model, LAG, 0)
    noise, finished = np.maximum(noise - model.floor[2:4], 0.0), []
    at_centre, no_nuisance, no_growth = np.zeros(2), np.zeros((2, 0)), np.zeros(0)
    for v, variance in zip(signal, noise, strict=True):
        smoother.step(model, Measurement(v, variance, at_centre, no_nuisance, no_growth))
        finished.append((smoother.traction[0], smoother.variance[0]))
    mean, variance = np.array(finished)[NEWEST].swapaxes(0, 1)
    return CellPosterior(mean, np.sqrt(variance))


def interpolated(signal: np.ndarray) -> np.ndarray:
    """The signals (n, 2) with a straight line across each gap. It ends at the cell behind the gap,
    which a live filter would have to wait for."""
    cells, known = np.arange(N), np.flatnonzero(np.isfinite(signal[:, 0]))
    return np.column_stack([np.interp(cells, known, v) for v in signal[known].T])


def cases(rng: np.random.Generator, covariances: Covariances) -> dict[str, tuple[np.ndarray, ...]]:
    """Of each case the signals (n, 2), drawn by a root of their covariance and NaN where missing,
    and the variances of their noise (n, 2)."""
    alike = np.full((N, 2), LEVEL)
    unequal = LEVEL * FACTOR ** rng.uniform(-1, 1, size=(N, 2))
    drawn = [
        (np.linalg.cholesky(covariances.of_signals(noise)) @ rng.normal(size=2 * N)).reshape(N, 2)
        for noise in (alike, unequal)
    ]
    is_missing, start = rng.random(N) < MISSING, rng.integers(MEMORY, N - RUN)
    is_missing[start : start + RUN] = True
    gaps = np.where(is_missing[:, None], np.nan, drawn[0])
    return {"regular": (drawn[0], alike), "gaps": (gaps, alike), "unequal": (drawn[1], unequal)}


def least_s(work: Callable[[], object]) -> float:
    """The least time [s] of three calls."""
    return min(timeit.repeat(work, number=1, repeat=3))


def delays(covariances: Covariances) -> None:
    """Print the standard error for each lag over that given all signals within `WINDOW_M`."""
    middle = round(WINDOW_M / CELL_M)
    n = 2 * middle + 1
    root = np.linalg.cholesky(covariances.of_signals(np.full((n, 2), LEVEL)))
    across = covariances.with_signals(np.array([middle]), n)[0]
    parts = sl.solve_triangular(root, across.T, lower=True)
    stderr = np.sqrt(1 - np.cumsum(parts**2, axis=0))[2 * middle + 1 :: 2]
    print("\n| lag [depths] | stderr p, q |\n|---|---|")
    for depths in LAGS:
        p, q = stderr[depths * DEPTH] / stderr[-1]
        print(f"| {depths} | {p:.2f}, {q:.2f} |")


def times(covariances: Covariances, joint: JointCovariance) -> None:
    """Print the times of both methods."""
    signal, noise = cases(np.random.default_rng(0), covariances)["regular"]
    finite, model = FiniteFilter(covariances, LEVEL), state_space(joint, LEARNED, DEPTH)
    finite_s = least_s(lambda: FiniteFilter(covariances, LEVEL))
    model_s = least_s(lambda: state_space(joint, LEARNED, DEPTH))
    apply_s = least_s(lambda: finite(signal)) / NEWEST.size
    step_s = least_s(lambda: smoothed(model, signal, noise)) / N
    bank = (BANK_DB + 1) ** 2
    megabytes = 1e-6 * bank * finite.weights.nbytes
    print(f"from cell to cell at {SPEED_M_PER_S} m/s: {1e3 * CELL_M / SPEED_M_PER_S:.2f} ms")
    print(f"finite filter: {1e3 * finite_s:.0f} ms to make, {1e6 * apply_s:.1f} us per cell")
    print(f"bank of {bank} filters: {bank * finite_s:.0f} s to make, {megabytes:.0f} MB")
    print(f"state space of {model.states} states: {1e3 * model_s:.0f} ms to make, "
          f"{1e6 * step_s:.0f} us per cell")  # fmt: skip


def errors(covariances: Covariances, joint: JointCovariance) -> None:
    """Print a table of the differences from the exact posterior.

    Off: rms difference of the means, in exact standard errors. Stderr: over the exact one, the mean
    over the cells. Error: rms of the estimate's error over its own standard error.
    """
    rng, model = np.random.default_rng(1), state_space(joint, LEARNED, DEPTH)
    off, ratio = defaultdict(list), defaultdict(list)
    for _ in range(DRAWS):
        for case, (signal, noise) in cases(rng, covariances).items():
            finite = FiniteFilter(covariances, float(noise.mean()))
            reference = exact(covariances, signal, noise)
            tried = {f"state space, {case}": smoothed(model, signal, noise)}
            if case == "gaps":
                tried["finite filter, gaps as straight lines"] = finite(interpolated(signal))
                tried["finite filter, gaps as zeros"] = finite(np.nan_to_num(signal))
            else:
                tried[f"finite filter, {case}"] = finite(signal)
            for name, answer in tried.items():
                off[name].append((answer.mean - reference.mean) / reference.stderr)
                ratio[name].append(answer.stderr / reference.stderr)
    print("\n| method and cells | off p, q | stderr p, q | error p, q |\n|---|---|---|---|")
    for name in sorted(off):
        d, r = np.concatenate(off[name]), np.concatenate(ratio[name])
        error = np.sqrt(np.mean((1 + d**2) / r**2, axis=0))
        columns = np.sqrt(np.mean(d**2, axis=0)), r.mean(axis=0), error
        print(f"| {name} | " + " | ".join(f"{p:.3f}, {q:.3f}" for p, q in columns) + " |")


def main() -> None:
    """Print times, errors, and what a delay costs."""
    prior = Wiener(p=Exponential(1500.0, 0.4e-3), q=Exponential(1500.0, 0.4e-3))
    joint = joint_covariance(Sensor(), prior, CELL_M, 2 * LEARNED, is_onwards=True)
    covariances = Covariances(joint.values[:4, :4])
    times(covariances, joint)
    errors(covariances, joint)
    delays(covariances)


if __name__ == "__main__":
    main()
