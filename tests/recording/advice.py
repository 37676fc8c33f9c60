"""Recordings in trouble, the advice that refusals and warnings give, and what following it reads.

The truth is a known scan; each case is written to a file, read by settings as they are typed, and
compared with it.
"""

import ast
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser

import srsinv.recording
from srsinv.errors import BadInput
from srsinv.recording import Recording
from srsinv.recording.even import load_even
from srsinv.recording.formats import BY_SUFFIX
from srsinv.recording.inspection import inspect
from srsinv.recording.reader import Reader
from tests.jobs.run import ROOT
from tests.recording.files import write_csv

N, RATE_HZ, SPEED_M_PER_S = 400, 2000.0, 0.02
TIME_S = np.arange(N) / RATE_HZ
POSITION_M = 0.01 + SPEED_M_PER_S * TIME_S
SIGNAL_V = np.random.default_rng(1).normal(size=(2, N))
SCAN: Mapping[str, Any] = {
    "time_ms": 1e3 * TIME_S,
    "position_mm": 1e3 * POSITION_M,
    "voltage_0_mV": 1e3 * SIGNAL_V[0],
    "voltage_1_V": SIGNAL_V[1],
}
KEYS = yaml.safe_load((ROOT / "configs" / "recording" / "file.yaml").read_text())


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


def typed(override: str) -> dict[str, Any]:
    """Settings of `recording` as the command line reads them."""
    parsed = OverridesParser.create().parse_override(override)
    group, _, key = str(parsed.key_or_group).partition(".")
    assert group == "recording", override
    assert key in KEYS, override
    return {key: parsed.value()}


def offered(sentence: str, key: str) -> str:
    """The setting of a key that a sentence gives with its value, as `recording.missing=allow`."""
    found = re.search(rf"(recording\.{key}=[^.\s,;]+)", sentence)
    assert found, sentence
    return found[1]


def asked(sentence: str, key: str, value: str) -> str:
    """The setting of a key that a sentence asks for, with a value."""
    assert re.search(rf"recording\.{key}\b", sentence), sentence
    return f"recording.{key}={value}"


Writer = Callable[[Path, Mapping[str, Any]], None]


class Case(NamedTuple):
    """A file (`table` by `write`, or `text`), its sidecar, the settings it is read by, and whether
    it is looked at before."""

    table: Mapping[str, Any] = SCAN
    settings: Sequence[str] = ()
    sidecar: str | None = None
    name: str = "r.csv"
    write: Writer = write_csv
    text: str | bytes | None = None
    beside: Mapping[str, str | bytes] = {}
    reader: Reader = BY_SUFFIX
    inspected: bool = False

    def read(self, folder: Path) -> Recording:
        """The recording, written to a folder and read as a job reads it."""
        for old in folder.iterdir():
            old.unlink()
        path = folder / self.name
        if self.text is None:
            self.write(path, self.table)
        else:
            path.write_bytes(self.text if isinstance(self.text, bytes) else self.text.encode())
        files = dict(self.beside) | ({} if self.sidecar is None else {"r.yaml": self.sidecar})
        for name, content in files.items():
            whole = content if isinstance(content, bytes) else content.encode()
            (folder / name).write_bytes(whole)
        settings: dict[str, Any] = {"path": str(path)}
        for each in self.settings:
            settings |= typed(each.replace("{folder}", str(folder)))
        if self.inspected:
            inspect(**settings)
        return load_even(settings, {}, self.reader)

    def refused(self, folder: Path) -> str:
        """The sentence by which it is refused."""
        try:
            self.read(folder)
        except BadInput as refusal:
            return str(refusal)
        raise AssertionError("it is read as it is")


class Row(NamedTuple):
    """A distinctive part of a sentence, a case that gets it, what its advice makes of the case, and
    how the recording then differs from the truth: `missing` samples, `factor` of the signals,
    `rows` of the scan that are left."""

    says: str
    trouble: Case
    followed: Case | Callable[[str], Case]
    missing: Sequence[int] = ()
    factor: float = 1.0
    rows: slice = slice(None)
    unit: str = "V"

    def follow(self, sentence: str) -> Case:
        """What following the sentence makes."""
        return self.followed if isinstance(self.followed, Case) else self.followed(sentence)


def assert_right(recording: Recording, row: Row) -> None:
    """The scan's own times, positions, speed and signals, whatever the file's units."""
    time_s = TIME_S[row.rows]
    np.testing.assert_allclose(
        recording.time_s - recording.time_s[0], time_s - time_s[0], rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        recording.position_m - recording.position_m[0], SPEED_M_PER_S * (time_s - time_s[0]),
        rtol=1e-6, atol=1e-9,
    )  # fmt: skip
    if recording.measured_position_m is not None:
        assert recording.position_m[0] == pytest.approx(POSITION_M[row.rows][0], rel=1e-9)
    np.testing.assert_allclose(recording.speed_m_per_s, SPEED_M_PER_S, rtol=1e-4)
    assert recording.signal_unit == row.unit
    for channel, signal in zip(recording.channels, recording.signal, strict=True):
        digit = re.search(r"\d", channel)
        assert digit, channel
        truth = row.factor * SIGNAL_V[int(digit[0])][row.rows]
        assert np.flatnonzero(np.isnan(signal)).tolist() == list(row.missing)
        seen = np.isfinite(signal)
        np.testing.assert_allclose(signal[seen], truth[seen], rtol=1e-9)


def text_of(table: Mapping[str, Any]) -> str:
    """A table as the text that is written of it."""
    rows = [list(table), *zip(*(np.asarray(v).tolist() for v in table.values()), strict=True)]
    return "".join(",".join(map(str, row)) + "\n" for row in rows)


# The sentences of the source


def pattern(part: str) -> re.Pattern[str]:
    """What finds a part of a sentence, {} where something is filled in."""
    return re.compile(".*?".join(map(re.escape, part.split("{}"))))


FOLLOWED: set[str] = set()


def follows(*parts: str) -> Callable[[Any], Any]:
    """Marks a test that follows the sentences with these parts."""
    FOLLOWED.update(parts)
    return lambda test: test


def sentences() -> Iterator[tuple[str, str]]:
    """Where each sentence in the readers' source stands, and its text, {} where a part is filled
    in: a string of three words or more that ends as a sentence does."""
    folder = Path(srsinv.recording.__file__).parent
    shared = (folder.with_name(name) for name in ("atomic.py", "files.py"))
    for path in (*shared, *sorted(folder.rglob("*.py"))):
        for line, text in _strings(ast.parse(path.read_text(encoding="utf-8"))):
            ends = text.endswith((".", "?", ": {}")) and "\\" not in text
            if ends and len(re.findall(r"[a-z]{2,}", text)) >= 3:
                yield f"{path.relative_to(folder.parent)}:{line}", text


def _strings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Strings that are no docstrings and no parts of others."""
    holders = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr | ast.Expr)]
    inner = {id(child) for holder in holders for child in ast.iter_child_nodes(holder)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = (p.value if isinstance(p, ast.Constant) else "{}" for p in node.values)
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and id(node) not in inner:
            yield node.lineno, str(node.value)
