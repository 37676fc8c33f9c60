"""Recordings: what one offers and refuses, what is written and read again, and real ones."""

import json
import os
from typing import Any

import numpy as np
import pytest
import xarray as xr

from srsinv.errors import BadInput
from srsinv.recording import Recording, check_settings, load, save
from srsinv.recording.even import on_even_times
from tests.recording.files import COLUMNS, SIGNAL, SPEED, TIME_S, N, columns, write_csv
from tests.refusals import refused
from tests.shared import SHARED, needs_shared

SIDECAR = {"sensor": {"depth_m": 7.5e-4}, "skin": {"model": "half_space"}}
POSITION = 1e-3 * (np.sin(500 * TIME_S) - 3 * TIME_S)


def same(a, b) -> bool:
    """Equal to the bit, missing samples included."""
    return np.asarray(a).tobytes() == np.asarray(b).tobytes()


def recording(**changes: Any) -> Recording:
    fields = {
        "signal": SIGNAL,
        "time_s": TIME_S,
        "speed_m_per_s": SPEED,
        "channels": ("voltage_0_V", "voltage_1_V"),
        "sidecar": SIDECAR,
        "name": "made",
    }
    return Recording(**(fields | changes))


# What a recording offers


def test_position_is_the_exact_integral_of_the_speed():
    time_s = np.cumsum(np.random.default_rng(1).uniform(0.5e-3, 2e-3, N))
    speed = 0.05 + 3 * time_s
    got = recording(time_s=time_s, speed_m_per_s=speed, sidecar={"scan_start_m": -0.002})
    exact = -0.002 + 0.05 * (time_s - time_s[0]) + 1.5 * (time_s**2 - time_s[0] ** 2)
    np.testing.assert_allclose(got.position_m, exact, rtol=1e-13, atol=1e-16)
    assert recording(sidecar={"scan_start_m": None}).position_m[0] == 0


@pytest.mark.parametrize(
    ("speed", "rtol", "constant"),
    [
        (np.full(N, -0.05), 1e-12, True),
        (np.full(N, 0.0), 1e-12, True),
        (SPEED, 1e-6, False),
        (-SPEED, 0.3, True),
    ],
)
def test_constant_speed(speed, rtol, constant):
    assert recording(speed_m_per_s=speed).is_constant_speed(rtol) is constant


def test_rate_and_jitter():
    got = recording()
    assert got.sample_rate_hz == pytest.approx(1000, rel=1e-12)
    assert got.sampling_jitter < 1e-12
    late = TIME_S.copy()
    late[-1] += 0.25e-3
    assert recording(time_s=late).sampling_jitter == pytest.approx(0.25, rel=1e-9)
    assert recording(time_s=late).sample_rate_hz == pytest.approx(11 / 0.01125, rel=1e-12)


def test_resample_uniform():
    time_s = TIME_S + 1e-4 * np.sin(np.arange(N))
    lines = np.stack([2 * time_s - 1, 5 - 300 * time_s])
    fields = {"signal": lines, "time_s": time_s, "speed_m_per_s": 0.05 + time_s}
    got = recording(**fields, measured_position_m=POSITION).resample_uniform()
    assert (got.time_s[0], got.time_s[-1]) == (time_s[0], time_s[-1])
    assert got.sampling_jitter < 1e-10
    np.testing.assert_allclose(got.signal, [2 * got.time_s - 1, 5 - 300 * got.time_s], rtol=1e-12)
    np.testing.assert_allclose(got.speed_m_per_s, 0.05 + got.time_s, rtol=1e-12)
    np.testing.assert_array_equal(got.position_m, np.interp(got.time_s, time_s, POSITION))
    lines[0, 3] = np.nan
    missing = np.isnan(recording(time_s=time_s, signal=lines).resample_uniform().signal)
    assert 1 <= missing[0].sum() <= 2
    assert not missing[1].any()


def test_a_recording_has_its_own_data():
    signal, sidecar = SIGNAL.copy(), {"sensor": {"depth_m": 1.0}}
    got = recording(signal=signal, sidecar=sidecar)
    signal[:], sidecar["sensor"]["depth_m"] = 0, 2.0
    assert same(got.signal, SIGNAL)
    assert got.sidecar["sensor"]["depth_m"] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        got.signal[0, 0] = 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"signal": SIGNAL[0]}, "(element, sample)"),
        ({"signal": SIGNAL[:1]}, "2 channels"),
        ({"speed_m_per_s": SPEED[:-1]}, "(11,)"),
        ({"measured_position_m": POSITION[:-1]}, "(11,) for 12 samples"),
        ({"signal": SIGNAL * np.inf}, "voltage_0_V is not finite at data row 1"),
        ({"speed_m_per_s": np.where(TIME_S > 0.002, np.nan, 1)}, "row 4"),
        ({"measured_position_m": np.where(TIME_S > 0.003, np.inf, TIME_S)}, "position_m"),
        ({"time_s": TIME_S[::-1]}, "does not come after"),
        ({"time_s": TIME_S * 1e-297}, "less than 1e-18 s"),
        ({"time_s": TIME_S * 1e303}, "time_s is 1e+300"),
        ({"speed_m_per_s": SPEED * 1e300}, "speed_m_per_s is 4e+298"),
        ({"channels": ("a", "a")}, "twice"),
        ({"channels": ("a", "time_s")}, "'time_s' cannot name a channel"),
        ({"channels": ("a", " b")}, "without spaces"),
        ({"channels": (), "signal": np.empty((0, N))}, "at least one"),
    ],
)
def test_a_recording_is_refused(changes, words):
    with pytest.raises(BadInput, match=r"^made: ") as caught:
        recording(**changes)
    assert words in str(caught.value)


# What is written


@pytest.mark.parametrize("name", ["out.csv", "out.nc"])
@pytest.mark.parametrize("channels", [("voltage_0_V", "voltage_1_V"), ("raw; a,b", "[#2] µ")])
def test_round_trip_is_exact(tmp_path, name, channels):
    signal = SIGNAL / 3
    signal[0, 2], signal[1, :3] = np.nan, [-0.0, 5e-324, 1.7e308]
    sidecar = SIDECAR | {"scan_start_m": 0.1 + 0.2, "description": "Zoë"}
    sidecar["sensor"] = {"elements": [{"offset_m": None}, {}]}
    out = recording(
        signal=signal,
        time_s=TIME_S + 1 / 3,
        speed_m_per_s=SPEED / 7,
        measured_position_m=POSITION,
        channels=channels,
        signal_unit="counts",
        sidecar=sidecar,
    )
    save(out, tmp_path / name)
    got = load(tmp_path / name, missing="allow")
    for field in ("signal", "time_s", "speed_m_per_s", "measured_position_m"):
        assert same(getattr(got, field), getattr(out, field)), field
    assert (got.channels, got.signal_unit, got.sidecar) == (channels, "counts", sidecar)
    assert got.name == name
    expected = {"out.csv": ["out.csv", "out.json"], "out.nc": ["out.nc"]}[name]
    assert sorted(os.listdir(tmp_path)) == expected


def test_netcdf_states_its_units(tmp_path):
    save(recording(signal_unit="mV"), tmp_path / "out.nc")
    with xr.open_dataset(tmp_path / "out.nc", decode_timedelta=False) as dataset:
        units = {name: variable.attrs["units"] for name, variable in dataset.variables.items()}
    assert units == {
        "time_s": "s",
        "speed_m_per_s": "m/s",
        "voltage_0_V": "mV",
        "voltage_1_V": "mV",
    }


@pytest.mark.parametrize("name", ["out.csv", "out.nc"])
def test_save_replaces_a_recording_of_the_same_facts(tmp_path, name):
    for factor in (1, 2):
        save(recording(signal=SIGNAL * factor), tmp_path / name)
    assert same(load(tmp_path / name).signal, SIGNAL * 2)


@pytest.mark.parametrize("name", ["out.csv", "out.nc"])
def test_a_broken_save_leaves_the_old_file(tmp_path, name, monkeypatch):
    save(recording(), tmp_path / name)
    before = (tmp_path / name).read_bytes()

    def fails(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(BadInput, match="No space left"):
        save(recording(signal=SIGNAL * 2), tmp_path / name)
    assert (tmp_path / name).read_bytes() == before
    assert [file for file in os.listdir(tmp_path) if file.startswith(".")] == []


# (where it is saved, changes of the recording, what stands there already, words of the refusal)
TAKEN: dict[str, tuple[str, dict[str, Any], dict[str, str], str]] = {
    "suffix": ("out.npz", {}, {}, ".csv, .nc"),
    "no suffix": ("out", {}, {}, "''"),
    "a name with a stroke": ("out.nc", {"channels": ("a", "N/m")}, {}, "without '/'"),
    "no such folder": ("nowhere/out.csv", {}, {}, "an existing, writable folder"),
    "no such folder, netCDF": ("nowhere/out.nc", {}, {}, "an existing, writable folder"),
    "a sidecar": ("out.csv", {}, {"out.json": '{"gain": 100}', "out.csv": "a\n"}, "out.json"),
    "data alone": ("out.csv", {}, {"out.csv": "time_s,voltage_0_V\n"}, "out.json"),
    "a sidecar in YAML": ("out.csv", {}, {"out.yaml": "gain: 100\n"}, "out.yaml"),
    "the other name of it": ("out.csv", {}, {"out.yml": "gain: 1\n"}, "out.yml"),
    "a sidecar of netCDF": ("out.nc", {}, {"out.yaml": "gain: 5\n"}, "out.yaml"),
    "no netCDF": ("out.nc", {}, {"out.nc": "mine"}, "choose another name, or move it away"),
}


@pytest.mark.parametrize("case", TAKEN)
def test_save_leaves_what_it_did_not_write(tmp_path, case):
    name, changes, existing, words = TAKEN[case]
    for each, text in existing.items():
        (tmp_path / each).write_text(text)
    refused(lambda: save(recording(**changes), tmp_path / name), words)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == existing


def test_netcdf_of_somebody_is_left_alone(tmp_path):
    xr.Dataset({"raw": ("x", [1.0])}).to_netcdf(tmp_path / "out.nc", engine="h5netcdf")
    before = (tmp_path / "out.nc").read_bytes()
    refused(lambda: save(recording(), tmp_path / "out.nc"), "choose another name")
    assert (tmp_path / "out.nc").read_bytes() == before
    (tmp_path / "other.nc").mkdir()
    refused(lambda: save(recording(), tmp_path / "other.nc"), "choose another name")


def test_prepared_signals_and_infinite_facts_are_not_saved(tmp_path):
    facts = recording()
    facts.sidecar["gain"] = np.inf
    refused(lambda: save(facts, tmp_path / "out.csv"), "finite numbers")
    prepared = on_even_times(recording(sidecar={"detrend": "constant"}))
    refused(lambda: save(prepared, tmp_path / "out.csv"), "filtered already")
    assert os.listdir(tmp_path) == []


def test_a_file_that_was_looked_at_is_not_read_again_unless_it_changed(tmp_path):
    path, other = tmp_path / "r.csv", tmp_path / "other.csv"
    write_csv(path, COLUMNS)
    text, before = path.read_text(), path.stat()
    check_settings({"path": str(path)})
    path.write_text(text.replace("0", "7"))  # under the same size and time: not noticed, not read
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert same(load(path).signal, SIGNAL)
    write_csv(path, COLUMNS)
    check_settings({"path": str(path)})
    write_csv(other, columns(voltage_0_V=2 * SIGNAL[0]))
    other.replace(path)
    assert same(load(path).signal[0], 2 * SIGNAL[0])


# The recordings beside the project


@needs_shared
@pytest.mark.parametrize(
    ("name", "elements", "rate_hz", "length_m", "constant"),
    [
        ("ridge_one_element", 1, 5000, 0.016, True),
        ("ridge_two_element", 2, 10000, 0.020, True),
        ("ridge_varying_speed", 2, 10000, 0.020229, False),
        ("tape_two_element", 2, 5000, 0.030, True),
    ],
)
def test_simulated_recordings(name, elements, rate_hz, length_m, constant):
    path = SHARED / "recordings" / f"{name}.csv"
    got = load(path)
    assert got.signal.shape == (elements, got.time_s.size)
    assert got.sample_rate_hz == pytest.approx(rate_hz, rel=1e-9)
    assert got.sampling_jitter < 1e-9
    assert got.position_m[0] == 0
    assert got.position_m[-1] == pytest.approx(length_m, abs=2e-5)
    assert got.is_constant_speed() is constant
    assert got.signal_unit == "V"
    assert got.sidecar == json.loads(path.with_suffix(".json").read_text())


@needs_shared
def test_real_recording():
    path = SHARED / "recordings" / "fabricslide" / "Board10mm_F120_V-10mmps_0.csv"
    got = load(path, time_unit="ms", channels=["channel5"], speed_m_per_s=0.01)
    assert got.signal.shape == (1, 539)
    assert (got.signal[0, :3].tolist(), got.signal_unit) == ([127, 128, 129], "counts")
    assert got.time_s[0] == 89.819
    assert got.sampling_jitter == pytest.approx(1 / 28)
    uniform = got.resample_uniform()
    assert uniform.sampling_jitter < 1e-9
    assert uniform.sample_rate_hz == pytest.approx(35.5, rel=0.01)
    assert uniform.position_m[-1] == pytest.approx(0.01 * (got.time_s[-1] - got.time_s[0]))
    with pytest.raises(BadInput, match="one of s, ms, us"):
        load(path, channels=["channel5"], speed_m_per_s=0.01)
    every = load(path, time_unit="ms", speed_m_per_s=0.01)
    assert every.channels == tuple(f"channel{number}" for number in range(1, 17))
