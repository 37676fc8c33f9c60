"""Advice that takes more than another file or another setting to follow."""

import math
import os
import re
import shlex
import signal
import sys
import tomllib
import warnings
import zipfile
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

from srsinv import config
from srsinv.atomic import write_whole
from srsinv.errors import BadInput
from srsinv.files import read_json
from srsinv.recording import Reader, Recording, _apart, load, mains, save
from srsinv.recording._schema import RecordingFacts, _facts_in, check_facts
from srsinv.recording.channels import channel_findings
from srsinv.recording.even import check_volts, load_even, load_steady, on_even_times
from srsinv.recording.flat_columns import load_columns, load_profile
from srsinv.recording.formats import BY_SUFFIX
from srsinv.recording.formats.text import Text
from srsinv.recording.inspection import inspect
from srsinv.recording.mains import MainsLine, waves
from srsinv.recording.preparation import preparation_warnings
from srsinv.recording.reader import read_table
from srsinv.recording.template import sidecar_template
from tests.jobs.run import ROOT, composed, result_of
from tests.recording.advice import (
    FOLLOWED,
    POSITION_M,
    RATE_HZ,
    SCAN,
    SIGNAL_V,
    SPEED_M_PER_S,
    TIME_S,
    Case,
    N,
    Row,
    asked,
    assert_right,
    follows,
    scan,
    text_of,
    typed,
)
from tests.recording.files import write, write_csv, write_h5
from tests.refusals import refused
from tests.tiers import quick

__all__ = ["FOLLOWED"]
RIGHT = Row("", Case(), Case())
FACTS: dict[str, Any] = {"sensor": {"depth_m": 1e-3}}


def recorded(signal=SIGNAL_V, **facts):
    """A recording of the scan's signals or others, at its rate."""
    rows = np.atleast_2d(signal)
    time_s = np.arange(rows.shape[1]) / RATE_HZ
    names = tuple(f"voltage_{index}_V" for index in range(len(rows)))
    return Recording(rows, time_s, np.full(time_s.size, SPEED_M_PER_S), names, facts)


# Paths and files


@follows("{}: give the name of a file.", "{} is {}: give the name of a file, in characters",
         "there is no such user: give a path", "name a regular file by", "cannot be opened ({})",
         "No recording is named")  # fmt: skip
@pytest.mark.parametrize(
    ("path", "words"),
    [
        (None, "give recording.path=FILE"),
        (5, "recording.path is 5: give the name of a file"),
        ("a\nb.csv", "give the name of a file, in characters that can be printed"),
        ("~nobody-of-this-name/r.csv", "there is no such user: give a path"),
        ("folder.csv", "name a regular file by recording.path=..."),
        ("a" * 300 + ".csv", "check recording.path=..."),
    ],
)
def test_a_path_is_given(tmp_path, monkeypatch, path, words):
    monkeypatch.chdir(tmp_path)
    os.mkdir("folder.csv")
    refused_path = path
    with pytest.raises(ValueError, match=re.escape(words)):
        load_even({"path": refused_path}, {})
    write_csv(tmp_path / "r.csv", SCAN)
    assert_right(load_even(typed("recording.path=r.csv"), {}), RIGHT)


@follows("may not be read: change its permissions")
@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is unreadable for root")
def test_permissions_are_changed(tmp_path):
    write_csv(tmp_path / "r.csv", SCAN)
    (tmp_path / "r.csv").chmod(0)
    refused(lambda: load(tmp_path / "r.csv"), "change its permissions")
    (tmp_path / "r.csv").chmod(0o600)
    assert_right(load(tmp_path / "r.csv"), RIGHT)


@follows("{} bytes long, above the limit of {}")
def test_a_file_beyond_the_limit_is_written_again(tmp_path):
    with (tmp_path / "r.csv").open("w") as file:
        file.write(text_of(SCAN))
        file.truncate(2**32 + 1)
    refused(lambda: load(tmp_path / "r.csv"), "write it again, or in shorter parts")
    write_csv(tmp_path / "r.csv", SCAN)
    assert_right(load(tmp_path / "r.csv"), RIGHT)


class Growing(Text):
    """Reads a file that is still being written."""

    def read(self, file):
        if file.size < len(text_of(SCAN)):
            file.path.write_text(text_of(SCAN))
        return super().read(file)


@follows("changed while it was read: try again once it is written")
def test_a_file_is_read_once_it_is_written(tmp_path):
    (tmp_path / "r.csv").write_text(text_of({name: v[:9] for name, v in SCAN.items()}))
    refused(lambda: load(tmp_path / "r.csv", reader=Growing()), "try again once it is written")
    assert_right(load(tmp_path / "r.csv", reader=Growing()), RIGHT)


@follows("does not hold as many bytes as it states: copy it")
@pytest.mark.skipif(not os.path.exists("/sys/kernel/mm"), reason="no file states more than it has")
def test_a_file_of_the_system_is_copied(tmp_path):
    write_csv(tmp_path / "r.csv", SCAN)
    (tmp_path / "r.yaml").symlink_to("/sys/devices/system/cpu/online")
    refused(lambda: load(tmp_path / "r.csv"), "copy it to a file of its own")
    content = (tmp_path / "r.yaml").read_text()
    (tmp_path / "r.yaml").unlink()
    (tmp_path / "r.yaml").write_text(f"description: {content}")
    assert load(tmp_path / "r.csv").sidecar["description"].strip() == content.strip()


class Small(Text):
    """Reads where there is little memory."""

    def read(self, file):
        if file.size > len(text_of(SCAN)) * 0.6:
            raise MemoryError
        return super().read(file)


@follows("ask for more memory than there is")
def test_a_recording_is_read_in_parts(tmp_path):
    write_csv(tmp_path / "r.csv", SCAN)
    with pytest.raises(ValueError, match=r"write it again, or in shorter parts"):
        load(tmp_path / "r.csv", reader=Small())
    for part in (slice(0, N // 2), slice(N // 2, N)):
        write_csv(tmp_path / "r.csv", {name: v[part] for name, v in SCAN.items()})
        row = Row("", Case(), Case(), rows=part)
        assert_right(load(tmp_path / "r.csv", reader=Small()), row)


NO_PROCESS = {
    "cannot be started": (None, ".npz"),
    "was killed": (signal.SIGKILL, ".npz"),
    "takes longer than a file of this size may": (signal.SIGXCPU, ".h5"),
}


@pytest.mark.full
@follows(*NO_PROCESS)
@pytest.mark.parametrize("says", NO_PROCESS)
def test_a_process_that_ends_for_no_fault_of_the_file(tmp_path, monkeypatch, says):
    """It is said so, and the remedy is of another kind than to write the file again as it is."""
    path, (ended, suffix) = write("hdf5", tmp_path), NO_PROCESS[says]
    _apart._SERVER.stop()
    with monkeypatch.context() as broken:
        if ended is None:
            broken.setattr(_apart.sys, "executable", "/nonexistent/python")
        else:
            broken.setattr(_apart, "_table", lambda answer: None)
            broken.setattr(_apart._Server, "_ended", lambda self: int(ended))
        refused(lambda: load(path), says)
        if suffix == ".npz":
            assert load(write("npz", tmp_path)).signal.size
    _apart._SERVER.stop()
    assert load(path).signal.size


@follows("bytes to {} unpacked")
def test_what_is_packed_more_than_any_recording_is_written_without_compression(tmp_path):
    """A file of values that were never written states as many as it likes."""
    zeros = np.zeros(10**7)
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file.create_dataset("voltage_0_V", zeros.shape, "f8", chunks=True, compression="gzip")
    refused(lambda: read_table(tmp_path / "r.h5", BY_SUFFIX), "again, without compression")
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["voltage_0_V"] = zeros
    assert read_table(tmp_path / "r.h5", BY_SUFFIX).columns["voltage_0_V"].size == zeros.size


# Formats


@follows("pip install srsinv[{}], or save")
@pytest.mark.parametrize(
    ("format", "package"), [("tdms", "nptdms"), ("parquet", "pyarrow"), ("flac", "soundfile")]
)
def test_an_extra_has_the_package_of_its_format(tmp_path, monkeypatch, format, package):
    path = write(format, tmp_path)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, package, None)
        without.setattr(_apart, "sys", SimpleNamespace(executable=""))
        with pytest.raises(ValueError, match="save the recording in another format") as caught:
            load(path)
    extra = re.search(r"pip install srsinv\[(\w+)\]", str(caught.value))[1]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert [p for p in project["optional-dependencies"][extra] if p.startswith(package)]
    assert load(path, speed_m_per_s=0.05).signal.shape[0] == 2
    saved = tmp_path / "again.csv"
    save(load(path, speed_m_per_s=0.05), saved)
    np.testing.assert_array_equal(load(saved).signal, load(path, speed_m_per_s=0.05).signal)


def h5_with(path, name, **dataset):
    write_h5(path, scan(**{name: None}))
    with h5py.File(path, "a") as file:
        file.create_dataset(name, **dataset)


def grouped(path):
    for group in ("scan 1", "scan 2"):
        with h5py.File(path, "a") as file:
            for name, values in SCAN.items():
                file.require_group(group)[name] = values


def many_members(path):
    with h5py.File(path, "w") as file:
        for group in range(12):
            for index in range(900):
                file.require_group(f"g{group}").create_dataset(f"d{index}", shape=(), dtype="f8")


def long_attribute(path):
    with h5py.File(path, "w", libver="latest") as file:
        for name, values in SCAN.items():
            file[name] = values
        file["voltage_1_V"].attrs.create("units", np.zeros(2**20 + 8, np.int8))


def unpacks_to_more(path):
    h5_with(path, "voltage_1_V", shape=(N,), dtype="f8", chunks=(N,), compression="gzip")
    with h5py.File(path, "a") as file:
        packed = np.random.default_rng(0).bytes(2**19)
        file["voltage_1_V"].id.write_direct_chunk((0,), packed)
        file["voltage_1_V"].id.write_direct_chunk((0,), huge())


def huge():
    """Bytes that unpack to much more than a chunk of the scan."""
    import zlib

    return zlib.compress(bytes(2**29), 1)


H5 = {
    "in chunks of {}: write it again": lambda path: h5_with(
        path, "voltage_1_V", shape=(N,), maxshape=(None,), dtype="f8", chunks=(2**22 + 1,)
    ),
    "keep one recording in one file": many_members,
    "columns are looked for at the root or in one group": grouped,
    "attribute {} takes {} bytes": long_attribute,
    "has chunks that may unpack to more": unpacks_to_more,
    "which brings the file above the limit": lambda path: h5_with(
        path, "voltage_1_V", shape=(2**37,), dtype="f8", chunks=(2**20,)
    ),
}


SLOW = {"keep one recording in one file", "has chunks that may unpack to more"}


@follows(*H5)
@pytest.mark.parametrize("part", quick(H5, *(H5.keys() - SLOW)))
def test_hdf5_is_written_again(tmp_path, part):
    H5[part](tmp_path / "r.h5")
    with pytest.raises(ValueError, match=r"write it (again|shorter)|write the file|keep one") as no:
        load(tmp_path / "r.h5")
    assert all(words in str(no.value) for words in part.split("{}"))
    (tmp_path / "r.h5").unlink()
    write_h5(tmp_path / "r.h5", SCAN)
    assert_right(load(tmp_path / "r.h5"), RIGHT)


@follows("column {} appears twice: give every column its own name")
def test_an_archive_has_each_name_once(tmp_path):
    np.savez(tmp_path / "once.npz", **SCAN)
    with zipfile.ZipFile(tmp_path / "once.npz") as once:
        arrays = {name: once.read(name) for name in once.namelist()}
    with zipfile.ZipFile(tmp_path / "r.npz", "w") as twice, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the name that is there already
        for name in (*arrays, "voltage_0_mV.npy"):
            twice.writestr(name, arrays[name])
    refused(lambda: load(tmp_path / "r.npz"), "give every column its own name")
    assert_right(load(tmp_path / "once.npz"), RIGHT)


@dataclass(frozen=True)
class Returning(Reader):
    """Gives what it is made of, or raises it."""

    given: Any

    def read(self, file):
        if isinstance(self.given, Exception):
            raise self.given
        return self.given


READERS = {
    "cannot read the file ({})": ZeroDivisionError("by zero"),
    "where a mapping of column names": [1, 2],
    "names a column {}, which is no text": {**SCAN, 3: TIME_S},
    "where a 1-D array of real numbers is": {**SCAN, "a": TIME_S[None]},
    "gives columns that differ in length": {**SCAN, "a": TIME_S[1:]},
    "gives no number in any column": {"a": np.full(N, np.nan)},
}


@pytest.mark.full
@follows(*READERS, "choose another by reader=...")
@pytest.mark.parametrize("part", READERS)
def test_another_reader_is_chosen(tmp_path, part):
    path = tmp_path / "r.lab"
    write_csv(path, SCAN)
    with pytest.raises(ValueError, match=r"choose another by reader=\.\.\.") as caught:
        load(path, reader=Returning(READERS[part]))
    assert all(words in str(caught.value) for words in part.split("{}"))
    name = composed("experiment=inspect_recording", f"recording.path={path}", "reader=text")
    assert name["reader"]["_target_"].endswith(".Text")
    assert_right(load(path, reader=Text()), RIGHT)


@follows("there is no column in the file: write it again")
def test_an_empty_archive_is_written_again(tmp_path):
    zipfile.ZipFile(tmp_path / "r.npz", "w").close()
    refused(lambda: load(tmp_path / "r.npz"), "a column for each quantity")
    np.savez(tmp_path / "r.npz", **SCAN)
    assert_right(load(tmp_path / "r.npz"), RIGHT)


@follows("there is no column of the {}")
def test_a_profile_s_columns_are_named_as_said(tmp_path):
    write_csv(tmp_path / "p.csv", {"x": POSITION_M, "height_um": TIME_S})
    said = refused(lambda: load_profile(tmp_path / "p.csv"), "name one so")
    name = re.search(r"\((\w+), ", said)[1]
    write_csv(tmp_path / "p.csv", {name: POSITION_M, "height_um": TIME_S})
    profile = load_profile(tmp_path / "p.csv")
    np.testing.assert_allclose(profile["position_m"], POSITION_M)
    np.testing.assert_allclose(profile["profile_m"], TIME_S * 1e-6)


@follows("there is no column {}: give {} {}")
def test_a_file_of_the_package_s_own_columns_is_given(tmp_path):
    names, path = ["time_s", "depth_m"], tmp_path / "c.csv"

    def read():
        return load_columns(path, names, "operator.path", "a file of both")

    write_csv(path, {"time_s": TIME_S})
    refused(read, "no column depth_m: give operator.path a file of both")
    write_csv(path, {"time_s": TIME_S, "depth_m": POSITION_M})
    np.testing.assert_allclose(read()["depth_m"], POSITION_M)


# A recording's own fields


@follows("signal, time_s and speed_m_per_s have shapes", "measured_position_m has shape",
         "no channel: name at least one", "is not finite at data row")  # fmt: skip
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"signal": SIGNAL_V.T}, "give (element, sample), (sample,) and (sample,)"),
        ({"measured_position_m": POSITION_M[1:]}, "give (sample,)"),
        ({"channels": (), "signal": np.empty((0, N))}, "name at least one"),
        ({"signal": np.where(TIME_S == 0, np.inf, SIGNAL_V)}, "correct the value"),
    ],
)
def test_fields_are_given_as_said(wrong, words):
    right = {"signal": SIGNAL_V, "time_s": TIME_S, "speed_m_per_s": np.full(N, SPEED_M_PER_S),
             "channels": ("a0", "a1"), "measured_position_m": POSITION_M}  # fmt: skip
    refused(lambda: Recording(**{**right, **wrong}), words)
    assert_right(Recording(**right), RIGHT)


@follows("no speed can be derived from the positions at these times")
def test_times_too_close_for_a_speed(tmp_path):
    time_s = np.concatenate([TIME_S[:5] - 1, [TIME_S[5] - 1 + 0], TIME_S[6:]])
    write_csv(tmp_path / "r.csv", scan(time_ms=None, time_s=close_together(time_s)))
    said = refused(lambda: load(tmp_path / "r.csv"), "no speed can be derived")
    speed = asked(said, "speed_m_per_s", "0.02")
    recording = load(tmp_path / "r.csv", **typed(speed))
    np.testing.assert_array_equal(recording.speed_m_per_s, 0.02)
    np.testing.assert_allclose(recording.signal, SIGNAL_V)


def close_together(time_s):
    """Increasing times of which two are one once the first is taken off."""
    return np.concatenate([[-1.0, 0.0, 1e-17], 1 + time_s[3:] - time_s[3]])


# Saving

SAVED = recorded()
SAVE = {
    "a recording cannot be written as": ("r.xlsx", {}, SAVED, "r.csv"),
    "netCDF cannot name a variable": (
        "r.nc", {}, Recording(SIGNAL_V, TIME_S, TIME_S, ("a/0", "b1")), "r.csv",
    ),
    "there is another sidecar": ("r.csv", {"r.json": "{}"}, SAVED, "other.csv"),
    "there are data already": ("r.csv", {"r.csv": "a\n"}, SAVED, "other.csv"),
    "there is a sidecar, {}, which would be taken": ("r.nc", {"r.yaml": "gain: 5"}, SAVED, "o.nc"),
    "there is a file already that is no such": ("r.nc", {"r.nc": "mine"}, SAVED, "other.nc"),
    "the file cannot be written": ("nowhere/r.csv", {}, SAVED, "r.csv"),
    "the signals of {} are prepared": (
        "r.csv", {}, on_even_times(recorded(detrend="constant")), "r.csv",
    ),
}  # fmt: skip


@follows(*SAVE)
@pytest.mark.parametrize("part", SAVE)
def test_a_recording_is_saved_where_it_is_said(tmp_path, part):
    name, there, recording, other = SAVE[part]
    for file, content in there.items():
        (tmp_path / file).write_text(content)
    said = refused(lambda: save(recording, tmp_path / name))
    assert all(words in said for words in part.split("{}"))
    if recording.raw_signal is not None:
        recording = recorded(detrend="constant")
    save(recording, tmp_path / other)
    got = load(tmp_path / other)
    np.testing.assert_array_equal(got.signal, recording.signal)
    np.testing.assert_array_equal(got.time_s, recording.time_s)
    assert {file: (tmp_path / file).read_text() for file in there} == there


@follows("the sidecar cannot be written as JSON")
def test_facts_are_text_and_finite_numbers(tmp_path):
    facts = recorded(description="rig")
    facts.sidecar["gain"] = math.inf
    refused(lambda: save(facts, tmp_path / "r.csv"), "keep to text, finite numbers")
    facts.sidecar["gain"] = 4.0
    save(facts, tmp_path / "r.csv")
    assert_right(load(tmp_path / "r.csv"), Row("", Case(), Case(), factor=0.25))


# Warnings of channels


def stuck(signal):
    return np.where((np.arange(N) >= 100) & (np.arange(N) < 130), signal[100], signal)


def clipped(signal):
    return np.minimum(signal, np.quantile(signal, 0.9))


FAULTS = {"is stuck": stuck, "is clipped": clipped}


@follows("is stuck: {}", "is clipped: {}")
@pytest.mark.parametrize("fault", FAULTS)
def test_samples_at_fault_are_marked_as_missing(tmp_path, fault):
    smooth = np.cumsum(SIGNAL_V[1])
    faulty = FAULTS[fault](smooth)
    write_csv(tmp_path / "r.csv", scan(voltage_1_V=faulty))
    first = load_even({"path": tmp_path / "r.csv"}, {})
    (said,) = channel_findings(first.channels, first.signal, "V")
    assert fault in said
    is_wrong = faulty != smooth if fault == "is clipped" else np.arange(N) // 30 * 30 == -1
    is_wrong |= (faulty == np.max(faulty)) if fault == "is clipped" else stretch(100, 130)
    cells = ["" if wrong else value for wrong, value in zip(is_wrong, faulty, strict=True)]
    write_csv(tmp_path / "r.csv", scan(voltage_1_V=cells))
    allowed = re.search(r"recording\.missing=\w+", said)[0]
    marked = load_even({"path": tmp_path / "r.csv"} | typed(allowed), {})
    assert channel_findings(marked.channels, marked.signal, "V") == ()
    np.testing.assert_array_equal(np.isnan(marked.signal[1]), is_wrong)
    np.testing.assert_array_equal(marked.signal[1][~is_wrong], smooth[~is_wrong])


def stretch(start, stop):
    return (np.arange(N) >= start) & (np.arange(N) < stop)


@follows("or each sample is stored several times")
@pytest.mark.parametrize("has_times", [True, False])
def test_samples_stored_several_times_are_left_out(tmp_path, has_times):
    every = {name: np.repeat(values, 4) for name, values in SCAN.items()}
    every["time_ms"] = 1e3 * np.arange(4 * N) / (4 * RATE_HZ)
    every |= {"position_mm": None, "time_ms": every["time_ms"] if has_times else None}
    table = {name: values for name, values in every.items() if values is not None}
    write_csv(tmp_path / "r.csv", table)
    settings = {"path": tmp_path / "r.csv", "speed_m_per_s": SPEED_M_PER_S}
    rate = {} if has_times else typed("recording.sample_rate_hz=8000")
    first = load_even(settings | rate, {})
    said = channel_findings(first.channels, first.signal, "V")[0]
    write_csv(tmp_path / "r.csv", {name: values[::4] for name, values in table.items()})
    rate = {} if has_times else typed(asked(said, "sample_rate_hz", "2000"))
    rest = load_even(settings | rate, {})
    assert channel_findings(rest.channels, rest.signal, "V") == ()
    assert_right(rest, RIGHT)


@follows("the speed varies by more than")
def test_a_speed_is_stated_for_a_job_at_one_speed(tmp_path):
    speed = np.linspace(0.019, 0.021, N)
    write_csv(tmp_path / "r.csv", scan(position_mm=None, speed_m_per_s=speed))
    settings = {"path": tmp_path / "r.csv"}
    said = refused(lambda: load_steady(settings, {}), "varies by more than")
    stated = typed(asked(said, "speed_m_per_s", "0.02"))
    assert_right(load_steady(settings | stated, {}), RIGHT)


@follows("which nothing converts to V")
@pytest.mark.parametrize(
    ("key", "value", "factor"), [("gain", "4", 0.25), ("signal_unit", "mV", 1e-3)]
)
def test_counts_become_volts(tmp_path, key, value, factor):
    table = scan(voltage_0_mV=None, voltage_1_V=None, AI0=SIGNAL_V[0], AI1=SIGNAL_V[1])
    write_csv(tmp_path / "r.csv", table)
    settings = {"path": tmp_path / "r.csv"}
    said = refused(lambda: check_volts(load_even(settings, {})), "nothing converts to V")
    recording = load_even(settings | typed(asked(said, key, value)), {})
    check_volts(recording)
    assert_right(recording, Row("", Case(), Case(), factor=factor))
    relative = re.search(r"use (.*)\.$", said)[1].split()
    assert composed(*relative, "recording.path=r.csv")["traction_unit"] == "relative"


@follows("(one for each channel where they differ)")
def test_counts_beside_volts_have_a_gain_of_their_own(tmp_path):
    table = scan(voltage_0_mV=None, voltage_1_V=None, AI0=4 * SIGNAL_V[0])
    write_csv(tmp_path / "r.csv", table | {"film 1 [V]": SIGNAL_V[1]})
    settings = {"path": tmp_path / "r.csv"} | typed("recording.channels=[AI0,film 1]")
    said = refused(lambda: check_volts(load_even(settings, {})), "one for each channel")
    recording = load_even(settings | typed(asked(said, "gain", "[4,1]")), {})
    check_volts(recording)
    assert_right(recording, RIGHT)


def leaves(facts, path=()):
    """The keys of all facts, and for each one that is in no other."""
    for key, field in facts.model_fields.items():
        below = _facts_in(field.annotation)
        if below is None:
            yield (*path, key)
        else:
            yield from leaves(below, (*path, key))


def nested(path, value):
    """Facts with a value at a key within keys; film elements are a list."""
    for key in reversed(path):
        value = [{key: value}] if path[path.index(key) - 1] == "elements" else {key: value}
    return value


@follows("where {} is expected: correct it in the sidecar")
def test_the_key_that_a_wrong_fact_names_can_be_typed():
    """As far as it names one: not every fact has a key on the command line."""
    cfg = composed("experiment=invert_recording", "recording.path=r.csv")
    named = {}
    for path in leaves(RecordingFacts):
        said = refused(lambda path=path: check_facts("r.csv", nested(path, {"no": "value"})))
        key = re.search(r"command line \(([\w.]+)=\.\.\.\)", said)
        if key:
            group, name = key[1].split(".")
            assert name in cfg[group], said
            named[path] = key[1]
    assert {path[0] for path in named} >= {"gain", "channels", "time_unit", "sensor", "drift"}
    assert named["sensor", "elements", "offset_m"] == "sensor.elements"
    assert {path[0] for path in leaves(RecordingFacts)} - {path[0] for path in named} == {
        "description", "scan_length_m", "skin", "feature", "rig_error",
    }  # fmt: skip


@follows("leave it out of mains_Hz, or cut the recording")
def test_a_broad_line_is_left_out_or_the_recording_cut(monkeypatch):
    monkeypatch.setattr(mains, "MOST_WAVES", 40)
    broad, narrow = (MainsLine(50.0, half, np.ones(1)) for half in (20.0, 0.01))
    time_s = np.arange(2000) / RATE_HZ
    with pytest.raises(ValueError, match="leave it out of mains_Hz, or cut the recording"):
        waves(time_s, [broad, narrow], 1e-3)
    assert len(waves(time_s, [narrow], 1e-3)[0])
    assert len(waves(time_s[:200], [broad, narrow], 1e-3)[0])


# Preparation: N samples last 0.1995 s

PREPARED = [
    ("and no notch is asked for", {"notch_width_Hz": 8.0}, {"notch_width_Hz": 8.0, "notch_Hz": 99}),
    ("and no notch is asked for", {"notch_width_Hz": 8.0}, {}),
    ("the line at {} Hz is in recording.notch_Hz and in", {"notch_Hz": [50.0, 99.0],
     "mains_Hz": [50.0, 150.0], "notch_width_Hz": 8.0},
     {"notch_Hz": 99.0, "mains_Hz": [50.0, 150.0], "notch_width_Hz": 8.0}),
    ("samples a second it has to be below", {"high_pass_Hz": 990.0}, {"high_pass_Hz": 979.9}),
    ("and takes the notch from", {"high_pass_Hz": 60.0, "notch_Hz": 50.0, "notch_width_Hz": 8.0},
     {"high_pass_Hz": 45.9, "notch_Hz": 50.0, "notch_width_Hz": 8.0}),
    ("has to lie between 0 and", {"notch_Hz": [50.0, 979.0], "notch_width_Hz": 8.0},
     {"notch_Hz": [50.0, 975.9], "notch_width_Hz": 8.0}),
    ("at {} frequencies, and more than", {"notch_Hz": [200.0, 400.0], "notch_width_Hz": 60.0},
     {"notch_Hz": [200.0, 400.0], "notch_width_Hz": 50.0}),
]  # fmt: skip


@follows(*(part for part, _, _ in PREPARED))
@pytest.mark.parametrize(("part", "wrong", "right"), PREPARED)
def test_a_preparation_is_given_within_its_bounds(part, wrong, right):
    said = refused(lambda: on_even_times(recorded(**wrong)))
    assert all(words in said for words in part.split("{}"))
    given = on_even_times(recorded(**right))
    assert given.raw_signal is None or np.array_equal(given.raw_signal, SIGNAL_V)


@follows("of a period of {} s, and the recording lasts", "in which no line is narrower than")
@pytest.mark.parametrize(("key", "start"), [("high_pass_Hz", "give "), ("notch_width_Hz", "than ")])
def test_the_least_frequency_that_is_said_is_taken(key, start):
    facts = {"notch_Hz": 50.0} if key == "notch_width_Hz" else {}
    for samples in range(390, 400):
        signal = SIGNAL_V[:, :samples]
        said = refused(lambda s=signal: on_even_times(recorded(s, **facts, **{key: 1.0})))
        least = float(re.search(rf"{start}([\d.]+)", said)[1])
        assert on_even_times(recorded(signal, **facts, **{key: least})).raw_signal is not None
    for other in ("recording.detrend=linear", "recording.mains_Hz"):
        if other in said:
            stated = typed(other if "=" in other else f"{other}=[50]")
            assert on_even_times(recorded(**stated)).sidecar == stated


@follows("and a filter needs")
def test_a_channel_of_holes_is_left_out_or_not_filtered():
    holes = np.where(np.arange(N) % 3, np.nan, SIGNAL_V[1])
    both = np.stack([SIGNAL_V[0], holes])
    refused(lambda: on_even_times(recorded(both, high_pass_Hz=9.0)), "or the channel")
    np.testing.assert_array_equal(on_even_times(recorded(both)).signal, both)
    assert on_even_times(recorded(both[0], high_pass_Hz=9.0)).raw_signal is not None


@follows(
    "recording.detrend={} took", "recording.high_pass_Hz={} took", "recording.notch_Hz={} took"
)
@pytest.mark.parametrize(
    "facts", [{"detrend": "linear"}, {"high_pass_Hz": 9.0}, {"notch_Hz": 50.0}], ids=str
)
def test_a_filter_is_left_out_and_its_cost_held(facts):
    (said,) = preparation_warnings(recorded(**facts), 100.0)
    assert "leave it out, and" in said
    key = re.search(r"and (?:give|invert with) recording\.(\w+)", said)[1]
    instead = typed(f"recording.{key}=auto")
    recording = on_even_times(recorded(**instead))
    assert preparation_warnings(recording, 100.0) == ()
    np.testing.assert_array_equal(recording.signal, SIGNAL_V)
    assert recording.sidecar == instead


# The template


@follows("in place of another sidecar", "correct what was guessed wrong", "remove the # to invert")
def test_the_template_is_filled_in_as_it_says(tmp_path):
    path = tmp_path / "r.csv"
    hum = 0.3 * np.sin(2 * np.pi * 50 * np.arange(4000) / RATE_HZ)
    noise = 1e-3 * np.random.default_rng(1).normal(size=(2, 4000))
    table = {"t": 1e3 * np.arange(4000) / RATE_HZ, "AI0": hum + noise[0], "AI1": hum + noise[1]}
    write_csv(path, table)
    (tmp_path / "r.yaml").write_text("speed_m_per_s: 0.02\nsignal_unit: V")
    template = sidecar_template(inspect(path))
    template = template.replace('time_unit: "s"', 'time_unit: "ms"')
    template = template.replace("polarity: null", "polarity: -1").replace("gain: null", "gain: 4")
    (tmp_path / "r.yaml").write_text(template)
    template = re.sub("# (mains_Hz|drift):", r"\1:", sidecar_template(inspect(path)))
    (tmp_path / "r.yaml").write_text(template)
    recording = load_even({"path": path}, {})
    np.testing.assert_allclose(recording.signal, -(hum + noise) / 4, rtol=1e-12)
    np.testing.assert_allclose(recording.time_s, np.arange(4000) / RATE_HZ, atol=1e-12)
    assert recording.sidecar["mains_Hz"] == [50]
    assert yaml.safe_load(template)["channels"] == ["AI0", "AI1"]


# What `inspect_recording` says


NEXT = {
    "polarity and gain": (scan(), ["recording.polarity=-1", "recording.gain=[4,4]"], -0.25),
    "channels": (
        {"time_ms": 1e3 * TIME_S, "Ch A (0) raw": SIGNAL_V[0], "back 'b' 1": SIGNAL_V[1]},
        ["recording.channels=['Ch A (0) raw',\"back 'b' 1\"]", "recording.signal_unit=V",
         "recording.speed_m_per_s=0.02"], 1.0,
    ),
    "times of its own": (
        scan(time_ms=7e3 * TIME_S, voltage_1_V=["", *SIGNAL_V[1][1:]]),
        ["recording.times=ignore", "recording.sample_rate_hz=2000"], 1.0,
    ),
    "a guessed unit": (
        scan(time_ms=None, position_mm=None, t=500 * np.arange(N)),
        ["recording.speed_m_per_s=0.02", "recording.scan_start_m=1e-2"], 1.0,
    ),
    "a reader and a film": (scan(), ["reader=text", "sensor.depth_m=0.00125"], 1.0),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("case", NEXT)
def test_the_next_command_reads_as_the_look_did(tmp_path, case):
    """Whatever was typed for the look is typed again: without it, signals would be others."""
    table, overrides, factor = NEXT[case]
    path = tmp_path / "scan (1), raw.csv"
    write_csv(path, table)
    cfg = composed("experiment=inspect_recording", f'recording.path="{path}"', *overrides)
    facts = result_of(cfg).dataset.attrs
    assert facts["verdict"].startswith("usable")
    assert ("a guess from the stamps" in facts["verdict"]) == (case == "a guessed unit")
    program, *again = shlex.split(facts["next_command"])
    assert program == "srsinv"
    cfg = composed(*again)
    recording = config.recording(cfg)
    missing = np.isnan(recording.signal)
    assert missing.sum() == (case == "times of its own")
    np.testing.assert_allclose(recording.signal[~missing], (factor * SIGNAL_V)[~missing])
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=1e-12)
    np.testing.assert_allclose(recording.speed_m_per_s, SPEED_M_PER_S, rtol=1e-4)
    assert cfg["sensor"]["depth_m"] == (0.00125 if "film" in case else None)
    assert cfg["reader"]["_target_"].endswith(".Text" if "film" in case else ".BySuffix")


@follows("is no JSON as srsinv writes it")
def test_json_that_is_written_again(tmp_path):
    path, where = tmp_path / "metrics.json", {"what": "file", "key": "gather.folder", "most": 1000}
    path.write_text('{"a": 1, "a": 2}')
    with pytest.raises(BadInput, match="run again"):
        read_json(path, **where)
    path.write_text('{"a": 1}')
    assert read_json(path, **where) == {"a": 1}


@follows("there is another file of this name: choose another name, or move it away")
def test_another_file_in_the_way(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("mine")
    with pytest.raises(BadInput, match="another file"):
        write_whole(path, b"new")
    path.rename(tmp_path / "mine.csv")
    write_whole(path, b"new")
    assert (path.read_bytes(), (tmp_path / "mine.csv").read_text()) == (b"new", "mine")
