"""The joint covariance of traction and signal along a scan, cell by cell.

Traction with a stationary Gaussian prior and the signal that it makes are one stationary Gaussian
process along the scan. Its covariances over distance hold the sensor and the prior completely; the
state-space model of a live inversion is made from them alone.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from ...errors import BadInput, echo, of_kind, refuse
from ...forward.film import CellAverage
from ...forward.sensor import Sensor
from ...grid import Convolution, Open, Periodic, as_real, wavenumbers
from ..line.prior import Prior
from ..line.problem import LineProblem
from ..method import Method
from ..wiener import TractionSpectrum, Wiener

# The signal's kernel reaches so many memories to both sides: it falls as 1/x^2, and what is beyond
# changes a band by less than a thousandth.
KERNEL_REACH = 2
LIVE_PRIOR = (
    "a method with given levels, such as Wiener(), or what Tikhonov().prior_fixed_on(problem) gives"
)

PriorOf = Callable[[LineProblem], Prior]


class JointCovariance(NamedTuple):
    """Covariances of the traction and of the signal per unit gain in cells along a scan.

    - `values` (z, z, lag): E z_a(j + lag) z_b(j), for cells numbered in the direction of motion.
      The z = c + 2 e channels are the traction's components, each element's signal, and its slope
      per cell; in units of the standard deviations of traction and signal.
    - `traction_Pa` (c,) [Pa], `signal` (e,): the standard deviations. A signal per unit gain is the
      film's charge [C], or its slope along x [C/m], averaged over a cell.
    - `least_power` (c,): the prior's least power over the wavenumbers, per cell, in units of the
      variance.
    """

    values: Float[np.ndarray, "z z lag"]
    traction_Pa: Float[np.ndarray, " c"]
    signal: Float[np.ndarray, " e"]
    least_power: Float[np.ndarray, " c"]

    @property
    def components(self) -> int:
        """The number of unknown components."""
        return self.traction_Pa.size


def joint_covariance(
    sensor: Sensor,
    prior: Any,
    cell_m: float,
    lags: int,
    *,
    is_onwards: bool,
    friction: float | None = None,
    speed_m_per_s: float | None = None,
) -> JointCovariance:
    """The covariances of cells of `cell_m` [m] up to `lags` cells apart.

    - `is_onwards`: whether the scan goes towards +x. `friction`: mu of q = mu p while it does; it
      turns with the motion.
    - `speed_m_per_s` [m/s]: at which the sensor's filters act; needed where it has any.

    Waves longer than `lags` cells have the power of those of that length, so that a prior without a
    level (a penalty on slopes) has one. Raises `BadInput` for a prior whose levels are not given,
    and for a sensor whose signal is zero.
    """
    reach = KERNEL_REACH * lags
    n = 2 * (reach + lags)  # of the circle, so long that nothing meets itself
    kernel = _kernel(sensor, cell_m, reach)
    circle = np.zeros((*kernel.shape[:2], n))
    circle[..., :reach], circle[..., -reach:] = kernel[..., reach:], kernel[..., :reach]
    gain = np.fft.rfft(circle) * _filtering(
        sensor, np.asarray(wavenumbers(n, cell_m)), is_onwards, speed_m_per_s
    )
    if friction is not None:
        gain = gain[:, :1] + (friction if is_onwards else -friction) * gain[:, 1:]
    elements, components, _ = gain.shape
    power = _power(prior, Periodic(n, cell_m), gain, friction, lags)
    slope = (1j if is_onwards else -1j) * 2 * np.pi * np.arange(power.shape[-1]) / n * gain
    itself = np.broadcast_to(np.eye(components)[..., None], (components, *power.shape))
    channels = np.concatenate([itself, gain, slope])
    spectrum = np.einsum("ack,ck,bck->abk", channels, power, channels.conj())
    values = np.fft.irfft(spectrum, n)[..., : lags + 1]
    size = np.sqrt(np.einsum("aa->a", values[..., 0]))[: components + elements]
    refuse(
        not bool(np.all(size > 0)),
        "The model's signal is zero for every traction: give a sensor with a gain other than 0.",
    )
    of_each = np.concatenate([size, size[components:]])
    values = values / of_each[:, None, None] / of_each[None, :, None]
    if not is_onwards:  # the cells are passed in the other order
        values = values.swapaxes(0, 1)
    least = power.min(axis=1) / size[:components] ** 2
    return JointCovariance(values, size[:components], size[components:], least)


def _kernel(sensor: Sensor, cell_m: float, reach: int) -> Float[np.ndarray, "e c lag"]:
    """The signal per unit gain of one cell of unit traction, from `reach` cells before it on,
    averaged over the cell that it is recorded in."""
    averaging = sensor.with_films(
        lambda film: film.with_effect(CellAverage.at_depth(cell_m, film.depth_m))
    )
    stage = averaging.film_signal(as_real(1.0), sensor.amplifier.order)
    operator = Open(reach, cell_m).operator(stage)
    circle = np.fft.irfft(np.asarray(operator.transfer), operator.length)
    return np.concatenate(
        [np.zeros((*circle.shape[:2], 1)), circle[..., 1 - reach :], circle[..., :reach]], axis=-1
    )


def _filtering(
    sensor: Sensor, k: Float[np.ndarray, " k"], is_onwards: bool, speed_m_per_s: float | None
) -> Complex[np.ndarray, "e 1 k"]:
    """The factors of the sensor's filters on each element's spectrum, at this speed."""
    factors = np.ones((len(sensor.elements), 1, k.size), complex)
    if not sensor.filters:
        return factors
    if speed_m_per_s is None:
        raise BadInput(
            "The sensor has filters, whose effect along x depends on the speed: give "
            "speed_m_per_s, or a sensor without filters."
        )
    speed = as_real(abs(speed_m_per_s) * (1 if is_onwards else -1))
    for e, film in enumerate(sensor.elements):
        for each in sensor.filters:
            factors[e, 0] *= np.asarray(each.along(speed, film.depth_m).transfer(jnp.asarray(k)))
    return factors


def _power(
    prior: Any,
    line: Periodic,
    gain: np.ndarray,
    friction: float | None,
    lags: int,
) -> Float[np.ndarray, "c k"]:
    """The prior's power per cell [Pa^2] at the line's wavenumbers."""
    transfer = jnp.asarray(gain if friction is None else np.concatenate([gain, 0 * gain], axis=1))
    forward = Convolution(transfer, line.cell_m, line.n, line.n)
    data = np.zeros((len(gain), line.n))
    problem = LineProblem(line, forward, data, np.ones(line.k.size), friction=friction)
    if isinstance(prior, TractionSpectrum):
        prior = Wiener(prior, prior)
    if isinstance(prior, Method):
        prior = given_prior(prior, problem)
    refuse(
        not (callable(prior) or isinstance(prior, Prior)),
        f"prior is {echo(prior)}: give {LIVE_PRIOR}.",
    )
    own = prior if isinstance(prior, Prior) else prior(problem)
    root = np.asarray(of_kind("what prior gives", own, Prior, "a Prior").root(line))
    refuse(
        root.shape != (problem.unknowns, line.k.size),
        "The prior is tied to another line: give a method, or what its prior_fixed_on gives.",
    )
    longest = -(-line.n // lags)
    precision = np.maximum(root**2, root[:, longest : longest + 1] ** 2)
    refuse(
        not bool(np.all(np.isfinite(precision) & (precision > 0))),
        "The prior has waves of infinite power or of none: give a prior with a level.",
    )
    return 1 / precision


def given_prior(method: Method, problem: LineProblem) -> PriorOf:
    """The prior of a method all of whose levels are given."""
    refuse(
        method.chooses_prior,
        f"{type(method).__name__} chooses its levels from a recording, which a live inversion does "
        f"not have: give {LIVE_PRIOR}, problem being that of an earlier recording.",
    )
    return method.prior_fixed_on(problem)
