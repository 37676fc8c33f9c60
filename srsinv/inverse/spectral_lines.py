"""Spectral lines: patterns periodic along x in several channels, and the error of their pitch.

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
from scipy.ndimage import median_filter
from scipy.stats import chi2, f

from ..grid import as_real
from ..status import Status
from .nonlinear import fit

STEPS = 20  # of the scan over pitches, in the time that it takes the scan's end to lose one period
OVERSAMPLING = 4  # of the periodogram
LOBE = 2.0  # half-width of the Hann taper's main lobe, in 1/length
FLOOR = 16  # width of the running median, in 1/length: a line's lobe takes a quarter of it
FLOOR_BINS = FLOOR / 1.5 * 2 / np.pi  # bins of a mean as precise: Hann's 1.5, a median's 2/pi
MOST_LINES = 8
LEAST_PERIODS = 3  # a straight line through the shifts, and one reading to spare
_TINY = np.finfo(float).tiny

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


class SpectralPeak(NamedTuple):
    """A significant line: `explained_fraction` of the channels' variance (mean over channels),
    `false_alarm` the probability that noise alone has one as strong anywhere."""

    wavelength_m: float
    stderr_m: float
    explained_fraction: float
    false_alarm: float


class Periodogram(NamedTuple):
    """A periodogram summed over channels, at `per_m` (k,) [cycles/m], and its distribution under
    noise.

    - `power` (k,), in the square of the channels' unit; `floor` (k,): its level between lines;
    - `shift`, `step`, `dof`: power / floor is like shift + step chi-square(dof), matched in three
      cumulants to the sum over channels that are not independent (Buckley and Eagleson 1988);
    - `trials`: independent wavenumbers.
    """

    per_m: Float[np.ndarray, " k"]
    power: Float[np.ndarray, " k"]
    floor: Float[np.ndarray, " k"]
    shift: float
    step: float
    dof: float
    trials: float

    def false_alarm(self, power: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Probability that noise alone reaches `power` (k,) at any wavenumber."""
        excess = (power / self.floor - self.shift) / (self.step * self.dof)
        return np.minimum(1.0, self.trials * f.sf(excess, self.dof, self.dof * FLOOR_BINS))

    def level(self, false_alarm: float) -> Float[np.ndarray, " k"]:
        """The power (k,) that noise alone reaches anywhere with this probability."""
        excess = f.isf(false_alarm / self.trials, self.dof, self.dof * FLOOR_BINS)
        return self.floor * (self.shift + self.step * self.dof * excess)


class SpectralPeaks(NamedTuple):
    """The lines found, the strongest first, the spectrum of the residual without them, and the
    power `before` (k,) any was taken out, in the same units."""

    lines: tuple[SpectralPeak, ...]
    left: Periodogram
    before: Float[np.ndarray, " k"]

    def false_alarm_at(self, wavelength_m: float, harmonics: int) -> float:
        """Probability that noise alone is as strong anywhere as the strongest of these harmonics
        was."""
        at = [
            np.argmin(np.abs(self.left.per_m - h / wavelength_m)) for h in range(1, harmonics + 1)
        ]
        return float(np.min(self.left.false_alarm(self.before)[at]))


def drift(x_m: Float[np.ndarray, " n"], fastest_m: float) -> Float[np.ndarray, "n d"]:
    """Orthonormal polynomials over even x that bend no faster than the wavelength `fastest_m`."""
    degree = int(2 * _length(x_m) / fastest_m)
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
    start, noise = _locate(x_m, y, known, range_m, harmonics)
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
    pitch_m, noise = _locate(x_m, y, known, range_m, harmonics)
    return _with_uncertainty(x_m, y, known, pitch_m, harmonics, noise)


def channel_pitches(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, "c n"],
    known: Float[np.ndarray, "n d"],
    pitch_m: float,
    harmonics: int,
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Pitch and standard error (c,) [m] of each channel alone, on the line at `pitch_m`."""
    near = _resolved(x_m, pitch_m)
    alone = [scan_pitch(x_m, each[None], known, near, harmonics) for each in signal]
    return np.array([each.pitch_m for each in alone]), np.array([each.stderr_m for each in alone])


def find_lines(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, "c n"],
    pitch: tuple[float, int],
    longest_m: float,
    false_alarm: float,
) -> SpectralPeaks:
    """The significant lines, up to `longest_m`, beside `pitch` (its value [m] and harmonics).

    The most significant is taken out and the rest searched again, until none exceeds the level that
    noise reaches with probability `false_alarm`, or `MOST_LINES` are found. A line that the scan
    cannot resolve from one already out does not count as another.
    """
    base = [drift(x_m, 2 * longest_m), waves(x_m, *pitch)]
    taken = [h / pitch[0] for h in range(1, pitch[1] + 1)]
    detected: dict[float, float] = {}

    def known(others) -> Float[np.ndarray, "n d"]:
        return np.linalg.qr(np.hstack([*base, *(waves(x_m, other, 1) for other in others)]))[0]

    while True:
        rest = without(known(detected), signal)
        scale = np.maximum(rest.std(axis=1), _TINY)
        left = spectrum(x_m, rest / scale[:, None], longest_m)
        distance = np.abs(left.per_m[:, None] - np.array(taken)[None]).min(axis=1)
        excess = np.where(distance < LOBE / _length(x_m), 0.0, left.power / left.floor)
        top = int(np.argmax(excess))
        chance = float(left.false_alarm(left.power)[top])
        if excess[top] == 0.0 or chance > false_alarm or len(detected) == MOST_LINES:
            break
        near = _resolved(x_m, 1 / left.per_m[top])
        wavelength, _ = _locate(x_m, rest, known(detected), near, 1)
        detected[wavelength] = chance
        taken.append(1 / wavelength)

    total = without(base[0], signal)
    lines = []
    for wavelength, chance in detected.items():
        others = known(other for other in detected if other != wavelength)
        alone = scan_pitch(x_m, signal, others, _resolved(x_m, wavelength), 1)
        explained_fraction = np.mean(np.sum(alone.pattern**2, axis=1) / np.sum(total**2, axis=1))
        lines.append(SpectralPeak(alone.pitch_m, alone.stderr_m, float(explained_fraction), chance))
    lines.sort(key=lambda line: -line.explained_fraction)
    before = spectrum(x_m, total / scale[:, None], longest_m).power
    return SpectralPeaks(tuple(lines), left, before)


def spectrum(
    x_m: Float[np.ndarray, " n"], y: Float[np.ndarray, "c n"], longest_m: float
) -> Periodogram:
    """The Hann-tapered periodogram of y (channels of like noise), from `longest_m` down to two
    samples, and its own scale.

    Floor and scatter come from medians and capped sums, which a few lines hardly move.
    """
    step = x_m[1] - x_m[0]
    bins = OVERSAMPLING * x_m.size
    per_m = np.fft.rfftfreq(bins, step)
    in_band = (per_m >= 1 / longest_m) & (per_m < 0.5 / step)
    amplitude = np.fft.rfft(y * np.hanning(x_m.size), bins)[:, in_band]
    power = np.maximum(np.sum(np.abs(amplitude) ** 2, axis=0), _TINY)
    floor = _floor(per_m[in_band], power)
    trials = _length(x_m) * (0.5 / step - 1 / longest_m)
    return Periodogram(per_m[in_band], power, floor, *_scatter(amplitude, power, floor), trials)


def _floor(per_m, power) -> Float[np.ndarray, " k"]:
    """The running median, taken about a parabola in the logarithms: unbiased at the ends of a red
    spectrum too."""
    at = np.log(per_m)
    trend = np.exp(np.polyval(np.polyfit(at, np.log(power), 2), at))
    width = min(FLOOR * OVERSAMPLING, power.size) // 2 * 2 + 1
    return trend * median_filter(power / trend, width, mode="reflect")


def _scatter(amplitude, power, floor) -> tuple[float, float, float]:
    """Shift, step and degrees of freedom of power / floor, whose median is 1.

    From the eigenvalues of the channels' covariance: the sum over channels is one of as many
    exponential variables. Bins are capped at their 90 % quantile, so that lines hardly count.
    """
    ratio = power / floor
    weight = np.minimum(1.0, np.quantile(ratio, 0.9) / ratio) / floor
    eigenvalues = np.linalg.eigvalsh((amplitude * weight) @ amplitude.conj().T)
    one, two, three = (np.sum(eigenvalues**order) for order in (1, 2, 3))
    dof = 2 * two**3 / three**2
    step = np.sqrt(two / (2 * dof))
    shift = one - step * dof
    median = shift + step * chi2.median(dof)
    return float(shift / median), float(step / median), float(dof)


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
    periods = max(int(_length(x_m) / pitch_m), LEAST_PERIODS)
    edges = np.linspace(0, x_m.size, periods + 1).astype(int)[:-1]
    count = np.diff([*edges, x_m.size])
    total = np.maximum(np.add.reduceat(weight, edges), _TINY)
    return Shifts(
        np.add.reduceat(x_m, edges) / count, np.add.reduceat(across, edges) / total, total
    )


def _length(x_m) -> float:
    return float(x_m[-1] - x_m[0])


def _rest(
    x_m: Samples, y: Samples, known: Samples, pitch_m: Any, harmonics: int, xp: Any = np
) -> Samples:
    """The part of y (c, n), `known` already out of it, that does not have the pitch."""
    columns = without(known, waves(x_m, pitch_m, harmonics, xp).T).T
    return without(xp.linalg.qr(columns)[0], y)


def _locate(x_m, y, known, range_m, harmonics: int) -> tuple[float, Float[np.ndarray, " c"]]:
    """The most likely pitch of a scan over the range, and the channels' noise levels there."""
    low, high = 1 / range_m[1], 1 / range_m[0]
    steps = int(np.ceil((high - low) * STEPS * _length(x_m)))
    per_m = np.linspace(low, high, max(steps, 2) + 1)
    squares = np.stack(
        [np.sum(_rest(x_m, y, known, 1 / each, harmonics) ** 2, axis=1) for each in per_m]
    )
    # The residual of noise-free data is rounding, whose logarithm would be noise.
    least = np.finfo(float).eps * np.sum(y**2, axis=1) + _TINY
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


def _resolved(x_m, wavelength_m: float) -> tuple[float, float]:
    """The range of wavelengths that the scan does not resolve from this one."""
    half = 0.5 / _length(x_m)
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


def strongest_line_m(x: np.ndarray, values: np.ndarray) -> float | None:
    """Wavelength [m] of the strongest line of evenly spaced values, drift taken out.

    By the windowed, finely sampled periodogram of the residual of a straight line, over wavelengths
    from two cells to two fifths of the stretch (a Hann window blurs longer ones into the drift).
    """
    if len(x) < 16:
        return None
    left = values - np.polynomial.Polynomial.fit(x, values, 1)(x)
    n = 32 * len(x)
    power = np.abs(np.fft.rfft(left * np.hanning(len(x)), n)) ** 2
    frequency = np.fft.rfftfreq(n, (x[-1] - x[0]) / (len(x) - 1))
    band = frequency >= 2.5 / (x[-1] - x[0])
    top = int(np.argmax(np.where(band, power, -1.0)))
    return float(1 / frequency[top])
