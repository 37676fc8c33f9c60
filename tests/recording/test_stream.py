"""Rows that arrive one by one are the rows of a file."""

import math
import os
from threading import Event

import numpy as np
import pytest

from srsinv.jobs._live_stream import LineSource, SampleStream, _head
from srsinv.recording.stream import RowFormat
from tests.refusals import refused

ROWS = [f"{0.1 * i:g},{0.5 * i:g},{i - 3},{2 * i + 1}\n" for i in range(12)]
HEADING = "time (ms),position (mm),voltage_0_mV,voltage_1_mV\n"
SETTINGS = {"gain": 100.0, "polarity": [1, -1]}


def source_of(lines):
    """Lines in a pipe that has ended."""
    there, here = os.pipe()
    os.write(here, "".join(lines).encode())
    os.close(here)
    return LineSource(there, Event())


def of_lines(lines, **settings):
    """The format of lines, and the samples that a stream takes from them."""
    source = source_of(lines)
    head, every = _head(source)
    rows = RowFormat("lines", [f"{line}\n" for line in head], SETTINGS | settings, {})
    samples = SampleStream(rows)
    parts = list(samples.chunks(every[rows.heading_lines :], source))
    return rows, samples, [np.concatenate([part[i] for part in parts], axis=-1) for i in range(3)]


def test_units_gain_and_polarity_are_applied():
    _, samples, (time_s, x_m, signal) = of_lines([HEADING, *ROWS])
    i = np.arange(12)
    assert samples.bad == 0
    assert np.allclose(time_s, 1e-4 * i)
    assert np.allclose(x_m, 5e-4 * i)
    assert np.allclose(signal, np.array([i - 3, -(2 * i + 1)]) * 1e-3 / 100)


def test_semicolons_and_decimal_commas():
    lines = [each.replace(",", ";").replace(".", ",") for each in [HEADING, *ROWS]]
    _, samples, (time_s, *_) = of_lines(lines)
    assert samples.bad == 0
    assert np.allclose(time_s, 1e-4 * np.arange(12))


def test_a_stated_rate_serves_rows_without_times():
    lines = [line.partition(",")[2] for line in [HEADING, *ROWS]]
    _, _, (time_s, *_) = of_lines(lines, sample_rate_hz=100.0)
    assert np.allclose(time_s, 0.01 * np.arange(12))
    _, _, (time_s, *_) = of_lines([HEADING, *ROWS], sample_rate_hz=100.0)  # of another recording
    assert np.allclose(time_s, 1e-4 * np.arange(12))
    _, _, (time_s, *_) = of_lines([HEADING, *ROWS], sample_rate_hz=100.0, times="ignore")
    assert np.allclose(time_s, 0.01 * np.arange(12))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1,2,3", "cells"),
        ("1,2,3,4,5", "cells"),
        ("1,2,three,4", "three"),
        (",2,3,4", "time"),
        ("1,,3,4", "position"),
        ("1,2,inf,4", "inf"),
    ],
)
def test_a_line_that_is_no_sample(line, words):
    rows, *_ = of_lines([HEADING, *ROWS])
    refused(lambda: rows.sample(line, 0), words)


def test_a_missing_signal_and_an_empty_cell_at_the_end():
    rows, *_ = of_lines([HEADING, *ROWS])
    sample = rows.sample("1,2,,4,", 0)
    assert math.isnan(sample.signal[0])
    assert sample.signal[1] == pytest.approx(-4e-5)


def test_one_wrong_time_and_a_clock_that_begins_anew(capsys):
    """Three samples are lost until the clock is known; then it goes on where it was."""
    wrong = [*ROWS[:6], "900,3,3,13\n", *ROWS[7:]]
    _, samples, (time_s, x_m, _) = of_lines([HEADING, *wrong])
    assert samples.bad == 2
    assert np.all(np.diff(time_s) > 0)
    assert x_m.size == 10
    again = [*ROWS, *ROWS]
    _, samples, (time_s, _, _) = of_lines([HEADING, *again])
    assert samples.bad == 2
    assert np.allclose(np.diff(time_s), 1e-4)
    assert "begin anew" in capsys.readouterr().err


def test_the_end_of_a_line_at_the_beginning():
    """As a port is opened within a line: its row is skipped, and the columns are as named."""
    _, samples, (time_s, *_) = of_lines([HEADING, "5,1,2,3\n", *ROWS])
    assert time_s.size >= 9
    assert np.all(np.diff(time_s) > 0)
    assert samples.bad <= 2


def test_preparations_of_a_whole_recording_are_refused():
    refused(lambda: of_lines([HEADING, *ROWS], detrend="linear"), "detrend", "live")
    refused(lambda: of_lines(["no table\n"]), "rows of numbers")


def test_lines_of_a_pipe(tmp_path):
    """Whole lines, whatever the blocks that they come in; a last one without its end, too."""

    there, here = os.pipe()
    source = LineSource(there, Event())
    os.write(here, b"one\ntw")
    assert source.take() == ["one"]
    os.write(here, b"o\r\nthree")
    os.close(here)
    assert [*source.take(), *source.take(), *source.take()] == ["two", "three"]
    os.close(there)
