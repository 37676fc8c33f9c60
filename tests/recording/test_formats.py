"""Every format gives the same recording; units, motion, wiring and facts come out in SI."""

import json

import h5py
import numpy as np
import pytest
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from srsinv.files import open_file
from srsinv.recording import facts_of, load, merge, save
from srsinv.recording.formats.matlab import Matlab
from tests.recording.bad import matlab_object
from tests.recording.files import (
    COLUMNS,
    COUNTS,
    FORMATS,
    RATE_HZ,
    SIGNAL,
    SPEED,
    TIME_S,
    WITHOUT_TIMES,
    N,
    columns,
    write,
    write_csv,
    write_mat,
    write_wav,
)


@pytest.mark.parametrize("format", [format for format in FORMATS if format not in WITHOUT_TIMES])
def test_every_format_gives_the_same_recording(tmp_path, format):
    got = load(write(format, tmp_path))
    np.testing.assert_array_equal(got.signal, SIGNAL)
    np.testing.assert_array_equal(got.time_s, TIME_S)
    np.testing.assert_array_equal(got.speed_m_per_s, SPEED)
    assert (got.channels, got.signal_unit) == (("voltage_0_V", "voltage_1_V"), "V")
    assert (got.sidecar, got.name) == ({}, FORMATS[format][0])
    holed = np.where(np.arange(N) == 4, np.nan, SIGNAL[1])
    write(format, tmp_path, columns(voltage_1_V=holed))
    np.testing.assert_array_equal(load(tmp_path / got.name, missing="allow").signal[1], holed)


def test_columns_in_one_group_beside_dead_links(tmp_path):
    with h5py.File(tmp_path / "r.h5", "w") as file:
        for name, values in COLUMNS.items():
            file[f"scan/{name}"] = values
        file["time_s"] = h5py.SoftLink("/nowhere")
    np.testing.assert_array_equal(load(tmp_path / "r.h5").signal, SIGNAL)


def test_matlab_vectors_of_either_shape_and_what_stands_beside_them(tmp_path):
    beside = {"note": "run 3", "rig": {"a": 1.0}, "calibration": np.eye(3)}
    table = {name: values[None] for name, values in COLUMNS.items()} | beside
    write_mat(tmp_path / "r.mat", table)
    np.testing.assert_array_equal(load(tmp_path / "r.mat").signal, SIGNAL)


@pytest.mark.parametrize(("kind", "compressed"), [("f4", True), ("i1", False), ("u2", True)])
def test_matlab_classes(tmp_path, kind, compressed):
    values = np.arange(1, N + 1).astype(kind)
    table = {"time_s": np.arange(N), "speed_m_per_s": np.ones(N), "a": values}
    savemat(tmp_path / "r.mat", table, do_compression=compressed)
    np.testing.assert_array_equal(load(tmp_path / "r.mat", channels="a").signal[0], values)


def test_matlab_says_what_is_no_column(tmp_path):
    """Of variables and of a struct's fields; MATLAB's logical values are bytes, as some numbers."""
    cell = np.array([1.0, "x"], object)
    kinds = {"cell": cell, "char": "run 3", "logical": COUNTS[0] > 0}
    others = {"complex": SIGNAL[0] + 1j, "matrix": np.eye(3)}
    bytes_ = np.arange(N, dtype=np.uint8)
    path = tmp_path / "r.mat"
    savemat(path, kinds | others | {"scan": kinds | others | {"bytes": bytes_}, "bytes": bytes_})
    path.write_bytes(path.read_bytes() + matlab_object("start"))
    with open_file(path) as file:
        table = Matlab().read(file)
    assert list(table.columns) == ["scan.bytes", "bytes"]
    for prefix in ("", "scan."):
        for kind in kinds:
            assert table.unusable[prefix + kind] == f"is a MATLAB {kind}"
        assert "complex" in table.unusable[f"{prefix}complex"]
        assert table.unusable[f"{prefix}matrix"] == "has shape (3, 3)"
    assert table.unusable["start"] == "is a MATLAB opaque object"


# Numbers of every width in WAV

FULL_SCALE = {
    "int16": (COUNTS[0], 2.0**15),
    "int32": (COUNTS[0].astype(np.int32) << 16, 2.0**31),
    "float32": (COUNTS[0].astype(np.float32) / 2**15, 1.0),
    "uint8": ((COUNTS[0] // 256 + 128).astype(np.uint8), None),
}


@pytest.mark.parametrize("kind", FULL_SCALE)
def test_wav_is_in_full_scales(tmp_path, kind):
    values, scale = FULL_SCALE[kind]
    write_wav(tmp_path / "r.wav", {"mono": values})
    got = load(tmp_path / "r.wav", speed_m_per_s=0.05)
    expected = values / scale if scale else (values.astype(float) - 128) / 128
    np.testing.assert_array_equal(got.signal, expected[None])
    np.testing.assert_allclose(got.time_s, TIME_S, rtol=1e-15)
    assert (got.channels, got.signal_unit) == (("channel_0",), "full scale")
    assert got.sidecar["sample_rate_hz"] == RATE_HZ


def test_wav_in_volts_by_its_gain(tmp_path):
    """A full scale of 2 V, in mV."""
    stated = {"speed_m_per_s": 0.05, "signal_unit": "mV", "gain": 1 / 2000}
    got = load(write("wav", tmp_path), **stated)
    np.testing.assert_allclose(got.signal, COUNTS / 2.0**15 * 2, rtol=1e-15)
    assert got.signal_unit == "V"
    only = load(tmp_path / "r.wav", **stated, channels=["channel_1"])
    np.testing.assert_array_equal(only.signal, got.signal[1:])


def test_24_bit_wav(tmp_path):
    """By hand: scipy writes none. Left-justified, so full scale is 2^31 again."""
    counts = np.array([0, 1, -1, 2**23 - 1, -(2**23)])
    data = b"".join(int(c).to_bytes(3, "little", signed=True) for c in counts)
    body = b"WAVEfmt " + np.array([16], "<u4").tobytes() + np.array([1, 1], "<u2").tobytes()
    body += np.array([RATE_HZ, 3 * RATE_HZ], "<u4").tobytes() + np.array([3, 24], "<u2").tobytes()
    body += b"data" + np.array([len(data)], "<u4").tobytes() + data + b"\0"
    (tmp_path / "r.wav").write_bytes(b"RIFF" + np.array([len(body)], "<u4").tobytes() + body)
    got = load(tmp_path / "r.wav", speed_m_per_s=0.05)
    np.testing.assert_array_equal(got.signal[0], counts / 2.0**23)


def test_tdms_waveforms_bring_their_rate_and_unit(tmp_path):
    waveform = {"wf_increment": 1 / RATE_HZ, "wf_start_offset": 0.0, "unit_string": "mV"}
    channels = [
        ChannelObject(group, name, values, properties=waveform)
        for group, name, values in (("a", "film", SIGNAL[0]), ("b", "film", SIGNAL[1]))
    ]
    with TdmsWriter(tmp_path / "r.tdms") as file:
        file.write_segment(channels)
    got = load(tmp_path / "r.tdms", speed_m_per_s=0.05)
    assert (got.channels, got.signal_unit) == (("a/film", "b/film"), "V")
    np.testing.assert_array_equal(got.signal, SIGNAL / 1000)
    np.testing.assert_allclose(got.time_s, TIME_S, rtol=1e-12)


@pytest.mark.parametrize("name", ["r.h5", "r.nc"])
def test_units_of_the_file(tmp_path, name):
    table = {"time": (TIME_S * 1e3, "ms"), "gauge": (SIGNAL[0], "mV")}
    variables = {n: ("sample", values, {"units": unit}) for n, (values, unit) in table.items()}
    xr.Dataset(variables).to_netcdf(tmp_path / name, engine="h5netcdf")
    got = load(tmp_path / name, channels="gauge", speed_m_per_s=0.05)
    np.testing.assert_allclose(got.time_s, TIME_S, rtol=1e-15)
    assert got.signal_unit == "V"
    np.testing.assert_array_equal(got.signal, SIGNAL[:1] / 1000)


@pytest.mark.parametrize("units", ["seconds", "seconds since 2024-05-01"])
def test_netcdf_times_stay_numbers(tmp_path, units):
    variables = {name: ("sample", values, {"units": units}) for name, values in COLUMNS.items()}
    xr.Dataset(variables).to_netcdf(tmp_path / "r.nc", engine="h5netcdf")
    np.testing.assert_array_equal(load(tmp_path / "r.nc").time_s, TIME_S)


def test_packed_netcdf_is_unpacked_and_its_own_facts_are_stated(tmp_path):
    """A gain in the file's own sidecar is applied on loading, and a calibration counts it in."""
    variables = {name: ("sample", values) for name, values in COLUMNS.items()}
    dataset = xr.Dataset(variables, attrs={"sidecar": json.dumps({"gain": 7.0})})
    packed = {"dtype": "int16", "scale_factor": 1e-9, "_FillValue": -9999}
    dataset.to_netcdf(tmp_path / "r.nc", engine="h5netcdf", encoding={"voltage_0_V": packed})
    settings = {"path": str(tmp_path / "r.nc"), "polarity": -1}
    assert facts_of(settings) == {"gain": 7.0, "polarity": -1}
    np.testing.assert_allclose(load(tmp_path / "r.nc").signal, SIGNAL / 7, atol=1e-10)


# The good recording by other names, units, gains and times, and how it is read
FORMS = [
    ({"time_s": None, "time_ms": TIME_S * 1e3}, {}),
    ({"time_s": None, "time_us": TIME_S * 1e6}, {}),
    ({"time_s": None, "timestamp": TIME_S * 1e3}, {"time_unit": "ms"}),
    ({"time_s": None, "t": TIME_S}, {"time_unit": "s"}),
    ({"time_s": None}, {"sample_rate_hz": 1000}),
    ({"time_s": TIME_S**2 + TIME_S}, {"sample_rate_hz": 1000, "times": "ignore"}),
    ({}, {"sample_rate_hz": 1004, "speed_m_per_s": None}),
    ({"note": ["x"] * N, "": range(N)}, {}),
    ({"speed_m_per_s": None, "speed_mm_per_s": SPEED * 1e3}, {}),
    ({"voltage_0_V": None, "voltage_0_mV": SIGNAL[0] * 1e3}, {}),
    ({"voltage_1_V": None, "voltage_1_uV": SIGNAL[1] * 1e6}, {}),
    ({"voltage_0_V": SIGNAL[0] * 1e3, "voltage_1_V": SIGNAL[1] * 1e3}, {"signal_unit": "mV"}),
    ({"voltage_0_V": -SIGNAL[0], "voltage_1_V": -SIGNAL[1]}, {"polarity": -1}),
    ({"voltage_1_V": -SIGNAL[1]}, {"polarity": [1, -1]}),
    ({"voltage_0_V": SIGNAL[0] * 50, "voltage_1_V": SIGNAL[1] * 50}, {"gain": 50}),
    ({"voltage_1_V": -SIGNAL[1] * 7}, {"gain": [None, 7.0], "polarity": [None, -1]}),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "stated"), FORMS)
def test_units_times_polarity_and_gain(tmp_path, changes, stated):
    write_csv(tmp_path / "r.csv", columns(**changes))
    got = load(tmp_path / "r.csv", **stated)
    np.testing.assert_allclose(got.signal, SIGNAL, rtol=1e-14)
    np.testing.assert_allclose(got.time_s, TIME_S, rtol=1e-14)
    np.testing.assert_allclose(got.speed_m_per_s, SPEED, rtol=1e-14)
    assert (set(got.channels), got.signal_unit) == ({"voltage_0_V", "voltage_1_V"}, "V")
    # They are done with: a recording that is saved and loaded again is the same.
    assert "gain" not in got.sidecar
    save(got, tmp_path / "again.csv")
    np.testing.assert_array_equal(load(tmp_path / "again.csv").signal, got.signal)


CHANNELS = [
    ({"voltage_10_V": TIME_S, "voltage_2_V": TIME_S}, {},
     ("voltage_0_V", "voltage_1_V", "voltage_2_V", "voltage_10_V"), "V"),
    ({"raw": TIME_S}, {"channels": ["raw", "voltage_1_V"]}, ("raw", "voltage_1_V"), "counts"),
    ({"raw": TIME_S}, {"channels": "raw", "signal_unit": "N"}, ("raw",), "N"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "stated", "channels", "unit"), CHANNELS)
def test_channels(tmp_path, changes, stated, channels, unit):
    table = columns(**changes)
    write_csv(tmp_path / "r.csv", table)
    got = load(tmp_path / "r.csv", **stated)
    assert (got.channels, got.signal_unit) == (channels, unit)
    np.testing.assert_array_equal(got.signal, [table[channel] for channel in channels])


# Motion: columns in place of the good ones, the sidecar, what is stated, and the speed.
PHASE = 2 * np.pi * TIME_S / TIME_S[-1]
POSITION = 1e-3 * (np.sin(PHASE) - 3 * TIME_S)
SPEEDS = [
    ({}, {"speed_m_per_s": 0.1}, {}, SPEED),
    ({}, {}, {"speed_m_per_s": 0.2}, 0.2),
    ({"speed_m_per_s": None}, {"speed_m_per_s": 0.1}, {}, 0.1),
    ({"speed_m_per_s": None}, {"speed_m_per_s": 0.1}, {"speed_m_per_s": 1}, 1),
    ({"speed_m_per_s": None, "position_m": 2 * TIME_S}, {"speed_m_per_s": 0.1}, {}, 2),
    ({"position_m": POSITION}, {}, {}, SPEED),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "sidecar", "stated", "speed"), SPEEDS)
def test_which_speed_is_taken(tmp_path, changes, sidecar, stated, speed):
    """What is typed replaces a column, and a sidecar does not."""
    write_csv(tmp_path / "r.csv", columns(**changes))
    (tmp_path / "r.json").write_text(json.dumps(sidecar))
    got = load(tmp_path / "r.csv", **stated)
    np.testing.assert_allclose(got.speed_m_per_s, np.broadcast_to(speed, N), rtol=1e-10)
    if "position_m" in changes:
        np.testing.assert_array_equal(got.position_m, changes["position_m"])


def test_a_stated_speed_replaces_positions(tmp_path):
    write_csv(tmp_path / "r.csv", columns(position_m=POSITION))
    got = load(tmp_path / "r.csv", speed_m_per_s=0.05)
    assert got.measured_position_m is None
    np.testing.assert_allclose(got.position_m, 0.05 * TIME_S, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize(("unit", "per_m"), [("m", 1), ("mm", 1e3), ("um", 1e6)])
def test_position_in_place_of_speed(tmp_path, unit, per_m):
    table = columns(speed_m_per_s=None, **{f"position_{unit}": POSITION * per_m})
    write_csv(tmp_path / "r.csv", table)
    got = load(tmp_path / "r.csv")
    np.testing.assert_allclose(got.position_m, POSITION, rtol=1e-14)
    speed = 1e-3 * (np.cos(PHASE) * 2 * np.pi / TIME_S[-1] - 3)
    np.testing.assert_allclose(got.speed_m_per_s, speed, atol=0.01 * np.abs(speed).max())


# The sidecar

SIDECARS = {
    "r.json": '{"sensor": {"depth_m": 0.00075, "strips": 1}, "description": "b", "gain": 1e7}',
    "r.yaml": "sensor: {depth_m: 75e-5, strips: 1}\ndescription: b\ngain: 1.0e7\n",
    "r.yml": "sensor:\n  depth_m: 0.00075\n  strips: 1\ndescription: 'b'\ngain: 1e7\n",
    "elsewhere.YAML": "{sensor: {depth_m: .00075, strips: 1}, description: b, gain: 1E+7}",
}


@pytest.mark.parametrize("name", SIDECARS)
def test_sidecar_beside_or_named_and_what_is_stated_wins(tmp_path, name):
    write_csv(tmp_path / "r.csv", COLUMNS)
    (tmp_path / name).write_text(SIDECARS[name])
    named = None if name.startswith("r.") else tmp_path / name
    stated = {"sensor": {"strips": 2, "elements": None}, "description": None}
    got = load(tmp_path / "r.csv", sidecar=named, **stated)
    assert got.sidecar == {"sensor": {"depth_m": 7.5e-4, "strips": 2}, "description": "b"}
    np.testing.assert_array_equal(got.signal, SIGNAL / 1e7)


@pytest.mark.parametrize(
    ("sidecar", "stated", "expected"),
    [
        ({"a": {"b": 1, "c": 2}}, {"a": {"b": 3}}, {"a": {"b": 3, "c": 2}}),
        ({"a": 1}, {"a": {"b": {"c": 3}}}, {"a": {"b": {"c": 3}}}),
        ({"a": {"b": 1}}, {"a": 5}, {"a": 5}),
        ({"a": [1, 2]}, {"a": [3], "d": None}, {"a": [3]}),
        ({"a": {"b": 1}}, {"a": {"b": None}}, {"a": {"b": 1}}),
        ({"a": 1}, {"a": 0, "b": False}, {"a": 0, "b": False}),
    ],
)
def test_merge(sidecar, stated, expected):
    before = json.dumps([sidecar, stated])
    assert merge(sidecar, stated) == expected
    assert json.dumps([sidecar, stated]) == before
