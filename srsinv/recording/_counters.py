"""Counters that wrap: a column of times or positions that begins anew at 2^16 or 2^32 counts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from srsinv.errors import LARGEST

from ._health import quantisation_step
from ._timing import resolution

_BITS = (8, 10, 12, 14, 16, 20, 24, 32)
_FEW_BITS = 14  # of a counter that goes by one count a sample: it may be a block that starts anew
_CLOSE = 5.0  # times the usual increment that one over a wrap may have
_FEWEST = 8  # samples that show what is usual


class Unwrapped(NamedTuple):
    """Values (sample,) that no longer begin anew, `bits` of the counter (0: it did not wrap), and
    the `rows`, from 0, at which it did."""

    values: Float[np.ndarray, " sample"]
    bits: int = 0
    rows: tuple[int, ...] = ()


def unwrapped(values: Float[np.ndarray, " sample"]) -> Unwrapped:
    """The values, where they jump by the range of a counter, with that range added or taken away.

    A jump is a wrap if it is the only kind of its size, the values span the counter's range, and
    the increment over it is then like its neighbours'.
    """
    if values.size <= _FEWEST or not np.max(np.abs(values)) < LARGEST:
        return Unwrapped(values)
    steps = np.diff(values)
    sizes = np.abs(steps)
    large = np.flatnonzero(sizes > np.ptp(values) / 2)
    usual = np.delete(sizes, large)
    # Samples between wraps: a wrap at every second sample shows nothing.
    if not large.size or 4 * large.size > steps.size or not usual.size:
        return Unwrapped(values)
    most = _CLOSE * float(np.max(usual))
    span = float(np.max(sizes))
    # A count may be the step that the values have, or a power of ten from their last digit to one.
    step, digit = quantisation_step(values) or 0.0, resolution(values)
    digits = [10.0**-place for place in range(10) if digit and 10.0**-place >= 0.99 * digit]
    for count in dict.fromkeys(each for each in (step, *digits) if each > 0):
        few = _FEW_BITS if np.isclose(count, np.median(sizes), rtol=1e-6) else 0
        for bits in (each for each in _BITS if each > few):
            modulus = count * 2.0**bits
            turns = np.round(-steps / modulus)
            turns[sizes <= most] = 0
            left = np.abs(steps + turns * modulus)
            is_full = span <= modulus * (1 + 1e-9) and span + most >= modulus
            if is_full and most < modulus / 2 and np.all(left[large] <= most):
                added = modulus * np.concatenate(([0.0], np.cumsum(turns)))
                rows = tuple((np.flatnonzero(turns) + 1).tolist())
                return Unwrapped(values + added, bits, rows)
    return Unwrapped(values)
