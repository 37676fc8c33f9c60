"""TDMS: a column a channel, at the sample rate of its waveform. Needs the extra `tdms`."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from srsinv.errors import BadInput

from .._table import Table
from .._units import may_be_signal


def read_tdms(path: Path) -> Table:
    """The channels, named group/channel where there are several groups, with their units.

    Raises `BadInput` where the package that reads them is not installed.
    """
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError as error:
        raise BadInput(
            f"{path.name}: reading .tdms takes a package that is not installed: add it by "
            "pip install srsinv[tdms], or save the recording in another format."
        ) from error
    log_manager.set_level(logging.CRITICAL)  # what is wrong is said here, once
    table = Table(path.name)
    # By a handle: beside a path the package would also read an index file, which may be stale.
    with path.open("rb") as file, TdmsFile.open(file) as tdms:
        if tdms.file_status.incomplete_final_segment:
            raise EOFError("cut short")
        groups = tdms.groups()
        channels = [channel for group in groups for channel in group.channels()]
        for channel in channels:
            name = channel.name if len(groups) == 1 else f"{channel.group_name}/{channel.name}"
            _take(table, name, channel)
        table.sidecar.update(_rate(channels))
    return table


def _take(table: Table, name: str, channel: Any) -> None:
    dtype = np.dtype(channel.dtype)
    unit = channel.properties.get("unit_string")
    table.take(name, (len(channel),), dtype, lambda: np.asarray(channel[:]), unit)
    if name in table.columns and may_be_signal(name):
        table.signals.append(name)


def _rate(channels: list[Any]) -> dict[str, float]:
    """The one sample rate of the channels' waveforms; nothing where they state none, or several."""
    steps_s = {channel.properties.get("wf_increment") for channel in channels} - {None, 0.0}
    return {"sample_rate_hz": 1 / float(steps_s.pop())} if len(steps_s) == 1 else {}
