"""Lines of samples that arrive one by one, as the rows of a recording's table (without jax).

The first lines name the columns. What each column is, its unit, and the gain and polarity of the
signals are found as for a file.
"""

import csv
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from srsinv.errors import BadInput, refuse

from ..files import DataFile
from ._columns import Quantity, column_of, signal_columns, signal_unit, unit_of
from ._read import per_channel, read_facts, recording_of_table
from ._recording import SPEED, Recording
from ._schema import RecordingFacts
from ._sidecar import Sidecars
from ._table import ColumnTable, listing
from ._units import PER_M, PER_M_PER_S, PER_S, PER_V
from .formats._heading import heading_of
from .formats._numbers import is_mark
from .formats.text import Text

# What a live inversion does not do with a recording's signals and positions.
NOT_LIVE = ("detrend", "high_pass_Hz", "notch_Hz", "backlash_m")


class Sample(NamedTuple):
    """One row: `time_s` [s]; `position_m` [m] and `speed_m_per_s` [m/s], NaN where the row has
    none; and the `signal` (e,), NaN where one is missing."""

    time_s: float
    position_m: float
    speed_m_per_s: float
    signal: tuple[float, ...]


class RowFormat:
    """How lines become samples.

    - `name`: for messages. `lines`: the heading and the first rows. `settings`: those of the
      configuration's `recording`. `known`: further facts.
    - `recording`: the first rows as a recording, with all facts that are known beside them;
      `heading_lines`: how many lines stand above the first row.

    Raises `BadInput` as [`load`][srsinv.load] does, for times that are dates, and for preparations
    that need the whole recording.
    """

    def __init__(
        self, name: str, lines: list[str], settings: Mapping[str, Any], known: Mapping[str, Any]
    ):
        text = "".join(lines)
        table, heading = _table(name, text), heading_of(text)
        beside = Path(settings.get("path") or name)
        stated = {key: settings[key] for key in settings if key in RecordingFacts.model_fields}
        facts = read_facts(beside, table, Sidecars.of_settings(settings), {**stated, **known})
        refused = next((key for key in NOT_LIVE if facts.get(key) is not None), None)
        refuse(
            refused is not None,
            f"recording.{refused} needs the whole recording, and is not done live: leave it out.",
        )
        refuse(
            bool(table.stamps),
            f"{name}: the times are dates or clock times: write them in seconds.",
        )
        times = settings.get("times") or "use"
        rate_hz = facts.get("sample_rate_hz")
        # For its facts, whatever its times: a wrong one is a bad line, and no reason to end.
        self.recording: Recording = recording_of_table(
            Path(name), table, Sidecars(), "allow", "ignore", {**facts, "sample_rate_hz": 1.0}
        )
        self.heading_lines, self._delimiter = heading.lines, heading.delimiter
        self._width = len(heading.names)
        place = {column: index for index, column in enumerate(heading.names)}
        self._factors: dict[int, float] = {}
        self._motion: list[int | None] = []
        quantities: tuple[tuple[Quantity, Mapping[str, int]], ...] = (
            ("time", PER_S), ("position", PER_M), ("speed", PER_M_PER_S),
        )  # fmt: skip
        for quantity, units in quantities:
            column = column_of(table, facts, quantity)
            column = None if quantity == "time" and times == "ignore" else column
            self._motion.append(None if column is None else place[column])
            if column is not None:
                unit = unit_of(table, facts, column, quantity)[0]
                refuse(
                    unit is None,
                    f"{name}: the unit of column {column!r} is not stated: give it by "
                    f"recording.{quantity}_unit=..., one of {', '.join(units)}.",
                )
                self._factors[place[column]] = 1 / units[str(unit)]
        channels = signal_columns(table, facts)
        gain, polarity = (
            per_channel(name, facts, key, len(channels)).tolist() for key in ("gain", "polarity")
        )
        self._signals = [place[column] for column in channels]
        for i, column in enumerate(channels):
            per_unit = PER_V.get(signal_unit(table, facts, column) or "", 1)
            ratio = _or_one(polarity[i]) / _or_one(gain[i])
            self._factors[place[column]] = ratio / per_unit
        self._speed = facts.get(SPEED)
        refuse(
            self._motion[0] is None and rate_hz is None,
            f"{name}: no column of times is recognised among {listing(table.columns)}: give "
            "recording.time_column=..., or recording.sample_rate_hz=...",
        )
        self._interval_s = 1 / float(rate_hz) if rate_hz else math.nan

    def sample(self, line: str, row: int) -> Sample:
        """The sample of a line; `row`: its number from 0. Raises `BadInput` for no sample."""
        try:
            cells = next(csv.reader([line], delimiter=self._delimiter), [])
        except csv.Error as error:
            raise BadInput(f"it is no row ({error}).") from error
        beyond = any(cell.strip() for cell in cells[self._width :])
        refuse(
            len(cells) < self._width or beyond,
            f"it has {len(cells)} cells, and the heading {self._width}.",
        )
        at_time, at_position, at_speed = self._motion
        time_s = row * self._interval_s if at_time is None else self._number(cells, at_time)
        position_m = math.nan if at_position is None else self._number(cells, at_position)
        refuse(math.isnan(time_s), "its time is missing.")
        refuse(at_position is not None and math.isnan(position_m), "its position is missing.")
        if self._speed is not None:
            speed = float(self._speed)
        else:
            speed = math.nan if at_speed is None else self._number(cells, at_speed)
        signal = tuple(self._number(cells, column) for column in self._signals)
        return Sample(time_s, position_m, speed, signal)

    def _number(self, cells: list[str], column: int) -> float:
        """A cell's number in SI units; NaN where it is empty or a mark of a missing sample."""
        text = cells[column].strip()
        if not text or is_mark(text):
            return math.nan
        try:
            value = float(text if self._delimiter == "," else text.replace(",", "."))
        except ValueError:
            raise BadInput(f"{text[:40]!r} is no number.") from None
        refuse(not math.isfinite(value), f"{text[:40]!r} is not finite.")
        return value * self._factors[column]


def _or_one(given: float) -> float:
    return 1.0 if math.isnan(given) else given


def _table(name: str, text: str) -> ColumnTable:
    """The table of a text, as a file of it would be read."""
    with tempfile.TemporaryFile() as file:
        file.write(text.encode())
        file.seek(0)
        with DataFile(os.dup(file.fileno()), Path(name)) as own:
            return Text().read(own)
