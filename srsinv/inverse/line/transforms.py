"""Real Fourier transforms in numpy, along the last axis and on all cores."""

import functools
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

LONG = 100_000  # values: two such rows, one after the other, leave the processor's cache

ON_A_CORE = "srsinv-rows"  # what threads of the pool are called

Item = TypeVar("Item")
Made = TypeVar("Made")
Rows = np.ndarray | Sequence  # of arrays


def to_spectrum(values: np.ndarray, length: int | None = None) -> np.ndarray:
    """The half spectrum of values, padded with zeros to `length`."""
    n = length or values.shape[-1]
    if n >= LONG:
        dtype = np.result_type(values, np.complex64)
        return _row_by_row(lambda row: np.fft.rfft(row, n), values, n // 2 + 1, dtype)
    return np.fft.rfft(values, length)


def from_spectrum(spectrum: np.ndarray, n: int) -> np.ndarray:
    """The n values of a half spectrum."""
    if n >= LONG:
        dtype = np.real(spectrum).dtype
        return _row_by_row(lambda row: np.fft.irfft(row, n), spectrum, n, dtype)
    return np.fft.irfft(spectrum, n)


def _row_by_row(
    transform: Callable[[np.ndarray], Any], of: np.ndarray, size: int, dtype: np.dtype
) -> np.ndarray:
    """The transforms of long rows, each of this size and on a core of its own."""
    made = np.empty((*of.shape[:-1], size), dtype)

    def put(at: tuple[int, ...]) -> None:
        made[at] = transform(of[at])

    each_on_a_core(put, np.ndindex(of.shape[:-1]))
    return made


def each_on_a_core(
    function: Callable[[Item], Made], items: Iterable[Item], n: int = LONG
) -> list[Made]:
    """The function of each item, on all cores where it is about rows of `n` values that are long;
    what it does itself so is done on its own core alone."""
    if n < LONG or threading.current_thread().name.startswith(ON_A_CORE):
        return list(map(function, items))
    return list(_threads(os.getpid()).map(function, items))


@functools.cache
def _threads(process: int) -> ThreadPoolExecutor:
    """Threads of this process: one that is forked off has none of its parent's."""
    del process
    return ThreadPoolExecutor(os.cpu_count(), ON_A_CORE)


def times(matrices: Rows, spectrum: Rows) -> np.ndarray:
    """The matrix (row, column, k) of each wavenumber times its column (column, k)."""
    rows = (sum(m * s for m, s in zip(row, spectrum, strict=True)) for row in matrices)
    return np.stack([np.asarray(row) for row in rows])


def adjoint(matrices: np.ndarray) -> np.ndarray:
    """The conjugate transpose (column, row, k) of the matrix of each wavenumber."""
    return matrices.conj().swapaxes(0, 1)
