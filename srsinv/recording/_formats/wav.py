"""WAV: a column a channel, at the file's own sample rate."""

import warnings
from pathlib import Path

import numpy as np
import scipy.io.wavfile
from jaxtyping import Float

from .._table import Table

UNIT = "full scale"


def read_wav(path: Path) -> Table:
    """`channel_0`, `channel_1`, ... as fractions of full scale, with `sample_rate_hz`.

    What a full scale is in volts only the experimenter knows: it is the inverse of `gain`.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Reached EOF", scipy.io.wavfile.WavFileWarning)
        rate_hz, samples = scipy.io.wavfile.read(path)
    if rate_hz <= 0:
        raise ValueError("no sample rate")
    table = Table(path.name, sidecar={"sample_rate_hz": int(rate_hz)})
    scaled = _full_scale(samples if samples.ndim == 2 else samples[:, None])
    for index, values in enumerate(scaled.T):
        name = f"channel_{index}"
        table.take(name, values.shape, values.dtype, values.copy, UNIT)
        table.signals.append(name)
    return table


def _full_scale(samples: np.ndarray) -> Float[np.ndarray, "sample channel"]:
    """Integers as fractions of their largest magnitude (unsigned ones about their middle)."""
    if samples.dtype.kind == "f":
        return samples.astype(np.float64)
    half = 2.0 ** (8 * samples.dtype.itemsize - 1)
    return (samples - (half if samples.dtype.kind == "u" else 0.0)) / half
