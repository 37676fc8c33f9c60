"""Patterns periodic along x in several channels: their pitch, and its error.

Model of channel c: drift[c](x) + sum over h of a[c, h] cos(2 pi h x / pitch) + b[c, h] sin(...) +
noise of its own level. The drift is a polynomial, slower than twice the longest pitch sought. Only
the pitch is common to the channels; all the rest is linear and projected out (variable projection;
Golub and Pereyra 1973), so that the fit has one parameter.

The standard error comes from [`shifts`][]. Each period of the surface is one reading of how far the
pattern of all channels lies from the fit, and the scatter of these readings about a straight line
gives the error of that line's slope, which is the pitch's. The residual near a line is mostly the
pattern itself, changing with load and posture: smooth over many samples, and common to channels.
The white-noise error (Cramer and Rao's) counts every sample of every channel as new and is several
times too small; scatter between channels misses their common noise. A reading is summed over the
channels first and spans more than the noise's correlation length, so that it needs to know neither.
Not covered: noise that lasts for several periods, and a pattern that is the same in every scan.
"""

from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...grid import as_real
from ...status import Status
from ..nonlinear import fit
from .periodogram import TINY, length

STEPS = 20  # of the scan over pitches, in the time that it takes the scan's end to lose one period
LEAST_PERIODS = 3  # a straight line through the shifts, and one reading to spare

Samples = TypeVar("Samples", Array, np.ndarray)


class Shifts(NamedTuple):
    """Shift of the pattern in each period from the fit, forward along x.

    - `x_m` (b,): the periods' middles; `shift_m` (b,); `weight` (b,): inverse variances, relative.
    """

    x_m: Float[np.ndarray, " b"]
    shift_m: Float[np.ndarray, " b"]
    weight: Float[np.ndarray, " b"]

    def slope_stderr(self) -> float:
        """Standard error [1] of the slope of a straight line through the shifts."""
        root = np.sqrt(self.weight)
        columns = root[:, None] * np.stack([np.ones_like(root), self.x_m - self.x_m.mean()], 1)
        line, *_ = np.linalg.lstsq(columns, root * self.shift_m)
        left = root * self.shift_m - columns @ line
        variance = left @ left / (root.size - 2)
        return float(np.sqrt(variance * np.linalg.inv(columns.T @ columns)[1, 1]))


class Pitch(NamedTuple):
    """A fitted pattern of one pitch.

    - `pattern` (c, n): the periodic part; `rest` (c, n): the residual of it and the drift;
    - `noise` (c,): the channels' standard deviations that weigh them;
    - `stderr_white_m`: as if the noise were white and the channels' independent;
    - `status`: how the search ended.
    """

    pitch_m: float
    stderr_m: float
    stderr_white_m: float
    status: Status
    pattern: Float[np.ndarray, "c n"]
    rest: Float[np.ndarray, "c n"]
    noise: Float[np.ndarray, " c"]
    shifts: Shifts


def drift(x_m: Float[np.ndarray, " n"], fastest_m: float) -> Float[np.ndarray, "n d"]:
    """Orthonormal polynomials over even x that bend no faster than the wavelength `fastest_m`."""
    degree = int(2 * length(x_m) / fastest_m)
    return np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, x_m.size), degree))[0]


def waves(x_m: Samples, pitch_m: Any, harmonics: int, xp: Any = np) -> Samples:
    """Cosines, then sines, of the harmonics from 1 on: (n, 2 harmonics)."""
    phase = 2 * xp.pi / pitch_m * x_m[:, None] * xp.arange(1, harmonics + 1)[None]
    return xp.concatenate([xp.cos(phase), xp.sin(phase)], axis=1)


def without(known: Samples, y: Samples) -> Samples:
    """Rows y (..., n) less their projection on the orthonormal columns `known` (n, d)."""
    return y - (y @ known) @ known.T


def fit_pitch(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, "c n"],
    known: Float[np.ndarray, "n d"],
    range_m: tuple[float, float],
    harmonics: int,
) -> Pitch:
    """Fit the pitch in `range_m` to all channels, each weighted by its residual.

    x even [m], `known` orthonormal columns that every channel may hold besides. The likelihood of
    channels with unknown noise levels is scanned over the range, and the fit starts at its top.
    """
    y = without(known, signal)
    start, noise = locate(x_m, y, known, range_m, harmonics)
    estimate = fit(
        _Pattern(as_real(x_m), as_real(y), as_real(known), harmonics),
        {"pitch_m": start},
        y,
        noise=np.broadcast_to(noise[:, None], y.shape),
        bounds={"pitch_m": range_m},
    )
    fitted = _with_uncertainty(x_m, y, known, float(estimate.value["pitch_m"]), harmonics, noise)
    status = Status.RANGE_END if estimate.at_bound else estimate.status
    return fitted._replace(stderr_white_m=float(estimate.stderr["pitch_m"]), status=status)


class _Pattern(eqx.Module):
    """The part of y with this pitch. Its arrays are traced, so that scans of one shape compile
    once."""

    x_m: Float[Array, " n"]
    y: Float[Array, "c n"]
    known: Float[Array, "n d"]
    harmonics: int = eqx.field(static=True)

    def __call__(self, params) -> Float[Array, "c n"]:
        inputs = self.x_m, self.y, self.known, params["pitch_m"], self.harmonics
        return self.y - _rest(*inputs, jnp)


def scan_pitch(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, "c n"],
    known: Float[np.ndarray, "n d"],
    range_m: tuple[float, float],
    harmonics: int,
) -> Pitch:
    """As [`fit_pitch`][], by the scan and a parabola at its top alone: nothing to compile, and off
    by a small part of the standard error."""
    y = without(known, signal)
    pitch_m, noise = locate(x_m, y, known, range_m, harmonics)
    return _with_uncertainty(x_m, y, known, pitch_m, harmonics, noise)


def channel_pitches(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, "c n"],
    known: Float[np.ndarray, "n d"],
    pitch_m: float,
    harmonics: int,
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Pitch and standard error (c,) [m] of each channel alone, on the line at `pitch_m`."""
    near = unresolved(x_m, pitch_m)
    alone = [scan_pitch(x_m, each[None], known, near, harmonics) for each in signal]
    return np.array([each.pitch_m for each in alone]), np.array([each.stderr_m for each in alone])


def shifts(
    x_m: Float[np.ndarray, " n"],
    slope: Float[np.ndarray, "c n"],
    rest: Float[np.ndarray, "c n"],
    noise: Float[np.ndarray, " c"],
    pitch_m: float,
) -> Shifts:
    """The least-squares shift of a pattern of x-derivative `slope`, in each period of the scan."""
    weighed = slope / noise[:, None] ** 2
    across = -np.sum(weighed * rest, axis=0)
    weight = np.sum(weighed * slope, axis=0)
    periods = max(int(length(x_m) / pitch_m), LEAST_PERIODS)
    edges = np.linspace(0, x_m.size, periods + 1).astype(int)[:-1]
    count = np.diff([*edges, x_m.size])
    total = np.maximum(np.add.reduceat(weight, edges), TINY)
    return Shifts(
        np.add.reduceat(x_m, edges) / count, np.add.reduceat(across, edges) / total, total
    )


def _rest(
    x_m: Samples, y: Samples, known: Samples, pitch_m: Any, harmonics: int, xp: Any = np
) -> Samples:
    """The part of y (c, n), `known` already out of it, that does not have the pitch."""
    columns = without(known, waves(x_m, pitch_m, harmonics, xp).T).T
    return without(xp.linalg.qr(columns)[0], y)


def locate(x_m, y, known, range_m, harmonics: int) -> tuple[float, Float[np.ndarray, " c"]]:
    """The most likely pitch of a scan over the range, and the channels' noise levels there."""
    low, high = 1 / range_m[1], 1 / range_m[0]
    steps = int(np.ceil((high - low) * STEPS * length(x_m)))
    per_m = np.linspace(low, high, max(steps, 2) + 1)
    squares = np.stack(
        [np.sum(_rest(x_m, y, known, 1 / each, harmonics) ** 2, axis=1) for each in per_m]
    )
    # The residual of noise-free data is rounding, whose logarithm would be noise.
    least = np.finfo(float).eps * np.sum(y**2, axis=1) + TINY
    squares = np.maximum(squares, least)
    top = int(np.argmin(np.sum(np.log(squares), axis=1)))
    free = x_m.size - known.shape[1] - 2 * harmonics
    # The squares are a parabola near their least, where the logarithms may have a cusp.
    best_per_m = _vertex(per_m, squares @ (1 / squares[top]), top)
    return float(1 / best_per_m), np.sqrt(squares[top] / free)


def _vertex(at, values, least: int) -> float:
    """The minimum of the parabola through the least of `values` and its neighbours."""
    if not 0 < least < at.size - 1:
        return at[least]
    before, here, after = values[least - 1 : least + 2]
    bend = before - 2 * here + after
    return at[least] + (at[1] - at[0]) * (0.5 * (before - after) / bend if bend > 0 else 0.0)


def unresolved(x_m, wavelength_m: float) -> tuple[float, float]:
    """The range of wavelengths that the scan does not resolve from this one."""
    half = 0.5 / length(x_m)
    return 1 / (1 / wavelength_m + half), 1 / (1 / wavelength_m - half)


def _with_uncertainty(x_m, y, known, pitch_m: float, harmonics: int, noise) -> Pitch:
    """The pattern at this pitch, with its standard error from the shifts."""
    rest = _rest(x_m, y, known, pitch_m, harmonics)
    columns = waves(x_m, pitch_m, harmonics)
    amplitude = np.linalg.lstsq(without(known, columns.T).T, y.T)[0]
    cosine, sine = np.split(columns, 2, axis=1)
    k = 2 * np.pi / pitch_m * np.arange(1, harmonics + 1)
    slope = (np.hstack([-k * sine, k * cosine]) @ amplitude).T
    readings = shifts(x_m, slope, rest, noise, pitch_m)
    stderr = pitch_m * readings.slope_stderr()
    return Pitch(pitch_m, stderr, np.nan, Status.GIVEN, y - rest, rest, noise, readings)
