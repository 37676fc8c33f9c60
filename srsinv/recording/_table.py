"""A file's named columns, whatever its format."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.errors import BadInput, echo, nearest_name, refuse

from ..files import COMPARED, DataFile, is_broken, quoted
from ._stated import Clock, is_neutral, is_of_time, is_scaling_word, is_stated_word, stated

MOST_SAMPLES = 10**8  # of all columns together: 0.8 GB as float64, and a few times that in use
MOST_COLUMNS = 1_000
LONGEST_NAME = 200  # characters of a column's name or unit

# Bytes that a file may unpack to: for each that it stores, and whatever it stores. A recording is
# packed to a tenth at most, and one whose channels are constant is short.
_MOST_PER_BYTE, _MOST_OF_SMALL = 100, 2**26
_LISTED = 20
_MOST_GAINS = 64  # values of an array that states gains or scales
_CELL = 40  # characters shown of a cell
# A number with a mark for thousands, or one that may be that or a decimal mark.
_MARKED = re.compile(r"[-+]?(?:\d{1,3}([,.'\u2019\s])\d{3}(?:\1\d{3})*(?:[.,]\d*)?|\d+([,_])\d+)")


def listing(names: Iterable[str]) -> str:
    """The first names, and how many more there are."""
    names = list(names)
    more = len(names) - _LISTED
    named = ", ".join(map(quoted, names[:_LISTED]))
    return (named or "none") + (f" and {more} more" if more > 0 else "")


def marked_number(cell: str) -> str | None:
    """The mark between a number's digits that may part thousands, or decimals; None: the cell is no
    such number."""
    parts = _MARKED.fullmatch(cell.strip())
    return None if parts is None else parts[1] or parts[2]


def most_unpacked(stored: int) -> int:
    """Bytes that the columns of a file of `stored` bytes may take."""
    return min(_MOST_OF_SMALL + _MOST_PER_BYTE * stored, 8 * MOST_SAMPLES)


@dataclass(frozen=True)
class ColumnTable:
    """The columns of one file, by name: 1-D arrays of real numbers.

    `unusable` gives the reason why any other array is no column; `units` the file's own units;
    `sidecar` the file's embedded one; `signals` the columns that are certainly signals. A column of
    text is NaN where its cell is empty or a mark of a missing sample, and infinite where it holds
    no finite number; `marks` has the first such mark, and `texts` the first other cell (empty where
    there is none). `rows` are the file's numbers of the data rows, where they are not all there.
    `gains` has the gains and `clocks` the times of samples that the file states of columns,
    `stamps` the columns of seconds that were dates or clock times, `scalars` what the file states
    once for all columns, and `notes` what a reader found, in sentences. `stored` is the file's size
    in bytes, which bounds what the columns may take; None: unbounded.
    """

    name: str
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    unusable: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    sidecar: dict[str, Any] = field(default_factory=dict)
    signals: list[str] = field(default_factory=list)
    texts: dict[str, str] = field(default_factory=dict)
    marks: dict[str, str] = field(default_factory=dict)
    gains: dict[str, float] = field(default_factory=dict)
    clocks: dict[str, Clock] = field(default_factory=dict)
    stamps: list[str] = field(default_factory=list)
    scalars: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    rows: list[int] | None = None
    stored: int | None = None

    @classmethod
    def of(cls, file: DataFile) -> "ColumnTable":
        """That of an open file, without columns yet."""
        return cls(quoted(file.path.name), stored=file.size)

    def __contains__(self, column: str) -> bool:
        return column in self.columns or column in self.unusable

    def __iter__(self) -> Iterator[str]:
        """All names, those of arrays that are no columns last."""
        return chain(self.columns, self.unusable)

    def take(
        self,
        name: str,
        shape: tuple[int, ...],
        dtype: np.dtype,
        read: Callable[[], np.ndarray],
        attributes: Mapping[str, Any] | None = None,
    ) -> None:
        """Take in the array that `read` gives; it is read only if it is a column.

        What its `attributes` state (unit, scale, offset, start, interval) is applied; a single
        number whose name states one of them is kept for the whole file. Raises `BadInput` for a
        name, a unit or a size beyond the limits, and `EOFError` where `read` gives another number
        of values than `shape` states.
        """
        facts = stated(attributes or {})
        word = name.rpartition(".")[2]
        is_scaling = is_scaling_word(name) and math.prod(shape) <= _MOST_GAINS
        is_single = math.prod(shape) == 1 and is_stated_word(word)
        if dtype.kind in "iuf" and (is_single or is_scaling):
            self.check_name(name)
            values = np.asarray(read()).ravel().tolist()
            self.scalars[word] = values[0] if len(values) == 1 else values
        elif facts.refused:
            self.leave_out(name, facts.refused, facts.unit)
        elif len(shape) != 1:
            self.leave_out(name, f"has shape {echo(tuple(shape))}", facts.unit)
        elif dtype.kind not in "iuf":
            self.leave_out(name, f"holds values of type {echo(str(dtype))[1:-1]}", facts.unit)
        else:
            self.check_name(name)
            self.check_size(name, shape[0], dtype.itemsize)
            values = read()
            if values.shape != tuple(shape):
                raise EOFError("not as many values as stated")
            self.columns[name] = facts.applied(values)
            if facts.unit:
                self._check_text(f"the unit of column {quoted(name)}", facts.unit)
                self.units[name] = facts.unit
            if facts.gain not in (None, 1.0):
                self.gains[name] = facts.gain
            if facts.clock:
                self.clocks[name] = facts.clock

    def state_rate(self) -> None:
        """Take the rate that the file states once for all columns for a fact of its own.

        Raises `BadInput` where it is stated in several ways that differ.
        """
        facts = stated({k: v for k, v in self.scalars.items() if is_of_time(k)})
        refuse(
            facts.refused is not None,
            f"{self.name}: the file {facts.refused}: write it again without that, and give "
            "recording.sample_rate_hz=... where it has no times.",
        )
        if facts.interval_s:
            self.sidecar.setdefault("sample_rate_hz", 1 / facts.interval_s)

    @property
    def scaling(self) -> dict[str, Any]:
        """Scales, offsets and gains that the file states, and not of which column's numbers."""
        words = {key: value for key, value in self.scalars.items() if not is_of_time(key)}
        for name, values in self.columns.items():  # of one value, as a column called Gain
            if is_scaling_word(name) and values.size and np.ptp(self.finite(name)) == 0:
                words[name] = float(values[0])
        return {key: value for key, value in words.items() if not is_neutral(key, value)}

    def leave_out(self, name: str, reason: str, unit: Any = None) -> None:
        """Record an array that is no column, why, and its unit: one in volts is asked for. Raises
        `BadInput` as [`check_name`][] does."""
        self.check_name(name)
        self.unusable[name] = reason
        if isinstance(unit, str) and unit:
            self._check_text(f"the unit of column {quoted(name)}", unit)
            self.units[name] = unit

    def check_name(self, name: str) -> None:
        """Refuse the next name where it cannot be used, stands there twice or is one too many."""
        self._check_text("the column's name", name)
        self.check_count(len(self.columns) + len(self.unusable) + 1)
        refuse(
            name in self,
            f"{self.name}: column {echo(name)} appears twice: give every column its own name.",
        )

    def check_count(self, columns: int) -> None:
        """Refuse more columns than the limit."""
        refuse(
            columns > MOST_COLUMNS,
            f"{self.name}: the file has {columns} columns or more, above the limit of "
            f"{MOST_COLUMNS}: keep those of one scan.",
        )

    def check_size(self, name: str, samples: int, itemsize: int = 8) -> None:
        """Refuse a column of `samples` samples, of `itemsize` bytes each, where the table's total
        is too large, or too large for what the file stores."""
        total = samples + sum(column.size for column in self.columns.values())
        refuse(
            total > MOST_SAMPLES,
            f"{self.name}: column {quoted(name)} states {samples} samples, so the file "
            f"exceeds the limit of {MOST_SAMPLES} in all columns: write it again in "
            "shorter parts.",
        )
        size = samples * itemsize + sum(column.nbytes for column in self.columns.values())
        refuse(
            self.stored is not None and size > most_unpacked(self.stored),
            f"{self.name}: column {quoted(name)} states {samples} samples, so "
            f"{self.stored} bytes of file would unpack to {size}: write the file again, "
            "without compression.",
        )

    def _check_text(self, what: str, text: str) -> None:
        refuse(
            len(text) > LONGEST_NAME,
            f"{self.name}: {what} is {len(text)} characters long, beginning with "
            f"{text[:_CELL]!a}: give it at most {LONGEST_NAME}.",
        )
        refuse(
            is_broken(text),
            f"{self.name}: {what} is {text!a}, which cannot be printed: write it without "
            "control characters.",
        )

    def numbers(self, column: str, *, allow_missing: bool = False) -> Float[np.ndarray, " row"]:
        """Column `column` as float64 (row,); NaN where its cell is empty, if that is allowed. The
        table's own array where it is float64 already.

        An array has no other way to leave a cell empty than NaN. Raises `BadInput` for a column
        that is absent or unusable, and for a cell that is not a finite number.
        """
        self.check_usable(column)
        values = self._cells(column)
        bad = ~np.isfinite(values) if not allow_missing else np.isinf(values)
        if bad.any():
            self._refuse_cell(column, int(bad.argmax()))
        return values

    def check_usable(self, column: str) -> None:
        """Refuse a column that is absent or unusable."""
        its = f"{self.name}: column {quoted(column)} {self.unusable.get(column)}"
        refuse(
            column in self.unusable and column in self.stamps,
            f"{its}: write seconds or stamps such as 2025-02-11T10:11:12.5, or, if no row "
            "is lost, give recording.times=ignore and recording.sample_rate_hz=...",
        )
        refuse(column in self.unusable, f"{its}: store it as a 1-D array of real numbers.")
        if column not in self.columns:
            near = nearest_name(column, self.columns, cutoff=0.0, compared=COMPARED)
            hint = f"the nearest is {quoted(near)}, and " if near else ""
            raise BadInput(
                f"{self.name}: there is no column {echo(column)}: {hint}the columns are "
                f"{listing(self.columns)}: name one of them."
            )

    def without_blank_rows(self) -> "ColumnTable":
        """The same table without rows that hold no number in any column; as it is where columns
        differ in length."""
        sizes = {values.size for values in self.columns.values()}
        if len(sizes) != 1:
            return self
        blank = np.ones(sizes.pop(), bool)
        for column, values in self.columns.items():
            if not blank.any():
                return self
            blank &= np.isnan(self._cells(column)) if values.dtype.kind == "f" else False
        if not blank.any() or blank.all():
            return self
        rows = (np.flatnonzero(~blank) + 1).tolist()
        return replace(self, columns={c: v[~blank] for c, v in self.columns.items()}, rows=rows)

    def row_of(self, index: int) -> int:
        """The file's number of a data row."""
        return index + 1 if self.rows is None else self.rows[index]

    def finite(self, column: str, most: float = math.inf) -> Float[np.ndarray, " row"]:
        """Column `column` as float64 (row,); NaN for every cell that is not a finite number of at
        most this magnitude."""
        values = self._cells(column)
        return np.where(np.isfinite(values) & (np.abs(values) <= most), values, np.nan)

    def _cells(self, column: str) -> Float[np.ndarray, " row"]:
        # A number beyond float64's range becomes infinite, and is refused as such.
        with np.errstate(over="ignore", invalid="ignore"):
            return self.columns[column].astype(np.float64, copy=False)

    def _refuse_cell(self, column: str, row: int) -> None:
        value = self.columns[column][row]
        is_text = column in self.texts
        cell = str(value) if not is_text else self.texts[column] if np.isinf(value) else ""
        mark = self.marks.get(column) if np.isnan(value) else None
        fault = f"is {cell[:_CELL]!r}, not a finite number" if cell else "is empty"
        if mark:
            fault = f"is no number, but empty or a mark such as {mark[:_CELL]!r}"
        its = f"{self.name}: data row {self.row_of(row)} of column {quoted(column)} {fault}"
        marked = marked_number(cell)
        refuse(
            marked is not None,
            f"{its}, as {marked!r} may separate thousands or decimals: write the numbers "
            "with a decimal point and no other mark.",
        )
        allow = "set recording.missing=allow"
        if np.isnan(value):
            raise BadInput(f"{its}: fill it in, or, for a signal, {allow}.")
        raise BadInput(f"{its}: correct it, or, for a signal, empty the cell and {allow}.")
