"""Widths that say how fine an estimate is: of averaging kernels, and of resolution over k."""

from typing import Any

import numpy as np
from jaxtyping import Float


def full_width_at_half_maximum(
    lag_m: Float[np.ndarray, " n"], kernel: Float[np.ndarray, " n"]
) -> float:
    """Width [m] of the peak of `kernel` (n,) over `lag_m` (n,), between its two crossings of half
    the maximum, straight lines between samples; NaN where it does not fall that far."""
    if not np.isfinite(kernel).all() or kernel.max() <= 0:
        return float("nan")
    top, half = int(np.argmax(kernel)), kernel.max() / 2
    left = np.flatnonzero(kernel[:top] < half)
    right = np.flatnonzero(kernel[top:] < half)
    if not left.size or not right.size:
        return float("nan")

    def crossing(i: Any, j: Any) -> float:
        fraction = (half - kernel[i]) / (kernel[j] - kernel[i])
        return float(lag_m[i] + fraction * (lag_m[j] - lag_m[i]))

    return crossing(top + right[0] - 1, top + right[0]) - crossing(left[-1], left[-1] + 1)


def cutoff(
    k: Float[np.ndarray, " k"], resolution: Float[np.ndarray, "*c k"]
) -> Float[np.ndarray, "*c"]:
    """The cut-off wavenumber [rad/m]: where the resolution (..., k) last falls through one half;
    NaN if nowhere."""
    high = resolution[..., :-1] >= 0.5
    falls = high & (resolution[..., 1:] < 0.5)
    last = falls.shape[-1] - 1 - np.argmax(falls[..., ::-1], axis=-1)
    upper = np.take_along_axis(resolution, last[..., None], -1)[..., 0]
    lower = np.take_along_axis(resolution, last[..., None] + 1, -1)[..., 0]
    fraction = (upper - 0.5) / np.where(upper > lower, upper - lower, 1.0)
    return np.where(falls.any(axis=-1), k[last] + fraction * (k[1] - k[0]), np.nan)
