"""A reader of a user's own, or one of the package's that the configuration names."""

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from srsinv.config import check_early
from srsinv.errors import BadInput
from srsinv.recording import Reader, check_settings, load
from srsinv.recording.even import load_even
from srsinv.recording.formats.hdf5 import Hdf5
from srsinv.recording.formats.text import Text
from srsinv.recording.inspection import inspect
from tests.recording.files import COLUMNS, RATE_HZ, SIGNAL, N, columns, write, write_csv


@dataclass(frozen=True)
class Returning(Reader):
    """Gives what it is made of, or raises it."""

    given: Any

    def read(self, file):
        if isinstance(self.given, BaseException):
            raise self.given
        return self.given


class Lines(Reader):
    """A CSV by hand, through a wrapper that closes the file at its end."""

    reads = 0

    def read(self, file):
        type(self).reads += 1
        names, *rows = io.TextIOWrapper(file).read().split()
        cells = np.array([row.split(",") for row in rows], float)
        return dict(zip(names.split(","), cells.T, strict=True))


@pytest.fixture
def scan(tmp_path):
    write_csv(tmp_path / "scan.lab", COLUMNS)
    return tmp_path / "scan.lab"


def test_a_reader_of_ones_own_gives_the_recording(scan):
    recording = load(scan, reader=Lines())
    np.testing.assert_array_equal(recording.signal, SIGNAL)
    assert (recording.name, recording.channels) == ("scan.lab", ("voltage_0_V", "voltage_1_V"))
    twice = {name: np.resize(values, 2 * N) for name, values in columns().items()}
    twice["time_s"] = np.arange(2 * N) / RATE_HZ
    settings = {"path": scan, "speed_m_per_s": 0.05}
    read = load_even(settings, {}, Returning(twice)).signal
    np.testing.assert_allclose(read, np.tile(SIGNAL, 2))
    assert len(inspect(scan, reader=Lines()).signals) == 2


def test_what_a_reader_masks_is_missing(scan):
    masked = np.ma.masked_array(SIGNAL[0], np.arange(SIGNAL.shape[1]) == 7)
    reader = Returning(COLUMNS | {"voltage_0_V": masked})
    signal = load(scan, reader=reader, missing="allow").signal
    np.testing.assert_array_equal(np.isnan(signal[0]), masked.mask)
    np.testing.assert_array_equal(signal[1], SIGNAL[1])


def test_without_a_reader_the_suffix_decides(scan):
    with pytest.raises(BadInput, match=r"cannot be read from suffix '\.lab'"):
        load(scan)


@pytest.mark.parametrize(("reader", "format"), [(Text(), "csv"), (Hdf5(), "hdf5")])
def test_a_named_format_reads_a_file_of_any_suffix(tmp_path, reader, format):
    path = write(format, tmp_path).rename(tmp_path / "scan.dat")
    np.testing.assert_array_equal(load(path, reader=reader).signal, SIGNAL)


NAMES = {"time_s": np.arange(5.0), "speed_m_per_s": np.ones(5), "voltage_0_V": np.ones(5)}
FAULTS = {
    "an exception": (ZeroDivisionError("by zero"), ["ZeroDivisionError: by zero"]),
    "an end": (SystemExit(0), ["SystemExit"]),
    "a refusal": (BadInput("scan.lab: no header: write one."), ["no header: write one."]),
    "no mapping": ([1, 2], ["[1, 2]", "a mapping of column names to 1-D arrays"]),
    "nothing": ({}, ["no number in any column"]),
    "unequal lengths": (NAMES | {"a": np.ones(4)}, ["differ in length", "time_s 5", "a 4"]),
    "text": (NAMES | {"voltage_0_V": ["a"] * 5}, ["column voltage_0_V", "values of type"]),
    "a matrix": (NAMES | {"voltage_0_V": np.ones((5, 2))}, ["column voltage_0_V", "shape (5, 2)"]),
    "ragged": (NAMES | {"voltage_0_V": [[1], [1, 2]]}, ["ValueError"]),
    "only NaN": ({name: np.full(5, np.nan) for name in NAMES}, ["no number in any column"]),
    "a numbered column": (NAMES | {3: np.ones(5)}, ["names a column 3, which is no text"]),
    "an unprintable name": (NAMES | {"a\n": np.ones(5)}, ["'a\\n'", "cannot be printed"]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_reader_that_fails_is_refused(fault, scan):
    given, words = FAULTS[fault]
    for look in (load, inspect):
        with pytest.raises(BadInput) as caught:
            look(scan, reader=Returning(given))
        assert str(caught.value).isprintable()
        assert all(word in str(caught.value) for word in ("scan.lab", *words))


def test_what_is_read_ahead_is_of_the_same_reader(scan):
    settings = {"path": str(scan)}
    other = {name: 2 * values for name, values in COLUMNS.items() if name != "time_s"}
    check_settings(settings, Returning(COLUMNS))
    twice = load(scan, reader=Returning(other), sample_rate_hz=10.0)
    np.testing.assert_array_equal(twice.signal, 2 * SIGNAL)


def test_a_reader_that_is_a_data_class_reads_once(scan):
    @dataclass(frozen=True)
    class Once(Lines):
        reads = 0

    check_settings({"path": str(scan)}, Once())
    load(scan, reader=Once())
    assert Once.reads == 1


@pytest.mark.parametrize("node", ["reader: {_target_: plugins.mine.Mine}", "_target_: os.system"])
def test_a_sidecar_names_no_reader(node, tmp_path):
    write_csv(tmp_path / "scan.csv", COLUMNS)
    (tmp_path / "scan.yaml").write_text(node)
    with pytest.raises(BadInput, match=r"there is no key '(reader|_target_)'"):
        load(tmp_path / "scan.csv")


def test_a_recording_in_json_is_no_sidecar_of_its_own(scan):
    path = scan.rename(scan.with_suffix(".json"))
    np.testing.assert_array_equal(load(path, reader=Lines()).signal, SIGNAL)
    path.with_suffix(".yaml").write_text("polarity: -1")
    np.testing.assert_array_equal(load(path, reader=Lines()).signal, -SIGNAL)


def test_the_early_check_reads_with_it(scan):
    node = {"_target_": "srsinv.recording.formats.text.Text"}
    check_early({"recording": {"path": str(scan), "sidecar": None}, "reader": node})
    other = {"_target_": "srsinv.recording._timing.EvenTimes"}
    with pytest.raises(BadInput, match=r"srsinv\.kinds\.Reader"):
        check_early({"recording": {"path": str(scan), "sidecar": None}, "reader": other})
