"""From a transfer known as numbers to its kernel along the open line.

What layers add to a half space has no closed form in x. It is sampled at wavenumbers, and brought
to places, that are both even in their logarithms, as stacks have lengths of all sizes.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from ..grid import as_real
from .scanned import lagrange

KAPPA_STEP = 0.04
KAPPA = np.exp(np.arange(np.log(1e-11), np.log(80.0), KAPPA_STEP))  # |k| depth
KAPPA_POINTS = 16  # of the polynomial between
STEP = 0.04  # of arcsinh(x/depth)
POINTS = 12  # of the polynomial between
FURTHEST = 540  # steps: 1.2e9 depths
NEAR = 5.0  # x/depth up to which the trapezoidal rule in ln(kappa) converges
ZEROS = 40  # of the wave within one unit of the double exponential's variable, times pi


def integral_over_x(
    transfer: Complex[Array, "*rows kappa"], even: Bool[np.ndarray, "*rows"]
) -> Callable[[Float[Array, " x"]], Float[Array, "*rows x"]]:
    """x/depth -> the integral over x/depth of depth times the kernel of `transfer`, from x = 0.

    `transfer` is given at |k| depth = `KAPPA`, k > 0: real where the kernel is `even`, imaginary
    where it is odd.
    """
    return _tabulated(transfer, even, _rules()[0])


def kernel(
    transfer: Complex[Array, "*rows kappa"], even: Bool[np.ndarray, "*rows"]
) -> Callable[[Float[Array, " x"]], Float[Array, "*rows x"]]:
    """x/depth -> depth times the kernel of `transfer`, given as for [`integral_over_x`][]."""
    return _tabulated(transfer, even, _rules()[1])


def _tabulated(transfer, even, rule: "_Rule"):
    from_even, from_odd = transfer.real @ as_real(rule.even), transfer.imag @ as_real(rule.odd)
    ahead = jnp.where(even[..., None], from_even, from_odd)
    turned = jnp.where(rule.mirrors_even == even, 1.0, -1.0)[..., None] * ahead
    table = jnp.concatenate([turned[..., :0:-1], ahead], axis=-1)
    return lambda xi: _interpolated(table, xi)


def _interpolated(table: Float[Array, "*rows t"], xi: Float[Array, " x"]) -> Array:
    at = jnp.clip(jnp.arcsinh(xi) / STEP + FURTHEST, 0, 2 * FURTHEST)
    first = jnp.clip(jnp.floor(at) - (POINTS // 2 - 1), 0, 2 * FURTHEST + 1 - POINTS)
    index = first.astype(int)[:, None] + np.arange(POINTS)[None]
    weights = lagrange(at - first, POINTS)
    weights = weights.reshape((1,) * (table.ndim - 1) + weights.shape)
    return jnp.sum(weights * table[..., index], axis=-1)


class _Rule(NamedTuple):
    """Matrices (kappa, x) from even and from odd transfers, real, at `KAPPA` to a function of
    x/depth >= 0, and whether that of an even one is even."""

    even: np.ndarray
    odd: np.ndarray
    mirrors_even: bool


@cache
def _rules() -> tuple[_Rule, _Rule]:
    """For the integral of the kernel over x/depth, and for the kernel times the depth.

    An odd transfer may jump at k = 0: its first sample, times exp(-kappa), is taken out and has
    closed forms.
    """
    t = STEP * np.arange(FURTHEST + 1)
    xi = np.sinh(t)
    cosine, sine = _integrals(xi, True, 0), _integrals(xi, False, 0)
    cosine_over, sine_over = _integrals(xi, True, -1), _integrals(xi, False, -1)
    jump = np.exp(KAPPA[0] - KAPPA)
    cosine_over[0] -= np.log(np.cosh(t)) + jump @ cosine_over
    sine[0] += xi / (1 + xi**2) - jump @ sine
    integral = _Rule(sine_over / np.pi, cosine_over / np.pi, False)
    return integral, _Rule(cosine / np.pi, -sine / np.pi, True)


def _integrals(xi: np.ndarray, cosine: bool, power: int) -> np.ndarray:
    """Weights (kappa, x) of the integral of F(kappa) kappa^power cos or sin(kappa xi)."""
    near = xi <= NEAR
    angle = KAPPA[:, None] * xi[None]
    wave = np.cos(angle) if cosine else np.sin(angle)
    rule = np.where(near[None], KAPPA_STEP * KAPPA[:, None] ** (power + 1) * wave, 0.0)
    # The integrand falls as kappa below the first sample: a geometric series.
    rule[0] /= -np.expm1(-KAPPA_STEP)
    node, weight = _double_exponential(cosine)
    far = np.flatnonzero(~near)
    at = np.log(node[None] / xi[far, None] / KAPPA[0]) / KAPPA_STEP
    at = np.clip(at, 0, KAPPA.size - 1)
    first = np.clip(np.floor(at) - (KAPPA_POINTS // 2 - 1), 0, KAPPA.size - KAPPA_POINTS)
    weight = weight[None] * (node[None] / xi[far, None]) ** power / xi[far, None]
    for point in range(KAPPA_POINTS):
        others = np.delete(np.arange(KAPPA_POINTS), point)
        factors = (at[..., None] - first[..., None] - others) / (point - others)
        index = (first.astype(int) + point, np.broadcast_to(far[:, None], at.shape))
        np.add.at(rule, index, weight * factors.prod(-1))
    return rule


def _double_exponential(cosine: bool) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of the integral of F(u) cos u or sin u over u > 0, whose nodes fall double
    exponentially onto the zeros of the wave (Ooura and Mori 1999)."""
    m, beta = ZEROS, 0.25
    alpha = beta / np.sqrt(1 + m * np.log(1 + m) / (4 * np.pi))
    t = np.pi / m * (np.arange(-2 * m, 1.65 * m) - (0.5 if cosine else 0.0))
    # A complex step is the derivative, and the limit at t = 0.
    along = t + 1e-20j
    bent = 2 * along - alpha * np.expm1(-along) + beta * np.expm1(along)
    node = -m * along / np.expm1(-bent)
    wave = np.cos(node.real) if cosine else np.sin(node.real)
    return node.real, np.pi / m * node.imag / 1e-20 * wave
