"""Real Fourier transforms in numpy, along the last axis and on all cores."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

Rows = np.ndarray | Sequence  # of arrays


def to_spectrum(values: np.ndarray, length: int | None = None) -> np.ndarray:
    """The half spectrum of values, padded with zeros to `length`."""
    spectrum: Any = scipy.fft.rfft(values, length, axis=-1, workers=-1)
    return spectrum


def from_spectrum(spectrum: np.ndarray, n: int) -> np.ndarray:
    """The n values of a half spectrum."""
    values: Any = scipy.fft.irfft(spectrum, n, axis=-1, workers=-1)
    return values


def times(matrices: Rows, spectrum: Rows) -> np.ndarray:
    """The matrix (row, column, k) of each wavenumber times its column (column, k)."""
    rows = (sum(m * s for m, s in zip(row, spectrum, strict=True)) for row in matrices)
    return np.stack([np.asarray(row) for row in rows])


def adjoint(matrices: np.ndarray) -> np.ndarray:
    """The conjugate transpose (column, row, k) of the matrix of each wavenumber."""
    return matrices.conj().swapaxes(0, 1)
