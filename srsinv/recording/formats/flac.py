"""FLAC: a column a channel, at the file's own sample rate, read by soundfile. Needs the extra
`flac`."""

import numpy as np

from ...files import DataFile
from .._apart import IsolatedReader
from .._table import ColumnTable
from ..reader import missing_package
from .wav import take_channels

_STORED = 2  # bytes of a sample before it is packed, in most files


class Flac(IsolatedReader):
    """FLAC, integers as fractions of full scale; needs the extra `flac`."""

    def read_here(self, file: DataFile) -> ColumnTable:
        """`channel_0`, `channel_1`, ... as fractions of full scale, with `sample_rate_hz`.

        The full scale in volts is not in the file: it is the inverse of `gain`. Raises `BadInput`
        where the package that reads them is not installed.
        """
        table = ColumnTable.of(file)
        try:
            import soundfile
        except ImportError as error:
            raise missing_package(table.name, "flac") from error
        with soundfile.SoundFile(file) as source:
            if source.format != "FLAC" or source.samplerate <= 0:
                raise ValueError("no FLAC")
            table.check_count(source.channels)
            table.check_size("channel_0", source.frames * source.channels, _STORED)
            table.sidecar["sample_rate_hz"] = int(source.samplerate)
            values = source.read(dtype="float64", always_2d=True)
            if len(values) != source.frames:
                raise EOFError("cut short")
        take_channels(table, np.ascontiguousarray(values.T))
        return table
