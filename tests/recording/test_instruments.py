"""Files as instruments and programs write them: one scan in the words of each, read as it was.

The scan is the one of `advice`; a writer gives its text, or writes its file. What a file states of
its numbers (start, interval, unit, scale) is used; where it cannot be, it is refused.
"""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr
from nptdms import ChannelObject, RootObject, TdmsWriter

from srsinv.errors import BadInput
from srsinv.recording import Recording
from srsinv.recording.even import load_even, usable
from srsinv.recording.inspection import inspect
from tests.recording.advice import (
    POSITION_M,
    RATE_HZ,
    SIGNAL_V,
    SPEED_M_PER_S,
    TIME_S,
    N,
    follows,
)

STEP_S = 1 / RATE_HZ
A, B = SIGNAL_V
MM = 1e3 * POSITION_M
MOVING = {"speed_m_per_s": SPEED_M_PER_S, "scan_start_m": float(POSITION_M[0])}


def table(*columns, delimiter=",", end="", form="{!r}"):
    """Rows of numbers, with what a writer leaves at the end of each."""
    rows = zip(*(np.asarray(c, object) for c in columns), strict=True)
    cells = ([each if isinstance(each, str) else form.format(float(each)) for each in row]
             for row in rows)  # fmt: skip
    return "".join(delimiter.join(row) + end + "\n" for row in cells)


def labview(x0=("0.0", "0.0", "0.0"), end=""):
    """A LabVIEW measurement file, whose rows have no cell for a comment, or an empty one."""
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "X_Columns\tOne\nTime_Pref\tRelative\nDate\t2025/02/11\nTime\t10:11:12.5\n"
        "***End_of_Header***\t\n\t\nChannels\t3\t\t\t\nSamples\t400\t400\t400\t\n"
        "Y_Unit_Label\tVolts\tVolts\tmm\t\nX_Dimension\tTime\tTime\tTime\t\n"
        f"X0\t{x0[0]}\t{x0[1]}\t{x0[2]}\t\nDelta_X\t0.0005\t0.0005\t0.0005\t\n"
        "***End_of_Header***\t\t\t\t\nX_Value\tDev1/ai0\tDev1/ai1\tPosition\tComment\n"
    )
    return head + table(TIME_S, A, B, MM, delimiter="\t", end=end)


def tektronix():
    """The older way of Tektronix: the preamble stands beside the first rows' cells."""
    return (
        "Model,TDS2024\nFirmware Version,22.0\n\nRecord Length,400,Points\n"
        f"Sample Interval,{STEP_S!r},s\nVertical Units,V,V\nHorizontal Units,s\n\nTIME,CH1,CH2\n"
        + table(TIME_S, A, B)
    )


def labview_multi(second=TIME_S):
    """One in which each channel has a column of times of its own (X_Columns: Multi)."""
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "Multi_Headings\tYes\nX_Columns\tMulti\nTime_Pref\tRelative\n***End_of_Header***\t\n\t\n"
        "Channels\t3\t\t\t\t\t\nSamples\t400\t\t400\t\t400\t\n"
        "Y_Unit_Label\tVolts\t\tVolts\t\tmm\t\nX_Dimension\tTime\t\tTime\t\tTime\t\n"
        f"X0\t0.0\t\t{float(second[0])}\t\t0.0\t\nDelta_X\t0.0005\t\t0.0005\t\t0.0005\t\n"
        "***End_of_Header***\t\t\t\t\t\t\n"
        "X_Value\tDev1/ai0\tX_Value\tDev1/ai1\tX_Value\tPosition\tComment\n"
    )
    return head + table(TIME_S, A, second, B, TIME_S, MM, delimiter="\t", end="\t")


def tektronix_blocks(second=TIME_S, units="Vertical Units,V,,Vertical Units,V\n"):
    """A block of times and numbers for each channel, an empty column between them."""
    head = (
        "Model,MSO58,,Model,MSO58\nLabel,,,Label,\nWaveform Type,ANALOG,,Waveform Type,ANALOG\n"
        "Horizontal Units,s,,Horizontal Units,s\nSample Interval,0.0005,,Sample Interval,0.0005\n"
        f"Record Length,400,,Record Length,400\n{units}TIME,CH1,,TIME,CH2\n"
    )
    return head + table(TIME_S, A, [""] * N, second, B)


def stamps(form, start="2025-02-11T23:59:59.900", step=1.0):
    """Time stamps, in words, from half a second before midnight on."""
    return [f"{pd.Timestamp(start) + pd.Timedelta(seconds=t):{form}}" for t in step * TIME_S]


def dated(form, known=MOVING, **changes):
    """A scan with time stamps in words."""
    return "Time,Ch 0 [V],Ch 1 [V]\n" + table(stamps(form, **changes), A, B), known


def scan_text(delimiter=",", after_header="", inside="", end=""):
    """The scan with lines below its header, after 100 rows and at its end."""
    rows = table(TIME_S, POSITION_M, A, B, delimiter=delimiter).splitlines(keepends=True)
    head = delimiter.join(["time_s", "position_m", "voltage_0_V", "voltage_1_V"]) + "\n"
    return "".join([head, after_header, *rows[:100], inside, *rows[100:], end])


def r_table(delimiter=" "):
    """As R's write.table leaves it: rows have names, for which the header has no cell."""
    head = delimiter.join(['"time_s"', '"position_m"', '"voltage_0_V"', '"voltage_1_V"'])
    labels = [f'"{row}"' for row in range(1, N + 1)]
    return f"{head}\n" + table(labels, TIME_S, POSITION_M, A, B, delimiter=delimiter)


def rigol(end=","):
    units = f"Sequence,Volt,Volt,-7.5e-01,{STEP_S!r}\n"
    return "X,CH1,CH2,Start,Increment,\n" + units + table(np.arange(N), A, B, end=end)


def keysight():
    return "x-axis,1,2\nsecond,Volt,Volt\n" + table(TIME_S - 0.1, A, B)


def picoscope():
    return "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n" + table(1e3 * TIME_S, A, 1e3 * B)


def lecroy():
    return "LECROYWS64,12345\nSegments,1\nTime,Ampl,Ampl 2\n" + table(TIME_S, A, B)


def siglent():
    return "Source,CH1,CH2\nSecond,Volt,Volt 2\n" + table(TIME_S, A, B)


def excel():
    commas = table(1e3 * TIME_S, MM, A, B, delimiter=";").replace(".", ",")
    return "sep=;\nTime (ms);Pos (mm);Ch 0 [V];Ch 1 [V]\n" + commas


def savetxt(header="time_s position_m voltage_0_V voltage_1_V", comment="# ", delimiter=" "):
    rows = table(TIME_S, POSITION_M, A, B, delimiter=delimiter, form="{:.18e}")
    return f"{comment}{header}\n{rows}" if header else rows


# name: (text, what is said of it when it is read)
TEXTS: dict[str, tuple[str | bytes, dict]] = {
    "LabVIEW": (labview(), {}),
    "LabVIEW, empty comments": (labview(end="\t"), {}),
    "Tektronix": (tektronix(), MOVING),
    "Rigol": (rigol(), MOVING),
    "Rigol, two delimiters": (rigol(",,"), MOVING),
    "Keysight": (keysight(), MOVING),
    "PicoScope": (picoscope(), MOVING),
    "LeCroy": (lecroy(), MOVING | {"time_unit": "s", "signal_unit": "V"}),
    "Siglent": (siglent(), MOVING | {"time_unit": "s", "signal_unit": "V"}),
    "Excel, decimal commas": (excel(), {}),
    "units of other quantities in the row of units": (
        "Time,Ch0,Ch1,Pos,Temp,Load\ns,V,V,mm,degC,N\n"
        + table(TIME_S, A, B, MM, 20 + TIME_S, 3 + TIME_S), {}),
    "units behind a stroke": ("Time / s,Ch 0 / V,Ch 1 / mV\n" + table(TIME_S, A, 1e3 * B), MOVING),
    "an index without a name": (
        ",Pos (mm),Ch 0 [V],Ch 1 [V]\n" + table(stamps("%Y-%m-%d %H:%M:%S.%f"), MM, A, B), {}),
    "a clock of whole seconds beside times": (
        "Time,t (s),Ch 0 [V],Ch 1 [V]\n" + table(stamps("%H:%M:%S"), TIME_S, A, B), MOVING),
    "decimal commas between spaces": (
        "time_s position_m voltage_0_V voltage_1_V\n"
        + table(TIME_S, POSITION_M, A, B, delimiter=" ").replace(".", ","), {}),
    "one name in volts does not hide another": (
        "time_s,position_m,voltage_0_V,Ch 1 [V]\n" + table(TIME_S, POSITION_M, A, B), {}),
    "thousands in a stated rate": (
        '# Sample rate: 2,000 Hz\nCh 0 [V]\tCh 1 [V]\n' + table(A, B, delimiter="\t"), MOVING),
    "savetxt": (savetxt(), {}),
    "savetxt, aligned": (
        "  ".join(["time_s", "position_m", "voltage_0_V", "voltage_1_V"])
        + "\n"
        + table(TIME_S, POSITION_M, A, B, delimiter="   ", form="{:25.17e}"),
        {},
    ),
    "savetxt with commas": (savetxt("time_s,position_m,voltage_0_V,voltage_1_V", "# ", ","), {}),
    "no header": (
        savetxt(""),
        {"time_column": "column_1", "time_unit": "s", "position_column": "column_2",
         "position_unit": "m", "channels": ["column_3", "column_4"], "signal_unit": "V"},
    ),
    "delimiters at the ends of rows": (
        "time_s,position_m,voltage_0_V,voltage_1_V\n" + table(TIME_S, POSITION_M, A, B, end=","),
        {},
    ),
    "a delimiter at the end of the header": (
        "time_s,position_m,voltage_0_V,voltage_1_V,\n" + table(TIME_S, POSITION_M, A, B),
        {},
    ),
    "rate in the preamble": (
        ";Tool: scope\n;Sample rate,2 kHz\nCH1(V),CH2(V),Position(mm)\n" + table(A, B, MM),
        {},
    ),
    "interval in the preamble": (
        "Date: today\nSampling interval (ms): 0.5\nCH1(V);CH2(V);Pos (mm)\n"
        + table(A, B, MM, delimiter=";"),
        {},
    ),
    "UTF-16": (("Time (ms),X [µm],Ch 0 [V],Ch 1 [V]\n" + table(1e3 * TIME_S, 1e3 * MM, A, B))
               .encode("utf-16"), {}),
    "Latin-1": (("Time (µs),Ch 0 [V],Ch 1 [V]\n" + table(1e6 * TIME_S, A, B)).encode("latin-1"),
                MOVING),
    "ISO stamps": ("time,Ch 0 [V],Ch 1 [V]\n" + table(stamps("%Y-%m-%dT%H:%M:%S.%f"), A, B),
                   MOVING),
    "dates and times": ("Date/Time;Ch 0 [V];Ch 1 [V]\n"
                        + table(stamps("%d.%m.%Y %H:%M:%S,%f"), A, B, delimiter=";")
                        .replace(".1", ".1"), MOVING | {"time_column": "Date/Time"}),
    "clock past midnight": ("Time (hh:mm:ss),Ch 0 [V],Ch 1 [V]\n"
                            + table(stamps("%H:%M:%S.%f"), A, B), MOVING),
    "nanoseconds": ("Time (ns),Ch 0 [V],Ch 1 [V]\n" + table(1e9 * TIME_S, A, B), MOVING),
    "microseconds that wrap": (
        "Time (us),Ch 0 [V],Ch 1 [V]\n"
        + table((2**32 - 50_000 + np.round(1e6 * TIME_S)) % 2**32, A, B), MOVING),
    "milliseconds of 16 bits": (
        "Time (ms),Ch 0 [V],Ch 1 [V]\n"
        + table((65_500 + 2e3 * TIME_S) % 2**16 / 2, A, B), MOVING),
    "an encoder that wraps": (
        "Time (ms),encoder (um),Ch 0 [V],Ch 1 [V]\n"
        + table(1e3 * TIME_S, (63_000 + 1e3 * MM + 2**15) % 2**16 - 2**15, A, B),
        {}),
    "any name in volts": (
        "Time (ms),X [V],Encoder side film [V],Stage pos (mm)\n" + table(1e3 * TIME_S, A, B, MM),
        {}),
    "LabVIEW, times for each channel": (labview_multi(), {}),
    "Tektronix, a block for each channel": (tektronix_blocks(), MOVING),
    "Tektronix, times for each channel": (
        "TIME,CH1,TIME,CH2\n" + table(TIME_S, A, TIME_S, B),
        MOVING | {"time_unit": "s", "signal_unit": "V"}),
    "Rigol, the unit at the name": ("Time(s),CH1V,CH2V\n" + table(TIME_S, A, B), MOVING),
    "Rigol, the increment in the header": (
        "CH1V,CH2mV,t0 =-7.5e-01s, tInc = 5e-04,\n" + table(A, 1e3 * B, end=","), MOVING),
    "Rigol, brackets": ("Time(s),CH1(V),CH2(V)\n" + table(TIME_S, A, B), MOVING),
    "descriptions below the units": (
        "Time,Ch0,Ch1,Pos\ns,V,V,mm\nsince the start,front film,back film,\n"
        + table(TIME_S, A, B, MM), {}),
    "units above the names": (
        "s,V,V,mm\nTime,Ch0,Ch1,Pos\n" + table(TIME_S, A, B, MM), {}),
    "MATLAB's dates": dated("%d-%b-%Y %H:%M:%S.%f"),
    "dates with a month's name": dated('"%b %d, %Y %H:%M:%S.%f"'),
    "dates with a day's name": dated('"%a, %d %b %Y %H:%M:%S.%f"'),
    "dates with two digits of the year": dated("%d-%b-%y %H:%M:%S.%f"),
    "numbered times of each channel": (
        "Time 1 (s),Ch 0 [V],Time 2 (s),Ch 1 [V]\n" + table(TIME_S, A, TIME_S, B), MOVING),
    "dates of the United States": dated("%m/%d/%Y %I:%M:%S.%f %p"),
    "dates with strokes": dated("%Y/%m/%d %H:%M:%S.%f"),
    "milliseconds behind a colon": (
        "Time,Ch 0 [V],Ch 1 [V]\n"
        + table([each[:-3] for each in stamps("%H:%M:%S:%f", step=2.0)], A, B),
        {**MOVING, "times": "ignore", "sample_rate_hz": RATE_HZ}),
    "dates in a column of their own": (
        "Date,Time,Ch 0 [V],Ch 1 [V]\n"
        + table(stamps("%d/%m/%Y"), stamps("%H:%M:%S.%f"), A, B), MOVING),
    "Ctrl-Z at the end": (scan_text(end="\x1a"), {}),
    "zeros at the end": (scan_text(end="\0" * 3000), {}),
    "comments of several kinds": (
        scan_text(after_header="# 1,2,3,4\n#\n! V\n", inside="%% a,b\n", end="// end"), {}),
    "a comment below the header": (scan_text(after_header="# by me, in the lab\n"), {}),
    "a comment between rows": (scan_text(inside="// it slipped\n"), {}),
    "a comment with a semicolon": (scan_text("\t", after_header="; by me\n"), {}),
    "a comment at the end": (scan_text(" ", end="% all of it\n"), {}),
    "units as a comment": ("Time,Ch0,Ch1,Pos\n# s,V,V,mm\n" + table(TIME_S, A, B, MM), {}),
    "a rate as a comment": (
        "Pos (mm),CH1(V),CH2(V)\n# Sample rate: 2 kHz\n" + table(MM, A, B), {}),
    "R": (r_table(), {}),
    "R, with commas": (r_table(","), {}),
    "temperature called T": (
        "T (degC),t (s),Ch 0 [V],Ch 1 [V],y pos (mm),Stage pos (mm)\n"
        + table(21 + TIME_S, TIME_S, A, B, 0 * MM, MM), {}),
}  # fmt: skip


def assert_is_scan(recording: Recording) -> None:
    """The scan's signals, intervals and motion; its origins may be others."""
    np.testing.assert_allclose(recording.signal, SIGNAL_V, rtol=1e-12)
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=2e-7)
    np.testing.assert_allclose(
        recording.position_m - recording.position_m[0], POSITION_M - POSITION_M[0], atol=1e-8
    )
    assert recording.signal_unit == "V"


@follows("No line names the columns", "as a counter of {} bits does",
         "The table is read without", "The {} columns {} are equal")  # fmt: skip
@pytest.mark.parametrize("case", TEXTS)
def test_text_of_instruments(tmp_path, case):
    text, known = TEXTS[case]
    path = tmp_path / "r.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    recording = load_even({"path": str(path), **known}, {})
    assert_is_scan(recording)
    inspection = inspect(path, **known)
    assert inspection.refusal is None
    assert inspection.doubts == ()


@follows("Line {} names the columns")
def test_the_line_of_the_header_is_said(tmp_path):
    (tmp_path / "r.txt").write_text(labview())
    assert any("Line 18 names" in note for note in inspect(tmp_path / "r.txt").notes)


# Files of numbers: each writes the scan, and states its times, units or scales by itself.


def late_stage(path: Path) -> None:
    """A stage that starts 50 samples after the films, at a tenth of their rate."""
    films = {"wf_increment": STEP_S, "wf_start_offset": 0.0, "unit_string": "V"}
    stage = {"wf_increment": 10 * STEP_S, "wf_start_offset": 50 * STEP_S, "unit_string": "mm"}
    with TdmsWriter(path) as file:
        file.write_segment([
            ChannelObject("scan", "Ch 0", A, films), ChannelObject("scan", "Ch 1", B, films),
            ChannelObject("scan", "Stage pos", MM[50::10], stage),
        ])  # fmt: skip


def scaled(words: tuple[str, str]) -> Callable[[Path], None]:
    """Whole numbers, whose scale and offset are attributes."""

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, values in (("Ch 0", A), ("Ch 1", B)):
                file[name] = np.round(values / 1e-6).astype(np.int32) + 7
                file[name].attrs.update({words[0]: 1e-6, words[1]: -7e-6, "units": "V"})
            file["position"] = MM
            file["position"].attrs["units"] = "mm"
            file.attrs["sampling_rate"] = RATE_HZ

    return write


def moments(path: Path) -> None:
    index = pd.Timestamp("2025-02-11T10:00") + pd.to_timedelta(TIME_S, "s")
    frame = pd.DataFrame({"Ch 0 [V]": A, "Ch 1 [V]": B, "pos_mm": MM}, index)
    frame.to_parquet(path)


def since(path: Path) -> None:
    time = ("n", np.round(1e6 * TIME_S).astype(np.int64), {"units": "us since 2025-02-11 10:00"})
    ch = [("n", values, {"units": "V"}) for values in (A, B)]
    file = xr.Dataset({"time": time, "Ch 0": ch[0], "Ch 1": ch[1], "x": ("n", MM, {"units": "mm"})})
    file.to_netcdf(path, engine="h5netcdf")


def struct(path: Path) -> None:
    fields = {"time_s": TIME_S, "position_m": POSITION_M, "voltage_0_V": A, "voltage_1_V": B}
    scipy.io.savemat(path, {"recording": fields})


def scope(path: Path) -> None:
    one = {"Tinterval": STEP_S, "Tstart": -0.1, "Length": N}
    scipy.io.savemat(path, {"A": A[:, None], "B": B[:, None], **one})


def rate_beside(path: Path) -> None:
    np.savez(path, voltage_0_V=A, voltage_1_V=B, position_m=POSITION_M, fs=RATE_HZ)


FILES: dict[str, tuple[Callable[[Path], None], str, dict]] = {
    "scale_factor": (scaled(("scale_factor", "add_offset")), "r.h5", {}),
    "conversion": (scaled(("conversion", "offset")), "r.h5", {}),
    "dates of pandas": (moments, "r.parquet", {}),
    "netCDF, us since": (since, "r.nc", {}),
    "MATLAB struct": (struct, "r.mat", {}),
    "PicoScope's MATLAB": (scope, "r.mat", MOVING | {"signal_unit": "V"}),
    "rate in an array of its own": (rate_beside, "r.npz", {}),
}


@pytest.mark.parametrize("case", FILES)
def test_files_that_state_their_times_and_scales(tmp_path, case):
    write, name, known = FILES[case]
    write(tmp_path / name)
    recording = load_even({"path": str(tmp_path / name), **known}, {})
    whole = np.round(SIGNAL_V, 6) if "r.h5" in name else SIGNAL_V
    np.testing.assert_allclose(recording.signal, whole, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=1e-9)
    np.testing.assert_allclose(recording.position_m, POSITION_M, atol=1e-9)


@follows("begins {} s after the first signal", "has an interval of {} s, by the file")
def test_columns_are_aligned_by_their_starts_and_intervals(tmp_path):
    late_stage(tmp_path / "r.tdms")
    recording = load_even({"path": str(tmp_path / "r.tdms")}, {})
    kept = slice(50, 50 + recording.time_s.size)
    assert recording.time_s.size == N - 50 - 9  # to the stage's last report
    np.testing.assert_array_equal(recording.signal, SIGNAL_V[:, kept])
    np.testing.assert_allclose(recording.position_m, POSITION_M[kept], atol=1e-9)
    assert any("aligned by their starts" in note for note in recording.notes)


def in_pairs(second, names="Time (s),Ch 0 [V],time (s),Ch 1 [V]"):
    """A column of times for each channel, in a table without a preamble."""
    return f"{names}\n" + table(TIME_S, A, second, B)


def in_milliseconds(second):
    """The second channel's times are in milliseconds."""
    return in_pairs(1e3 * second, "Time (s),Ch 0 [V],Time (ms),Ch 1 [V]")


def of_pandas(second):
    """The same, as pandas names columns of one name."""
    return in_pairs(second, "Time (s),Ch 0 [V],Time (s).1,Ch 1 [V]")


@pytest.mark.parametrize(
    "text", [labview_multi, tektronix_blocks, in_pairs, in_milliseconds, of_pandas]
)
def test_channels_with_times_of_their_own_are_aligned(tmp_path, text):
    (tmp_path / "r.csv").write_text(text(TIME_S + 40 * STEP_S))
    known = {} if text is labview_multi else MOVING
    recording = load_even({"path": str(tmp_path / "r.csv"), **known}, {})
    np.testing.assert_array_equal(recording.signal, [A[40:], B[:-40]])
    assert recording.sample_rate_hz == pytest.approx(RATE_HZ)
    assert any("aligned by their starts" in note for note in recording.notes)


SKIPPED = {
    "below the header": (scan_text(after_header="# here\n", end="# there\n"), "lines 2, 403"),
    "between rows": (scan_text(inside="# here\n"), "line 102"),
    "a row": (scan_text(inside="#0.04975,0.01,0.1,0.2\n"), "line 102"),
    "descriptions": (TEXTS["descriptions below the units"][0], "line 3"),
}


@pytest.mark.parametrize("case", SKIPPED)
def test_lines_that_are_no_rows_are_named(tmp_path, case):
    text, where = SKIPPED[case]
    (tmp_path / "r.csv").write_text(text)
    notes = load_even({"path": str(tmp_path / "r.csv")}, {}).notes
    assert any(f"without {where}," in note for note in notes)


# Positions that a stage reports now and then, in motions of several kinds.


def reported(motion_mm, every, phase):
    """Positions as they are held between reports, to a tenth of a micrometre."""
    at = (np.arange(T_S.size) - phase) // every * every + phase
    return np.round(motion_mm(at / RATE_HZ), 4)


T_S = np.arange(3000) / RATE_HZ
HELD = {
    "even": (lambda t: 20 * t, 40, 0),
    "even, from another sample": (lambda t: 20 * t, 40, 13),
    "accelerated": (lambda t: 5 * t + 8 * t**2, 20, 3),
    "there and back": (lambda t: 10 - 10 * np.cos(2 * np.pi * t / 1.5), 25, 0),
    "often": (lambda t: 20 * t + 3 * t**2, 4, 0),
    "every second": (lambda t: 20 * t + 3 * t**2, 2, 0),
    "with rests": (lambda t: 4 - 4 * np.cos(np.pi * np.clip((t - 0.4) / 0.7, 0, 1)), 20, 5),
}


@follows("{}. All steps are equal")
@pytest.mark.parametrize("case", HELD)
def test_positions_between_reports(tmp_path, case):
    motion_mm, every, phase = HELD[case]
    truth_mm = motion_mm(T_S)
    noise = np.random.default_rng(3).normal(size=T_S.size)
    rows = table(1e3 * T_S, noise, reported(motion_mm, every, phase))
    (tmp_path / "r.csv").write_text("Time (ms),Ch 0 [V],Stage pos (mm)\n" + rows)
    recording = load_even({"path": str(tmp_path / "r.csv")}, {})
    inner = slice(every, -2 * every)
    off_mm = 1e3 * recording.position_m - truth_mm
    assert np.max(np.abs(off_mm[inner])) < 0.011  # 10 um, and the report's rounding
    assert recording.notes or recording.doubts
    moving = recording.speed_m_per_s[inner] > 1e-3
    assert np.all(moving) or case in ("there and back", "with rests")


@follows("is reported in {} of {} data rows", "are left out, as {} is empty there")
@pytest.mark.parametrize("blank", ["", "NaN"])
@pytest.mark.parametrize("case", HELD)
def test_positions_that_are_written_now_and_then(tmp_path, case, blank):
    motion_mm, every, phase = HELD[case]
    at = np.arange(phase, T_S.size, every)
    cells = np.full(T_S.size, blank, object)
    cells[at] = [repr(float(v)) for v in np.round(motion_mm(T_S[at]), 4)]
    noise = np.random.default_rng(3).normal(size=T_S.size)
    rows = table(1e3 * T_S, noise, cells)
    (tmp_path / "r.csv").write_text("Time (ms),Ch 0 [V],Stage pos (mm)\n" + rows)
    recording = load_even({"path": str(tmp_path / "r.csv")}, {})
    kept = slice(at[0], at[-1] + 1)
    np.testing.assert_array_equal(recording.signal[0], noise[kept])
    assert np.max(np.abs(1e3 * recording.position_m - motion_mm(T_S)[kept])) < 0.011
    assert any(f"reported in {at.size} of" in note for note in recording.notes)
    assert any("left out" in note for note in recording.notes) == (recording.time_s.size < T_S.size)


def test_few_positions_are_not_interpolated(tmp_path):
    cells = np.full(N, "", object)
    cells[[0, -1]] = ["10.0", "13.99"]
    rows = table(1e3 * TIME_S, A, cells)
    (tmp_path / "r.csv").write_text("Time (ms),Ch 0 [V],Stage pos (mm)\n" + rows)
    with pytest.raises(BadInput, match="data row 2 is empty"):
        load_even({"path": str(tmp_path / "r.csv")}, {})


def test_reports_that_come_unevenly(tmp_path):
    """The stage is busy at times: 20 samples between reports, and half as many more or fewer."""
    rng = np.random.default_rng(8)
    at = np.cumsum(rng.integers(10, 31, size=400))
    last = at[np.searchsorted(at, np.arange(T_S.size), side="right") - 1]
    position_mm = np.round(20 * last / RATE_HZ + 3 * (last / RATE_HZ) ** 2, 4)
    position_mm[: at[0]] = 0.0
    rows = table(1e3 * T_S, rng.normal(size=T_S.size), position_mm)
    (tmp_path / "r.csv").write_text("Time (ms),Ch 0 [V],Stage pos (mm)\n" + rows)
    recording = load_even({"path": str(tmp_path / "r.csv")}, {})
    off_mm = 1e3 * recording.position_m - (20 * T_S + 3 * T_S**2)
    assert np.max(np.abs(off_mm[60:-60])) < 0.011


@pytest.mark.parametrize(("count_mm", "digits"), [(4.8828e-3, 3), (12.207e-3, 4)])
def test_counts_in_few_digits_are_no_reports(tmp_path, count_mm, digits):
    position_mm = np.round(count_mm * np.round(2 * T_S / count_mm), digits)
    rows = table(1e3 * T_S, np.random.default_rng(3).normal(size=T_S.size), position_mm)
    (tmp_path / "r.csv").write_text("Time (ms),Ch 0 [V],Stage pos (mm)\n" + rows)
    assert load_even({"path": str(tmp_path / "r.csv")}, {}).notes == ()


@pytest.mark.parametrize("count_um", [2, 10])
def test_an_encoders_counts_are_no_reports(tmp_path, count_um):
    position_mm = count_um * 1e-3 * np.round(2 * T_S / (count_um * 1e-3))  # 1 um a sample
    rows = table(1e3 * T_S, np.random.default_rng(3).normal(size=T_S.size), position_mm)
    (tmp_path / "r.csv").write_text("Time (ms),Ch 0 [V],Stage pos (mm)\n" + rows)
    recording = load_even({"path": str(tmp_path / "r.csv")}, {})
    np.testing.assert_allclose(1e3 * recording.position_m, position_mm, atol=1e-9)
    assert recording.notes == recording.doubts == ()


# What is stated and cannot be used, and what may mean something else, is refused or asked.


def with_gain(path):
    scaled(("scale_factor", "add_offset"))(path)
    with h5py.File(path, "r+") as file:
        file["Ch 0"].attrs["gain"] = 95.0


def with_scale_in_words(path):
    scaled(("scale_factor", "add_offset"))(path)
    with h5py.File(path, "r+") as file:
        file["Ch 0"].attrs["scale_factor"] = "a millionth"


def between(path):
    """Two films of which one is sampled half an interval after the other."""
    with TdmsWriter(path) as file:
        file.write_segment([
            ChannelObject("scan", f"Ch {i}", values,
                          {"wf_increment": STEP_S, "wf_start_offset": i * STEP_S / 2,
                           "unit_string": "V"})
            for i, values in enumerate(SIGNAL_V)
        ])  # fmt: skip


def thousands(path):
    counts = np.round(500 * A).astype(int)
    path.write_text("AI0 (counts)\n" + "\n".join(f"{c:,}".replace(",", ".") for c in counts))


def apart(path):
    """A stage that starts when the film's recording is over."""
    late = {"wf_increment": STEP_S, "wf_start_offset": 2 * N * STEP_S, "unit_string": "mm"}
    film = {"wf_increment": STEP_S, "wf_start_offset": 0.0, "unit_string": "V"}
    with TdmsWriter(path) as file:
        stage = ChannelObject("scan", "Stage pos", MM, late)
        file.write_segment([ChannelObject("scan", "Ch 0", A, film), stage])


def twice_stated(path):
    np.savez(path, voltage_0_V=A, position_m=POSITION_M, fs=RATE_HZ, dt=1e-3)


def gains(write):
    """A file of the scan with what else is written into it."""

    def made(path: Path) -> None:
        columns = {"time_s": TIME_S, "position_m": POSITION_M, "voltage_0_V": A, "voltage_1_V": B}
        write(path, columns)

    return made


def tdms_gain(path, columns):
    with TdmsWriter(path) as file:
        root = RootObject({"Gain": 95.0})
        file.write_segment([root, *(ChannelObject("scan", *each) for each in columns.items())])


def h5_late_stage(path):
    with h5py.File(path, "w") as file:
        for name, values in (("time_s", TIME_S), ("voltage_0_V", A), ("position_m", POSITION_M)):
            file[name] = values
        file["position_m"].attrs["start_time"] = -0.1


def h5_of_two_units(path):
    with h5py.File(path, "w") as file:
        for name, values in (("time_s", TIME_S), ("voltage_0_V", A), ("position_mm", MM)):
            file[name] = values
        file["position_mm"].attrs["units"] = "m"


def with_group(path):
    """Columns at the root, and a further signal in a group beside them."""
    with h5py.File(path, "w") as file:
        for name, values in (("time_s", TIME_S), ("voltage_0_V", A), ("position_m", POSITION_M)):
            file[name] = values
        file["board2/Ch 1"] = B
        file["board2/Ch 1"].attrs["units"] = "V"


def text_of(head):
    return gains(lambda path, c: path.write_text(head + ",".join(c) + "\n" + table(*c.values())))


def text(content):
    """A file of this text."""
    return lambda path: path.write_bytes(content.encode())


def marked(form, delimiter=","):
    """Numbers of a million, with marks for thousands."""
    cells = ([form(f"{1e6 * v:,.3f}") for v in each] for each in (2 + A, 2 + B))
    head = delimiter.join(["time_s", "voltage_0_uV", "voltage_1_uV"])
    return text(f"{head}\n" + table(np.arange(N), *cells, delimiter=delimiter))


def digits(odd):
    """The scan with a number that Python alone reads."""
    return text(
        f"time_s,position_m,voltage_0_V\n0,0.01,{odd}\n" + table(TIME_S, POSITION_M, A)[12:]
    )


def days_apart(form, days):
    """Stamps of which the second half is as many days later."""
    late = stamps(form, start=f"2025-02-{3 + days:02}T10:11:12")
    cells = [*stamps(form, start="2025-02-03T10:11:12")[: N // 2], *late[N // 2 :]]
    return text("Time,Ch 0 [V],Ch 1 [V]\n" + table(cells, A, B))


REFUSED = {
    "a gain in a comment": (text(scan_text(inside="# Gain: 95\n")), "r.csv", {}),
    "thousands with commas": (marked(lambda cell: f'"{cell}"'), "r.csv", MOVING),
    "thousands with spaces": (
        marked(lambda cell: cell.replace(",", " ").replace(".", ","), ";"),
        "r.csv",
        MOVING,
    ),
    "thousands with apostrophes": (marked(lambda cell: cell.replace(",", "'")), "r.csv", MOVING),
    "thousands with points": (
        marked(lambda cell: cell.replace(",", "_").replace(".", ",").replace("_", "."), ";"),
        "r.csv",
        MOVING,
    ),
    "a low line between digits": (digits("1_0"), "r.csv", {}),
    "digits of another script": (digits("\u0661.\u0665"), "r.csv", {}),
    "zeros in place of a row's end": (text(scan_text()[:-5] + "\0" * 99), "r.csv", {}),
    "Ctrl-Z between rows": (text(scan_text(inside="\x1a\n")), "r.csv", {}),
    "a day between two rows": (days_apart("%Y-%m-%d %H:%M:%S.%f", 1), "r.csv", MOVING),
    "a day, or a month": (days_apart("%d/%m/%Y %H:%M:%S.%f", 1), "r.csv", MOVING),
    "two days, or two months": (days_apart("%d/%m/%Y %H:%M:%S.%f", 2), "r.csv", MOVING),
    "a day by a column of dates": (
        text(
            "Date,Time,Ch 0 [V]\n"
            + table(
                [*["03/02/2025"] * (N // 2), *["04/02/2025"] * (N // 2)],
                stamps("%H:%M:%S.%f", start="2025-02-03T10:11:12"),
                A,
            )
        ),
        "r.csv",
        MOVING,
    ),
    "channels of rates of their own": (text(tektronix_blocks(2 * TIME_S)), "r.csv", MOVING),
    "uneven times of one channel": (
        text(tektronix_blocks(TIME_S + 1e-3 * np.sin(np.arange(N)))),
        "r.csv",
        MOVING,
    ),
    "a scale of one channel's block": (
        text(tektronix_blocks(units="Scale factor,1,,Scale factor,0.5\n")),
        "r.csv",
        MOVING | {"signal_unit": "V"},
    ),
    "gains in a preamble": (text_of("Gain,,95,110\n"), "r.csv", {}),
    "a gain of one channel in a preamble": (text_of("Gain Ch 0: 95\n"), "r.csv", {}),
    "scales in a preamble": (text_of("Scale factor,,0.001,0.002\n"), "r.csv", {}),
    "gains in a column": (
        gains(
            lambda path, c: path.write_text(
                ",".join(c) + ",Gain\n" + table(*c.values(), np.full(N, 95))
            )
        ),
        "r.csv",
        {},
    ),
    "gains in an array": (
        gains(lambda path, c: np.savez(path, **c, gain=np.array([95.0, 110.0]))),
        "r.npz",
        {},
    ),
    "a gain of the whole TDMS file": (gains(tdms_gain), "r.tdms", {}),
    "a gain in a struct": (
        gains(lambda path, c: scipy.io.savemat(path, c | {"info": {"gain": 95.0}})),
        "r.mat",
        {},
    ),
    "a start of the stage alone": (h5_late_stage, "r.h5", {}),
    "a unit in the name and another in the file": (h5_of_two_units, "r.h5", {}),
    "a film of another group": (with_group, "r.h5", {}),
    "a gain beside the numbers": (with_gain, "r.h5", {}),
    "a scale in words": (with_scale_in_words, "r.h5", {}),
    "samples between samples": (between, "r.tdms", MOVING),
    "no time in common": (apart, "r.tdms", {}),
    "a mark for thousands": (thousands, "r.csv", MOVING | {"sample_rate_hz": RATE_HZ}),
    "two rates": (twice_stated, "r.npz", {}),
}


@follows("have no time in common", "are not sampled at the same times",
         "and not whether its numbers contain it", "write it again without that",
         "among whole numbers, which may be thousands", "does: state both, or neither",
         "state it, or align them", "by the file: correct one of them.",
         "by the file: correct one of them, or give recording.signal_unit")  # fmt: skip
@pytest.mark.parametrize("case", REFUSED)
def test_what_is_stated_is_never_dropped(tmp_path, case):
    write, name, known = REFUSED[case]
    write(tmp_path / name)
    with pytest.raises(BadInput):
        load_even({"path": str(tmp_path / name), **known}, {})


def test_a_stated_gain_is_taken_where_the_experimenter_states_it(tmp_path):
    with_gain(tmp_path / "r.h5")
    recording = load_even({"path": str(tmp_path / "r.h5"), "gain": [95.0, 1.0]}, {})
    np.testing.assert_allclose(recording.signal[0], np.round(A, 6) / 95, rtol=1e-9, atol=1e-9)


def test_decimals_of_three_digits_are_no_thousands(tmp_path):
    values = np.round(500 * A, 3)
    (tmp_path / "r.csv").write_text("Ch 0 [V]\n" + "\n".join(f"{v:.3f}" for v in values))
    known = MOVING | {"sample_rate_hz": RATE_HZ}
    recording = load_even({"path": str(tmp_path / "r.csv"), **known}, {})
    np.testing.assert_array_equal(recording.signal[0], values)


# What is improbable is read, and doubted on every channel.
IMPROBABLE = {
    "seconds called milliseconds": {"time_ms": TIME_S},
    "a code for out of range": {"voltage_1_V": np.where(np.arange(N) % 150 == 7, -9999.0, B)},
    "metres called millimetres": {"position_m": MM, "position_mm": None},
    "seconds called hours": {"time_ms": 3.6e9 * TIME_S},
    "an unsigned speed there and back": {
        "position_mm": np.where(np.arange(N) < N // 2, MM, MM[::-1]),
        "speed_mm_per_s": np.full(N, 20.0),
    },
    "a position that jumps": {"position_mm": MM + 131.0 * (np.arange(N) > 250)},
    "blocks of 128 rows": {"position_mm": MM[np.arange(N) % 128]},
    "held, with noise": {
        "position_mm": MM[np.arange(N) // 20 * 20] + 1e-4 * np.sin(7 * np.arange(N))
    },
}


@follows("where {} m/s is fast", "above {} Hz: check", "far beyond all others",
         "below {} Hz: check", "m long, above {} m", "The position jumps by",
         "The position stands nearly still", "The speed and the positions disagree")  # fmt: skip
@pytest.mark.parametrize("case", IMPROBABLE)
def test_what_is_improbable_is_doubted(tmp_path, case):
    columns = {"time_ms": 1e3 * TIME_S, "position_mm": MM, "voltage_0_V": A, "voltage_1_V": B}
    columns = {k: v for k, v in (columns | IMPROBABLE[case]).items() if v is not None}
    rows = ",".join(columns) + "\n" + table(*columns.values())
    (tmp_path / "r.csv").write_text(rows)
    recording = load_even({"path": str(tmp_path / "r.csv")}, {})
    assert recording.doubts
    assert inspect(tmp_path / "r.csv").doubts[: len(recording.doubts)] == recording.doubts


@follows(
    "of the scan, which goes from {} m", "is stated as {} m, where", "slides by the film's depth"
)
def test_facts_that_are_improbable_are_doubted(tmp_path):
    rows = "time_s,position_m,voltage_0_V,voltage_1_V\n" + table(TIME_S, POSITION_M, A, B)
    (tmp_path / "r.csv").write_text(rows)
    for depth_m, doubted, said in ((0.75e-3, 0, 0), (0.75, 1, 1), (5e-5, 0, 1)):
        known = {"sensor": {"depth_m": depth_m}}
        assert len(load_even({"path": str(tmp_path / "r.csv")}, known).doubts) == doubted
        assert len(inspect(tmp_path / "r.csv", **known).doubts) == said
    for window_m, doubted in (([0.0, 0.1], 0), ([0.0, 0.011], 1)):
        known = {"path": str(tmp_path / "r.csv"), "contact_window_m": window_m}
        assert len(load_even(known, {}).doubts) == doubted


@follows("about {} Pa on the skin")
@pytest.mark.parametrize(("factor", "is_doubted"), [(1.0, False), (10.0, False), (1e4, True)])
def test_pressure_far_above_the_modulus_is_doubted(factor, is_doubted):
    """10 kPa at the film's depth, by the same order of magnitude."""
    element = {"strip_width_m": 7e-4, "active_length_m": 8e-3}
    sensor = {"depth_m": 1e-3, "feedback_resistance_ohm": 1e6, "elements": [element]}
    signal_V = factor * 1e4 * 2.3e-11 * 7e-4 * 8e-3 * SPEED_M_PER_S / 1e-3 * 1e6
    signal = signal_V * np.sin(2 * np.pi * TIME_S / 0.05)[None]
    speed = np.full(N, SPEED_M_PER_S)
    recording = Recording(signal, TIME_S, speed, ("voltage_0_V",), {"sensor": sensor})
    assert bool(usable(recording).doubts) == is_doubted


@follows("samples are too few to tell", "every channel has one value throughout")
@pytest.mark.parametrize(("rows", "value"), [(3, None), (N, 0.5)])
def test_nothing_to_find_is_refused_by_all(tmp_path, rows, value):
    signals = SIGNAL_V if value is None else np.full((2, N), value)
    columns = [each[:rows] for each in (TIME_S, POSITION_M, *signals)]
    text = "time_s,position_m,voltage_0_V,voltage_1_V\n" + table(*columns)
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(BadInput) as refusal:
        load_even({"path": str(tmp_path / "r.csv")}, {})
    assert inspect(tmp_path / "r.csv").refusal == str(refusal.value)


@follows("which instruments write for a sample beyond their range")
@pytest.mark.parametrize("word", ["NaN", "OVERLOAD", "-nan(ind)", "#N/A", "9.9E+37", ""])
def test_marks_of_missing_samples(tmp_path, word):
    cells = np.array([repr(float(v)) for v in B], object)
    cells[[5, 200]] = word
    rows = "time_s,position_m,voltage_0_V,voltage_1_V\n" + table(TIME_S, POSITION_M, A, cells)
    (tmp_path / "r.csv").write_text(rows)
    with pytest.raises(BadInput, match=r"recording\.missing=allow"):
        load_even({"path": str(tmp_path / "r.csv")}, {})
    signal = load_even({"path": str(tmp_path / "r.csv"), "missing": "allow"}, {}).signal
    assert np.flatnonzero(np.isnan(signal[1])).tolist() == [5, 200]
    np.testing.assert_array_equal(signal[0], A)
    assert inspect(tmp_path / "r.csv").overrides == ("recording.missing=allow",)
