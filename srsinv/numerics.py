"""Numbers: sums along millions of samples without loss of digits, lengths of fast Fourier
transforms, means of what is known, whole steps in a length, runs in a mask, roots of covariances,
orthonormal bases, and a normal's band."""

import math

import numpy as np
from jaxtyping import Bool, Float

BAND_90 = 1.6448536269514722  # half-width of a normal's central 90 %, in standard errors
FEW = 64  # values that are added in sequence
# Of a number of steps: far above what sums over a recording leave in it, which differs from one
# processor to another, and far below what makes a step shorter or longer.
SAME_COUNT = 1e-9
FLAT = 1e-9  # of a spectrum: what differs by less differs by rounding
ALIKE = 1e-6  # relative singular value below which directions are dependent
ROUNDED = 16 * float(np.finfo(float).eps)  # of a sum of squares: what rounding leaves of it


def fast_length(least: int) -> int:
    """The least length of a fast real Fourier transform, at least `least`: 2^a 3^b 5^c."""
    lengths = []
    five = 1
    while five < 5 * least:
        three = five
        while three < 3 * least:
            lengths.append(three << max(0, (-(-least // three) - 1).bit_length()))
            three *= 3
        five *= 5
    return min(lengths)


def shared_count(n: int) -> int:
    """A number from n on, at most a quarter more: 4, 5, 6 or 7 times a power of two. Programs for
    so many cells or samples serve all lengths below."""
    step = 1 << max(0, (n - 1).bit_length() - 3)
    return -(-n // step) * step


def blackman_harris(n: int) -> Float[np.ndarray, " n"]:
    """Harris's window of four terms, whose side lobes are below -92 dB (1978, table 1)."""
    phase = np.linspace(-np.pi, np.pi, n)
    terms = (0.35875, 0.48829, 0.14128, 0.01168)
    return sum((a * np.cos(i * phase) for i, a in enumerate(terms)), np.zeros(n))


def mean_known(values: Float[np.ndarray, "..."], axis: int | None = None) -> np.ndarray:
    """The mean of what is not NaN, NaN where all is."""
    known = ~np.isnan(values)
    total, count = np.sum(np.where(known, values, 0.0), axis), np.sum(known, axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def whole_steps(length: float, step: float) -> int:
    """How many steps lie within a length, a last one that is cut by rounding alone with them."""
    return math.floor(length / step * (1 + SAME_COUNT))


def root_of(covariance: Float[np.ndarray, "*row m m"]) -> Float[np.ndarray, "*row m m"]:
    """A root R, R R^T the covariance, also of one that rounding has made indefinite."""
    values, axes = np.linalg.eigh(covariance)
    return axes * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def orthonormal_basis(columns: Float[np.ndarray, "row m"]) -> Float[np.ndarray, "row k"]:
    """An orthonormal basis of the columns' space, whatever their lengths; dependent columns are
    dropped."""
    length = np.linalg.norm(columns, axis=0)
    unit = columns[:, length > 0] / length[length > 0]
    basis, strength, _ = np.linalg.svd(unit, full_matrices=False)
    return basis[:, strength > ALIKE * strength.max(initial=0.0)]


def is_flat(spectra: Float[np.ndarray, "*row k"]) -> bool:
    """Whether each spectrum is the same at all k, but for rounding."""
    return bool(np.all(np.ptp(spectra, axis=-1) <= FLAT * np.max(np.abs(spectra), axis=-1)))


def runs(mask: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """The [start, stop) index ranges over which `mask` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def pairwise_cumsum(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Cumulative sum with rounding that grows as the logarithm of the number of values.

    Sums of pairs first, and of these the same again (Blelloch 1990).
    """
    if values.size <= FEW:
        return np.cumsum(values)
    pairs = values.size // 2
    upto = pairwise_cumsum(values[: 2 * pairs : 2] + values[1 : 2 * pairs : 2])
    total = np.empty_like(upto, shape=values.size)
    total[0], total[1 : 2 * pairs : 2] = values[0], upto
    later = total[2::2]
    later[:] = values[2::2] + upto[: later.size]
    return total
