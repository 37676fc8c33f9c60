"""Every sentence of advice in the readers, followed: the recording is then read right.

A sentence that is added to the readers needs a row here, or a test in `test_advice_by_hand` that
follows it.
"""

import re

import numpy as np
import pandas as pd
import pytest

from srsinv.recording.formats.text import Text
from tests.recording import test_advice_by_hand as by_hand
from tests.recording import test_disturbances, test_instruments  # noqa: F401  (follow, too)
from tests.recording.advice import (
    POSITION_M,
    SCAN,
    SIGNAL_V,
    TIME_S,
    Case,
    N,
    Row,
    asked,
    assert_right,
    offered,
    pattern,
    renamed,
    scan,
    sentences,
    text_of,
    with_cell,
    without_rows,
)
from tests.recording.files import write_h5, write_npz
from tests.tiers import quick

BARE_TIME = renamed(time_ms="time")
NO_TIME = scan(time_ms=None)
RATE = "recording.sample_rate_hz=2000"
JITTERED = scan(time_ms=1e3 * TIME_S + np.random.default_rng(2).uniform(-0.2, 0.2, N))
OTHERS_MS = scan(time_ms=None, time_s=1e3 * TIME_S)
FRONT = {"front 0": SIGNAL_V[0], "back 1": SIGNAL_V[1]}
UNNAMED = scan(voltage_0_mV=None, voltage_1_V=None, **FRONT)
ALIKE = scan(voltage_0_mV=None, **{"Ch 0 [V]": 9 * SIGNAL_V[0], "ch 0 [mV]": 1e3 * SIGNAL_V[0]})
RAIL = renamed(position_mm="rail")
INCHES = scan(position_mm=None, **{"Stage pos (in)": POSITION_M / 0.0254})
MINUTES = scan(time_ms=None, **{"Time (min)": TIME_S / 60})
TWO_RAILS = scan(position_mm=None, **{"Pos A (mm)": 1e3 * POSITION_M, "Pos B (mm)": 0 * TIME_S})
NO_MOTION = scan(position_mm=None)
HOLE = np.where(np.arange(N) == 7, np.nan, SIGNAL_V[1])
ONE = {"voltage_0_mV": None}
DAY = scan(time_ms=1e3 * TIME_S + np.where(np.arange(N) < 250, 0, 86_400e3))
ONE_OF_TWO = '{"sensor": {"elements": [{}]}}'
LINES = text_of(SCAN).splitlines(keepends=True)


def short(rows):
    """The text with some cells of these rows left out."""
    cut = [",".join(line.split(",")[:2]) + "\n" if i in rows else line
           for i, line in enumerate(LINES)]  # fmt: skip
    return "".join(cut)


def columns_in(sentence):
    """The columns that a sentence lists."""
    return re.search(r"columns (.*?)(:|$)", sentence)[1].split(", ")


def cut_at(sentence):
    """The scan up to the data row that a sentence says to cut it after."""
    row = int(re.search(r"after data row (\d+)", sentence)[1])
    return Case({name: values[:row] for name, values in DAY.items()})


def after(words, sentence):
    """The name after these words of a sentence."""
    return re.search(rf"{words}([\w.]+\w)", sentence)[1]


def nearest(sentence):
    """What a sentence says is nearest."""
    return after("the nearest is ", sentence)


def suffix_of_hdf5(sentence):
    """A file's name with one of the suffixes that a sentence lists."""
    return f"r{re.search('[.]hdf5', sentence)[0]}"


COLUMNS = [
    Row("may be any of the columns {}: give the whole name",
        Case(ALIKE, ["recording.channels=[CH 0]"]),
        lambda s: Case(ALIKE, [f"recording.channels=['{columns_in(s)[1]}']"])),
    Row("may be any of the columns {}: name one by recording.", Case(TWO_RAILS),
        lambda s: Case(TWO_RAILS, [asked(s, "position_column", f"'{columns_in(s)[0]}'")])),
    Row("may be any of the columns {}: name one by recording.",
        Case(renamed(time_ms="Time A (ms)") | {"Time B (ms)": 2 * TIME_S}),
        lambda s: Case(renamed(time_ms="Time A (ms)") | {"Time B (ms)": 2 * TIME_S},
                       [asked(s, "time_column", "Time A")])),
    Row("name the signals by recording.channels=[...]", Case(UNNAMED),
        lambda s: Case(UNNAMED, [asked(s, "channels", f"[{','.join(columns_in(s)[-2:])}]")]),
        unit="counts"),
    Row("and there is no column {} among", Case(RAIL, ["recording.position_column=stage"]),
        lambda s: Case(RAIL, ["recording.position_column=rail", "recording.position_unit=mm"])),
    Row("the columns are {}: name one of them", Case(SCAN, ["recording.channels=[voltage_0]"]),
        lambda s: Case(SCAN, [f"recording.channels=[{nearest(s)}]"])),
]  # fmt: skip

BLANK = [*LINES[:3], "\n\n", *LINES[5:]]  # two rows of the scan, which are then missing


def changed(row, old, new):
    """The text with blank rows and a change in the data row of this number."""
    lines = "".join(BLANK).splitlines(keepends=True)
    return Case(text="".join([*lines[:row], lines[row].replace(old, new), *lines[row + 1 :]]))


def mended(trouble):
    """What puts a number back into the data row that a sentence names, as the file has it."""

    def follow(sentence):
        row = int(re.search(r"data row (\d+)", sentence)[1])
        lines = trouble.text.splitlines(keepends=True)
        return Case(text="".join([*lines[:row], LINES[row], *lines[row + 1 :]]))

    return follow


WORD, BACK, FAR = (changed(9, LINES[9].split(",")[at] + ",", new)
                   for at, new in ((2, "x,"), (0, "0.25,"), (1, "1e30,")))  # fmt: skip
BLANKS = [
    Row("correct it, or leave the row out", WORD, mended(WORD), missing=[2, 3]),
    Row("time must increase strictly", BACK, mended(BACK), missing=[2, 3]),
    Row("beyond {}: correct the value or its unit", FAR, mended(FAR), missing=[2, 3]),
]
TIMES = [
    Row("give recording.times=ignore and recording.sample_rate_hz=...", Case(JITTERED),
        lambda s: Case(JITTERED, [offered(s, "times"), asked(s, "sample_rate_hz", "2000")])),
    Row("leave sample_rate_hz out, as the stamps are used",
        Case(SCAN, ["recording.sample_rate_hz=1000"]), Case(SCAN)),
    Row("leave sample_rate_hz out, as the stamps are used",
        Case(BARE_TIME, [RATE, "recording.time_unit=s"]),
        lambda s: Case(BARE_TIME, [RATE, asked(s, "time_unit", "ms")])),
    Row("leave sample_rate_hz out, as the stamps are used", Case(OTHERS_MS, [RATE]),
        Case(SCAN, [RATE])),
    Row("leave sample_rate_hz out, as the stamps are used",
        Case(scan(time_ms=3e3 * TIME_S), [RATE]),
        lambda s: Case(scan(time_ms=3e3 * TIME_S), [RATE, offered(s, "times")])),
    Row("cut the recording at its", Case(DAY), cut_at, rows=slice(250)),
    Row("leaves the times out: give", Case(SCAN, ["recording.times=ignore"]),
        lambda s: Case(SCAN, [offered(s, "times"), asked(s, "sample_rate_hz", "2000")])),
    Row("there is no time column", Case(NO_TIME),
        lambda s: Case(NO_TIME, [asked(s, "sample_rate_hz", "2000")])),
    Row("there is no time column", Case(NO_TIME), Case(NO_TIME | {"time_s": TIME_S})),
    Row("time must increase strictly", Case(with_cell("time_ms", 7, 3.0)),
        Case(without_rows(7)), missing=[7]),
    Row("time must increase strictly",
        Case({name: np.concatenate([v[100:], v[:100]]) for name, v in SCAN.items()}), Case(SCAN)),
    Row("time must increase strictly", Case(scan(time_ms=np.round(1e3 * TIME_S))), Case(SCAN)),
    Row("comes {} s after data row {}, less than", Case(scan(time_ms=1e-17 * np.arange(N))),
        Case(SCAN)),
    Row("too few samples", Case({name: v[:2] for name, v in SCAN.items()}), Case(SCAN)),
]  # fmt: skip

UNITS = [
    Row("convert the column to one of them",
        Case(MINUTES), Case(scan(time_ms=None, time_s=TIME_S))),
    Row("convert the column to one of them", Case(INCHES, ["recording.position_column=Stage pos"]),
        Case(SCAN)),
    Row("only if it is one of them by another name",
        Case(renamed(time_ms="Time [millis]")),
        lambda s: Case(renamed(time_ms="Time [millis]"), [asked(s, "time_unit", "ms")])),
    Row("if the column's name is wrong, rename it", Case(SCAN, ["recording.position_unit=um"]),
        Case(SCAN)),
    Row("is not stated: give it by", Case(RAIL, ["recording.position_column=rail"]),
        lambda s: Case(RAIL, ["recording.position_column=rail", asked(s, "position_unit", "mm")])),
    Row("is not stated: give it by", Case(BARE_TIME),
        lambda s: Case(BARE_TIME, [asked(s, "time_unit", "ms")])),
]  # fmt: skip

DATES = pd.Timestamp("2025-02-11") + pd.to_timedelta(TIME_S, "s")
JOINED = renamed(time_ms="time") | {"time": DATES.strftime("%Y%m%d_%H%M%S_%f").to_list()}
BARE_THOUSANDS = with_cell("voltage_0_mV", 7, '"1,234.5"')
TIMES_APART = "time_ms,voltage_0_mV,time_ms,position_mm,voltage_1_V\n" + "".join(
    f"{a},{b},{a + 0.4 * (i % 2) + 5},{c},{d}\n"
    for i, (a, c, b, d) in enumerate(zip(*SCAN.values(), strict=True))
)
IN_WORDS = [
    Row("or, only where no row is lost, give", Case(JOINED),
        lambda s: Case(JOINED, [offered(s, "times"), asked(s, "sample_rate_hz", "2000")])),
    Row("or, only where no row is lost, give", Case(JOINED),
        Case(scan(time_ms=None) | {"time": DATES.strftime("%Y-%m-%dT%H:%M:%S.%f").to_list()})),
    Row("write the numbers with a point for decimals", Case(BARE_THOUSANDS), Case(SCAN)),
    Row("write one column of times for all columns", Case(text=TIMES_APART), Case(SCAN)),
]  # fmt: skip

MOTION = [
    Row("no speed: there is no column", Case(NO_MOTION),
        lambda s: Case(NO_MOTION, [asked(s, "speed_m_per_s", "0.02")])),
    Row("no speed: there is no column", Case(NO_MOTION), Case(SCAN)),
    Row("no speed: there is no column", Case(NO_MOTION),
        Case(NO_MOTION | {"speed_m_per_s": np.full(N, 0.02)})),
    Row("the speed is 0, so no surface", Case(scan(position_mm=0 * TIME_S)),
        lambda s: Case(scan(position_mm=0 * TIME_S), [asked(s, "speed_m_per_s", "0.02")])),
    Row("beyond {}: correct the value or its unit", Case(with_cell("position_mm", 7, 1e30)),
        Case(without_rows(7)), missing=[7]),
    Row("beyond {}: correct the value or its unit", Case(with_cell("position_mm", 7, 1e30)),
        Case(SCAN)),
]  # fmt: skip

VALUES = [
    Row("correct it, or leave the row out", Case(with_cell("voltage_1_V", 7, "o.1")), Case(SCAN)),
    Row("correct it, or leave the row out", Case(with_cell("voltage_1_V", 7, "nan")),
        Case(without_rows(7)), missing=[7]),
    Row("correct it, or leave the row out", Case(with_cell("voltage_1_V", 7, "nan", **ONE)),
        lambda s: Case(with_cell("voltage_1_V", 7, "", **ONE), [offered(s, "missing")]),
        missing=[7]),
    Row("correct it, or leave the row out",
        Case(scan(voltage_1_V=HOLE, **ONE), name="r.npz", write=write_npz),
        lambda s: Case(scan(voltage_1_V=HOLE, **ONE), [offered(s, "missing")],
                       name="r.npz", write=write_npz),
        missing=[7]),
    Row("the columns differ in length",
        Case(scan(voltage_1_V=SIGNAL_V[1][:-1]), name="r.npz", write=write_npz),
        Case(name="r.npz", write=write_npz)),
    Row("store it as a 1-D array", Case(scan(time_ms=TIME_S[None]), name="r.npz", write=write_npz),
        Case(name="r.npz", write=write_npz)),
    Row("numbers for {} signal columns: give one number", Case(SCAN, ["recording.gain=[1,2,3]"]),
        Case(SCAN, ["recording.gain=[4,4]"]), factor=0.25),
    Row("numbers for {} signal columns: give one number", Case(SCAN, ["recording.polarity=[-1]"]),
        Case(SCAN, ["recording.polarity=-1"]), factor=-1),
    Row("samples that are there, where at least",
        Case(scan(voltage_1_V=[0.5, *[""] * (N - 1)]), ["recording.missing=allow"]),
        lambda s: Case(scan(voltage_1_V=[0.5, *[""] * (N - 1)]),
                       [asked(s, "channels", "[voltage_0_mV]")])),
    Row("once divided by its gain, beyond", Case(SCAN, ["recording.gain=1e-20"]),
        lambda s: Case(SCAN, [asked(s, "gain", "0.25")]), factor=4),
    Row("is named twice", Case(SCAN, ["recording.channels=[voltage_0_mV,voltage_0_mV]"]),
        Case(SCAN, ["recording.channels=[voltage_0_mV]"])),
    Row("cannot name a channel",
        Case(scan(time_ms=None, time_s=TIME_S), ["recording.channels=[time_s]"]),
        Case(scan(time_ms=None, time_s=TIME_S), ["recording.channels=[voltage_1_V]"])),
    Row("no column holds a number", Case({"a": ["x"] * 5}, inspected=True), Case(SCAN)),
]  # fmt: skip

SIDECARS = [
    Row("there is no key {}", Case(sidecar="polarty: -1"),
        lambda s: Case(sidecar=f"{nearest(s)}: -1"), factor=-1),
    Row("there is no key {}", Case(sidecar="weather: fine"),
        lambda s: Case(sidecar=f"{after('goes into ', s)}: 'weather: fine'")),
    Row("is expected: correct it", Case(sidecar="gain: four"), Case(sidecar="gain: 4"),
        factor=0.25),
    Row("is expected: correct it", Case(sidecar="gain: four"),
        lambda s: Case(sidecar="gain: four", settings=[asked(s, "gain", "4")]), factor=0.25),
    Row("is expected: correct it", Case(sidecar="sensor: {elements: [{offset_m: near}, {}]}"),
        Case(sidecar="sensor: {elements: [{offset_m: 0.0}, {}]}")),
    Row("cannot be a key", Case(sidecar='"a\\u0007": 1'), Case(sidecar="gain: 1")),
    Row("name one by recording.sidecar=FILE",
        Case(beside={"r.json": '{"gain": 4}', "r.yaml": "gain: 5"}),
        lambda s: Case(settings=[asked(s, "sidecar", "{folder}/r.json")],
                       beside={"r.json": '{"gain": 4}', "r.yaml": "gain: 5"}),
        factor=0.25),
    Row("a sidecar ends in", Case(settings=["recording.sidecar={folder}/r.txt"],
                                  beside={"r.txt": "gain: 4"}),
        Case(settings=["recording.sidecar={folder}/s.yaml"], beside={"s.yaml": "gain: 4"}),
        factor=0.25),
    Row("this sidecar is not UTF-8", Case(beside={"r.yaml": "description: µ".encode("latin-1")}),
        Case(sidecar="description: µ\ngain: 4"), factor=0.25),
    Row("correct the sidecar's", Case(sidecar="gain: 1\ngain: 4"), Case(sidecar="gain: 4"),
        factor=0.25),
    Row("correct the sidecar's", Case(beside={"r.json": '{"gain": 4'}),
        Case(beside={"r.json": '{"gain": 4}'}), factor=0.25),
    Row("where a mapping of names to values", Case(sidecar="4"), Case(sidecar="gain: 4"),
        factor=0.25),
    Row("give one element for each", Case(sidecar=ONE_OF_TWO),
        Case(sidecar='{"sensor": {"elements": [{}, {}]}}')),
    Row("give one element for each", Case(sidecar=ONE_OF_TWO),
        lambda s: Case(sidecar=ONE_OF_TWO, settings=[asked(s, "channels", "[voltage_1_V]")])),
]  # fmt: skip

FILES = [
    Row("there is no such {}", Case(settings=["recording.sidecar={folder}/s.yaml"],
                                    beside={"ss.yaml": "gain: 4"}),
        lambda s: Case(
            settings=[f"recording.sidecar={{folder}}/{after('did you mean ', s)}"],
            beside={"ss.yaml": "gain: 4"},
        ), factor=0.25),
    Row("did you mean", Case(settings=["recording.path={folder}/rr.csv"]),
        lambda s: Case(settings=[f"recording.path={{folder}}/{after('did you mean ', s)}"])),
    Row("{} is empty: record or copy it again", Case(text=""), Case(SCAN)),
    Row("a recording cannot be read from suffix", Case(name="r.dat"), Case(name="r.csv")),
    Row("a recording cannot be read from suffix", Case(name="r.dat"),
        Case(name="r.dat", reader=Text())),
    Row("the file cannot be read as", Case(name="r.csv", write=write_h5),
        lambda s: Case(name=suffix_of_hdf5(s), write=write_h5)),
    Row("there is no table", Case(text="\n# of today\n"),
        Case(text="time_ms,position_mm,voltage_0_mV,voltage_1_V\n" + "".join(LINES[1:]))),
    Row("give every column its own name", Case(text="time_ms,voltage_0_mV," + "".join(LINES)[8:]),
        Case(SCAN)),
    Row("close every quotation mark", Case(text=LINES[0] + '"' + "".join(LINES[1:]) * 8),
        Case(SCAN)),
    Row("where the header names {} columns", Case(text=short({8})), Case(SCAN)),
    Row("where the header names {} columns", Case(text=short({8})), Case(without_rows(7)),
        missing=[7]),
    Row("the file names {} columns or more", Case(scan(**{f"c{i}": TIME_S for i in range(1000)})),
        Case(SCAN)),
    Row("characters long, beginning with", Case(scan(**{"a" * 201: TIME_S})),
        Case(scan(**{"a" * 200: TIME_S}))),
    Row("which cannot be printed", Case(scan(**{"a\x07": TIME_S})), Case(scan(a=TIME_S))),
]  # fmt: skip
ROWS = [*BLANKS, *COLUMNS, *TIMES, *UNITS, *IN_WORDS, *MOTION, *VALUES, *SIDECARS, *FILES]


@pytest.mark.parametrize(
    "number", quick(range(len(ROWS)), *range(0, len(ROWS), 3)), ids=[row.says for row in ROWS]
)
def test_advice_that_is_followed_gives_the_scan(tmp_path, number):
    row = ROWS[number]
    sentence = row.trouble.refused(tmp_path)
    assert pattern(row.says).search(sentence), sentence
    assert_right(row.follow(sentence).read(tmp_path), row)


# Sentences that advise nothing.
NO_ADVICE = ("What srsinv has to be told of", "What only the experimenter", "stated: V, mV")


def test_every_sentence_of_advice_is_followed():
    said = {*(row.says for row in ROWS), *by_hand.FOLLOWED, *NO_ADVICE}
    source = dict(sentences())
    assert {where: text for where, text in source.items() if not _names(text, said)} == {}
    unsaid = {part for part in said if not any(part in text for text in source.values())}
    assert unsaid == set()


def _names(text, said):
    return any(part in text for part in said)
