"""TDMS: a column a channel, at the sample rate of its waveform. Needs the extra `tdms`."""

import logging
import re
from typing import Any

import numpy as np

from ...files import DataFile
from .._columns import is_of_other, quantity_of
from .._stated import is_word
from .._table import ColumnTable
from ..reader import Reader, missing_package

_MOST_READS = 2_000_000  # of all segments' descriptions: some seconds
_MOST_SCALES = 10  # steps from raw values to a channel's; each may refer to two before it
_SCALE = re.compile(r"NI_Scale\[(\d+)\]")


class Tdms(Reader):
    """TDMS; needs the extra `tdms`."""

    def read(self, file: DataFile) -> ColumnTable:
        """The channels, named group/channel where there are several groups, with their units.

        Raises `BadInput` where the package that reads them is not installed.
        """
        table = ColumnTable.of(file)
        try:
            from nptdms import TdmsFile
            from nptdms.log import log_manager
        except ImportError as error:
            raise missing_package(table.name, "tdms") from error
        log_manager.set_level(logging.CRITICAL)  # errors are reported here, once
        # By a handle: beside a path the package would also read an index file, which may be stale.
        file.limit(reads=_MOST_READS)
        with TdmsFile.open(file) as tdms:
            file.limit()
            if tdms.file_status.incomplete_final_segment:
                raise EOFError("cut short")
            groups = tdms.groups()
            channels = [channel for group in groups for channel in group.channels()]
            table.check_count(len(channels))
            for channel, group in ((c, g) for g in groups for c in g.channels()):
                name = channel.name if len(groups) == 1 else f"{channel.group_name}/{channel.name}"
                if _most_scales(channel, group, tdms) > _MOST_SCALES:
                    table.leave_out(name, f"has more than {_MOST_SCALES} scales")
                else:
                    facts = {**tdms.properties, **group.properties, **channel.properties}
                    facts = {key: value for key, value in facts.items() if is_word(key)}
                    _take(table, name, channel, file.size, facts)
        return table


def _most_scales(*holders: Any) -> int:
    """The number of scales stated by a channel, its group or its file."""
    numbers = [0]
    for holder in holders:
        numbers.append(int(holder.properties.get("NI_Number_Of_Scales", 0)))
        numbers += [int(m[1]) + 1 for key in holder.properties if (m := _SCALE.match(key))]
    return max(numbers)


def _take(table: ColumnTable, name: str, channel: Any, most: int, facts: dict[str, Any]) -> None:
    dtype = np.dtype(channel.dtype)

    def read() -> np.ndarray:
        if len(channel) > most:  # not even a byte for each
            raise EOFError("fewer values than stated")
        return np.asarray(channel[:])

    table.take(name, (len(channel),), dtype, read, facts)
    is_free = name in table.columns and quantity_of(table, name) is None
    if is_free and not is_of_other(table.units.get(name)):
        table.signals.append(name)
