"""Whitening of residuals by the noise of the data: z = N^(-1/2) r, and log det N^(1/2)."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import BadInput, refuse
from ...grid import as_real, half_spectrum_weights
from ...known import array_module, is_traced
from ...modules import with_fields
from ...numerics import shared_count
from ._parameters import on_host, real

# Of each variance, in roundings a row: how much of it the data before must leave open at least.
# Below, the covariance is singular but for rounding, whether or not a factorisation notices.
POSITIVE = 8
# Largest difference of a covariance from its transpose, in standard deviations.
ALIKE = 1e-8
# Relative standard error of a level that is stated, and the least of any that is estimated: two
# digits are rounded by as much, and no noise is the same from one minute to the next to less.
LEVEL_STDERR = 0.01


class Whitener(eqx.Module):
    """Gaussian noise of the data y, of any shape."""

    @property
    def level_stderr(self) -> Any:
        """Relative standard error of its level."""
        return LEVEL_STDERR

    @abc.abstractmethod
    def __call__(self, residual: Float[Array, "..."]) -> Float[Array, " n"]:
        """The residual in units of the noise, in a row: white, of variance one."""

    @abc.abstractmethod
    def log_volume(self, shape: tuple[int, ...]) -> float:
        """Half the log of the determinant of the noise's covariance over data of this shape."""

    @abc.abstractmethod
    def observed(self, shape: tuple[int, ...]) -> Any:
        """Mask of valid data, of the data's shape."""

    def count(self, shape: tuple[int, ...]) -> Any:
        """Number of independent values in the data."""
        observed = self.observed(shape)
        return observed.sum() if is_traced(observed) else int(observed.sum())

    def filled_up(self, shape: tuple[int, ...], more: int) -> "Whitener | None":
        """That of data of this shape and then `more` that are missing along the last axis; None
        where noise of this kind is not known there."""
        del shape, more

    def whitened(self, residual: Float[np.ndarray, "..."]) -> Float[np.ndarray, " n"]:
        """The same of a known residual, by a program that many lengths share."""
        shape = residual.shape
        more = shared_count(shape[-1]) - shape[-1]
        whole = self.filled_up(shape, more) if more else None
        if whole is None:
            return np.asarray(self(as_real(residual)))
        rows = np.asarray(whole(padded(residual, more, 0.0))).reshape(-1, shape[-1] + more)
        return rows[:, : shape[-1]].ravel()


class Independent(Whitener):
    """White noise: a standard deviation for all data, or one for each; infinite leaves one out.

    `relative_stderr`: of these, where they are estimates.
    """

    stderr: Float[Array, "..."] | Float[np.ndarray, "..."]
    relative_stderr: Any = eqx.field(converter=on_host, default=LEVEL_STDERR)

    @property
    def level_stderr(self) -> Any:
        return self.relative_stderr

    def __call__(self, residual: Float[Array, "..."]) -> Float[Array, " n"]:
        observed = jnp.isfinite(self.stderr)
        return jnp.ravel(jnp.where(observed, residual, 0.0) / jnp.where(observed, self.stderr, 1.0))

    def log_volume(self, shape: tuple[int, ...]) -> float:
        stderr = np.broadcast_to(np.asarray(self.stderr), shape)
        return float(np.sum(np.log(stderr[np.isfinite(stderr)])))

    def observed(self, shape: tuple[int, ...]) -> Any:
        xp = array_module(self.stderr)
        return xp.broadcast_to(xp.isfinite(xp.asarray(self.stderr)), shape)

    def filled_up(self, shape: tuple[int, ...], more: int) -> "Independent":
        stderr = np.broadcast_to(np.asarray(self.stderr), shape)
        return with_fields(self, stderr=padded(stderr, more, np.inf))


class Spectrum(Whitener):
    """Stationary noise along the last axis, by its power (k,) per sample at the half spectrum.

    As `forward.noise` has it: white noise of rms s has the power s^2 everywhere. Rows are
    independent and the noise is taken as periodic. An infinite power at k = 0 takes the mean of
    each row out of the data, one elsewhere that wavenumber. Raises `BadInput` for a power that is
    not above 0.
    """

    power: Float[Array, " k"]

    def __init__(self, power):
        sentence = "The noise's power spectrum must be one row of numbers above 0."
        power = real(power, sentence)
        is_wrong = not is_traced(power) and not bool(np.all(power > 0))
        refuse(power.ndim != 1 or is_wrong, sentence)
        self.power = as_real(power)

    def __call__(self, residual: Float[Array, "..."]) -> Float[Array, " n"]:
        n = residual.shape[-1]
        white = jnp.fft.irfft(jnp.fft.rfft(residual) / jnp.sqrt(self.power), n)
        return jnp.ravel(white)

    def log_volume(self, shape: tuple[int, ...]) -> float:
        power = np.asarray(self.power)
        finite = np.isfinite(power)
        logs = np.log(np.where(finite, power, 1.0))
        return float(np.prod(shape) / 2 * np.sum(half_spectrum_weights(shape[-1]) * logs))

    def count(self, shape: tuple[int, ...]) -> Any:
        xp = array_module(self.power)
        finite = xp.isfinite(xp.asarray(self.power))
        count = np.prod(shape) * xp.sum(half_spectrum_weights(shape[-1]) * finite)
        return count if xp is jnp else round(count)

    def observed(self, shape: tuple[int, ...]) -> np.ndarray:
        refuse(
            shape[-1] // 2 + 1 != self.power.size,
            f"The noise's power spectrum has {self.power.size} numbers, but {shape[-1]} samples in "
            f"a row have {shape[-1] // 2 + 1} wavenumbers: give as many.",
        )
        return np.ones(shape, bool)


class WhitePlusOU(Whitener):
    """White noise and one that is correlated along the motion as exp(-|dx|/correlation_m), of the
    same level and length in all rows or of their own.

    Rows are independent. Samples may lie unevenly in x, or be missing: the correlated part is an
    Ornstein-Uhlenbeck process along the path, and a Kalman filter gives each sample's prediction
    from those before it, exactly. Where the motion turns back the noise is taken as independent.

    Raises `BadInput` for a level or a length that is not positive.
    """

    take: Float[Array, "e sample"]
    stderr: Float[Array, "e sample"]
    keep: Float[Array, "place e block"]
    decay_within: Float[Array, "place e block"]
    decay_across: Float[Array, "block e"]
    relative_stderr: Any

    def __init__(self, position_m, white, sliding, correlation_m, relative_stderr=LEVEL_STDERR):
        """`position_m` (sample,); `white` (e, sample), infinite where a sample is left out;
        `sliding` and `correlation_m`, (#e,) or numbers: the correlated part's standard deviation
        and length; `relative_stderr`: of the white noise's level, where it is an estimate."""
        given = position_m, white, sliding, correlation_m
        refuse(
            is_traced(given),
            "Noise that is correlated along the motion has to be known: make "
            "it outside jit, vmap and grad.",
        )
        self.relative_stderr = on_host(relative_stderr)
        white = real(white, "The white noise must be one standard deviation for each of the data.")
        for name, value in (("sliding", sliding), ("correlation_m", correlation_m)):
            above = bool(np.all(np.asarray(value) > 0))
            refuse(not above, f"The noise's {name} is {value!r}: give a number above 0.")
        refuse(
            not bool((white > 0).all()),
            "The white noise has a level that is not above 0: give positive ones.",
        )
        variance, length = (
            np.broadcast_to(np.ravel(each), len(white))
            for each in (np.square(sliding), correlation_m)
        )
        moved = np.abs(np.diff(np.asarray(position_m, float), append=np.inf))
        step = moved / length[:, None]
        decay, added = np.exp(-step), -np.expm1(-2 * step) * variance[:, None]
        each = white**2, decay**2, added, variance
        predicted = _predicted(*(rows.tolist() for rows in each))
        gain, total = np.moveaxis(np.asarray(predicted).reshape(*white.shape, 2), -1, 0)
        keep, take = decay * (1 - gain), decay * gain
        self.take, self.stderr = as_real(take), as_real(np.sqrt(total))
        self.keep, self.decay_within, self.decay_across = _in_blocks(keep)

    @property
    def level_stderr(self) -> Any:
        return self.relative_stderr

    @compiled
    def __call__(self, residual: Float[Array, "e sample"]) -> Float[Array, " n"]:
        observed = jnp.isfinite(self.stderr)
        known = jnp.where(observed, residual, 0.0)

        predicted = self._followed(self.take * known)
        white = (known - predicted) / jnp.where(observed, self.stderr, 1.0)
        return jnp.ravel(jnp.where(observed, white, 0.0))

    def _followed(self, push: Float[Array, "e sample"]) -> Float[Array, "e sample"]:
        """c_i of c_(i+1) = keep_i c_i + push_i, from c_0 = 0: in every block from zero, then the
        carry from block to block."""
        pushed = _by_place(push, jnp)
        ends, within = jax.lax.scan(_follow, jnp.zeros_like(pushed[0]), (self.keep, pushed))
        _, before = jax.lax.scan(_follow, jnp.zeros_like(ends[:, 0]), (self.decay_across, ends.T))
        total = within + self.decay_within * before.T[None]
        return total.transpose(1, 2, 0).reshape(len(push), -1)[:, : push.shape[1]]

    def filled_up(self, shape: tuple[int, ...], more: int) -> "WhitePlusOU":
        keep = np.asarray(self.keep).transpose(1, 2, 0).reshape(len(self.stderr), -1)
        keep, within, across = _in_blocks(padded(keep[:, : shape[-1]], more, 0.0))
        take, stderr = padded(self.take, more, 0.0), padded(self.stderr, more, np.inf)
        return with_fields(
            self, take=take, stderr=stderr, keep=keep, decay_within=within, decay_across=across
        )

    def coloured(self, white: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "e sample m"]:
        """Inverse of whitening: noise with the columns of `white` as its whitened form; zero where
        samples are missing."""
        elements, n = self.stderr.shape
        stderr, take = (np.asarray(each)[..., None] for each in (self.stderr, self.take))
        keep = np.asarray(self.keep).transpose(1, 2, 0).reshape(elements, -1, 1)
        made = np.where(np.isfinite(stderr), stderr, 0.0) * white.reshape(elements, n, -1)
        predicted = np.zeros_like(made[:, 0])
        for i in range(n):
            made[:, i] += np.isfinite(stderr[:, i]) * predicted
            predicted = keep[:, i] * predicted + take[:, i] * made[:, i]
        return made

    def log_volume(self, shape: tuple[int, ...]) -> float:
        del shape
        stderr = np.asarray(self.stderr)
        return float(np.sum(np.log(stderr[np.isfinite(stderr)])))

    def observed(self, shape: tuple[int, ...]) -> np.ndarray:
        refuse(
            self.stderr.shape != shape,
            f"The noise is for data of shape {self.stderr.shape}, but they have {shape}.",
        )
        return np.isfinite(np.asarray(self.stderr))


def _predicted(
    white: Sequence[Sequence[float]],
    factors: Sequence[Sequence[float]],
    added: Sequence[Sequence[float]],
    first: Sequence[float],
) -> list[list[tuple[float, float]]]:
    """Gain and predicted variance (e, sample) of a Kalman filter of processes that begin with the
    variances `first` (e,), beside variances `white` (e, sample), where each step multiplies them by
    `factors` and adds `added` (e, sample).

    In Python's own numbers: arrays of two or three elements take several times as long.
    """
    rows = []
    for begin, *each_row in zip(first, white, factors, added, strict=True):
        expected, own = begin, []
        for each, factor, more in zip(*each_row, strict=True):
            total = expected + each
            gain = expected / total if total else 0.0  # and where the white noise is infinite
            own.append((gain, total))
            expected = factor * (1 - gain) * expected + more
        rows.append(own)
    return rows


def _follow(carry, at):
    # Not within the method: as the same function it is compiled once where it is called eagerly.
    return at[0] * carry + at[1], carry


def padded(values: Any, more: int, by: float) -> Array:
    """Rows with `more` numbers at their ends."""
    whole = np.asarray(values)
    return as_real(np.pad(whole, [(0, 0)] * (whole.ndim - 1) + [(0, more)], constant_values=by))


def _in_blocks(keep: Any) -> tuple[Array, Array, Array]:
    """What is kept from sample to sample (e, n) in about sqrt(n) parallel blocks, with the decay
    over each place in a block, and over each block."""
    blocked = _by_place(np.asarray(keep), np)
    through = np.cumprod(blocked, axis=0)
    within = np.concatenate([np.ones_like(through[:1]), through[:-1]])
    return as_real(blocked), as_real(within), as_real(through[-1].T)


def _by_place(values: Any, xp: Any) -> Any:
    """Rows (e, n), filled up with zeros, as (place in a block, e, block)."""
    elements, n = values.shape
    length = int(np.ceil(np.sqrt(n)))
    blocks = -(-n // length)
    whole = xp.pad(values, ((0, 0), (0, blocks * length - n)))
    return whole.reshape(elements, blocks, length).transpose(2, 0, 1)


class Correlated(Whitener):
    """Noise of a full covariance matrix (n, n) over the data in a row.

    Raises `BadInput` for a matrix that is not symmetric and positive definite.
    """

    factor: Float[Array, "n n"]

    def __init__(self, covariance):
        sentence = "The noise's covariance must be a symmetric matrix over all data in a row."
        covariance = real(covariance, sentence)
        square = covariance.ndim == 2 and covariance.shape[0] == covariance.shape[1]
        refuse(not square, sentence)
        if is_traced(covariance):
            self.factor = jnp.linalg.cholesky(covariance)
            return
        variance = np.diagonal(covariance)
        # Rounding in a covariance that is close to zero is of the size of the variances.
        deviation = np.sqrt(np.abs(variance))
        limit = ALIKE * np.outer(deviation, deviation)
        refuse(not np.all(np.abs(covariance - covariance.T) <= limit), sentence)
        (factorise,) = scipy.linalg.get_lapack_funcs(("potrf",), (covariance,))
        factor, failed = factorise(covariance, lower=1, clean=1)
        least = POSITIVE * np.finfo(factor.dtype).eps * len(covariance) * variance
        refuse(
            bool(failed) or not bool(np.all(np.diagonal(factor) ** 2 > least)),
            "The noise's covariance is not positive definite: add white noise to its diagonal.",
        )
        self.factor = as_real(factor)

    def __call__(self, residual: Float[Array, "..."]) -> Float[Array, " n"]:
        return jax.scipy.linalg.solve_triangular(self.factor, jnp.ravel(residual), lower=True)

    def log_volume(self, shape: tuple[int, ...]) -> float:
        return float(np.sum(np.log(np.diagonal(np.asarray(self.factor)))))

    def observed(self, shape: tuple[int, ...]) -> np.ndarray:
        size = int(np.prod(shape))
        refuse(
            self.factor.shape[0] != size,
            f"The noise's covariance is for {self.factor.shape[0]} data, but there are {size}.",
        )
        return np.ones(shape, bool)


def whitener(noise: Any, shape: tuple[int, ...]) -> tuple[Whitener, Any]:
    """The whitener that `noise` specifies, and the mask of valid data; None is white noise of rms
    one, to be scaled."""
    if not isinstance(noise, Whitener):
        sentence = (
            f"The noise does not fit data of shape {shape}: give one standard deviation, or one "
            "for each."
        )
        stderr = real(1.0 if noise is None else noise, sentence)
        xp = array_module(stderr)
        try:
            stderr = xp.broadcast_to(stderr, shape)
        except ValueError as error:
            raise BadInput(sentence) from error
        refuse(
            xp is np and not bool((stderr > 0).all()),
            "The noise has a standard deviation that is not above 0: give positive ones, "
            "infinite for a sample to leave out.",
        )
        noise = Independent(on_host(stderr))
    return noise, noise.observed(shape)
