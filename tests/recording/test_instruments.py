"""Files as instruments and programs write them: one scan in the words of each, read as it was.

The scan is the one of `advice`; a writer gives its text, or writes its file. What a file states of
its numbers (start, interval, unit, scale) is used; where it cannot be, it is refused.
"""

import re
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
from srsinv.recording.even import load_even
from srsinv.recording.inspection import inspect
from tests.recording.scan import (
    MM,
    MOVING,
    POSITION_M,
    RATE_HZ,
    SIGNAL_V,
    STEP_S,
    TIME_S,
    A,
    B,
    N,
    assert_is_scan,
    rows_of,
    scan,
    text_of,
)


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
    return head + rows_of(TIME_S, A, B, MM, delimiter="\t", end=end)


def tektronix():
    """The older way of Tektronix: the preamble stands beside the first rows' cells."""
    return (
        "Model,TDS2024\nFirmware Version,22.0\n\nRecord Length,400,Points\n"
        f"Sample Interval,{STEP_S!r},s\nVertical Units,V,V\nHorizontal Units,s\n\nTIME,CH1,CH2\n"
        + rows_of(TIME_S, A, B)
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
    return head + rows_of(TIME_S, A, second, B, TIME_S, MM, delimiter="\t", end="\t")


def tektronix_blocks(second=TIME_S, units="Vertical Units,V,,Vertical Units,V\n"):
    """A block of times and numbers for each channel, an empty column between them."""
    head = (
        "Model,MSO58,,Model,MSO58\nLabel,,,Label,\nWaveform Type,ANALOG,,Waveform Type,ANALOG\n"
        "Horizontal Units,s,,Horizontal Units,s\nSample Interval,0.0005,,Sample Interval,0.0005\n"
        f"Record Length,400,,Record Length,400\n{units}TIME,CH1,,TIME,CH2\n"
    )
    return head + rows_of(TIME_S, A, [""] * N, second, B)


def stamps(form, start="2025-02-11T23:59:59.900", step=1.0):
    """Time stamps, in words, from half a second before midnight on."""
    return [f"{pd.Timestamp(start) + pd.Timedelta(seconds=t):{form}}" for t in step * TIME_S]


def dated(form, known=MOVING, **changes):
    """A scan with time stamps in words."""
    return "Time,Ch 0 [V],Ch 1 [V]\n" + rows_of(stamps(form, **changes), A, B), known


def scan_text(delimiter=",", after_header="", inside="", end=""):
    """The scan with lines below its header, after 100 rows and at its end."""
    rows = rows_of(TIME_S, POSITION_M, A, B, delimiter=delimiter).splitlines(keepends=True)
    head = delimiter.join(["time_s", "position_m", "voltage_0_V", "voltage_1_V"]) + "\n"
    return "".join([head, after_header, *rows[:100], inside, *rows[100:], end])


def r_table(delimiter=" "):
    """As R's write.table leaves it: rows have names, for which the header has no cell."""
    head = delimiter.join(['"time_s"', '"position_m"', '"voltage_0_V"', '"voltage_1_V"'])
    labels = [f'"{row}"' for row in range(1, N + 1)]
    return f"{head}\n" + rows_of(labels, TIME_S, POSITION_M, A, B, delimiter=delimiter)


def rigol(end=","):
    units = f"Sequence,Volt,Volt,-7.5e-01,{STEP_S!r}\n"
    return "X,CH1,CH2,Start,Increment,\n" + units + rows_of(np.arange(N), A, B, end=end)


def keysight():
    return "x-axis,1,2\nsecond,Volt,Volt\n" + rows_of(TIME_S - 0.1, A, B)


def picoscope():
    return "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n" + rows_of(1e3 * TIME_S, A, 1e3 * B)


def lecroy():
    return "LECROYWS64,12345\nSegments,1\nTime,Ampl,Ampl 2\n" + rows_of(TIME_S, A, B)


def siglent():
    return "Source,CH1,CH2\nSecond,Volt,Volt 2\n" + rows_of(TIME_S, A, B)


def excel():
    commas = rows_of(1e3 * TIME_S, MM, A, B, delimiter=";").replace(".", ",")
    return "sep=;\nTime (ms);Pos (mm);Ch 0 [V];Ch 1 [V]\n" + commas


def savetxt(header="time_s position_m voltage_0_V voltage_1_V", comment="# ", delimiter=" "):
    rows = rows_of(TIME_S, POSITION_M, A, B, delimiter=delimiter, form="{:.18e}")
    return f"{comment}{header}\n{rows}" if header else rows


LAB = {"Time (ms)": 1e3 * TIME_S, "Ch A [V]": A, "Ch B [mV]": 1e3 * B, "Stage pos (mm)": MM}


def lab(*renamed: tuple[str, str, float], delimiter: str = ",") -> str:
    """A lab's columns beside a temperature, some under another name and in another unit."""
    other = {old: (new, factor) for old, new, factor in renamed}
    columns = {
        other.get(name, (name, 1))[0]: values * other.get(name, (name, 1))[1]
        for name, values in LAB.items()
    }
    return text_of(columns | {"Temperature (C)": 20 + 0 * TIME_S}, delimiter)


def beside_dates():
    """Decimal commas, cell by cell."""
    head, *lines = lab(delimiter=";").replace(".", ",").splitlines()
    rows = "".join(f"{line};24.11.2026 10:00:00,5\n" for line in lines)
    return f"{head};Date\n{rows}"


# name: (text, what is said of it when it is read)
TEXTS: dict[str, tuple[str | bytes, dict]] = {
    "LabVIEW": (labview(), {}),
    "Tektronix": (tektronix(), MOVING),
    "Rigol": (rigol(), MOVING),
    "Keysight": (keysight(), MOVING),
    "PicoScope": (picoscope(), MOVING),
    "LeCroy": (lecroy(), MOVING | {"time_unit": "s", "signal_unit": "V"}),
    "Siglent": (siglent(), MOVING | {"time_unit": "s", "signal_unit": "V"}),
    "Excel, decimal commas": (excel(), {}),
    "units of other quantities in the row of units": (
        "Time,Ch0,Ch1,Pos,Temp,Load\ns,V,V,mm,degC,N\n"
        + rows_of(TIME_S, A, B, MM, 20 + TIME_S, 3 + TIME_S), {}),
    "units behind a stroke": (
        "Time / s,Ch 0 / V,Ch 1 / mV\n" + rows_of(TIME_S, A, 1e3 * B), MOVING),
    "an index without a name": (
        ",Pos (mm),Ch 0 [V],Ch 1 [V]\n" + rows_of(stamps("%Y-%m-%d %H:%M:%S.%f"), MM, A, B), {}),
    "a clock of whole seconds beside times": (
        "Time,t (s),Ch 0 [V],Ch 1 [V]\n" + rows_of(stamps("%H:%M:%S"), TIME_S, A, B), MOVING),
    "decimal commas between spaces": (
        "time_s position_m voltage_0_V voltage_1_V\n"
        + rows_of(TIME_S, POSITION_M, A, B, delimiter=" ").replace(".", ","), {}),
    "one name in volts does not hide another": (
        "time_s,position_m,voltage_0_V,Ch 1 [V]\n" + rows_of(TIME_S, POSITION_M, A, B), {}),
    "thousands in a stated rate": (
        '# Sample rate: 2,000 Hz\nCh 0 [V]\tCh 1 [V]\n' + rows_of(A, B, delimiter="\t"), MOVING),
    "savetxt": (savetxt(), {}),
    "savetxt, aligned": (
        "  ".join(["time_s", "position_m", "voltage_0_V", "voltage_1_V"])
        + "\n"
        + rows_of(TIME_S, POSITION_M, A, B, delimiter="   ", form="{:25.17e}"),
        {},
    ),
    "no header": (
        savetxt(""),
        {"time_column": "column_1", "time_unit": "s", "position_column": "column_2",
         "position_unit": "m", "channels": ["column_3", "column_4"], "signal_unit": "V"},
    ),
    "delimiters at the ends of rows": (
        "time_s,position_m,voltage_0_V,voltage_1_V\n" + rows_of(TIME_S, POSITION_M, A, B, end=","),
        {},
    ),
    "rate in the preamble": (
        ";Tool: scope\n;Sample rate,2 kHz\nCH1(V),CH2(V),Position(mm)\n" + rows_of(A, B, MM),
        {},
    ),
    "interval in the preamble": (
        "Date: today\nSampling interval (ms): 0.5\nCH1(V);CH2(V);Pos (mm)\n"
        + rows_of(A, B, MM, delimiter=";"),
        {},
    ),
    "capitals": (lab(("Time (ms)", "TIME (MS)", 1), ("Stage pos (mm)", "STAGE POS (MM)", 1)), {}),
    "other brackets": (lab(("Time (ms)", "time [ms]", 1), ("Ch A [V]", "Ch A (V)", 1)), {}),
    "centimetres": (lab(("Stage pos (mm)", "Position (cm)", 0.1)), {}),
    "seconds written out": (lab(("Time (ms)", "Elapsed time (seconds)", 1e-3)), {}),
    "microseconds": (lab(("Time (ms)", "timestamp (μs)", 1e3)), {}),
    "suffixes": (lab(("Time (ms)", "t_ms", 1), ("Stage pos (mm)", "encoder_mm", 1)), {}),
    "names in volts": (
        lab(("Ch A [V]", "front film [uV]", 1e6), ("Ch B [mV]", "back_mV", 1)), {}),
    "decimal commas between tabs": (lab(delimiter="\t").replace(".", ","), {}),
    "decimal commas beside dates": (beside_dates(), {}),
    **{f"a sign of a unit in {each}": (lab(("Stage pos (mm)", "X [µm]", 1e3)).encode(each), {})
       for each in ("utf-8-sig", "utf-16-le", "utf-16-be")},
    "UTF-16": (("Time (ms),X [µm],Ch 0 [V],Ch 1 [V]\n" + rows_of(1e3 * TIME_S, 1e3 * MM, A, B))
               .encode("utf-16"), {}),
    "Latin-1": (("Time (µs),Ch 0 [V],Ch 1 [V]\n" + rows_of(1e6 * TIME_S, A, B)).encode("latin-1"),
                MOVING),
    "ISO stamps": ("time,Ch 0 [V],Ch 1 [V]\n" + rows_of(stamps("%Y-%m-%dT%H:%M:%S.%f"), A, B),
                   MOVING),
    "dates and times": ("Date/Time;Ch 0 [V];Ch 1 [V]\n"
                        + rows_of(stamps("%d.%m.%Y %H:%M:%S,%f"), A, B, delimiter=";")
                        .replace(".1", ".1"), MOVING | {"time_column": "Date/Time"}),
    "clock past midnight": ("Time (hh:mm:ss),Ch 0 [V],Ch 1 [V]\n"
                            + rows_of(stamps("%H:%M:%S.%f"), A, B), MOVING),
    "nanoseconds": ("Time (ns),Ch 0 [V],Ch 1 [V]\n" + rows_of(1e9 * TIME_S, A, B), MOVING),
    "microseconds that wrap": (
        "Time (us),Ch 0 [V],Ch 1 [V]\n"
        + rows_of((2**32 - 50_000 + np.round(1e6 * TIME_S)) % 2**32, A, B), MOVING),
    "an encoder that wraps": (
        "Time (ms),encoder (um),Ch 0 [V],Ch 1 [V]\n"
        + rows_of(1e3 * TIME_S, (63_000 + 1e3 * MM + 2**15) % 2**16 - 2**15, A, B),
        {}),
    "any name in volts": (
        "Time (ms),X [V],Encoder side film [V],Stage pos (mm)\n" + rows_of(1e3 * TIME_S, A, B, MM),
        {}),
    "LabVIEW, times for each channel": (labview_multi(), {}),
    "Tektronix, a block for each channel": (tektronix_blocks(), MOVING),
    "Rigol, the unit at the name": ("Time(s),CH1V,CH2V\n" + rows_of(TIME_S, A, B), MOVING),
    "Rigol, the increment in the header": (
        "CH1V,CH2mV,t0 =-7.5e-01s, tInc = 5e-04,\n" + rows_of(A, 1e3 * B, end=","), MOVING),
    "descriptions below the units": (
        "Time,Ch0,Ch1,Pos\ns,V,V,mm\nsince the start,front film,back film,\n"
        + rows_of(TIME_S, A, B, MM), {}),
    "units above the names": (
        "s,V,V,mm\nTime,Ch0,Ch1,Pos\n" + rows_of(TIME_S, A, B, MM), {}),
    "MATLAB's dates": dated("%d-%b-%Y %H:%M:%S.%f"),
    "dates with a month's name": dated('"%b %d, %Y %H:%M:%S.%f"'),
    "numbered times of each channel": (
        "Time 1 (s),Ch 0 [V],Time 2 (s),Ch 1 [V]\n" + rows_of(TIME_S, A, TIME_S, B), MOVING),
    "dates of the United States": dated("%m/%d/%Y %I:%M:%S.%f %p"),
    "dates with strokes": dated("%Y/%m/%d %H:%M:%S.%f"),
    "milliseconds behind a colon": (
        "Time,Ch 0 [V],Ch 1 [V]\n"
        + rows_of([each[:-3] for each in stamps("%H:%M:%S:%f", step=2.0)], A, B),
        {**MOVING, "times": "ignore", "sample_rate_hz": RATE_HZ}),
    "dates in a column of their own": (
        "Date,Time,Ch 0 [V],Ch 1 [V]\n"
        + rows_of(stamps("%d/%m/%Y"), stamps("%H:%M:%S.%f"), A, B), MOVING),
    "Ctrl-Z at the end": (scan_text(end="\x1a"), {}),
    "zeros at the end": (scan_text(end="\0" * 3000), {}),
    "comments of several kinds": (
        scan_text(after_header="# 1,2,3,4\n#\n! V\n", inside="%% a,b\n", end="// end"), {}),
    "a comment with a semicolon": (scan_text("\t", after_header="; by me\n"), {}),
    "units as a comment": ("Time,Ch0,Ch1,Pos\n# s,V,V,mm\n" + rows_of(TIME_S, A, B, MM), {}),
    "a rate as a comment": (
        "Pos (mm),CH1(V),CH2(V)\n# Sample rate: 2 kHz\n" + rows_of(MM, A, B), {}),
    "R": (r_table(), {}),
    "temperature called T": (
        "T (degC),t (s),Ch 0 [V],Ch 1 [V],y pos (mm),Stage pos (mm)\n"
        + rows_of(21 + TIME_S, TIME_S, A, B, 0 * MM, MM), {}),
}  # fmt: skip


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
    return f"{names}\n" + rows_of(TIME_S, A, second, B)


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
    "below the header": (scan_text(after_header="# here\n", end="# there\n"), "lines 2, 403,"),
    "a row": (scan_text(inside="#0.04975,0.01,0.1,0.2\n"), "line 102,"),
    "descriptions": (TEXTS["descriptions below the units"][0], "line 3,"),
    "a preamble": (labview(), "Line 18 names"),
}


@pytest.mark.parametrize("case", SKIPPED)
def test_lines_that_are_no_rows_are_noted(tmp_path, case):
    text, where = SKIPPED[case]
    (tmp_path / "r.csv").write_text(text)
    notes = load_even({"path": str(tmp_path / "r.csv")}, {}).notes
    assert any(re.search(where, note) for note in notes)


# What is stated and cannot be used, and what may mean something else, is refused or asked.


HAND = {"time_s": TIME_S, "position_m": POSITION_M, "voltage_0_V": A, "voltage_1_V": B}


def h5(columns, scaled_by=None, **attributes) -> Callable[[Path], None]:
    """Columns with attributes of one of them (`name`), perhaps whole numbers with a scale."""

    def write(path: Path) -> None:
        if scaled_by:
            scaled(scaled_by)(path)
        with h5py.File(path, "a") as file:
            for name, values in columns.items():
                file[name] = values
            for name, values in attributes.items():
                file[name].attrs.update(values)

    return write


SCALED = ("scale_factor", "add_offset")
WITH_GAIN = h5({}, SCALED, **{"Ch 0": {"gain": 95.0}})


def two_films(second, unit="V") -> Callable[[Path], None]:
    """Two channels of TDMS, of which the second has properties of its own."""

    def write(path: Path) -> None:
        own = ({"wf_start_offset": 0.0, "unit_string": "V"}, {"unit_string": unit, **second})
        names = ("Ch 0", "Ch 1" if unit == "V" else "Stage pos")
        with TdmsWriter(path) as file:
            file.write_segment([
                ChannelObject("scan", name, values, {"wf_increment": STEP_S} | properties)
                for name, values, properties in zip(names, (A, B), own, strict=True)
            ])  # fmt: skip

    return write


def tdms_gain(path: Path) -> None:
    with TdmsWriter(path) as file:
        root = RootObject({"Gain": 95.0})
        file.write_segment([root, *(ChannelObject("scan", *each) for each in HAND.items())])


def text(*parts: str) -> Callable[[Path], None]:
    """A file of this text."""
    return lambda path: path.write_bytes("".join(parts).encode()) and None


def thousands(form, delimiter=","):
    """Numbers of a million, with marks for thousands."""
    cells = ([form(f"{1e6 * v:,.3f}") for v in each] for each in (2 + A, 2 + B))
    head = delimiter.join(["time_s", "voltage_0_uV", "voltage_1_uV"])
    return text(f"{head}\n", rows_of(np.arange(N), *cells, delimiter=delimiter))


def digits(odd):
    """The scan with a number that Python alone reads."""
    rows = rows_of(TIME_S[1:], POSITION_M[1:], A[1:])
    return text(f"time_s,position_m,voltage_0_V\n0,0.01,{odd}\n", rows)


def days_apart(form, days):
    """Stamps of which the second half is as many days later."""
    late = stamps(form, start=f"2025-02-{3 + days:02}T10:11:12")
    cells = [*stamps(form, start="2025-02-03T10:11:12")[: N // 2], *late[N // 2 :]]
    return text("Time,Ch 0 [V],Ch 1 [V]\n", rows_of(cells, A, B))


def dates_apart():
    """The same, by a column of dates beside the times."""
    dates = [*["03/02/2025"] * (N // 2), *["04/02/2025"] * (N // 2)]
    times = stamps("%H:%M:%S.%f", start="2025-02-03T10:11:12")
    return text("Date,Time,Ch 0 [V]\n", rows_of(dates, times, A))


COUNTS = [f"{round(each):,}".replace(",", ".") for each in 500 * A]
WAVY_S = TIME_S + 1e-3 * np.sin(np.arange(N))
SCALES = tektronix_blocks(units="Scale factor,1,,Scale factor,0.5\n")
# how it is written, the file's name, what is stated, and a part of the sentence
REFUSED: dict[str, tuple[Callable[[Path], object], str, dict, str]] = {
    "a gain in a comment": (text(scan_text(inside="# Gain: 95\n")), "r.csv", {}, "Gain '95'"),
    "gains in a preamble": (text("Gain,,95,110\n", text_of(HAND)), "r.csv", {}, "'95; 110'"),
    "a gain of one channel": (
        text("Gain Ch 0: 95\n", text_of(HAND)), "r.csv", {}, "Gain Ch 0 '95'"),
    "scales in a preamble": (
        text("Scale factor,,0.001,0.002\n", text_of(HAND)), "r.csv", {}, "'0.001; 0.002'"),
    "gains in a column": (text(text_of(HAND | {"Gain": np.full(N, 95)})), "r.csv", {}, "Gain 95.0"),
    "gains in an array": (
        lambda path: np.savez(path, **HAND, gain=np.array([95.0, 110.0])),
        "r.npz", {}, "[95.0, 110.0]"),
    "a gain of the whole TDMS file": (tdms_gain, "r.tdms", {}, "gain of 95"),
    "a gain in a struct": (
        lambda path: scipy.io.savemat(path, HAND | {"info": {"gain": 95.0}}),
        "r.mat", {}, "gain 95.0"),
    "a gain beside the numbers": (WITH_GAIN, "r.h5", {}, "gain of 95 for Ch 0"),
    "a scale in words": (
        h5({}, SCALED, **{"Ch 0": {"scale_factor": "a millionth"}}), "r.h5", {}, "'a millionth'"),
    "a scale of one channel's block": (
        text(SCALES), "r.csv", MOVING | {"signal_unit": "V"}, "'1; 0.5'"),
    "thousands with commas": (
        thousands(lambda cell: f'"{cell}"'), "r.csv", MOVING, "'2,345,584.192'"),
    "thousands with spaces": (
        thousands(lambda cell: cell.translate({44: " ", 46: ","}), ";"),
        "r.csv", MOVING, "'2 345 584,192'"),
    "thousands with apostrophes": (
        thousands(lambda cell: cell.translate({44: "'"})), "r.csv", MOVING, "2'345'584.192"),
    "thousands with points": (
        thousands(lambda cell: cell.translate({44: ".", 46: ","}), ";"),
        "r.csv", MOVING, "'2.345.584,192'"),
    "counts with points": (
        text("AI0 (counts)\n", "\n".join(COUNTS)),
        "r.csv", MOVING | {"sample_rate_hz": RATE_HZ}, "'-1.356'"),
    "a low line between digits": (digits("1_0"), "r.csv", {}, "'1_0'"),
    "digits of another script": (digits("\u0661.\u0665"), "r.csv", {}, "'\u0661.\u0665'"),
    "zeros in place of a row's end": (text(scan_text()[:-5], "\0" * 99), "r.csv", {}, "cut short"),
    "Ctrl-Z between rows": (text(scan_text(inside="\x1a\n")), "r.csv", {}, "r.csv"),
    "a day between two rows": (
        days_apart("%Y-%m-%d %H:%M:%S.%f", 1), "r.csv", MOVING, "data row 200"),
    "a day, or a month": (days_apart("%d/%m/%Y %H:%M:%S.%f", 1), "r.csv", MOVING, "data row 200"),
    "two days, or two months": (
        days_apart("%d/%m/%Y %H:%M:%S.%f", 2), "r.csv", MOVING, "'03/02/2025 10:11:12.000000'"),
    "a day by a column of dates": (dates_apart(), "r.csv", MOVING, "data row 200"),
    "channels of rates of their own": (
        text(tektronix_blocks(2 * TIME_S)), "r.csv", MOVING, "CH1, CH2"),
    "uneven times of one channel": (text(tektronix_blocks(WAVY_S)), "r.csv", MOVING, "TIME"),
    "samples between samples": (
        two_films({"wf_start_offset": STEP_S / 2}), "r.tdms", MOVING, "Ch 0, Ch 1"),
    "no time in common": (
        two_films({"wf_start_offset": 2 * N * STEP_S}, "mm"), "r.tdms", {}, "Ch 0, Stage pos"),
    "a start of the stage alone": (
        h5(HAND, position_m={"start_time": -0.1}), "r.h5", {}, "start of position_m"),
    "a unit in the name and another in the file": (
        h5(scan(), position_mm={"units": "m"}), "r.h5", {}, "mm by its name and m"),
    "a film of another group": (
        h5(HAND | {"board2/Ch 2": B}, **{"board2/Ch 2": {"units": "V"}}),
        "r.h5", {}, "board2/Ch 2"),
    "two rates": (
        lambda path: np.savez(path, voltage_0_V=A, position_m=POSITION_M, fs=RATE_HZ, dt=1e-3),
        "r.npz", {}, "dt 0.001"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_stated_is_never_dropped(tmp_path, case):
    write, name, known, words = REFUSED[case]
    write(tmp_path / name)
    with pytest.raises(BadInput) as caught:
        load_even({"path": str(tmp_path / name), **known}, {})
    assert words in str(caught.value)


def test_a_stated_gain_is_taken_where_the_experimenter_states_it(tmp_path):
    WITH_GAIN(tmp_path / "r.h5")
    recording = load_even({"path": str(tmp_path / "r.h5"), "gain": [95.0, 1.0]}, {})
    np.testing.assert_allclose(recording.signal[0], np.round(A, 6) / 95, rtol=1e-9, atol=1e-9)


def test_decimals_of_three_digits_are_no_thousands(tmp_path):
    values = np.round(500 * A, 3)
    (tmp_path / "r.csv").write_text("Ch 0 [V]\n" + "\n".join(f"{v:.3f}" for v in values))
    known = MOVING | {"sample_rate_hz": RATE_HZ}
    recording = load_even({"path": str(tmp_path / "r.csv"), **known}, {})
    np.testing.assert_array_equal(recording.signal[0], values)
