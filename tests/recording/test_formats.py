"""Every format gives the same recording; units, motion and wiring come out in SI."""

import json

import h5py
import numpy as np
import pytest
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from srsinv.errors import BadInput
from srsinv.files import open_file
from srsinv.recording import Recording, facts_of, load, save
from srsinv.recording.formats.matlab import Matlab
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
from tests.recording.harmful import matlab_object


@pytest.mark.parametrize("format", [format for format in FORMATS if format not in WITHOUT_TIMES])
def test_every_format_gives_the_same_recording(tmp_path, format):
    got = load(write(format, tmp_path))
    np.testing.assert_array_equal(got.signal, SIGNAL)
    np.testing.assert_array_equal(got.time_s, TIME_S)
    np.testing.assert_array_equal(got.speed_m_per_s, SPEED)
    assert (got.channels, got.signal_unit) == (("voltage_0_V", "voltage_1_V"), "V")
    assert got.sidecar == {}


def test_matlab_vectors_of_either_shape_and_what_stands_beside_them(tmp_path):
    beside = {"note": "run 3", "rig": {"a": 1.0}, "calibration": np.eye(3)}
    table = {name: values[None] for name, values in COLUMNS.items()} | beside
    write_mat(tmp_path / "r.mat", table)
    np.testing.assert_array_equal(load(tmp_path / "r.mat").signal, SIGNAL)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i8"])
def test_matlab_classes(tmp_path, kind, compressed):
    raw = np.arange(1, N + 1).astype(kind)
    table = {"time_s": np.arange(N), "speed_m_per_s": np.ones(N), "a": raw}
    savemat(tmp_path / "r.mat", table, do_compression=compressed)
    np.testing.assert_array_equal(load(tmp_path / "r.mat", channels="a").signal[0], raw)


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
    assert got.signal.min() == -1
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


# Units in names

UNITS = [
    ({"time_s": None, "time_us": TIME_S * 1e6}, {}),
    ({"speed_m_per_s": None, "speed_mm_per_s": SPEED * 1e3}, {}),
    ({"voltage_0_V": None, "voltage_0_mV": SIGNAL[0] * 1e3}, {}),
    ({"voltage_1_V": None, "voltage_1_uV": SIGNAL[1] * 1e6}, {}),
    (
        {"voltage_0_V": None, "voltage_1_V": None, "voltage_0_mV": SIGNAL[0] * 1e3,
         "voltage_1_mV": SIGNAL[1] * 1e3},
        {"channels": ["voltage_0_mV", "voltage_1_mV"]},
    ),
    (
        {"voltage_0_V": SIGNAL[0] * 1e3, "voltage_1_V": SIGNAL[1] * 1e3},
        {"signal_unit": "mV"},
    ),
    ({"voltage_0_V": -SIGNAL[0], "voltage_1_V": -SIGNAL[1]}, {"polarity": -1}),
    ({"voltage_1_V": -SIGNAL[1]}, {"polarity": [1, -1]}),
    ({"voltage_0_V": SIGNAL[0] * 50, "voltage_1_V": SIGNAL[1] * 50}, {"gain": 50}),
    ({"voltage_1_V": -SIGNAL[1] * 7}, {"gain": [None, 7.0], "polarity": [None, -1]}),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "stated"), UNITS)
def test_units_polarity_and_gain(tmp_path, changes, stated):
    write_csv(tmp_path / "r.csv", columns(**changes))
    got = load(tmp_path / "r.csv", **stated)
    np.testing.assert_allclose(got.signal, SIGNAL, rtol=1e-14)
    np.testing.assert_allclose(got.time_s, TIME_S, rtol=1e-14)
    np.testing.assert_allclose(got.speed_m_per_s, SPEED, rtol=1e-14)
    assert (set(got.channels), got.signal_unit) == ({"voltage_0_V", "voltage_1_V"}, "V")
    # They are done with: a recording that is saved and loaded again is the same.
    assert got.sidecar == {}
    save(got, tmp_path / "again.csv")
    np.testing.assert_array_equal(load(tmp_path / "again.csv").signal, got.signal)


def test_a_signal_that_is_no_column_is_not_left_out(tmp_path):
    with h5py.File(tmp_path / "r.h5", "w") as file:
        for name, values in columns(voltage_0_V=SIGNAL).items():
            file[name] = values
    with pytest.raises(BadInput, match="voltage_0_V has shape"):
        load(tmp_path / "r.h5")


# Measured positions

PHASE = 2 * np.pi * TIME_S / TIME_S[-1]
POSITION = 1e-3 * (np.sin(PHASE) - 3 * TIME_S)


@pytest.mark.parametrize("per_m", [1, 1e3, 1e6])
def test_position_in_place_of_speed(tmp_path, per_m):
    unit = {1: "m", 1e3: "mm", 1e6: "um"}[per_m]
    write_csv(
        tmp_path / "r.csv", columns(speed_m_per_s=None, **{f"position_{unit}": POSITION * per_m})
    )
    got = load(tmp_path / "r.csv")
    np.testing.assert_allclose(got.position_m, POSITION, rtol=1e-14)
    speed = 1e-3 * (np.cos(PHASE) * 2 * np.pi / TIME_S[-1] - 3)
    np.testing.assert_allclose(got.speed_m_per_s, speed, atol=0.01 * np.abs(speed).max())


def test_speed_from_positions_converges_with_fifth_order(tmp_path):
    errors = []
    for n in (20, 40, 80):
        time_s = np.linspace(5.0, 6.0, n)
        table = {"time_s": time_s, "position_m": np.sin(4 * time_s), "voltage_0_V": time_s}
        np.savez(tmp_path / "r.npz", **table)
        speed = load(tmp_path / "r.npz").speed_m_per_s
        errors.append(np.max(np.abs(speed - 4 * np.cos(4 * time_s))))
    slopes = np.diff(np.log2(errors))
    assert np.all(slopes < -4.5), slopes


@pytest.mark.parametrize("samples", [3, 4, 5, 6])
def test_speed_of_few_positions(tmp_path, samples):
    time_s = np.arange(samples) * 0.1
    table = {"time_s": time_s, "position_m": 2 - 3 * time_s**2, "voltage_0_V": time_s}
    np.savez(tmp_path / "r.npz", **table)
    np.testing.assert_allclose(load(tmp_path / "r.npz").speed_m_per_s, -6 * time_s, atol=1e-12)


def test_position_beside_speed_and_a_known_speed_over_both(tmp_path):
    write_csv(tmp_path / "r.csv", columns(position_m=POSITION))
    both = load(tmp_path / "r.csv")
    np.testing.assert_array_equal(both.speed_m_per_s, SPEED)
    np.testing.assert_array_equal(both.position_m, POSITION)
    with_speed = load(tmp_path / "r.csv", speed_m_per_s=0.05)
    assert with_speed.measured_position_m is None
    np.testing.assert_allclose(with_speed.position_m, 0.05 * TIME_S, rtol=1e-12, atol=1e-18)


def test_a_speed_in_the_sidecar_does_not_replace_positions(tmp_path):
    write_csv(tmp_path / "r.csv", columns(speed_m_per_s=None, position_m=2 * TIME_S))
    (tmp_path / "r.json").write_text(json.dumps({"speed_m_per_s": 0.1}))
    np.testing.assert_allclose(load(tmp_path / "r.csv").speed_m_per_s, 2, rtol=1e-10)


def test_positions_follow_through_resampling_and_files(tmp_path):
    time_s = TIME_S + 1e-4 * np.sin(np.arange(N))
    scan = Recording(
        SIGNAL, time_s, SPEED, ("a", "b"), {"scan_start_m": 9.0}, measured_position_m=POSITION
    )
    even = scan.resample_uniform()
    np.testing.assert_array_equal(even.position_m, np.interp(even.time_s, time_s, POSITION))
    for name in ("out.csv", "out.nc"):
        save(scan, tmp_path / name)
        again = load(tmp_path / name, channels=["a", "b"])
        np.testing.assert_array_equal(again.measured_position_m, POSITION)
        np.testing.assert_array_equal(again.speed_m_per_s, SPEED)


@pytest.mark.parametrize(
    ("position", "words"),
    [
        (POSITION[:-1], "(11,) for 12 samples"),
        (np.where(TIME_S > 0.003, np.inf, TIME_S), "position_m is not finite at data row 5"),
    ],
)
def test_positions_are_refused(position, words):
    with pytest.raises(BadInput) as caught:
        Recording(SIGNAL, TIME_S, SPEED, ("a", "b"), measured_position_m=position)
    assert words in str(caught.value)


def test_positions_that_stand_still_or_start(tmp_path):
    """No swing of a spline makes a motion of rest, or turns one that never goes back."""
    time_s = np.arange(400) / 1000
    at_rest, starting = 0.01 + 0 * time_s, 0.05 * np.maximum(time_s - 0.1, 0)
    for position_m, fastest in ((at_rest, 0.0), (starting, 0.05)):
        np.savez(tmp_path / "r.npz", time_s=time_s, position_m=position_m, voltage_0_V=time_s)
        speed = load(tmp_path / "r.npz").speed_m_per_s
        assert speed.min() >= 0
        np.testing.assert_allclose(speed.max(), fastest, rtol=1e-9)


def test_facts_within_a_file_are_stated_too(tmp_path):
    """A gain in the file's own sidecar is applied on loading, and a calibration counts it in."""
    variables = {name: ("sample", values) for name, values in COLUMNS.items()}
    inside = xr.Dataset(variables, attrs={"sidecar": json.dumps({"gain": 7.0})})
    inside.to_netcdf(tmp_path / "r.nc", engine="h5netcdf")
    settings = {"path": str(tmp_path / "r.nc"), "polarity": -1}
    assert facts_of(settings) == {"gain": 7.0, "polarity": -1}
    np.testing.assert_allclose(load(tmp_path / "r.nc").signal, SIGNAL / 7)
