"""Fourier transforms of a smooth function times a weight that ends in an edge.

The kernel of a finger that touches over a finite zone is a smooth kernel times an envelope that
goes to 0 as a square root, or linearly. Its spectrum has no closed form, and the wave may turn many
times within the zone. So the function, not the wave, is expanded in the polynomials C_n of
Gegenbauer's that are orthogonal under the weight (1 - s^2)^(l - 1/2): those of Chebyshev's second
kind for l = 1, Legendre's for l = 1/2. The transform of each is a Bessel function
(docs/explanation/physics/patch.md),

    integral of (1 - s^2)^(l - 1/2) C_n exp(-i kappa s) ds / |C_n|^2 = (-i)^n 2 (n + l) B_n(kappa),

with B_n = J_(n+1)(kappa)/kappa for l = 1, and the spherical j_n(kappa) for l = 1/2. As many terms
as the function needs serve waves of any length.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Complex, Float

from ..grid import sinc

SQUARE_ROOT, PLAIN = 1.0, 0.5  # l, of the weights sqrt(1 - s^2) and 1
# |kappa| up to which the Bessel functions of order 0 and 1 are a mean of `QUARTER` values over a
# quarter turn, which is exact to rounding; beyond by `HANKEL` terms of Hankel's expansion.
LARGE, QUARTER, HANKEL = 64.0, 32, 14


@cache
def weighted_nodes(power: float, terms: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes s (node,) in -1 to 1, and weights (node,) of the integral over s under the weight:
    exact for products of two polynomials with so many terms, and two orders more."""
    if power == SQUARE_ROOT:  # Gauss and Chebyshev
        angle = np.pi * np.arange(1, terms + 3) / (terms + 3)
        return np.cos(angle), np.pi / (terms + 3) * np.sin(angle) ** 2
    count = 2 * terms + 4  # Fejer's second rule
    odd = np.where(np.arange(1, count) % 2, 1 / np.arange(1, count), 0.0)
    angle = np.pi * np.arange(1, count) / count
    return np.cos(angle), 2 / count * np.sin(angle) * scipy.fft.dst(odd, 1)


def transform(
    power: float,
    nodes: Float[np.ndarray, " node"],
    values: Float[Array, "*rows node"],
    kappa: Float[Array, " k"],
    terms: int,
) -> Complex[Array, "*rows k"]:
    """The integral of the weight, with l = `power`, times g(s) exp(-i kappa s), kappa of either
    sign; `values` of g are at the nodes, times their weights."""
    size = jnp.abs(kappa)
    safe = jnp.where(size < 1, 1.0, kappa)
    order = np.arange(terms)
    turns = np.stack([np.array([1, 0, -1, 0])[order % 4], np.array([0, -1, 0, 1])[order % 4]], -1)

    def add(carry, step):
        (before, own), (last, bessel), total = carry
        n, turn, ratio = step
        part = 2 * (n + power) * jnp.multiply.outer(values @ own, bessel)
        total = total[0] + turn[0] * part, total[1] + turn[1] * part
        after = (2 * (n + power) * nodes * own - (n + 2 * power - 1) * before) / (n + 1)
        rising = 2 * (n + power) / safe * bessel - last
        following = jnp.where(n + 1 <= size, rising, ratio * bessel)
        return ((own, after), (bessel, following), total), None

    one = jnp.ones_like(values[(0,) * (values.ndim - 1)])
    nothing = jnp.zeros((*values.shape[:-1], *kappa.shape), values.dtype)
    start = (0 * one, one), _first_two(power, kappa, safe), (nothing, nothing)
    steps = jnp.asarray(order, values.dtype), jnp.asarray(turns, values.dtype)
    steps = (*steps, _ratios(power, kappa, terms))
    (_, _, (real, imaginary)), _ = jax.lax.scan(add, start, steps)
    return real + 1j * imaginary


def _ratios(power: float, kappa: Float[Array, " k"], terms: int) -> Float[Array, "term k"]:
    """B_n/B_(n-1) for n = 1 ... `terms` where n > |kappa|, from above, where they settle."""
    above = terms + 10 + int(7 * np.cbrt(terms))

    def below(ratio, n):
        own = jnp.where(n > jnp.abs(kappa), kappa / (2 * (n + power) - kappa * ratio), 0.0)
        return own, own

    down = jnp.arange(above, 0, -1).astype(kappa.dtype)
    return jax.lax.scan(below, jnp.zeros_like(kappa), down)[1][::-1][:terms]


def first_bessel_over(kappa: Float[Array, " k"]) -> Float[Array, " k"]:
    """J_1(kappa)/kappa for kappa of either sign, 1/2 at 0."""
    near, far, sine = _near_and_far(kappa)
    mean = jnp.mean(sinc(near * sine) * sine**2, axis=-1)
    return jnp.where(jnp.abs(kappa) < LARGE, mean, _hankel(1, far) / far)


def _first_two(power: float, kappa, safe) -> tuple[Array, Array]:
    """B_(-1), where |kappa| is at least 1, and B_0."""
    if power == PLAIN:
        return jnp.cos(kappa) / safe, sinc(kappa)
    near, far, sine = _near_and_far(kappa)
    mean = jnp.mean(jnp.cos(near * sine), axis=-1)
    first = jnp.where(jnp.abs(kappa) < LARGE, mean, _hankel(0, far)) / safe
    return first, first_bessel_over(kappa)


def _near_and_far(kappa: Float[Array, " k"]) -> tuple[Array, Array, np.ndarray]:
    """kappa (k, 1) where it is not large, else 0; its size where it is, else `LARGE`; and the sines
    of the mean over a quarter turn."""
    size = jnp.abs(kappa)
    is_near = size < LARGE
    sine = np.sin((np.arange(QUARTER) + 0.5) / QUARTER * np.pi / 2)[None]
    return jnp.where(is_near, kappa, 0.0)[:, None], jnp.where(is_near, LARGE, size), sine


def _hankel(order: int, kappa: Float[Array, " k"]) -> Float[Array, " k"]:
    """J of this order for a large argument (Abramowitz and Stegun 1964, 9.2.5)."""
    term, sums = jnp.ones_like(kappa), [jnp.ones_like(kappa), jnp.zeros_like(kappa)]
    for n in range(1, HANKEL):
        term = term * (4 * order**2 - (2 * n - 1) ** 2) / (8 * n * kappa)
        sums[n % 2] = sums[n % 2] + (-1) ** (n // 2) * term
    phase = kappa - (2 * order + 1) * jnp.pi / 4
    return jnp.sqrt(2 / (jnp.pi * kappa)) * (jnp.cos(phase) * sums[0] - jnp.sin(phase) * sums[1])
