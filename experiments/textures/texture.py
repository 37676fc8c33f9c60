"""A texture by its spectrum: density of heights from a signal's power, and the nearest known one.

The signal's power at a wavenumber is gain times density plus noise; see
docs/explanation/physics/contact.md, for the linear law of full contact behind the gain. Powers are
per sample, as those of `forward.noise`.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

LEVEL = 0.9  # of the band about a density


class Bands:
    """Bands of wavenumber even in its logarithm, each of one wave or more.

    - `gain` (k,): power of the signal per unit of density; `noise` (k,): its own, both at the
      wavenumbers `k` of a whole window.
    - Bands end before `last` [rad/m]; there are at most `count`. `middle` (band,) and `edges`.
    """

    def __init__(self, k, gain, noise, last: float, count: int):
        k = np.asarray(k)
        edges = np.unique(np.round(np.geomspace(1, last / k[1], count + 1)).astype(int))
        self._waves, self._sizes = slice(edges[0], edges[-1]), np.diff(edges)
        self._gain, self._noise = np.asarray(gain), np.asarray(noise)
        self.edges = k[edges] - k[1] / 2
        self.middle = np.sqrt(self.edges[:-1] * self.edges[1:])

    @property
    def gain(self) -> Float[np.ndarray, " band"]:
        """The gain summed over each band."""
        return self.sum(self._gain)

    def sum(self, values: Float[np.ndarray, "*rows k"]) -> Float[np.ndarray, "*rows band"]:
        """Summed over each band."""
        return self._add(values[..., self._waves])

    def average(self, density: Float[np.ndarray, "*rows k"]) -> Float[np.ndarray, "*rows band"]:
        """A density averaged over each band, with the weights of its estimate."""
        return self.sum(self._gain * density) / self.sum(self._gain)

    def density(self, power: Float[np.ndarray, "*rows k"]) -> tuple[np.ndarray, ...]:
        """The density (..., band) estimated from the power, and the two ends of its confidence
        interval.

        Each wave's power is exponential about its expectation: a band's is taken as chi-square with
        two degrees of freedom for each wave, fewer where they weigh unequally.
        """
        total, noise, gain = self.sum(power), self.sum(self._noise), self.sum(self._gain)
        value = (total - noise) / gain
        flat = np.repeat(np.maximum(value, 0.0), self._sizes, axis=-1)
        each = self._gain[self._waves] * flat + self._noise[self._waves]
        freedom = 2 * self._add(each) ** 2 / self._add(each**2)
        low, high = (
            np.maximum(freedom * total / scipy.stats.chi2.ppf(probability, freedom) - noise, 0.0)
            / gain
            for probability in ((1 + LEVEL) / 2, (1 - LEVEL) / 2)
        )
        return value, low, high

    def usable(self, power: Float[np.ndarray, "row k"]) -> Bool[np.ndarray, "row band"]:
        """The bands in a row, about the clearest one, that have more signal than noise."""
        ratio = self.sum(power) / self.sum(self._noise)
        return np.stack([_run_about(int(row.argmax()), row > 2) for row in ratio])

    def limits(self, usable: Bool[np.ndarray, " band"]) -> Float[np.ndarray, "2"]:
        """Lower and upper limit of the usable bands [rad/m], NaN where there are none."""
        at = np.flatnonzero(usable)
        if not at.size:
            return np.full(2, np.nan)
        return self.edges[[at[0], at[-1] + 1]]

    def _add(self, values: np.ndarray) -> np.ndarray:
        starts = np.cumsum(self._sizes) - self._sizes
        return np.add.reduceat(values, starts, axis=-1)


def _run_about(top: int, mask: np.ndarray) -> np.ndarray:
    """Mask of the run of true values about `top`."""
    left, right = mask[: top + 1][::-1], mask[top:]
    return np.concatenate([np.cumprod(left)[::-1][:-1], np.cumprod(right)]) == 1


class HeightSpectra(NamedTuple):
    """Densities of height [m^3] in bands of wavenumber, by the linear law of full contact.

    - `middle` [rad/m] of the bands; `densities`, with their bands of 90 % from `low` to `high`;
      `mean` of the draws.
    - `expected`: of the true density; `usable`: which have more signal than noise, with their
      `limits` [rad/m].
    - `ratio`: power estimated over the true one, in the usable bands.
    """

    middle: Float[np.ndarray, " band"]
    densities: Float[np.ndarray, "contact texture draw band"]
    low: Float[np.ndarray, "contact texture draw band"]
    high: Float[np.ndarray, "contact texture draw band"]
    mean: Float[np.ndarray, "contact texture band"]
    expected: Float[np.ndarray, "texture band"]
    usable: Bool[np.ndarray, "texture band"]
    limits: Float[np.ndarray, "texture 2"]
    ratio: Float[np.ndarray, "contact texture"]

    @property
    def coverage(self) -> float:
        """Fraction of usable bands under the first pressure that hold the expected density."""
        expected = self.expected[:, None]
        inside = (self.low[0] <= expected) & (expected <= self.high[0])
        return float(inside[np.broadcast_to(self.usable[:, None], inside.shape)].mean())


def height_spectra(
    bands: Bands,
    power: Float[np.ndarray, "contact texture draw k"],
    truth: Float[np.ndarray, "texture k"],
) -> HeightSpectra:
    """Spectra of heights from the power of whole windows; `truth` is their density [m^3]."""
    expected, usable = bands.average(truth), bands.usable(power[0].mean(axis=1))
    mean = bands.density(power.mean(axis=2))[0]
    weights = usable * bands.gain
    densities, low, high = bands.density(power)
    return HeightSpectra(
        bands.middle,
        densities,
        low,
        high,
        mean,
        expected,
        usable,
        np.stack([bands.limits(row) for row in usable]),
        np.sum(weights * mean, axis=-1) / np.sum(weights * expected, axis=-1),
    )


def tapered_power(
    signal: Float[np.ndarray, "*rows n"], samples: int
) -> Float[np.ndarray, "*rows j"]:
    """Power of the first `samples` of each signal under a Hann window."""
    taper = _hann(samples)
    return np.abs(np.fft.rfft(taper * signal[..., :samples])) ** 2 / np.sum(taper**2)


def expected_power(
    power: Float[np.ndarray, "*rows k"], n: int, samples: int
) -> Float[np.ndarray, "*rows j"]:
    """Expectation of [`tapered_power`][] where the signal has this power over windows of n."""
    taper, lags = _hann(samples), np.arange(samples)
    overlap = np.correlate(taper, taper, "full")[samples - 1 :] / np.sum(taper**2)
    covariance = np.fft.irfft(power, n)[..., lags]
    # Real and even in the lag: all lags but zero count twice.
    lagged = np.where(lags > 0, 2.0, 1.0) * overlap * covariance
    return np.fft.rfft(lagged, axis=-1).real


def nearest(
    power: Float[np.ndarray, "*rows j"], references: Float[np.ndarray, "reference j"]
) -> Int[np.ndarray, "*rows"]:
    """The reference under which each row of power is most likely, by its place.

    Whittle's likelihood: waves independent, their power exponential about the reference's. The
    mean and the last wave are left out.
    """
    waves, spectra = power[..., None, 1:-1], references[:, 1:-1]
    return np.sum(waves / spectra + np.log(spectra), axis=-1).argmin(axis=-1)


def confusion(
    power: Float[np.ndarray, "truth draw j"], references: Float[np.ndarray, "reference j"]
) -> Int[np.ndarray, "truth reference"]:
    """How many draws of each texture are nearest to each reference."""
    count = len(references)
    return np.stack([np.bincount(row, minlength=count) for row in nearest(power, references)])


def _hann(samples: int) -> np.ndarray:
    return np.hanning(samples + 2)[1:-1]
