"""Problems that several test files share, and their answers from dense matrices in numpy.

The dense answers go other ways than the package: conditioning of covariances in the space of the
data, and QR of stacked rows with unknown offsets as columns of their own.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from srsinv.forward.amplifier import ChargeReadout
from srsinv.forward.film import Film, Offset
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic
from srsinv.inverse.line.problem import LineProblem

N, LENGTH_M, DEPTH_M = 48, 12e-3, 0.75e-3
LINES = {"periodic": Periodic, "open": Open}
FILMS = {
    "pair": lambda: (Film(DEPTH_M), Film(DEPTH_M, np.pi / 2, effects=(Offset(2e-4),))),
    "turned": lambda: (Film(DEPTH_M, 0.5), Film(0.6e-3, 2.0)),
    "one": lambda: (Film(DEPTH_M),),
    "same": lambda: (Film(DEPTH_M), Film(DEPTH_M)),
    "oblique": lambda: (Film(DEPTH_M, 0.3), Film(DEPTH_M, 0.7)),
    "same_turned": lambda: (Film(DEPTH_M, 0.5), Film(DEPTH_M, 0.5)),
}
RATE, SLOW = None, ChargeReadout(1e9, 0.0)


class ProblemCase(NamedTuple):
    """A problem, the traction (2, n) behind its data, and its white noise's standard deviation."""

    problem: LineProblem
    truth: np.ndarray
    sigma: float


def make_line(kind="periodic", n=N):
    """A line of 12 mm about zero."""
    return LINES[kind](n, LENGTH_M / n, -LENGTH_M / 2)


def make_operator(line, films: str | Sequence[Film] = "pair", amplifier=RATE):
    """The recorded signal of the films, or of those that the name stands for, at 5 cm/s."""
    elements = FILMS[films]() if isinstance(films, str) else films
    return _operator(line, Sensor(elements, amplifier=amplifier), ConstantSpeed(0.05))


@eqx.filter_jit
def _operator(line, sensor, scan):
    return sensor.operator(line, scan)


def signals_along(sensor, line, motion, traction, directions=None) -> np.ndarray:
    """The recorded signals (e, sample) of traction along a motion, by one compiled program;
    `directions`: those of the motion, where it is not concrete itself."""
    return np.asarray(_signals(sensor, line, motion, traction, directions or motion.directions))


@eqx.filter_jit
def _signals(sensor, line, motion, traction, directions):
    return sensor.operator_along(line, motion, directions=directions)(jnp.asarray(traction))


def bumps(line, background_Pa=0.0, friction=None) -> np.ndarray:
    """Traction (2, n) [Pa]: a bump of p, and of q beside it unless friction says q = mu p."""
    x = np.asarray(line.x)
    p = background_Pa + 2e3 * np.exp(-((x / 1.2e-3) ** 2))
    q = 0.3 * p + 500 * np.exp(-(((x - 1e-3) / 1e-3) ** 2))
    return np.stack([p, q if friction is None else friction * p])


def make_case(
    kind="periodic",
    films: str | Sequence[Film] = "pair",
    *,
    n=N,
    amplifier=RATE,
    friction=None,
    background_Pa=0.0,
    colour: bool | str = False,
    free_offset=False,
    noise_fraction=1e-2,
    scale=1.0,
    seed=0,
    **known,
) -> ProblemCase:
    """Signals of the bumps in noise of `noise_fraction` of their rms, all of it times `scale`;
    `colour`: False, True, or "apart", another one in each element."""
    line = make_line(kind, n)
    operator = make_operator(line, films, amplifier)
    truth = scale * bumps(line, background_Pa, friction)
    signal = np.asarray(operator(jnp.asarray(truth)))
    sigma = noise_fraction * signal.std()
    # Noise that rises four times towards long waves, where it is coloured.
    shape = 1 + 3 * np.exp(-((np.asarray(line.k) / 2e3) ** 2))[None] * bool(colour)
    if colour == "apart":
        shape = np.concatenate([shape, *[4 / shape] * (len(signal) - 1)])
    white = np.random.default_rng(seed).normal(size=signal.shape)
    data = signal + np.fft.irfft(sigma * np.sqrt(shape) * np.fft.rfft(white), n)
    noise = sigma**2 * shape
    noise[:, 0] = np.inf if free_offset else noise[:, 0]
    problem = LineProblem(line, operator, data, noise, friction=friction, **known)
    return ProblemCase(problem, truth, float(sigma))


def gaps(n=N) -> np.ndarray:
    """Samples that are there (2, n): none at the left end, other gaps for each element."""
    is_observed = np.ones((2, n), bool)
    is_observed[:, :5] = False
    is_observed[0, 20:24] = False
    is_observed[1, n - 9 : n - 6] = False
    return is_observed


def deviation(problem: LineProblem, traction: np.ndarray) -> np.ndarray:
    """The traction less its mean, where the problem solves for the deviation only."""
    traction = traction[..., : problem.unknowns, :]
    mean = traction.mean(axis=-1, keepdims=True)
    return traction - mean * np.array(problem.zero_mean)[:, None]


def from_reference(problem: LineProblem) -> np.ndarray:
    """(c n, c n): traction to what the standard error is of.

    On an open line, where the mean is weakly observed, that is the deviation from the mean over
    the stretch with samples; else the value itself.
    """
    n, is_observed = problem.line.n, observed(problem).reshape(-1, problem.line.n).any(axis=0)
    mean = np.outer(np.ones(n), is_observed / is_observed.sum())
    weakly = isinstance(problem.line, Open) & ~np.array(problem.zero_mean)
    return np.array(scipy.linalg.block_diag(*[np.eye(n) - mean * w for w in weakly]))


def stderr_of(problem: LineProblem, covariance: np.ndarray) -> np.ndarray:
    """The standard error (c, n) that belongs to a covariance (c n, c n) of the traction."""
    to = from_reference(problem)
    return np.sqrt(np.diag(to @ covariance @ to.T)).reshape(problem.unknowns, -1)


def relative(ours, reference) -> float:
    """Largest error in units of the reference's largest value."""
    ours, reference = np.asarray(ours), np.asarray(reference)
    return float(np.abs(ours - reference).max() / np.abs(reference).max())


def circulant(spectrum, n) -> np.ndarray:
    """The matrix (n, n) whose eigenvalues are the given half spectrum."""
    return scipy.linalg.circulant(np.fft.irfft(np.asarray(spectrum), n))


def blocks(spectra, n) -> np.ndarray:
    """One circulant block for each row of the spectra."""
    return np.array(scipy.linalg.block_diag(*[circulant(s, n) for s in np.asarray(spectra)]))


def matrix(problem: LineProblem) -> np.ndarray:
    """The forward model (e n, c n)."""
    size = problem.unknowns * problem.line.n
    basis = jnp.eye(size).reshape(size, problem.unknowns, problem.line.n)
    columns = np.array(jax.vmap(problem.forward)(basis))
    return columns.reshape(size, -1).T


def observed(problem: LineProblem) -> np.ndarray:
    """Which rows of the forward model have a sample."""
    if problem.observed is None:
        return np.ones(problem.data.size, bool)
    return np.array(problem.observed).ravel()


def noise_covariance(problem: LineProblem) -> np.ndarray:
    """Covariance of the samples that are there; an unknown offset is left out of it."""
    spectra = np.asarray(problem.noise)
    spectra = np.where(np.isfinite(spectra), spectra, spectra[:, 1:2])
    is_observed = observed(problem)
    each = np.broadcast_to(spectra, (problem.data.shape[0], spectra.shape[1]))
    covariance = blocks(each, problem.line.n)
    if problem.noise_scale is not None:
        scale = np.ravel(problem.noise_scale)
        covariance = scale[:, None] * covariance * scale
    return covariance[np.ix_(is_observed, is_observed)]


def prior_covariance(problem: LineProblem, power) -> np.ndarray:
    """Covariance (c n, c n) of traction of the given spectra, its fixed means apart."""
    power = np.array(power, float)
    power[np.asarray(problem.zero_mean), 0] = 0.0
    return blocks(power, problem.line.n)


def condition(problem: LineProblem, power) -> tuple[np.ndarray, np.ndarray]:
    """Gaussian conditioning: posterior mean (c, n) and covariance (c n, c n) of the deviation."""
    is_observed = observed(problem)
    model = matrix(problem)[is_observed]
    prior = prior_covariance(problem, power)
    gain = np.linalg.solve(model @ prior @ model.T + noise_covariance(problem), model @ prior).T
    mean = gain @ np.ravel(problem.data)[is_observed]
    return mean.reshape(problem.unknowns, -1), prior - gain @ model @ prior


def log_marginal(problem: LineProblem, power) -> float:
    """Log density of the data, up to a constant."""
    is_observed = observed(problem)
    model, data = matrix(problem)[is_observed], np.ravel(problem.data)[is_observed]
    covariance = model @ prior_covariance(problem, power) @ model.T + noise_covariance(problem)
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, data)
    return -np.log(np.diag(root)).sum() - white @ white / 2


def penalty_rows(problem: LineProblem, order, weights, length_m=DEPTH_M) -> np.ndarray:
    """The rows D with |D r|^2 the derivative penalty, by differences of neighbouring cells."""
    n = problem.line.n
    step = np.eye(n)
    for _ in range(order):
        step = np.roll(step, -1, axis=0) - step
    if isinstance(problem.line, Open):
        step = step[: n - order]
    step = step * (length_m / float(problem.line.cell_m)) ** order
    return np.array(scipy.linalg.block_diag(*[np.sqrt(weight) * step for weight in weights]))


class Dense(NamedTuple):
    """The dense minimiser, its covariance, whitened residual sum of squares, trace of the hat."""

    value: np.ndarray
    covariance: np.ndarray
    residual: float
    freedom: float


def minimiser(problem: LineProblem) -> Callable[[np.ndarray], Dense]:
    """penalty -> what minimises |N^(-1/2) (m - G r - offset)|^2 + |penalty r|^2.

    Over deviations r where the mean is not solved for, and over the offsets where they are free.
    """
    n, is_observed = problem.line.n, observed(problem)
    deviations = scipy.linalg.null_space(np.ones((1, n)))
    solved = scipy.linalg.block_diag(*[deviations if c else np.eye(n) for c in problem.zero_mean])
    columns = matrix(problem)[is_observed] @ solved
    if problem.has_free_offset:
        ones = np.kron(np.eye(problem.data.shape[0]), np.ones((n, 1)))[is_observed]
        columns = np.hstack([columns, ones])
    root = np.linalg.cholesky(noise_covariance(problem))
    white = np.linalg.solve(root, columns)
    data = np.linalg.solve(root, np.ravel(problem.data)[is_observed])

    def minimise(penalty: np.ndarray) -> Dense:
        below = np.zeros((len(penalty), white.shape[1]))
        below[:, : solved.shape[1]] = penalty @ solved
        q, r = np.linalg.qr(np.vstack([white, below]))
        q = q[: len(data)]
        inverse = scipy.linalg.solve_triangular(r, np.eye(len(r)))[: solved.shape[1]]
        value = solved @ (inverse @ (q.T @ data))
        residual = data - q @ (q.T @ data)
        covariance = solved @ inverse @ inverse.T @ solved.T
        freedom = float(np.sum(q**2))
        return Dense(value.reshape(-1, n), covariance, float(residual @ residual), freedom)

    return minimise
