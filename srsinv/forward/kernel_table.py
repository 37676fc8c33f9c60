"""Kernels along the open line of transfers known numerically.

What layers add to a half space has no closed form in x. It is sampled at wavenumbers, and brought
to places, that are both even in their logarithms, as stacks have lengths of all sizes. One rule
serves all places: the trapezoidal rule for the integral of F(kappa) exp(i kappa xi) d ln(kappa),
ended smoothly. As F is analytic about the positive axis, what is cut off is exponentially small
(docs/explanation/physics/layers.md).
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Complex, Float

from ..grid import as_real
from .operator import lagrange

KAPPA_STEP = 0.03
KAPPA = np.exp(np.arange(np.log(1e-11), np.log(80.0), KAPPA_STEP))  # |k| depth
# |k x| where the rule ends, and how smoothly. The step resolves waves up to 2 pi/KAPPA_STEP = 209
# less what the transfer has; an end before 60 or a sharper one truncates significant parts.
LAST, FADE = 80.0, 10.0
STEP = 0.04  # of arcsinh(x/depth)
POINTS = 12  # of the polynomial between
FURTHEST = 540  # steps: 1.2e9 depths


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
    """Rules for the integral of the kernel over x/depth, and for the kernel times the depth."""
    angle = KAPPA[:, None] * np.sinh(STEP * np.arange(FURTHEST + 1))[None]
    ended = scipy.special.erfc((LAST - angle) / FADE) / 2
    left = KAPPA_STEP / np.pi * scipy.special.erfc((angle - LAST) / FADE) / 2
    cosine, sine = left * np.cos(angle), left * np.sin(angle)
    # cos - 1, as the integral begins at x = 0.
    cosine_over = -2 * left * np.sin(angle / 2) ** 2 - KAPPA_STEP / np.pi * ended
    kappa = KAPPA[:, None]
    integral = _Rule(_from_zero(sine, 1), _from_zero(cosine_over, 2), False)
    return integral, _Rule(_from_zero(kappa * cosine, 1), _from_zero(-kappa * sine, 2), True)


def _from_zero(weights: np.ndarray, order: int) -> np.ndarray:
    """Weights that include all below the first sample, a geometric series as the integrand falls
    there as kappa^order."""
    weights[0] /= -np.expm1(-order * KAPPA_STEP)
    return weights
