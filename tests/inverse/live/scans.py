"""Scans with known traction, sampled along a motion, and exact answers for cells.

The signal of a sample is interpolated between cells eight times finer than those of the inversion,
of which each of those is eight alike.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import scipy

from srsinv import Live, LiveCells, Open, Sensor, Wiener
from srsinv.forward.film import SampleAverage
from srsinv.forward.sensor import FilmSignal
from srsinv.grid import as_real
from srsinv.inverse.wiener import Exponential

DEPTH_M = 0.75e-3
CELL_M = DEPTH_M / 8
RATE_HZ, SPEED_M_PER_S, OHM = 1e4, 0.05, 1e6
RMS_PA, CORRELATION_M = 1500.0, 0.4e-3
FINE = 8


def prior(rms_Pa: float = RMS_PA) -> Wiener:
    """Exponentially correlated p and q."""
    return Wiener(p=Exponential(rms_Pa, CORRELATION_M), q=Exponential(rms_Pa, CORRELATION_M))


@cache
def _state() -> dict[str, np.ndarray]:
    return Live(Sensor(), prior(), lag_m=4 * DEPTH_M).state()


def live(noise=None) -> Live:
    """A live inversion of two elements with a lag of four depths; its noise adaptive, or given."""
    state = dict(_state())
    if noise is not None:
        level = np.full(2, noise)
        state |= {"settings.noise": level, "level.given": level**2, "level.variance": level**2}
    return Live.from_state(state)


class World(NamedTuple):
    """Cells at `x_m`, their traction (2, n) [Pa], and the signal per unit gain as a function of the
    position."""

    x_m: np.ndarray
    traction: np.ndarray
    field: scipy.interpolate.CubicSpline

    def scores(self, cells: LiveCells) -> np.ndarray:
        """Errors over standard errors (2, n)."""
        own = np.round((cells.x_m - self.x_m[0]) / CELL_M).astype(int)
        value, stderr = (cells.p_Pa, cells.q_Pa), (cells.p_stderr_Pa, cells.q_stderr_Pa)
        return (np.stack(value) - self.traction[:, own]) / np.stack(stderr)


def drawn(rng, length_m: float = 0.03, margin_m: float = 0.02) -> World:
    """Traction drawn from the prior."""
    n = round((length_m + 2 * margin_m) / CELL_M)
    decay = np.exp(-CELL_M / CORRELATION_M)
    white = rng.normal(size=(2, n + 200))
    traction = scipy.signal.lfilter([np.sqrt(1 - decay**2)], [1, -decay], white)[:, 200:]
    return world(RMS_PA * traction, margin_m)


def world(traction: np.ndarray, margin_m: float = 0.02, sensor: Sensor | None = None) -> World:
    """The world of this traction (2, n), which begins `margin_m` before x = 0."""
    n, first = traction.shape[1], -round(margin_m / CELL_M)
    sensor = Sensor() if sensor is None else sensor
    stage = FilmSignal(sensor.skin, sensor.elements, as_real(1.0), 1)
    fine = Open(n * FINE, CELL_M / FINE, (first + 0.5 / FINE) * CELL_M)
    field = np.asarray(fine.operator(stage)(np.repeat(traction, FINE, axis=1)))
    x_m = (first + 0.5 + np.arange(n)) * CELL_M
    return World(x_m, traction, scipy.interpolate.CubicSpline(np.asarray(fine.x), field, axis=1))


def steady(length_m: float = 0.03) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, positions and speeds at constant speed."""
    time_s = np.arange(int(length_m / SPEED_M_PER_S * RATE_HZ)) / RATE_HZ
    return time_s, SPEED_M_PER_S * time_s, np.full(time_s.size, SPEED_M_PER_S)


def paced(profile, length_m: float = 0.03) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same at `profile` times the speed, a function of the time."""
    time_s = np.arange(int(4 * length_m / SPEED_M_PER_S * RATE_HZ)) / RATE_HZ
    speed = SPEED_M_PER_S * profile(time_s)
    x = scipy.integrate.cumulative_trapezoid(speed, time_s, initial=0.0)
    own = x < length_m
    return time_s[own], x[own], speed[own]


def recorded(rng, own: World, x_m, speed_m_per_s, noise) -> np.ndarray:
    """The voltages (2, n) along a motion, with white noise of this rms (sample by sample)."""
    clean = OHM * speed_m_per_s * own.field(x_m)
    return clean + noise * rng.normal(size=clean.shape)


def volts(own: World) -> float:
    """The rms of a steady scan's signal."""
    return float(OHM * SPEED_M_PER_S * np.sqrt(np.mean(own.field(own.x_m[200:-200]) ** 2)))


def run(inversion: Live, time_s, x_m, signal, chunk: int | None = None) -> LiveCells:
    """All cells of a scan that is pushed in chunks."""
    step = chunk or len(time_s)
    parts = [
        inversion.push(time_s[i : i + step], x_m[i : i + step], signal[:, i : i + step])
        for i in range(0, len(time_s), step)
    ]
    return LiveCells.joined([*parts, inversion.finish()])


@cache
def exact_covariance(lags: int) -> np.ndarray:
    """Covariances (z, z, lag) of p, q and the two elements' cell averages, in units of their
    standard deviations: from the exponential's covariance and the kernel of one cell."""
    average = SampleAverage(64, CELL_M / 64)
    sensor = Sensor().with_films(lambda film: film.with_effect(average))
    reach = 4 * lags
    operator = Open(reach, CELL_M).operator(
        FilmSignal(sensor.skin, sensor.elements, as_real(1.0), 1)
    )
    circle = np.fft.irfft(np.asarray(operator.transfer), operator.length)
    kernel = np.concatenate([circle[..., 1 - reach :], circle[..., :reach]], axis=-1)
    apart = np.exp(-CELL_M / CORRELATION_M * np.abs(np.arange(-2 * reach, 2 * reach + 1)))
    # r with r is `apart`; s with r is the kernel over that; s with s that over the other kernel.
    with_r = scipy.signal.fftconvolve(kernel, apart[None, None], axes=-1)
    middle = (with_r.shape[-1] - 1) // 2
    values = np.zeros((4, 4, lags + 1))
    values[0, 0] = values[1, 1] = apart[2 * reach : 2 * reach + lags + 1]
    values[2:, :2] = with_r[..., middle : middle + lags + 1]
    values[:2, 2:] = with_r[..., middle - lags : middle + 1][..., ::-1].swapaxes(0, 1)
    for a in range(2):
        for b in range(2):
            both = sum(scipy.signal.fftconvolve(with_r[a, c], kernel[b, c][::-1]) for c in range(2))
            centre = (both.size - 1) // 2
            values[2 + a, 2 + b] = both[centre : centre + lags + 1]
    size = np.sqrt(np.einsum("aa->a", values[..., 0]))
    return values / size[:, None, None] / size[None, :, None]


def dense(
    covariance: np.ndarray, signal: np.ndarray, noise: np.ndarray, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and standard error (2, cell) of these cells' traction, given the signals
    (2, n), NaN where missing, with noise of these variances (2, n); all in units of the standard
    deviations."""
    n = signal.shape[1]
    lag = np.arange(n)[:, None] - np.arange(n)

    def block(a: int, b: int) -> np.ndarray:
        rows = np.where(lag >= 0, covariance[a, b][np.abs(lag)], covariance[b, a][np.abs(lag)])
        return np.asarray(rows)

    known = np.isfinite(signal).ravel()
    among = np.block([[block(2 + a, 2 + b) for b in range(2)] for a in range(2)])
    among = (among + np.diag(noise.ravel()))[np.ix_(known, known)]
    with_r = np.concatenate(
        [np.hstack([block(c, 2 + b)[cells] for b in range(2)]) for c in range(2)]
    )[:, known]
    weights = np.linalg.solve(among, with_r.T).T
    mean = weights @ signal.ravel()[known]
    variance = covariance[0, 0, 0] - np.sum(weights * with_r, axis=1)
    return mean.reshape(2, -1), np.sqrt(variance).reshape(2, -1)
