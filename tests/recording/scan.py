"""One known scan: its columns as a lab may name them, and what a recording of it has to read."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from srsinv.errors import BadInput
from srsinv.recording import Recording
from srsinv.recording.even import load_even
from srsinv.recording.formats import BY_SUFFIX
from srsinv.recording.reader import Reader
from tests.recording.files import write_csv

N, RATE_HZ, SPEED_M_PER_S = 400, 2000.0, 0.02
STEP_S = 1 / RATE_HZ
TIME_S = np.arange(N) / RATE_HZ
POSITION_M = 0.01 + SPEED_M_PER_S * TIME_S
SIGNAL_V = np.random.default_rng(1).normal(size=(2, N))
A, B = SIGNAL_V
MM = 1e3 * POSITION_M
MOVING = {"speed_m_per_s": SPEED_M_PER_S, "scan_start_m": float(POSITION_M[0])}
SCAN: Mapping[str, Any] = {
    "time_ms": 1e3 * TIME_S, "position_mm": MM, "voltage_0_mV": 1e3 * A, "voltage_1_V": B
}  # fmt: skip


def scan(**changes: Any) -> dict[str, Any]:
    """The scan's columns with some replaced, added or, by None, left out."""
    return {name: values for name, values in ({**SCAN, **changes}).items() if values is not None}


def renamed(**names: str) -> dict[str, Any]:
    """The scan's columns, in their order, some under other names."""
    return {names.get(name, name): values for name, values in SCAN.items()}


def with_cell(name: str, row: int, cell: Any, **changes: Any) -> dict[str, Any]:
    """The scan with one cell of a column replaced."""
    table = scan(**changes)
    return table | {name: [cell if i == row else v for i, v in enumerate(table[name])]}


def without_rows(*rows: int, **changes: Any) -> dict[str, Any]:
    """The scan with some rows left out."""
    return {name: np.delete(values, rows) for name, values in scan(**changes).items()}


def rows_of(*columns: Any, delimiter: str = ",", end: str = "", form: str = "{!r}") -> str:
    """Rows of numbers and words as text; `end`: what a writer leaves at the end of each."""
    rows = zip(*(np.asarray(c, object) for c in columns), strict=True)
    cells = (
        [each if isinstance(each, str) else form.format(float(each)) for each in row]
        for row in rows
    )
    return "".join(delimiter.join(row) + end + "\n" for row in cells)


def text_of(table: Mapping[str, Any], delimiter: str = ",") -> str:
    """A table with its header as text."""
    return delimiter.join(table) + "\n" + rows_of(*table.values(), delimiter=delimiter)


def typed(override: str) -> dict[str, Any]:
    """A setting of `recording` as the command line reads it."""
    parsed = OverridesParser.create().parse_override(override)
    group, _, key = str(parsed.key_or_group).partition(".")
    assert group == "recording", override
    return {key: parsed.value()}


Writer = Callable[[Path, Mapping[str, Any]], None]


class Case(NamedTuple):
    """A recording's file (`table` by `write`, or `text`), its sidecar, files beside it, and the
    settings that it is read by."""

    table: Mapping[str, Any] = SCAN
    settings: Sequence[str] = ()
    sidecar: str | None = None
    name: str = "r.csv"
    write: Writer = write_csv
    text: str | None = None
    beside: Mapping[str, str] = {}
    reader: Reader = BY_SUFFIX

    def read(self, folder: Path) -> Recording:
        """The recording, written to an emptied folder and read as a job reads it."""
        for old in folder.iterdir():
            old.unlink()
        path = folder / self.name
        if self.text is None:
            self.write(path, self.table)
        else:
            path.write_text(self.text)
        files = dict(self.beside) | ({} if self.sidecar is None else {"r.yaml": self.sidecar})
        for name, content in files.items():
            (folder / name).write_text(content)
        settings: dict[str, Any] = {"path": str(path)}
        for each in self.settings:
            settings |= typed(each.replace("{folder}", str(folder)))
        return load_even(settings, {}, self.reader)

    def refusal(self, folder: Path) -> str:
        """The sentence by which it is refused."""
        with pytest.raises(BadInput) as caught:
            self.read(folder)
        return str(caught.value)


def assert_is_scan(
    recording: Recording,
    rows: slice = slice(None),
    missing: Sequence[int] = (),
    factor: float = 1.0,
    channels: Sequence[int] = (0, 1),
    unit: str = "V",
) -> None:
    """The scan's intervals, motion and signals, whatever the file's units; its origins may differ.

    `missing`: samples that are; `factor`, `unit`: of the signals; `rows`: those that are left.
    """
    time_s = TIME_S[rows] - TIME_S[rows][0]
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], time_s, atol=2e-7)
    np.testing.assert_allclose(
        recording.position_m - recording.position_m[0], SPEED_M_PER_S * time_s, atol=1e-8
    )
    assert recording.signal_unit == unit
    truth = factor * SIGNAL_V[list(channels), rows]
    seen = np.isfinite(recording.signal)
    assert {*np.flatnonzero(~seen.all(axis=0)).tolist()} == {*missing}
    np.testing.assert_allclose(recording.signal[seen], truth[seen], rtol=1e-9)


def setting(sentence: str, key: str, value: str | None = None) -> str:
    """The setting of a key that a sentence asks for: with the value that it gives, or another."""
    found = re.search(rf"recording\.{key}(=[^.\s,;]+|\b)", sentence)
    assert found, sentence
    return found[0] if value is None else f"recording.{key}={value}"


def after(words: str, sentence: str) -> str:
    """The name after these words of a sentence."""
    found = re.search(rf"{words}([\w.]+\w)", sentence)
    assert found, sentence
    return found[1]
