"""The sampled line x and the convolutions on it.

Traction is held as cell averages r[c, j] over cells of width `cell_m` centred on x[j]; signals are
sampled at the same x[j]. Two lines differ in what happens beyond their ends:

- [`Periodic`][]: everything repeats with the window. A physical stage is its Fourier transfer.
- [`Open`][]: the traction is zero outside the window, nothing wraps around. A stage is its exact
  response to one cell of uniform traction.

Both turn a stage into the same [`Convolution`][], so nothing above this file knows the difference.
"""

import abc
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .compiled import compiled
from .errors import number, refuse
from .known import by_numpy
from .numerics import fast_length, shared_count

Scalar = float | Float[Array, ""]


def as_real(value) -> Float[Array, "..."]:
    """A physical number as an array of the working precision, so that jit traces it."""
    return jnp.asarray(value, dtype=jnp.result_type(float))


class Operator(eqx.Module):
    """A linear map from traction on the cells of a line to a sensor's signal.

    Traction is (component, cell) [Pa], or (way, component, cell) along a motion that turns: while
    sliding towards +x, then towards -x. The signal is (element, sample), in the amplifier's unit.
    """

    @abc.abstractmethod
    def __call__(self, traction: Float[Array, "*way c n"]) -> Float[Array, "e sample"]:
        """The signal."""

    @abc.abstractmethod
    def adjoint(self, signal: Float[Array, "e sample"]) -> Float[Array, "c n"]:
        """The transpose for one traction, whichever way: <y, self(r)> = <self.adjoint(y), r>."""

    def symbol(self, k: Float[Array, " k"]) -> Complex[Array, "e c k"] | None:
        """The signal's spectrum over the traction's at the wavenumbers k [rad/m], far from the
        line's ends; None where samples do not follow the cells."""
        del k
        return None

    @property
    def is_circular(self) -> bool:
        """Whether the line wraps around, so that each wavenumber can be treated alone."""
        return False


class Convolution(Operator):
    """The operator with a sample at every cell: y[e] = sum_c h[e, c] * r[c].

    `transfer` (e, c, k) is the half spectrum of the circular kernel of `length` samples `cell_m`
    apart; with `length` >= 2 n - 1 the convolution is linear (open line), with `length` = n
    circular. `has_dc_gain` says whether an endless uniform r gives any signal: a rate does not.
    """

    transfer: Complex[Any, "e c k"]
    cell_m: Float[Any, ""]
    n: int = eqx.field(static=True)
    length: int = eqx.field(static=True)
    has_dc_gain: bool = eqx.field(static=True, default=True)

    def __call__(self, traction: Float[Any, "c n"]) -> Float[Any, "e n"]:
        shape = self.transfer.shape[1], self.n
        refuse(
            traction.shape != shape,
            f"The traction has the shape {traction.shape}: give (component, cell), as the line has "
            f"it: {shape}.",
        )
        if isinstance(self.transfer, np.ndarray):
            spectrum = np.fft.rfft(np.asarray(traction), self.length)
            # Row by row: those of a rig's changes are many, and twice as long as the signals.
            each = (np.sum(row * spectrum, axis=0) for row in self.transfer)
            return np.stack([np.fft.irfft(row, self.length)[: self.n] for row in each])
        return _convolved(self.transfer, traction, self.n, self.length)

    def adjoint(self, signal: Float[Array | np.ndarray, "e n"]) -> Float[Array, "c n"]:
        return _correlated(self.transfer, signal, self.n, self.length)

    @compiled
    def symbol(self, k: Float[Array, " k"]) -> Complex[Array, "e c k"]:
        """The kernel's Fourier sum at any k [rad/m], |k| cell <= pi; as many terms as the kernel
        has samples for each k. On a periodic line `transfer` at its own wavenumbers."""
        ahead = self.n // 2 + 1 if self.is_circular else self.n
        lag = np.arange(self.length)
        lag = np.where(lag < ahead, lag, lag - self.length)
        waves = jnp.exp(-1j * k[:, None] * self.cell_m * lag[None])
        return jnp.einsum("ecl,kl->eck", jnp.fft.irfft(self.transfer, self.length), waves)

    def circulant(self) -> "Convolution":
        """The circular convolution nearest to this one: itself, or its n most central lags."""
        if self.is_circular:
            return self
        transfer = _wrapped(self.transfer, self.n, self.length)
        return Convolution(transfer, self.cell_m, self.n, self.n, self.has_dc_gain)

    @property
    def is_circular(self) -> bool:
        return self.length == self.n


@by_numpy
def _centres(n: int, start_m: Any, cell_m: Any, xp: Any = jnp) -> Float[Any, " n"]:
    return start_m + cell_m * xp.arange(n, dtype=xp.result_type(start_m))


@by_numpy
def _wrapped(
    transfer: Complex[Any, "e c k"], n: int, length: int, xp: Any = jnp
) -> Complex[Any, "e c m"]:
    """The transfer of the n most central lags of a circle of `length`."""
    ahead = n // 2 + 1

    def of_element(rows):
        kernel = xp.fft.irfft(rows, length)
        return xp.fft.rfft(
            xp.concatenate([kernel[..., :ahead], kernel[..., length - (n - ahead) :]], axis=-1)
        )

    # One after the other in numpy, as those of a rig's changes are many.
    return xp.stack([of_element(rows) for rows in transfer]) if xp is np else of_element(transfer)


# By jax.jit, whose dispatch is a quarter of filter_jit's: that is as long as a thousand cells take.
@partial(jax.jit, static_argnames=("n", "length"))
def _convolved(
    transfer: Complex[Array, "e c k"], traction: Float[Array, "c n"], n: int, length: int
) -> Float[Array, "e n"]:
    spectrum = jnp.fft.rfft(traction, length)
    # A sum of products over the (one or two) components: faster than a batched matrix product.
    total = sum(transfer[:, c] * spectrum[c][None] for c in range(transfer.shape[1]))
    return jnp.fft.irfft(total, length)[:, :n]


@partial(jax.jit, static_argnames=("n", "length"))
def _correlated(
    transfer: Complex[Array, "e c k"], signal: Float[Array, "e n"], n: int, length: int
) -> Float[Array, "c n"]:
    spectrum = jnp.fft.rfft(signal, length)
    total = sum(transfer[e].conj() * spectrum[e][None] for e in range(transfer.shape[0]))
    return jnp.fft.irfft(total, length)[:, :n]


class Stage(eqx.Module):
    """A linear, shift-invariant physical stage from traction to signals, in both domains."""

    @property
    def has_dc_gain(self) -> bool:
        """Whether an endless uniform traction gives any signal."""
        return True

    @abc.abstractmethod
    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, "e c k"]:
        """Fourier transfer at the wavenumbers k [rad/m]."""

    @abc.abstractmethod
    def cell_response(
        self, x: Float[Array, " x"], cell_m: Float[Array, ""]
    ) -> Float[Array, "e c x"]:
        """Signal at x from unit uniform traction on the cell |x'| < cell_m/2."""

    def series_radius_m(self, cell_m: Float[Array, ""]) -> Scalar:
        """Distance |x| [m] beyond which [`cell_response`][] is a power series in 1/x, infinite
        where none is known."""
        del cell_m
        return np.inf


class Line(eqx.Module):
    """Base of lines: n cells along x, centred on x[j] = start_m + j cell_m.

    - `n`: number of cells; `cell_m` [m]: width of each; `start_m` [m]: centre of the first.

    Raises `BadInput` for fewer than three cells or a cell width that is not positive.
    """

    n: eqx.AbstractVar[int]
    cell_m: eqx.AbstractVar[Float[Array, ""]]
    start_m: eqx.AbstractVar[Float[Array, ""]]

    @property
    def kind(self) -> str:
        """Its name in a configuration: periodic or open."""
        return type(self).__name__.lower()

    @property
    def x(self) -> Float[Any, " n"]:
        """Cell centres [m]."""
        return _centres(self.n, self.start_m, self.cell_m)

    @property
    def k(self) -> Float[Any, " k"]:
        """Wavenumbers [rad/m] of the n-point half spectrum."""
        return wavenumbers(self.n, self.cell_m)

    @abc.abstractmethod
    def operator(self, stage: Stage) -> Convolution:
        """The stage as a map from cell averages of traction to samples on this line."""

    @abc.abstractmethod
    def differences(self, r: Float[Array, "c n"], order: int) -> Float[Array, "c m"]:
        """Forward differences of `order` 0, 1 or 2, in units of r per cell^order."""


def _checked(n: int, cell_m, start_m) -> tuple[int, Array, Array]:
    refuse(n < 3, f"A line of {n} cells is too short: it needs at least 3 cells or samples.")
    cell_m = number("cell_m", cell_m, "a positive width in metres", above=0)
    start_m = number("start_m", start_m, "a position in metres")
    return int(n), as_real(cell_m), as_real(start_m)


class Periodic(Line):
    """A periodic line, which repeats with its window n cell_m.

    `n` cells; `cell_m` [m]: width of each; `start_m` [m]: centre of the first.

    The traction is the band-limited function with the given cell averages, so that a stage acts
    as transfer(k) / sinc(k cell/2): exact for band-limited traction, order 5/2 for a Hertz edge.
    """

    n: int = eqx.field(static=True)
    cell_m: Float[Array, ""]
    start_m: Float[Array, ""]

    def __init__(self, n: int, cell_m, start_m=0.0):
        self.n, self.cell_m, self.start_m = _checked(n, cell_m, start_m)

    @compiled
    def operator(self, stage: Stage) -> Convolution:
        k = self.k
        transfer = stage.transfer(k) / sinc(k * self.cell_m / 2)[None, None]
        if self.n % 2 == 0:
            # The last wavenumber stands for +k and -k at once: only its real part can act.
            transfer = transfer.at[..., -1].set(transfer[..., -1].real)
        return Convolution(transfer, self.cell_m, self.n, self.n, stage.has_dc_gain)

    def differences(self, r: Float[Array, "c n"], order: int) -> Float[Array, "c n"]:
        for _ in range(order):
            r = jnp.roll(r, -1, axis=-1) - r
        return r


class Open(Line):
    """An open line: traction is zero beyond its window, and nothing wraps around.

    `n` cells; `cell_m` [m]: width of each; `start_m` [m]: centre of the first.

    The traction is constant over each cell, and its stress is exact (Johnson 1985, 2.5).
    """

    n: int = eqx.field(static=True)
    cell_m: Float[Array, ""]
    start_m: Float[Array, ""]

    def __init__(self, n: int, cell_m, start_m=0.0):
        self.n, self.cell_m, self.start_m = _checked(n, cell_m, start_m)

    def operator(self, stage: Stage) -> Convolution:
        length = fast_length(2 * self.n)
        # So many cells that lines of many lengths share a program.
        responses = _cell_responses(stage, shared_count(self.n), self.cell_m)
        transfer = _transfer(*responses, self.n, length)
        return Convolution(transfer, self.cell_m, self.n, length, stage.has_dc_gain)

    def differences(self, r: Float[Array, "c n"], order: int) -> Float[Array, "c m"]:
        return jnp.diff(r, order, axis=-1) if order else r


# Responses of one cell this many cells away and farther are taken from their power series in the
# inverse distance, where it converges within a `CLEAR`-th of that distance: a polynomial through
# `NODES` places leaves 1e-18 of the largest response.
FAR, CLEAR, NODES = 256, 4.0, 16


@by_numpy
def _transfer(
    ahead: Float[Any, "e c m"], back: Float[Any, "e c m"], n: int, length: int, xp: Any = jnp
) -> Complex[Any, "e c k"]:
    """The transfer of the responses up to n - 1 cells away."""
    ahead, back = ahead[..., :n], back[..., :n]
    # Lags that no pair of cells has are padding, and must not wrap into the window.
    padding = xp.zeros((*ahead.shape[:-1], length - 2 * n + 1), ahead.dtype)
    return xp.fft.rfft(xp.concatenate([ahead, padding, back[..., :0:-1]], axis=-1))


@compiled
def _cell_responses(
    stage: Stage, n: int, cell_m: Float[Array, ""]
) -> tuple[Float[Array, "e c n"], Float[Array, "e c n"]]:
    """The signal 0, 1, ..., n - 1 cells after a cell of unit traction, and before it."""
    if n < 8 * FAR:
        response = stage.cell_response(cell_m * np.arange(1 - n, n), cell_m)
        return response[..., n - 1 :], response[..., n - 1 :: -1]
    nodes = np.polynomial.chebyshev.chebpts1(NODES)  # in -1 to 1, as 2 FAR / lag - 1 is
    near, away = np.arange(FAR), 2 * FAR / (1 + nodes)
    places = np.concatenate([near, away, -near, -away])
    parts = stage.cell_response(cell_m * places, cell_m)
    sides = [parts[..., : places.size // 2], parts[..., places.size // 2 :]]
    to_series = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, NODES - 1)).T

    def by_series():
        at = 2 * FAR / jnp.arange(FAR, n, dtype=cell_m.dtype) - 1
        return tuple(_chebyshev(at, side[..., FAR:] @ to_series) for side in sides)

    def one_by_one():
        distance_m = cell_m * np.arange(FAR, n)
        return tuple(stage.cell_response(sign * distance_m, cell_m) for sign in (1, -1))

    is_clear = CLEAR * stage.series_radius_m(cell_m) <= FAR * cell_m
    beyond = jax.lax.cond(is_clear, by_series, one_by_one)
    ahead, back = (
        jnp.concatenate([side[..., :FAR], far], axis=-1)
        for side, far in zip(sides, beyond, strict=True)
    )
    return ahead, back


def _chebyshev(at: Float[Array, " x"], series: Float[Array, "*row m"]) -> Float[Array, "*row x"]:
    """The sum of Chebyshev polynomials at these places, by Clenshaw's recurrence."""
    at = at.reshape((1,) * (series.ndim - 1) + (-1,))
    last, before = jnp.zeros_like(at), jnp.zeros_like(at)
    for degree in range(series.shape[-1] - 1, 0, -1):
        last, before = series[..., degree, None] + 2 * at * last - before, last
    return series[..., 0, None] + at * last - before


LINES = {"periodic": Periodic, "open": Open}  # by the name of what is beyond the ends


@by_numpy
def wavenumbers(n: int, spacing_m, xp: Any = jnp) -> Float[Any, " k"]:
    """Wavenumbers [rad/m] of the half spectrum of n samples `spacing_m` apart."""
    spacing = as_real(spacing_m) if xp is jnp else np.asarray(spacing_m)
    each = xp.arange(n // 2 + 1, dtype=xp.result_type(spacing, jnp.float32))
    return each * (2 * np.pi / (n * spacing))


def sinc(a: Float[Array, "..."]) -> Float[Array, "..."]:
    """sin(a)/a, with its value and its derivatives at and about a = 0."""
    # (cos a - sin(a)/a)/a, the closed form's derivative, cancels for small a: there a series.
    small = jnp.abs(a) < 1
    square, series = jnp.where(small, a, 0.0) ** 2, 1.0
    for n in range(9, 0, -1):
        series = 1 - square * series / (2 * n * (2 * n + 1))
    safe = jnp.where(small, 1.0, a)
    return jnp.where(small, series, jnp.sin(safe) / safe)


def half_spectrum_weights(n: int) -> np.ndarray:
    """Weights (k,) with mean over all n wavenumbers = sum(weights * half spectrum)."""
    weights = np.full(n // 2 + 1, 2.0)
    weights[0] = 1.0
    if n % 2 == 0:
        weights[-1] = 1.0
    return weights / n


def spread_over(kernel: Callable, shifts, weights) -> Callable:
    """x -> sum_j weights[j] kernel(x + shifts[j]), one shift at a time to spare memory."""

    def spread(x):
        def add(total, node):
            shift, weight = node
            return total + weight * kernel(x + shift), None

        nodes = (jnp.asarray(shifts), as_real(weights))
        zero = jnp.zeros_like(kernel(x))
        return jax.lax.scan(add, zero, nodes)[0]

    return spread
