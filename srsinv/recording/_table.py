"""A file's named columns, whatever its format."""

import difflib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.errors import BadInput, refuse

_LISTED = 20
# 2 GiB as float64: a damaged or hostile header may ask for any amount.
LARGEST_FILE = 2**28


def listing(names: Iterable[str]) -> str:
    """The first names, and how many more there are."""
    names = list(names)
    more = len(names) - _LISTED
    shown = ", ".join(map(quoted, names[:_LISTED]))
    return (shown or "none") + (f" and {more} more" if more > 0 else "")


def quoted(name: str) -> str:
    """A name as it is, or in quotes where it could be misread."""
    return name if name == name.strip() and name.isprintable() else repr(name)


@dataclass(frozen=True)
class Table:
    """The columns of one file, by name: text cells or 1-D arrays of real numbers.

    `unusable` says of every other array why it is no column; `units` holds the file's own words;
    `sidecar` what the file itself carries of one; `signals` the columns that can be nothing else.
    """

    name: str
    columns: dict[str, list[str] | np.ndarray] = field(default_factory=dict)
    unusable: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    sidecar: dict[str, Any] = field(default_factory=dict)
    signals: list[str] = field(default_factory=list)

    def __contains__(self, column: str) -> bool:
        return column in self.columns or column in self.unusable

    def take(
        self,
        name: str,
        shape: tuple[int, ...],
        dtype: np.dtype,
        read: Callable[[], np.ndarray],
        unit: Any = None,
    ) -> None:
        """Take in the array that `read` gives; it is read only if it is a column.

        Raises `BadInput` where the columns together would hold more than `LARGEST_FILE` values.
        """
        if len(shape) != 1:
            self.unusable[name] = f"has shape {shape}"
        elif dtype.kind not in "iuf":
            self.unusable[name] = f"holds values of type {dtype}"
        else:
            values = shape[0] + sum(len(column) for column in self.columns.values())
            refuse(
                values > LARGEST_FILE,
                f"{self.name}: column {quoted(name)} states {shape[0]} samples, which brings the "
                f"file above the limit of {LARGEST_FILE} values: write the file again, or in "
                "shorter parts.",
            )
            self.columns[name] = read()
            if isinstance(unit, str) and unit:
                self.units[name] = unit

    def numbers(self, column: str, *, allow_missing: bool = False) -> Float[np.ndarray, " row"]:
        """Column `column` as float64 (row,); NaN where its cell is empty, if that is allowed.

        An array has no other way to leave a cell empty than NaN. Raises `BadInput` for a column
        that is absent or unusable, and for a cell that is not a finite number.
        """
        self.check_usable(column)
        values = self._cells(column)
        bad = ~np.isfinite(values) if not allow_missing else np.isinf(values)
        if bad.any():
            self._refuse_cell(column, self.columns[column], int(bad.argmax()))
        return values

    def check_usable(self, column: str) -> None:
        """Refuse a column that is absent or unusable."""
        refuse(
            column in self.unusable,
            f"{self.name}: column {quoted(column)} {self.unusable.get(column)}: store it as a 1-D "
            "array of real numbers.",
        )
        if column not in self.columns:
            raise BadInput(self._no_column(column))

    def finite(self, column: str) -> Float[np.ndarray, " row"]:
        """Column `column` as float64 (row,); NaN for every cell that is not a finite number."""
        values = self._cells(column)
        return np.where(np.isfinite(values), values, np.nan)

    def _cells(self, column: str) -> Float[np.ndarray, " row"]:
        raw = self.columns[column]
        values = np.array([_number(cell) for cell in raw]) if isinstance(raw, list) else raw
        # A number beyond float64's range becomes infinite, and is refused as such.
        with np.errstate(over="ignore", invalid="ignore"):
            return values.astype(np.float64)

    def _no_column(self, column: str) -> str:
        near = difflib.get_close_matches(column, self.columns, n=1, cutoff=0.0)
        nearest = f"the nearest is {quoted(near[0])}, and " if near else ""
        return (
            f"{self.name}: there is no column {column!r}: {nearest}the columns are "
            f"{listing(self.columns)}: name one of them."
        )

    def _refuse_cell(self, column: str, raw: list[str] | np.ndarray, row: int) -> None:
        cell = str(raw[row]).strip()
        found = f"holds {cell[:40]!r}, not a finite number" if cell else "is empty"
        raise BadInput(
            f"{self.name}: column {quoted(column)}, data row {row + 1} {found}: correct it or "
            "leave the row out, or, if this is a missing sample of a signal, leave the cell empty "
            "(NaN in an array) and set recording.missing=allow."
        )


def is_number(cell: str) -> bool:
    """Whether a cell holds a finite number."""
    return math.isfinite(_number(cell))


def _number(cell: str) -> float:
    """The number in a cell: NaN only if the cell is empty, infinite if it holds no finite one."""
    if not cell or cell.isspace():
        return math.nan
    try:
        number = float(cell)
    except ValueError:
        return math.inf
    return number if math.isfinite(number) else math.inf
