"""The straight pass that is expected to tell most about a feature that was detected.

With the posterior covariance C of the feature's parameters before a pass, and the slopes J of the
pass's whitened signal, the log determinant of the posterior's information rises by

    log det(1 + C J^T J),

and half of it is the information gained, in nats (Chaloner and Verdinelli, Statistical Science
10, 1995). J depends on the parameters, so that the gain is the mean over draws from the posterior.
A faster pass has a larger rate signal, but fewer samples on the feature and more of the signal
beyond the bandwidth of the sensor's filters: heading and speed have an optimum, which is sought
along the gradient from several starts.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import BadInput, number, refuse, whole
from ...forward.planar import PathScan, StraightPass
from ...forward.sensor import Sensor
from ...grid import as_real
from ...resolution import cell_m
from .finder import Direction
from .signal import PlanarSignal, StraightFeature

DRAWS = 4  # from the posterior, over which the gain is averaged
HEADINGS, SPEEDS, DESCENTS = 6, 3, 1  # tried at first, and the best of them that are improved
LEAST = 0.05  # of the mean of a width or a pitch, below which no draw falls


class PassLimits(eqx.Module):
    """What a pass may be: `least_speed_m_per_s` to `greatest_speed_m_per_s`, `samples` in
    `duration_s`, and its middle (`middle_x_m`, `middle_y_m`).

    A pass takes all of its duration, as more samples never tell less. Raises `BadInput` for speeds
    that leave no room between, and what [`StraightPass`][] refuses.
    """

    least_speed_m_per_s: float = eqx.field(static=True, default=0.01)
    greatest_speed_m_per_s: float = eqx.field(static=True, default=0.1)
    duration_s: float = eqx.field(static=True, default=0.2)
    samples: int = eqx.field(static=True, default=200)
    middle_x_m: float = eqx.field(static=True, default=0.0)
    middle_y_m: float = eqx.field(static=True, default=0.0)

    def __check_init__(self):
        wanted = "a positive speed in m/s"
        low = number("least_speed_m_per_s", self.least_speed_m_per_s, wanted, above=0)
        high = number("greatest_speed_m_per_s", self.greatest_speed_m_per_s, wanted, above=0)
        refuse(
            not low < high,
            f"The speeds are from {low} to {high} m/s: give the lesser first, and leave room "
            "between.",
        )
        self.path(0.0, low)

    def path(self, heading_rad: Any, speed_m_per_s: Any) -> StraightPass:
        """The pass in this direction at this speed."""
        return StraightPass(
            heading_rad, speed_m_per_s, self.duration_s, self.samples, self.middle_x_m,
            self.middle_y_m,
        )  # fmt: skip


@dataclass(frozen=True)
class NextPass:
    """A proposed pass.

    - `path`: the pass; `gain_nats`: the information that it is expected to give.
    - `headings_rad`, `speeds_m_per_s`, `gains_nats` (start,): the passes tried at first.
    - `ends_nats` (descent,): the gains at the ends of the searches; `evaluations`: of the gradient.
    """

    path: StraightPass
    gain_nats: float
    headings_rad: Float[np.ndarray, " start"]
    speeds_m_per_s: Float[np.ndarray, " start"]
    gains_nats: Float[np.ndarray, " start"]
    ends_nats: Float[np.ndarray, " descent"]
    evaluations: int


class ExpectedGain(eqx.Module):
    """The expected information gain [nat] of a pass: a function of its heading [rad] and the log of
    its speed, differentiable in both.

    - `rows` (draw, m): draws of the parameters, in the order of `feature.names`; `root` (m, m): a
      root of their covariance, C = root root^T; `noise_rms` (e,): of each element.
    - `size`: how many samples are taken as one, their mean.
    """

    sensor: Sensor
    feature: StraightFeature
    limits: PassLimits
    rows: Float[Array, "draw m"]
    root: Float[Array, "m m"]
    noise_rms: Float[Array, " e"]
    size: int = eqx.field(static=True)

    def __call__(self, point: Float[Array, "2"]) -> Float[Array, ""]:
        path = self.limits.path(point[0], jnp.exp(point[1])).coarser(self.size)
        signal = PlanarSignal(self.feature, (PathScan(self.sensor, path),))
        rms = self.noise_rms / np.sqrt(self.size)

        def gain(row: Float[Array, " m"]) -> Float[Array, ""]:
            slopes = signal.whitened_slopes(row, rms).reshape(-1, row.size) @ self.root
            return jnp.linalg.slogdet(jnp.eye(row.size) + slopes.T @ slopes)[1] / 2

        return jnp.mean(jax.lax.map(gain, self.rows))


def next_pass(
    sensor: Sensor,
    feature: StraightFeature,
    found: Direction,
    noise_rms: float | Float[np.ndarray, " e"],
    limits: PassLimits | None = None,
    *,
    draws: Any = DRAWS,
    seed: int = 0,
) -> NextPass:
    """Propose the next pass over a feature: its direction and speed.

    - `found`: what is known of the feature by the passes so far, from a [`DirectionFinder`][]. Give
      it priors where one pass does not determine every parameter.
    - `noise_rms`: standard deviation of a sample's noise, of all elements or of each (e,).
    - `draws`: draws from the posterior; `seed`: of their quasi-random points.

    Raises `BadInput` where the fit does not determine every parameter or is of another feature, and
    for noise that is not above 0 or not of every element.
    """
    limits = PassLimits() if limits is None else limits
    draws = whole("draws", draws, "a whole number from 1", least=1)
    seed = whole("seed", seed, "a whole number from 0", least=0)
    rms, elements = np.asarray(noise_rms, float), len(sensor.elements)
    refuse(
        rms.shape not in ((), (elements,)),
        f"noise_rms has the shape {rms.shape}: give one number, or one of each of {elements} "
        "elements.",
    )
    refuse(
        not np.all((rms > 0) & np.isfinite(rms)),
        f"noise_rms is {noise_rms}: give finite numbers above 0.",
    )
    mean, covariance = found.posterior(feature.names)
    root = _root(covariance)
    rows = mean + _normal(draws, mean.size, seed) @ root.T
    lengths = [name in ("width_m", "pitch_m") for name in feature.names]
    rows[:, lengths] = np.maximum(rows[:, lengths], LEAST * np.abs(mean[lengths]))
    cell = cell_m("ridge_search", float(sensor.depth_m))
    size = limits.path(0.0, limits.greatest_speed_m_per_s).group_size(cell)
    arrays = as_real(rows), as_real(root), as_real(np.broadcast_to(rms, elements))
    gain = ExpectedGain(sensor, feature, limits, *arrays, size)
    low, high = np.log([limits.least_speed_m_per_s, limits.greatest_speed_m_per_s])
    headings = np.pi * np.arange(HEADINGS) / HEADINGS
    speeds = low + (high - low) * (np.arange(SPEEDS) + 0.5) / SPEEDS
    tried = np.stack(np.meshgrid(headings, speeds, indexing="ij"), axis=-1).reshape(-1, 2)
    first = np.array([_value(gain, point) for point in tried])
    best = np.argsort(-first)[:DESCENTS]
    ends = [_improved(gain, tried[at], (low, high)) for at in best]
    point, value, _ = max(ends, key=lambda end: end[1])
    return NextPass(
        limits.path(float(point[0] % (2 * np.pi)), float(np.exp(point[1]))), value, tried[:, 0],
        np.exp(tried[:, 1]), first, np.array([end[1] for end in ends]),
        sum(end[2] for end in ends),
    )  # fmt: skip


def _root(covariance: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
    size = np.sqrt(np.diag(covariance))
    is_known = bool(np.all(np.isfinite(covariance)) and np.all(size > 0))
    if is_known:
        try:
            return size[:, None] * np.linalg.cholesky(covariance / np.outer(size, size))
        except np.linalg.LinAlgError:
            pass
    raise BadInput(
        "The fit does not determine every parameter of the feature, so that the next pass cannot "
        "be weighed: give the DirectionFinder priors."
    )


def _normal(draws: int, size: int, seed: int) -> Float[np.ndarray, "draw m"]:
    """Quasi-random normal points, a power of two of them at first."""
    sobol = scipy.stats.qmc.Sobol(size, rng=np.random.default_rng(seed))
    power = int(np.ceil(np.log2(draws)))
    return scipy.stats.norm.ppf(sobol.random_base2(power)[:draws])


def _improved(gain: ExpectedGain, start: np.ndarray, speeds: tuple[float, float]):
    """The end of a search from one start, its gain, and the gradients that it took."""

    # By central differences: the program of the exact slope takes five times as long to compile.
    step = float(np.finfo(gain.rows.dtype).eps) ** (1 / 3)

    def slope(point: np.ndarray) -> tuple[float, np.ndarray]:
        rises = [
            _value(gain, point + by) - _value(gain, point - by) for by in step * np.eye(point.size)
        ]
        return -_value(gain, point), -np.array(rises) / (2 * step)

    result: Any = scipy.optimize.minimize(
        slope, start, jac=True, method="L-BFGS-B", bounds=[(None, None), speeds],
        options={"maxiter": 10, "ftol": 1e-4},
    )  # fmt: skip
    return result.x, -float(result.fun), int(result.nfev)


def _value(gain: ExpectedGain, point: Float[np.ndarray, "2"]) -> float:
    return float(_gain(gain, as_real(point)))


@compiled
def _gain(gain: ExpectedGain, point: Float[Array, "2"]) -> Float[Array, ""]:
    return gain(point)
