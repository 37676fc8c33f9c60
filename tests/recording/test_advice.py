"""Advice that is followed: a refused recording is then read with the right numbers.

An advice that is wrong corrupts data in silence. Whoever changes one adds a row here, or a test.
"""

import re
import shlex
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest

from srsinv import config
from srsinv.recording import Recording, load
from srsinv.recording._schema import RecordingFacts, _facts_in, check_facts
from srsinv.recording.channels import channel_findings
from srsinv.recording.even import check_volts, load_steady, on_even_times
from srsinv.recording.preparation import preparation_warnings
from srsinv.recording.unusable import without_unusable
from tests.jobs.run import composed, result_of
from tests.recording.files import write_csv, write_h5, write_npz
from tests.recording.scan import (
    MM,
    RATE_HZ,
    SCAN,
    SIGNAL_V,
    SPEED_M_PER_S,
    TIME_S,
    Case,
    N,
    after,
    assert_is_scan,
    renamed,
    scan,
    setting,
    text_of,
    typed,
    with_cell,
    without_rows,
)
from tests.refusals import refused
from tests.tiers import quick

RATE = "recording.sample_rate_hz=2000"


class Advice(NamedTuple):
    """A case in trouble, what following the sentence that refuses it makes of it, and how the
    recording then differs from the scan (arguments of `assert_is_scan`)."""

    trouble: Case
    followed: Case | Callable[[str], Case]
    differs: Mapping[str, Any] = {}


def set_by(table: Case, key: str, value: str | None = None, *others: str) -> Advice:
    """One that asks for a setting: with the value that it gives, or with this one."""
    return Advice(
        table,
        lambda said: table._replace(settings=[*table.settings, *others, setting(said, key, value)]),
    )


def differs(advice: Advice, **how: Any) -> Advice:
    return advice._replace(differs=how)


def times_ignored(table: Case) -> Advice:
    """Rows that the sentence says to count by a rate."""
    return Advice(
        table,
        lambda said: table._replace(
            settings=[setting(said, "times"), setting(said, "sample_rate_hz", "2000")]
        ),
    )


def listed(said: str, number: int) -> str:
    """One of the columns that a sentence lists."""
    found = re.search(r"columns (.*?)(:|$)", said)
    assert found
    return f"'{found[1].split(', ')[number]}'"


LINES = text_of(SCAN).splitlines(keepends=True)
BLANK = [*LINES[:3], "\n\n", *LINES[5:]]  # two rows of the scan, which are then missing


def row_mended(cell: int, wrong: str) -> Advice:
    """One that names a row below blank ones by its number."""
    lines = "".join(BLANK).splitlines(keepends=True)
    bad = lines[9].replace(LINES[9].split(",")[cell] + ",", wrong)

    def mend(said: str) -> Case:
        found = re.search(r"data row (\d+)", said)
        assert found
        row = int(found[1])
        return Case(text="".join([*lines[:row], LINES[row], *lines[row + 1 :]]))

    return Advice(Case(text="".join([*lines[:9], bad, *lines[10:]])), mend, {"missing": [2, 3]})


def cut_at(said: str) -> Case:
    """The scan up to the data row that a sentence says to cut it after."""
    found = re.search(r"after data row (\d+)", said)
    assert found
    return Case({name: values[: int(found[1])] for name, values in DAY.items()})


DAY = scan(time_ms=1e3 * TIME_S + np.where(np.arange(N) < 250, 0, 86_400e3))
ONE = {"voltage_0_mV": None}
ALIKE = scan(**ONE, **{"Ch 0 [V]": 9 * SIGNAL_V[0], "ch 0 [mV]": 1e3 * SIGNAL_V[0]})
TWO_RAILS = scan(position_mm=None, **{"Pos A (mm)": MM, "Pos B (mm)": 0 * TIME_S})
TWO_TIMES = renamed(time_ms="Time A (ms)") | {"Time B (ms)": 2 * TIME_S}
UNNAMED = scan(voltage_1_V=None, **ONE, **{"front 0": SIGNAL_V[0], "back 1": SIGNAL_V[1]})
RAIL, BARE_TIME = renamed(position_mm="rail"), renamed(time_ms="time")
JITTERED = scan(time_ms=1e3 * TIME_S + np.random.default_rng(2).uniform(-0.2, 0.2, N))
TRIPLE = scan(time_ms=3e3 * TIME_S)
STAMPS = pd.Timestamp("2025-02-11") + pd.to_timedelta(TIME_S, "s")
JOINED = BARE_TIME | {"time": STAMPS.strftime("%Y%m%d_%H%M%S_%f").to_list()}
TIMES_APART = "time_ms,voltage_0_mV,time_ms,position_mm,voltage_1_V\n" + "".join(
    f"{a},{b},{a + 0.4 * (i % 2) + 5},{c},{d}\n"
    for i, (a, c, b, d) in enumerate(zip(*SCAN.values(), strict=True))
)
HOLE = scan(voltage_1_V=np.where(np.arange(N) == 7, np.nan, SIGNAL_V[1]), **ONE)
SPARSE = Case(scan(voltage_1_V=[0.5, *[""] * (N - 1)]), ["recording.missing=allow"])
JSON_AND_YAML = Case(beside={"r.json": '{"gain": 4}', "r.yaml": "gain: 5"})
CLOSE_S = np.concatenate([[-1.0, 0.0, 1e-17], 1 + TIME_S[3:] - TIME_S[3]])
SHORT_ROW = [LINES[0], ",".join(LINES[8].split(",")[:2]) + "\n"]

FOLLOWED = {
    # Columns
    "a name of two columns": Advice(
        Case(ALIKE, ["recording.channels=[CH 0]"]),
        lambda s: Case(ALIKE, [f"recording.channels=[{listed(s, 1)}]"]), {"channels": [0]}),
    "two positions": Advice(
        Case(TWO_RAILS), lambda s: Case(TWO_RAILS, [setting(s, "position_column", listed(s, 0))])),
    "two times": set_by(Case(TWO_TIMES), "time_column", "Time A"),
    "no signals": Advice(
        Case(UNNAMED), lambda s: Case(UNNAMED, [
            setting(s, "channels", f"[{listed(s, -2)},{listed(s, -1)}]")]), {"unit": "counts"}),
    "no such column": Advice(
        Case(RAIL, ["recording.position_column=stage"]),
        Case(RAIL, ["recording.position_column=rail", "recording.position_unit=mm"])),
    "no such channel": Advice(
        Case(SCAN, ["recording.channels=[voltage_0]"]),
        lambda s: Case(SCAN, [f"recording.channels=[{after('the nearest is ', s)}]"]),
        {"channels": [0]}),
    "a channel of one sample": differs(
        set_by(SPARSE, "channels", "[voltage_0_mV]"), channels=[0]),
    # Rows
    "a word below blank rows": row_mended(2, "x,"),
    "a time below blank rows": row_mended(0, "0.25,"),
    "a short row": Advice(
        Case(text="".join([*LINES[:8], SHORT_ROW[1], *LINES[9:]])), Case(without_rows(7)),
        {"missing": [7]}),
    "NaN among times": Advice(
        Case(with_cell("voltage_1_V", 7, "nan")), Case(without_rows(7)), {"missing": [7]}),
    "an empty cell": Advice(
        Case(with_cell("voltage_1_V", 7, "", **ONE)),
        lambda s: Case(with_cell("voltage_1_V", 7, "", **ONE), [setting(s, "missing")]),
        {"missing": [7], "channels": [1]}),
    "NaN in an array": Advice(
        Case(HOLE, name="r.npz", write=write_npz),
        lambda s: Case(HOLE, [setting(s, "missing")], name="r.npz", write=write_npz),
        {"missing": [7], "channels": [1]}),
    "a position out of range": Advice(
        Case(with_cell("position_mm", 7, 1e30)), Case(without_rows(7)), {"missing": [7]}),
    "a time that repeats": Advice(
        Case(with_cell("time_ms", 7, 3.0)), Case(without_rows(7)), {"missing": [7]}),
    # Times
    "uneven times": times_ignored(Case(JITTERED)),
    "a rate that the times contradict": Advice(
        Case(SCAN, ["recording.sample_rate_hz=1000"]), Case(SCAN)),
    "times that a rate contradicts": Advice(
        Case(TRIPLE, [RATE]), lambda s: Case(TRIPLE, [RATE, setting(s, "times")])),
    "a rate and a wrong unit": Advice(
        Case(BARE_TIME, [RATE, "recording.time_unit=s"]),
        lambda s: Case(BARE_TIME, [RATE, setting(s, "time_unit", "ms")])),
    "a day's rest": Advice(Case(DAY), cut_at, {"rows": slice(250)}),
    "no rate": set_by(Case(SCAN, ["recording.times=ignore"]), "sample_rate_hz", "2000"),
    "no time": set_by(Case(scan(time_ms=None)), "sample_rate_hz", "2000"),
    "stamps in words of one's own": times_ignored(Case(JOINED)),
    "times of two columns": Advice(Case(text=TIMES_APART), Case(SCAN)),
    # Units and numbers
    "a unit that is not known": set_by(
        Case(renamed(time_ms="Time [millis]")), "time_unit", "ms"),
    "a time of no unit": set_by(Case(BARE_TIME), "time_unit", "ms"),
    "a position of no unit": set_by(
        Case(RAIL, ["recording.position_column=rail"]), "position_unit", "mm"),
    "a unit beside the name's": Advice(Case(SCAN, ["recording.position_unit=um"]), Case(SCAN)),
    "thousands": Advice(Case(with_cell("voltage_0_mV", 7, '"1,234.5"')), Case(SCAN)),
    "three gains": differs(
        Advice(Case(SCAN, ["recording.gain=[1,2,3]"]), Case(SCAN, ["recording.gain=[4,4]"])),
        factor=0.25),
    "a gain of nothing": differs(
        Advice(Case(SCAN, ["recording.gain=1e-20"]),
               lambda s: Case(SCAN, [setting(s, "gain", "0.25")])), factor=4.0),
    # Motion
    "no speed": set_by(Case(scan(position_mm=None)), "speed_m_per_s", "0.02"),
    "no motion": set_by(Case(scan(position_mm=0 * TIME_S)), "speed_m_per_s", "0.02"),
    # Sidecars and files
    "a key of the sidecar": differs(
        Advice(Case(sidecar="polarty: -1"),
               lambda s: Case(sidecar=f"{after('the nearest is ', s)}: -1")), factor=-1.0),
    "a word in the sidecar": differs(
        set_by(Case(sidecar="gain: four"), "gain", "4"), factor=0.25),
    "two sidecars": differs(
        set_by(JSON_AND_YAML, "sidecar", "{folder}/r.json"), factor=0.25),
    "an element too few": differs(
        set_by(Case(sidecar='{"sensor": {"elements": [{}]}}'), "channels", "[voltage_1_V]"),
        channels=[1]),
    "a path": Advice(
        Case(settings=["recording.path={folder}/rr.csv"]),
        lambda s: Case(settings=[f"recording.path={{folder}}/{after('did you mean ', s)}"])),
    "a suffix": Advice(
        Case(write=write_h5),
        lambda s: Case(name=f"r{re.findall('[.]hdf5', s)[0]}", write=write_h5)),
}  # fmt: skip


@pytest.mark.parametrize("name", quick(FOLLOWED, *list(FOLLOWED)[::3]))
def test_advice_that_is_followed_gives_the_scan(tmp_path, name):
    trouble, followed, how = FOLLOWED[name]
    said = trouble.refusal(tmp_path)
    case = followed if isinstance(followed, Case) else followed(said)
    assert_is_scan(case.read(tmp_path), **how)


def test_a_speed_is_stated_where_times_are_too_close(tmp_path):
    path = tmp_path / "r.csv"
    write_csv(path, scan(time_ms=None, time_s=CLOSE_S))
    said = refused(lambda: load(path))
    recording = load(path, **typed(setting(said, "speed_m_per_s", "0.02")))
    np.testing.assert_array_equal(recording.speed_m_per_s, SPEED_M_PER_S)
    np.testing.assert_allclose(recording.signal, SIGNAL_V)


# Jobs that need more of a recording than that it is read


def test_a_speed_is_stated_for_a_job_at_one_speed(tmp_path):
    speed = np.linspace(0.019, 0.021, N)
    write_csv(tmp_path / "r.csv", scan(position_mm=None, speed_m_per_s=speed))
    settings = {"path": tmp_path / "r.csv"}
    said = refused(lambda: load_steady(settings, {}))
    stated = typed(setting(said, "speed_m_per_s", "0.02"))
    assert_is_scan(load_steady(settings | stated, {}))


COUNTS: dict[str, tuple[dict[str, Any], list[str], str, str, float]] = {
    "gain": ({"AI0": SIGNAL_V[0], "AI1": SIGNAL_V[1]}, [], "gain", "4", 0.25),
    "unit": ({"AI0": SIGNAL_V[0], "AI1": SIGNAL_V[1]}, [], "signal_unit", "mV", 1e-3),
    "beside volts": ({"AI0": 4 * SIGNAL_V[0], "film 1 [V]": SIGNAL_V[1]},
                     ["recording.channels=[AI0,film 1]"], "gain", "[4,1]", 1.0),
}  # fmt: skip


@pytest.mark.parametrize("case", COUNTS)
def test_counts_become_volts(tmp_path, case):
    columns, given, key, value, factor = COUNTS[case]
    counts = Case(scan(voltage_0_mV=None, voltage_1_V=None, **columns), given)
    said = refused(lambda: check_volts(counts.read(tmp_path)))
    volts = counts._replace(settings=[*given, setting(said, key, value)]).read(tmp_path)
    check_volts(volts)
    assert_is_scan(volts, factor=factor)
    relative = re.search(r"use (.*)\.$", said)
    assert relative
    assert composed(*relative[1].split(), "recording.path=r")["traction_unit"] == "relative"


# Warnings


FAULTS = {
    "stuck": lambda signal: np.where(np.arange(N) // 30 == 3, signal[90], signal),
    "clipped": lambda signal: np.minimum(signal, np.quantile(signal, 0.9)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_samples_at_fault_are_missing_where_they_are_not_kept(tmp_path, fault):
    smooth = np.cumsum(SIGNAL_V[1])
    faulty = FAULTS[fault](smooth)
    table = scan(voltage_1_V=faulty)
    kept, by_kept = without_unusable(Case(table, ["recording.unusable=keep"]).read(tmp_path), 1e-3)
    assert np.isfinite(kept.signal).all()
    (said,) = by_kept
    is_wrong = np.arange(N) // 30 == 3 if fault == "stuck" else faulty == np.max(faulty)
    left, words = without_unusable(Case(table, [setting(said, "unusable")]).read(tmp_path), 1e-3)
    assert len(words) == 1
    np.testing.assert_array_equal(np.isnan(left.signal[1]), is_wrong)
    np.testing.assert_array_equal(left.signal[1][~is_wrong], smooth[~is_wrong])
    assert channel_findings(left.channels, left.signal, "V") == ()


def test_samples_stored_several_times_are_left_out(tmp_path):
    speed = "recording.speed_m_per_s=0.02"
    columns = {"voltage_0_V": SIGNAL_V[0], "voltage_1_V": SIGNAL_V[1]}
    every = {name: np.repeat(values, 4) for name, values in columns.items()}
    first = Case(every, [speed, "recording.sample_rate_hz=8000"]).read(tmp_path)
    said = channel_findings(first.channels, first.signal, "V")[0]
    rest = Case(columns, [speed, setting(said, "sample_rate_hz", "2000")]).read(tmp_path)
    assert channel_findings(rest.channels, rest.signal, "V") == ()
    assert_is_scan(rest)


# Preparation


def recorded(signal=SIGNAL_V, **facts):
    """The scan's signals or others, at its rate."""
    rows = np.atleast_2d(signal)
    time_s = np.arange(rows.shape[1]) / RATE_HZ
    names = tuple(f"voltage_{index}_V" for index in range(len(rows)))
    return Recording(rows, time_s, np.full(time_s.size, SPEED_M_PER_S), names, facts)


@pytest.mark.parametrize("key", ["high_pass_Hz", "notch_width_Hz"])
def test_the_least_frequency_that_is_offered_is_taken(key):
    facts = {"notch_Hz": 50.0} if key == "notch_width_Hz" else {}
    for samples in (390, 395, 399):
        signal = SIGNAL_V[:, :samples]
        said = refused(lambda s=signal: on_even_times(recorded(s, **facts, **{key: 1.0})))
        least = re.search(r"give at least ([\d.]+)", said)
        assert least
        bound = {key: float(least[1])}
        assert on_even_times(recorded(signal, **facts, **bound)).raw_signal is not None


@pytest.mark.parametrize(
    "facts", [{"detrend": "linear"}, {"high_pass_Hz": 9.0}, {"notch_Hz": 50.0}], ids=str
)
def test_a_filter_is_left_out_and_its_cost_held(facts):
    (said,) = preparation_warnings(recorded(**facts), 100.0)
    key = re.search(r"and (?:give|invert with) recording\.(\w+)", said)
    assert key
    instead = typed(f"recording.{key[1]}=auto")
    recording = on_even_times(recorded(**instead))
    assert preparation_warnings(recording, 100.0) == ()
    np.testing.assert_array_equal(recording.signal, SIGNAL_V)
    assert recording.sidecar == instead


# The command that `inspect_recording` offers next

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
    program, *again = shlex.split(facts["next_command"])
    assert program == "srsinv"
    cfg = composed(*again)
    missing = [0] if case == "times of its own" else []
    assert_is_scan(config.recording(cfg), missing=missing, factor=factor)
    assert cfg["sensor"]["depth_m"] == (0.00125 if "film" in case else None)
    assert cfg["reader"]["_target_"].endswith(".Text" if "film" in case else ".BySuffix")


# Facts of a sidecar


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
