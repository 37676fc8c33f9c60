"""WAV: a column a channel, at the file's own sample rate."""

import struct
import warnings

import numpy as np
import scipy
from jaxtyping import Float

from ...files import DataFile
from .._table import ColumnTable
from ..reader import Reader

_UNIT = "full scale"
_MOST_READS = 10_000  # of the file's parts, of which there are a handful
_MOST_PARTS = 1_000


class Wav(Reader):
    """WAV, integers as fractions of full scale."""

    def read(self, file: DataFile) -> ColumnTable:
        """`channel_0`, `channel_1`, ... as fractions of full scale, with `sample_rate_hz`.

        The full scale in volts is not in the file: it is the inverse of `gain`.
        """
        table = ColumnTable.of(file)
        channels, samples = _stated(file)
        table.check_count(channels)
        table.check_size("channel_0", samples * channels)
        file.limit(reads=_MOST_READS)
        wavfile = scipy.io.wavfile
        with warnings.catch_warnings():
            warnings.filterwarnings("error", "Reached EOF", wavfile.WavFileWarning)
            rate_hz, raw = wavfile.read(file)
        if rate_hz <= 0:
            raise ValueError("no sample rate")
        table.sidecar["sample_rate_hz"] = int(rate_hz)
        take_channels(table, _full_scale(raw if raw.ndim == 2 else raw[:, None]).T)
        return table


def take_channels(table: ColumnTable, channels: Float[np.ndarray, "channel sample"]) -> None:
    """Take in fractions of full scale as the signals `channel_0`, `channel_1`, ..."""
    for index, values in enumerate(channels):
        name = f"channel_{index}"
        table.take(name, values.shape, values.dtype, values.copy, {"units": _UNIT})
        table.signals.append(name)


def _stated(file: DataFile) -> tuple[int, int]:
    """Number of channels stated by the file, and of samples of each."""
    kind = file.read(12)[:4]
    order = ">" if kind == b"RIFX" else "<"
    channels = block = 0
    for _ in range(_MOST_PARTS):
        part, size = struct.unpack(f"{order}4sI", file.read(8))
        at, left = file.tell(), file.size - file.tell()
        if part == b"fmt ":
            _, channels, _, _, block = struct.unpack(f"{order}HHIIH", file.read(14))
        elif part == b"data":
            file.seek(0)
            if size > left and kind != b"RF64":  # which states it elsewhere
                raise EOFError("cut short")
            return channels, min(size, left) // block
        file.seek(at + size + size % 2)
    raise ValueError("no samples")


def _full_scale(samples: np.ndarray) -> Float[np.ndarray, "sample channel"]:
    """Integers as fractions of their largest magnitude (unsigned ones about their middle)."""
    if samples.dtype.kind == "f":
        return samples.astype(np.float64)
    half = 2.0 ** (8 * samples.dtype.itemsize - 1)
    return (samples - (half if samples.dtype.kind == "u" else 0.0)) / half
