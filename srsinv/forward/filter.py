"""Filters of the electronics in time: the amplifier's bandwidth, an antialias filter.

A filter is linear, causal and the same at all times, a constant signal passes it unchanged, and its
impulse response is a sum of decaying exponentials, h(t) = Re sum_j r_j exp(p_j t), t > 0. In units
of its time scale T the poles p_j = P_j/T and the residues r_j = R_j/T are fixed numbers, so that
nothing is divided by T: T = 0 is a filter that does nothing. At constant speed a filter is one more
effect along the line; along a measured motion it is run over the samples.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Complex, Float
from numpy.polynomial.legendre import leggauss, legvander

from ..compiled import compiled
from ..errors import number, refuse, whole
from ..grid import Scalar, as_real, spread_over
from ..numerics import fast_length
from .film import Kernel, LineEffect

HIGHEST_ORDER = 8
MOST_NODES = 2**16
UNEVEN = 1e-3  # of the mean interval, by which an interval may differ from it
DEPTHS_IF_TRACED = 0.25
_FEWEST_DEPTHS = 2.0**-10
_E_FOLDS = 31.0  # until h has fallen to 3e-14
_WIDEST = 36.0  # panel in units of T
_SHORTEST = 1e-4  # time scale per interval, below which exp(p dt) is negligible
_REAL = 1e-12  # imaginary part of a pole that has none but for round-off


class Filter(eqx.Module):
    """Base of filters: linear in time, with gain 1 at frequency 0.

    - `time_scale_s` [s]: T, with which the poles scale.
    - `poles`: all of them times T, each once and of modulus 1; complex ones come in pairs.
    """

    time_scale_s: eqx.AbstractVar[Any]
    poles: eqx.AbstractVar[Any]

    def response(self, omega_rad_per_s, xp: Any = jnp):
        """H = 1/prod_j (1 - i omega T/P_j), (k,) at (k,), by `xp`: jax.numpy or numpy."""
        turn = 1j * omega_rad_per_s * xp.asarray(self.time_scale_s)
        total = xp.ones_like(turn)
        for pole in self.poles:
            total = total / (1 - turn / pole)
        return total

    def along(self, speed_m_per_s: Float[Array, ""], depth_m: Float[Array, ""]) -> "Lag":
        """The filter along the line, at constant speed, for a film at this depth.

        On the open line the quadrature is made for the lag u T of the given values. Of traced
        values it is made for lags up to a quarter of the depth; the signal of a longer one is NaN.
        """
        given = (speed_m_per_s, self.time_scale_s, depth_m)
        if any(isinstance(value, Tracer) for value in given):
            return Lag(self, speed_m_per_s, depth_m, DEPTHS_IF_TRACED)
        speed, scale, depth = (float(value) for value in given)
        # Up to a power of 2, so that similar sensors share one program; of a little more, so that
        # rounding does not exceed it.
        depths = max(1.001 * (abs(speed) * scale / depth), _FEWEST_DEPTHS)
        return Lag(self, speed_m_per_s, depth_m, float(2 ** np.ceil(np.log2(depths))))

    @compiled
    def in_time(
        self, signal: Float[Array, "e sample"], interval_s: Float[Array, ""]
    ) -> Float[Array, "e sample"]:
        """The filtered signal at its samples, `interval_s` apart: exact where the signal is linear
        between samples, and had its first value ever before.

        With s = i omega T and C_j = R_j/P_j, H = 1 + sum_j C_j s/(s - P_j). What each pole adds to
        the signal x follows d' = p d + C x', so that a straight step from x_0 to x_1 takes d to
        e^z d + C (e^z - 1)/z (x_1 - x_0), z = p dt; all steps at once are a convolution.
        """
        pole, residue = _partial_fractions(self.poles)
        scale = self.time_scale_s / interval_s
        acts = scale > _SHORTEST
        z = pole / jnp.where(acts, scale, 1.0)
        first = residue / pole * jnp.where(acts, jnp.expm1(z), -1.0) * scale / pole
        steps = np.arange(signal.shape[-1] - 1)
        decay = jnp.where(acts | (steps == 0)[None], jnp.exp(z[:, None] * steps[None]), 0.0)
        added = jnp.sum(jnp.real(first[:, None] * decay), axis=0)
        return signal + jnp.pad(causal(added, jnp.diff(signal)), ((0, 0), (1, 0)))

    @compiled
    def in_time_adjoint(
        self, y: Float[Array, "e sample"], interval_s: Float[Array, ""]
    ) -> Float[Array, "e sample"]:
        """The transpose: <y, in_time(s)> = <in_time_adjoint(y), s>."""
        (signal,) = jax.linear_transpose(lambda s: self.in_time(s, interval_s), y)(y)
        return signal


class FirstOrder(Filter):
    """One pole, H = 1/(1 + i omega tau): an amplifier with tau = R_f C_f.

    A time constant of 0 is no delay. Raises `BadInput` for a negative one.
    """

    time_constant_s: Float[Array, ""]

    def __init__(self, time_constant_s):
        wanted = "a time in seconds that is at least 0"
        self.time_constant_s = as_real(
            number("filter time_constant_s", time_constant_s, wanted, least=0)
        )

    @property
    def time_scale_s(self) -> Scalar:
        return self.time_constant_s

    @property
    def poles(self) -> tuple[complex, ...]:
        return (-1.0 + 0j,)


class Butterworth(Filter):
    """An antialias filter, |H|^2 = 1/(1 + (f/cutoff)^(2 order)) (Butterworth 1930).

    Raises `BadInput` for a cutoff that is not positive, and an order outside 1 to 8.
    """

    cutoff_hz: Float[Array, ""]
    order: int = eqx.field(static=True)

    def __init__(self, cutoff_hz, order: Any = 4):
        wanted = "a positive frequency in Hz"
        self.cutoff_hz = as_real(number("filter cutoff_hz", cutoff_hz, wanted, above=0))
        wanted = f"a whole number from 1 to {HIGHEST_ORDER}"
        self.order = whole("filter order", order, wanted, least=1, most=HIGHEST_ORDER)

    @property
    def time_scale_s(self) -> Scalar:
        return 1 / (2 * jnp.pi * self.cutoff_hz)

    @property
    def poles(self) -> tuple[complex, ...]:
        angle = np.pi * (np.arange(self.order) + 0.5) / self.order
        return tuple(complex(-np.sin(a), np.cos(a)) for a in angle)


class Lag(LineEffect):
    """A filter at constant speed: the factor H(k u), and the kernel's mean over the past, the
    integral over t > 0 of h(t) kernel(x - u t).

    The integral is Gauss's rule on panels no wider than two depths, for a kernel that is analytic
    within a depth of the real axis. Its nodes are enough for u T up to `depths`, in depths: beyond,
    the kernel is NaN. Raises `BadInput` for more than 65536 nodes.
    """

    acts_on_signal = True
    filter: Filter
    speed_m_per_s: Float[Array, ""]
    depth_m: Float[Array, ""]
    depths: float = eqx.field(static=True)

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, " k"]:
        return self.filter.response(k * self.speed_m_per_s)

    def spread(self, kernel: Kernel) -> Kernel:
        poles, depths = self.filter.poles, self.depths
        panels, _, nodes = _panels(poles, depths)
        refuse(
            panels * nodes > MOST_NODES,
            f"The filter's time scale is up to {depths:g} film depths at this speed, too "
            "long for an open line: give a faster filter, a lower speed or "
            "grid.line=periodic.",
        )
        time, weights = _quadrature(poles, depths)
        length = self.speed_m_per_s * self.filter.time_scale_s
        enough = jnp.abs(length) <= depths * self.depth_m
        return spread_over(kernel, -jnp.where(enough, length, jnp.nan) * time, weights)


def filtered(
    filters: tuple[Filter, ...], signal: Float[Array, "e sample"], interval_s: Any
) -> Float[Array, "e sample"]:
    """The signal after every filter, in their order; `interval_s` [s] as a filter takes it, or None
    where there is no filter."""
    for each in filters:
        signal = each.in_time(signal, interval_s)
    return signal


def filtered_adjoint(
    filters: tuple[Filter, ...], y: Float[Array, "e sample"], interval_s: Any
) -> Float[Array, "e sample"]:
    """The transpose of [`filtered`][]."""
    for each in reversed(filters):
        y = each.in_time_adjoint(y, interval_s)
    return y


def even_interval(time_s: Float[Array, " sample"]) -> Float[Array, ""]:
    """The interval [s] of evenly spaced samples.

    Raises `BadInput` where an interval is off the mean one by more than a thousandth and what
    rounding the times leaves, unless they are traced.
    """
    if not isinstance(time_s, Tracer):
        time = np.asarray(time_s)
        each, mean = np.diff(time), (time[-1] - time[0]) / (time.size - 1)
        at = int(np.abs(each - mean).argmax())
        allowed = UNEVEN * mean + 2 * np.finfo(time.dtype).eps * np.abs(time).max()
        refuse(
            bool(abs(each[at] - mean) > allowed),
            f"scan.time_s steps by {each[at]:.6g} s after sample {at + 1}, but by "
            f"{mean:.6g} s on average, and filters need even steps: resample the motion "
            "at even times, or leave the sensor's filters out.",
        )
    return (time_s[-1] - time_s[0]) / (time_s.size - 1)


def causal(kernel: Float[Array, " step"], steps: Float[Array, "e step"]) -> Float[Array, "e step"]:
    """sum over j <= i of kernel[i - j] steps[j]."""
    length = fast_length(2 * kernel.size)
    spectrum = jnp.fft.rfft(kernel, length)[None] * jnp.fft.rfft(steps, length)
    return jnp.fft.irfft(spectrum, length)[:, : kernel.size]


def _partial_fractions(poles: tuple[complex, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Poles P and residues R (j,) with h T = Re sum_j R_j exp(P_j t/T).

    One of each pair stands for both, at twice its residue.
    """
    pole = np.asarray(poles, dtype=complex)
    difference = pole[:, None] - pole[None]
    np.fill_diagonal(difference, 1)
    residue = np.prod(-pole) / np.prod(difference, axis=1)
    real, first = abs(np.imag(pole)) <= _REAL, np.imag(pole) >= -_REAL
    residue = np.where(real, residue, 2 * residue)
    return np.real_if_close(pole[first]), np.real_if_close(residue[first])


def _quadrature(poles: tuple[complex, ...], depths: float) -> tuple[np.ndarray, np.ndarray]:
    """Times in units of T and weights (node,): sum of weights f(times) = integral of h f, for f
    analytic within 1/depths of the real axis.

    Gauss's rule for h f; or, where f varies much less than h and fewer nodes do, the integral of h
    times the polynomial through f at Gauss's nodes.
    """
    time, weights = _gauss(*_panels(poles, depths))
    pole, residue = _partial_fractions(poles)
    weights = weights * np.real(np.exp(pole * time[:, None]) @ residue)
    half = _lasts(poles) / 2
    # Of a polynomial through the kernel on half the duration of h: it converges as r^(-nodes).
    nodes = int(np.ceil(_E_FOLDS / np.arcsinh(1 / (depths * half)))) + 2
    if nodes >= time.size:
        return time, weights
    few, own = _gauss(1, half, nodes)
    degree = np.arange(nodes)
    moments = weights @ legvander(time / half - 1, nodes - 1) * (degree + 0.5) / half
    return few, own * (legvander(few / half - 1, nodes - 1) @ moments)


def _gauss(panels: int, half: float, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss's rule on panels of half width `half` from 0 on."""
    at, weights = leggauss(nodes)
    places = half * (2 * np.arange(panels)[:, None] + 1 + at).ravel()
    return places, np.tile(half * weights, panels)


def _panels(poles: tuple[complex, ...], depths: float) -> tuple[int, float, int]:
    """Number of panels, half their width in units of T, and number of nodes each.

    Gauss's rule converges as r^(-2 nodes), r the sum of the half axes of the ellipse up to where
    the kernel is singular; h, which is so nowhere, takes one more node for each T of half width.
    """
    lasts = _lasts(poles)
    panels = int(np.ceil(lasts * max(depths / 2, 1 / _WIDEST)))
    half = lasts / panels / 2
    nodes = _E_FOLDS / 2 / np.arcsinh(1 / (depths * half)) + half
    return panels, half, int(np.ceil(nodes)) + 2


def _lasts(poles: tuple[complex, ...]) -> float:
    """Duration of h in units of T."""
    return _E_FOLDS / min(-pole.real for pole in poles)
