"""Recordings: what is read, what is written, and what is refused."""

import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from srsinv.errors import BadInput
from srsinv.recording import Recording, check_settings, load, merge, save
from tests.shared import SHARED, needs_shared

N = 12
TIME_S = np.arange(N) / 1000
SPEED = np.linspace(0.04, 0.06, N)
SIGNAL = np.random.default_rng(7).normal(size=(2, N)) * 1e-6
COLUMNS = {
    "time_s": TIME_S,
    "speed_m_per_s": SPEED,
    "voltage_0_V": SIGNAL[0],
    "voltage_1_V": SIGNAL[1],
}
SIDECAR = {"sensor": {"depth_m": 7.5e-4}, "skin": {"model": "half_space"}}


def columns(**changes):
    """The good columns with some replaced, added or, by None, left out."""
    return {name: values for name, values in (COLUMNS | changes).items() if values is not None}


def with_value(name, row, value):
    """The good columns, as text, with one cell replaced."""
    cells = [repr(float(v)) for v in COLUMNS[name]]
    cells[row] = value
    return columns(**{name: cells})


def write_csv(path, table, *, delimiter=",", before="", encoding="utf-8", newline="\n"):
    rows = [list(table), *zip(*table.values(), strict=True)]
    text = before + "".join(delimiter.join(map(str, row)) + newline for row in rows)
    path.write_bytes(text.encode(encoding))


def write_npz(path, table):
    np.savez(path, **table)


def write_h5(path, table, group="/"):
    with h5py.File(path, "a") as file:
        for name, values in table.items():
            file.require_group(group)[name] = values


def write_nc(path, table, **attrs):
    lengths = {len(values): f"n{len(values)}" for values in table.values()}
    variables = {name: (lengths[len(values)], values) for name, values in table.items()}
    xr.Dataset(variables, attrs=attrs).to_netcdf(path, engine="h5netcdf")


WRITERS = {
    "r.csv": write_csv,
    "r.txt": lambda path, table: write_csv(path, table, delimiter=";"),
    "r.tsv": lambda path, table: write_csv(path, table, delimiter="\t"),
    "r.CSV": lambda path, table: write_csv(path, table, encoding="utf-8-sig", newline="\r\n"),
    "comments.csv": lambda path, table: write_csv(path, table, before="# rig 3, run 2\n\n# ok\n"),
    "spaces.csv": lambda path, table: write_csv(path, table, delimiter=" , "),
    "r.npz": write_npz,
    "r.h5": write_h5,
    "group.hdf5": lambda path, table: write_h5(path, table, "scan"),
    "r.nc": write_nc,
}


def same(a, b):
    """Equal to the bit, missing samples included."""
    return np.asarray(a).tobytes() == np.asarray(b).tobytes()


def recording(**changes):
    fields = {
        "signal": SIGNAL,
        "time_s": TIME_S,
        "speed_m_per_s": SPEED,
        "channels": ("voltage_0_V", "voltage_1_V"),
        "sidecar": SIDECAR,
        "name": "made",
    }
    return Recording(**(fields | changes))


# What is read


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_recording(tmp_path, name):
    WRITERS[name](tmp_path / name, COLUMNS)
    got = load(tmp_path / name)
    assert same(got.signal, SIGNAL)
    assert same(got.time_s, TIME_S)
    assert same(got.speed_m_per_s, SPEED)
    assert (got.channels, got.signal_unit) == (("voltage_0_V", "voltage_1_V"), "V")
    assert (got.sidecar, got.name) == ({}, name)


@pytest.mark.parametrize(
    ("table", "known"),
    [
        (columns(time_s=None, time_ms=TIME_S * 1e3), {}),
        (columns(time_s=None, time_us=TIME_S * 1e6), {}),
        (columns(time_s=None, timestamp=TIME_S * 1e3), {"time_unit": "ms"}),
        (columns(time_s=None, time=TIME_S * 1e6), {"time_unit": "us"}),
        (columns(time_s=None, t=TIME_S), {"time_unit": "s"}),
        (columns(time_s=None), {"sample_rate_hz": 1000}),
        (columns(time_s=TIME_S**2 + TIME_S), {"sample_rate_hz": 1000, "times": "ignore"}),
        (columns(), {"sample_rate_hz": 1004}),
    ],
)
def test_time(tmp_path, table, known):
    write_csv(tmp_path / "r.csv", table)
    np.testing.assert_allclose(load(tmp_path / "r.csv", **known).time_s, TIME_S, rtol=1e-15)


@pytest.mark.parametrize("name", ["r.h5", "r.nc"])
def test_units_of_the_file(tmp_path, name):
    path = tmp_path / name
    table = {"time": (TIME_S * 1e3, "ms"), "gauge": (SIGNAL[0], "mV")}
    variables = {n: ("sample", values, {"units": unit}) for n, (values, unit) in table.items()}
    xr.Dataset(variables).to_netcdf(path, engine="h5netcdf")
    got = load(path, channels="gauge", speed_m_per_s=0.05)
    np.testing.assert_allclose(got.time_s, TIME_S, rtol=1e-15)
    assert got.signal_unit == "V"
    assert same(got.signal, SIGNAL[:1] / 1000)


@pytest.mark.parametrize(
    ("table", "sidecar", "known", "expected"),
    [
        (columns(), {}, {"speed_m_per_s": None}, SPEED),
        (columns(), {"speed_m_per_s": 0.1}, {}, SPEED),
        (columns(), {}, {"speed_m_per_s": 0.2}, np.full(N, 0.2)),
        (columns(speed_m_per_s=None), {"speed_m_per_s": 0.1}, {}, np.full(N, 0.1)),
        (columns(speed_m_per_s=None), {"speed_m_per_s": 0.1}, {"speed_m_per_s": 1}, np.ones(N)),
    ],
)
def test_speed(tmp_path, table, sidecar, known, expected):
    write_csv(tmp_path / "r.csv", table)
    (tmp_path / "r.json").write_text(json.dumps(sidecar))
    assert same(load(tmp_path / "r.csv", **known).speed_m_per_s, expected)


@pytest.mark.parametrize(
    ("table", "known", "channels", "unit"),
    [
        (
            columns(voltage_10_V=TIME_S, voltage_2_V=TIME_S),
            {},
            ("voltage_0_V", "voltage_1_V", "voltage_2_V", "voltage_10_V"),
            "V",
        ),
        (
            columns(raw=TIME_S),
            {"channels": ["raw", "voltage_1_V"]},
            ("raw", "voltage_1_V"),
            "counts",
        ),
        (columns(raw=TIME_S), {"channels": "raw", "signal_unit": "N"}, ("raw",), "N"),
        (columns(note=["x"] * N, **{"": range(N)}), {}, ("voltage_0_V", "voltage_1_V"), "V"),
    ],
)
def test_channels(tmp_path, table, known, channels, unit):
    write_csv(tmp_path / "r.csv", table)
    got = load(tmp_path / "r.csv", **known)
    assert (got.channels, got.signal_unit) == (channels, unit)
    assert same(got.signal, [table[channel] for channel in channels] + np.zeros(1))


@pytest.mark.parametrize("name", ["r.csv", "r.npz", "r.h5", "r.nc"])
def test_missing_samples_where_allowed(tmp_path, name):
    hole = with_value("voltage_1_V", 4, " ")
    expected = SIGNAL[1].copy()
    expected[4] = np.nan
    WRITERS[name](tmp_path / name, hole if name == "r.csv" else columns(voltage_1_V=expected))
    np.testing.assert_array_equal(load(tmp_path / name, missing="allow").signal[1], expected)


@pytest.mark.parametrize("units", ["seconds", "seconds since 2024-05-01"])
def test_netcdf_times_stay_numbers(tmp_path, units):
    variables = {name: ("sample", values, {"units": units}) for name, values in COLUMNS.items()}
    xr.Dataset(variables).to_netcdf(tmp_path / "r.nc", engine="h5netcdf")
    assert same(load(tmp_path / "r.nc").time_s, TIME_S)


def test_packed_netcdf_is_unpacked(tmp_path):
    dataset = xr.Dataset({name: ("sample", values) for name, values in COLUMNS.items()})
    packed = {"dtype": "int16", "scale_factor": 1e-9, "_FillValue": -9999}
    dataset.to_netcdf(tmp_path / "r.nc", engine="h5netcdf", encoding={"voltage_0_V": packed})
    np.testing.assert_allclose(load(tmp_path / "r.nc").signal[0], SIGNAL[0], atol=6e-10)


# The sidecar


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "r.json",
            '{"sensor": {"depth_m": 0.00075, "strips": 1}, "description": "b", "gain": 1e7}',
        ),
        ("r.yaml", "sensor: {depth_m: 75e-5, strips: 1}\ndescription: b\ngain: 1.0e7\n"),
        ("r.yml", "sensor:\n  depth_m: 0.00075\n  strips: 1\ndescription: 'b'\ngain: 1e7\n"),
        ("elsewhere.YAML", "{sensor: {depth_m: .00075, strips: 1}, description: b, gain: 1E+7}"),
    ],
)
def test_sidecar_beside_or_named_and_known_wins(tmp_path, name, text):
    write_csv(tmp_path / "r.csv", COLUMNS)
    (tmp_path / name).write_text(text)
    named = None if name.startswith("r.") else tmp_path / name
    got = load(
        tmp_path / "r.csv", sidecar=named, sensor={"strips": 2, "elements": None}, description=None
    )
    assert got.sidecar == {
        "sensor": {"depth_m": 7.5e-4, "strips": 2},
        "description": "b",
    }
    np.testing.assert_array_equal(got.signal, SIGNAL / 1e7)


@pytest.mark.parametrize(
    ("sidecar", "known", "expected"),
    [
        ({}, {}, {}),
        ({"a": {"b": 1, "c": 2}}, {"a": {"b": 3}}, {"a": {"b": 3, "c": 2}}),
        ({"a": 1}, {"a": {"b": {"c": 3}}}, {"a": {"b": {"c": 3}}}),
        ({"a": {"b": 1}}, {"a": 5}, {"a": 5}),
        ({"a": [1, 2]}, {"a": [3], "d": None}, {"a": [3]}),
        ({"a": {"b": 1}}, {"a": {"b": None}}, {"a": {"b": 1}}),
        ({"a": 1}, {"a": 0, "b": False}, {"a": 0, "b": False}),
    ],
)
def test_merge(sidecar, known, expected):
    before = json.dumps([sidecar, known])
    assert merge(sidecar, known) == expected
    assert json.dumps([sidecar, known]) == before


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
        (SPEED, 0.3, True),
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
    got = recording(time_s=time_s, signal=lines, speed_m_per_s=0.05 + time_s).resample_uniform()
    assert (got.time_s[0], got.time_s[-1]) == (time_s[0], time_s[-1])
    assert got.sampling_jitter < 1e-10
    np.testing.assert_allclose(got.signal, [2 * got.time_s - 1, 5 - 300 * got.time_s], rtol=1e-12)
    np.testing.assert_allclose(got.speed_m_per_s, 0.05 + got.time_s, rtol=1e-12)
    lines[0, 3] = np.nan
    missing = np.isnan(recording(time_s=time_s, signal=lines).resample_uniform().signal)
    assert 1 <= missing[0].sum() <= 2
    assert not missing[1].any()


def test_a_recording_keeps_its_own_data():
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
        ({"signal": SIGNAL * np.inf}, "voltage_0_V is not finite at data row 1"),
        ({"speed_m_per_s": np.where(TIME_S > 0.002, np.nan, 1)}, "row 4"),
        ({"time_s": TIME_S[::-1]}, "increase"),
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
        channels=channels,
        signal_unit="counts",
        sidecar=sidecar,
    )
    save(out, tmp_path / name)
    got = load(tmp_path / name, missing="allow")
    for field in ("signal", "time_s", "speed_m_per_s"):
        assert same(getattr(got, field), getattr(out, field)), field
    assert (got.channels, got.signal_unit, got.sidecar) == (channels, "counts", sidecar)
    assert got.name == name
    expected = {"out.csv": ["out.csv", "out.json"], "out.nc": ["out.nc"]}[name]
    assert sorted(os.listdir(tmp_path)) == expected


FOREIGN = {
    "netCDF of somebody's": lambda p: xr.Dataset({"raw": ("x", [1.0])}).to_netcdf(p / "out.nc"),
    "no netCDF": lambda p: (p / "out.nc").write_text("mine"),
    "a folder": lambda p: (p / "out.nc").mkdir(),
    "another's sidecar": lambda p: (p / "out.yaml").write_text("scan_start_m: 5.0"),
}


@pytest.mark.parametrize("make", FOREIGN.values(), ids=FOREIGN)
def test_netcdf_replaces_only_what_was_saved(tmp_path, make):
    save(recording(), tmp_path / "again.nc")
    save(recording(signal_unit="mV"), tmp_path / "again.nc")
    assert load(tmp_path / "again.nc").signal[0, 0] == SIGNAL[0, 0] / 1000
    make(tmp_path)
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(BadInput, match="choose another name, or move it away"):
        save(recording(), tmp_path / "out.nc")
    assert {path: path.is_file() and path.read_bytes() for path in tmp_path.iterdir()} == before


def test_netcdf_says_its_units(tmp_path):
    save(recording(signal_unit="mV"), tmp_path / "out.nc")
    with xr.open_dataset(tmp_path / "out.nc", decode_timedelta=False) as dataset:
        units = {name: variable.attrs["units"] for name, variable in dataset.variables.items()}
    assert units == {
        "time_s": "s",
        "speed_m_per_s": "m/s",
        "voltage_0_V": "mV",
        "voltage_1_V": "mV",
    }


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("out.npz", {}, ".csv, .nc"),
        ("out", {}, "cannot be written as ''"),
        ("out.nc", {"channels": ("a", "N/m")}, "without '/'"),
        ("nowhere/out.csv", {}, "a folder that is there"),
        ("nowhere/out.nc", {}, "a folder that is there"),
    ],
)
def test_save_is_refused_and_leaves_nothing(tmp_path, name, changes, words):
    with pytest.raises(BadInput) as caught:
        save(recording(**changes), tmp_path / name)
    assert_one_sentence(caught.value, Path(name).stem, words)
    assert os.listdir(tmp_path) == []


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


# (what stands there already, the file named in the refusal)
TAKEN = {
    "another recording's sidecar": ({"out.json": '{"gain": 100}'}, "out.json"),
    "the same, with data": ({"out.json": '{"gain": 100}', "out.csv": "time_s\n"}, "out.json"),
    "data alone": ({"out.csv": "time_s,voltage_0_V\n"}, "out.json"),
    "a sidecar in YAML": ({"out.yaml": "gain: 100\n"}, "out.yaml"),
    "the other name of it": ({"out.yml": "gain: 100\n", "out.csv": "a\n"}, "out.yml"),
}


@pytest.mark.parametrize(("existing", "named"), TAKEN.values(), ids=TAKEN)
def test_save_leaves_what_it_did_not_write(tmp_path, existing, named):
    for name, text in existing.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(BadInput) as caught:
        save(recording(), tmp_path / "out.csv")
    assert_one_sentence(caught.value, "out.csv", named, "choose another name")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == existing


def test_save_replaces_a_recording_of_the_same_facts(tmp_path):
    for factor in (1, 2):
        save(recording(signal=SIGNAL * factor), tmp_path / "out.csv")
    assert same(load(tmp_path / "out.csv").signal, SIGNAL * 2)


# What is refused


def text(content):
    return lambda path: path.write_text(content)


def raw(content):
    return lambda path: path.write_bytes(content)


def table(changed, **options):
    return lambda path: WRITERS[path.name](path, changed, **options)


def beside(name, content):
    """A good recording with this sidecar beside it."""

    def make(path):
        WRITERS[path.name](path, COLUMNS)
        (path.parent / name).write_text(content)

    return make


def cut(path):
    WRITERS[path.name](path, COLUMNS)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def other(name):
    """The bytes of another format under this name."""

    def make(path):
        WRITERS[name](path.parent / name, COLUMNS)
        (path.parent / name).rename(path)

    return make


def near_miss(path):
    write_csv(path.with_name("rr.csv"), COLUMNS)


def two_groups(path):
    write_h5(path, COLUMNS, "a")
    write_h5(path, COLUMNS, "b")


def dead_links(path):
    write_h5(path, {"x": TIME_S}, "a")
    with h5py.File(path, "a") as file:
        file["time_s"] = h5py.SoftLink("/nowhere")
        file["voltage_0_V"] = h5py.ExternalLink("elsewhere.h5", "/voltage_0_V")


def two_sidecars(path):
    beside("r.json", "{}")(path)
    beside("r.yaml", "{}")(path)


ELEMENTS = json.dumps({"sensor": {"elements": [{"offset_m": 0.0}]}})
NO_TIME = columns(time_s=None)
STUCK = np.where(np.arange(N) == 6, TIME_S[5], TIME_S)
SHORT = {name: values[:2] for name, values in COLUMNS.items()}
MANY = columns(voltage_0_V=None, voltage_1_V=None, **{f"c{i}": TIME_S for i in range(30)})
OBJECTS = np.array([1.0, None] * 6, dtype=object)
ROWS = "time_s,speed_m_per_s,voltage_0_V\n0,1,1\n1,1,{}\n2,1,1\n3,1,1\n"

# name: (file, how it is made, what load is told, words of the sentence)
REFUSED = {
    "no file": ("r.csv", near_miss, {}, ["no such file", "did you mean rr.csv"]),
    "no file nor a near one": ("r.nc", lambda path: None, {}, ["recording.path"]),
    "a folder": ("r.csv", lambda path: path.mkdir(), {}, ["a folder", "recording.path"]),
    "suffix": ("r.xlsx", text("x"), {}, ["'.xlsx'", ".csv", ".nc"]),
    "no suffix": ("recording", text("x"), {}, ["''", ".csv"]),
    "empty csv": ("r.csv", text(""), {}, ["is empty"]),
    "empty npz": ("r.npz", text(""), {}, ["is empty"]),
    "only comments": ("r.csv", text("# nothing\n\n"), {}, ["there is no table"]),
    "only a header": ("r.csv", text(ROWS.split("\n")[0]), {}, ["too few samples: 0", "at least 3"]),
    "two samples": ("r.csv", table(SHORT), {}, ["too few samples: 2", "longer recording"]),
    "two samples nc": ("r.nc", table(SHORT), {}, ["too few samples: 2"]),
    "no header": ("r.csv", text("0,1,2\n1,2,3\n"), {}, ["column_1", "recording.channels"]),
    "header commented out": ("r.csv", text("# t\n0,1\n1,2\n"), {}, ["column_1"]),
    "binary as csv": ("r.csv", other("r.h5"), {}, ["cannot be read as .csv", "suffix"]),
    "nul in csv": ("r.csv", raw(b"time_s,\0\n1,2\n"), {}, ["cannot be read as .csv"]),
    "one huge cell": ("r.csv", text("a\n" + "9" * 200_000), {}, ["cannot be read as .csv"]),
    "csv as npz": ("r.npz", other("r.csv"), {}, ["cannot be read as .npz"]),
    "csv as hdf5": ("r.h5", other("r.csv"), {}, ["cannot be read as .h5"]),
    "csv as netcdf": ("r.nc", other("r.csv"), {}, ["cannot be read as .nc"]),
    "old netcdf": ("r.nc", raw(b"CDF\x01" + bytes(40)), {}, ["cannot be read as .nc"]),
    "npz cut short": ("r.npz", cut, {}, ["cut short"]),
    "hdf5 cut short": ("r.h5", cut, {}, ["cut short"]),
    "netcdf cut short": ("r.nc", cut, {}, ["cut short"]),
    "csv cut short": (
        "r.csv",
        text(ROWS.format(1) + "4,1"),
        {},
        ["row 5 has 2 cells", "3 columns"],
    ),
    "one cell too many": ("r.csv", text(ROWS.format("0,05")), {}, ["row 2 has 4 cells"]),
    "column twice": ("r.csv", text("a, b,a\n1,2,3\n"), {}, ["'a' appears twice"]),
    "nan": ("r.csv", text(ROWS.format("nan")), {}, ["voltage_0_V, data row 2", "'nan'"]),
    "a word, missing allowed": (
        "r.csv",
        text(ROWS.format("bad")),
        {"missing": "allow"},
        ["data row 2 holds 'bad'"],
    ),
    "inf": ("r.csv", text(ROWS.format("-inf")), {}, ["voltage_0_V, data row 2", "'-inf'"]),
    "overflow": ("r.csv", text(ROWS.format("1e999")), {}, ["data row 2", "'1e999'"]),
    "empty cell": ("r.csv", text(ROWS.format("")), {}, ["data row 2 is empty", "missing=allow"]),
    "word": ("r.csv", table(with_value("voltage_1_V", 3, "o.1")), {}, ["voltage_1_V", "'o.1'"]),
    "decimal comma": ("r.txt", table(with_value("voltage_1_V", 3, "0,1")), {}, ["row 4", "'0,1'"]),
    "no time, allowed": (
        "r.csv",
        table(with_value("time_s", 1, "")),
        {"missing": "allow"},
        ["time_s, data row 2 is empty"],
    ),
    "no speed at a sample": (
        "r.csv",
        table(with_value("speed_m_per_s", 2, "")),
        {"missing": "allow"},
        ["speed_m_per_s, data row 3 is empty"],
    ),
    "nan in npz": ("r.npz", table(columns(voltage_0_V=SIGNAL[0] * np.nan)), {}, ["row 1", "nan"]),
    "inf in nc": (
        "r.nc",
        table(columns(voltage_0_V=np.where(np.arange(N) == 5, np.inf, 1))),
        {"missing": "allow"},
        ["data row 6 holds 'inf'"],
    ),
    "missing=": ("r.csv", table(COLUMNS), {"missing": "drop"}, ["'drop'", "refuse, allow"]),
    "time stands still": (
        "r.csv",
        table(columns(time_s=STUCK)),
        {},
        ["row 7 (0.005 s)", "increase"],
    ),
    "time goes back": (
        "r.npz",
        table(columns(time_s=-TIME_S)),
        {},
        ["data row 2", "reorder the rows"],
    ),
    "no time": ("r.csv", table(NO_TIME), {}, ["no time column", "recording.sample_rate_hz"]),
    "bare time": ("r.csv", table(NO_TIME | {"time": TIME_S}), {}, ["'time'", "s, ms, us"]),
    "time unit": (
        "r.csv",
        table(NO_TIME | {"t": TIME_S}),
        {"time_unit": "min"},
        ["min", "time_unit", "s, ms, us"],
    ),
    "rate of 0": (
        "r.csv",
        table(NO_TIME),
        {"sample_rate_hz": 0},
        ["sample_rate_hz is 0", "above 0"],
    ),
    "no speed": (
        "r.csv",
        table(columns(speed_m_per_s=None)),
        {},
        ["no speed", "recording.speed_m_per_s=..."],
    ),
    "speed in words": ("r.csv", table(COLUMNS), {"speed_m_per_s": "fast"}, ["'fast'", "number"]),
    "two speeds": (
        "r.csv",
        table(COLUMNS),
        {"speed_m_per_s": [1, 2]},
        ["[1, 2]", "finite"],
    ),
    "no channels": ("r.csv", table(MANY), {}, ["c17 and 12 more", "recording.channels=[...]"]),
    "channels empty": (
        "r.csv",
        table(COLUMNS),
        {"channels": []},
        ["is []", "command line"],
    ),
    "channels a number": (
        "r.csv",
        table(COLUMNS),
        {"channels": 5},
        ["is 5", "list of column names"],
    ),
    "wrong channel": (
        "r.csv",
        table(COLUMNS),
        {"channels": ["voltage_2V"]},
        ["'voltage_2V'", "nearest is voltage_", "speed_m_per_s"],
    ),
    "channel twice": ("r.csv", table(COLUMNS), {"channels": ["voltage_0_V"] * 2}, ["twice"]),
    "lengths npz": (
        "r.npz",
        table(columns(voltage_1_V=TIME_S[1:])),
        {},
        ["voltage_1_V 11", "same"],
    ),
    "lengths h5": ("r.h5", table(columns(time_s=TIME_S[1:])), {}, ["time_s 11"]),
    "lengths nc": ("r.nc", table(columns(speed_m_per_s=SPEED[1:])), {}, ["speed_m_per_s 11"]),
    "2-D npz": ("r.npz", table(columns(time_s=TIME_S[None])), {}, ["(1, 12)", "1-D"]),
    "scalar h5": ("r.h5", table(columns(speed_m_per_s=0.1)), {}, ["speed_m_per_s has shape ()"]),
    "pickled objects": (
        "r.npz",
        table(columns(time_s=OBJECTS)),
        {},
        ["time_s is not a plain array"],
    ),
    "text array": ("r.npz", table(columns(time_s=["0"] * N)), {}, ["of type <U1", "real numbers"]),
    "complex array": ("r.h5", table(columns(time_s=TIME_S * 1j)), {}, ["complex128"]),
    "two groups": ("r.h5", two_groups, {}, ["a, b", "one recording in one file"]),
    "dead links": ("r.h5", dead_links, {}, ["columns x", "recording.channels"]),
    "no such sidecar": (
        "r.csv",
        table(COLUMNS),
        {"sidecar": "r.csv.yaml"},
        ["there is no such sidecar", "recording.sidecar"],
    ),
    "sidecar's suffix": (
        "r.csv",
        table(COLUMNS),
        {"sidecar": "r.csv.txt"},
        ["'.txt'", "JSON or YAML"],
    ),
    "two sidecars": ("r.csv", two_sidecars, {}, ["r.json, r.yaml", "recording.sidecar"]),
    "broken JSON": ("r.csv", beside("r.json", '{"a": \n1,'), {}, ["r.json", "sidecar's JSON"]),
    "NaN in JSON": ("r.csv", beside("r.json", '{"a": NaN}'), {}, ["r.json", "NaN"]),
    "deep JSON": ("r.csv", beside("r.json", "[" * 200_000), {}, ["r.json", "sidecar's JSON"]),
    "broken YAML": ("r.csv", beside("r.yaml", "a: [1,\nb: 2"), {}, ["r.yaml", "sidecar's YAML"]),
    "YAML that runs": (
        "r.csv",
        beside("r.yaml", "a: !!python/object/apply:os.getcwd []"),
        {},
        ["r.yaml", "sidecar's YAML"],
    ),
    "YAML aliases": ("r.csv", beside("r.yaml", "a: &x [1]\nb: [*x, *x]"), {}, ["aliases"]),
    "sidecar a list": ("r.csv", beside("r.json", "[1]"), {}, ["r.json", "[1]", "mapping"]),
    "sidecar empty": ("r.csv", beside("r.yaml", ""), {}, ["r.yaml", "is empty"]),
    "embedded sidecar": (
        "r.nc",
        lambda path: write_nc(path, COLUMNS, sidecar="{"),
        {},
        ["attribute sidecar", "sidecar's JSON"],
    ),
    "negative depth": (
        "r.csv",
        table(COLUMNS),
        {"sensor": {"depth_m": -1e-3}},
        ["sensor.depth_m is -0.001", "above 0", "command line"],
    ),
    "YAML's 1_100": (
        "r.csv",
        beside("r.yml", "sensor: {elements: [{offset_m: 1_100}, {}]}"),
        {},
        ["sensor.elements[0].offset_m is '1_100'", "7.5e-4"],
    ),
    "sensor a number": ("r.csv", table(COLUMNS), {"sensor": 5}, ["sensor is 5", "mapping"]),
    "window": (
        "r.csv",
        table(COLUMNS),
        {"contact_window_m": [1, 0.5]},
        ["[1, 0.5]", "start below"],
    ),
    "half a window": ("r.csv", table(COLUMNS), {"contact_window_m": [None, 1]}, ["[None, 1]"]),
    "elements": ("r.csv", beside("r.json", ELEMENTS), {}, ["lists 1", "2 signal columns"]),
    "elements a word": ("r.csv", table(COLUMNS), {"sensor": {"elements": "x"}}, ["'x'", "a list"]),
}


def assert_one_sentence(error, name, *words):
    message = str(error)
    assert "\n" not in message
    assert name in message
    # The remedy follows the colon after what is wrong.
    assert len(message.split(": ")) >= 3
    for word in words:
        assert word in message


@pytest.mark.parametrize("case", REFUSED)
def test_load_is_refused(tmp_path, case):
    name, make, stated, words = REFUSED[case]
    make(tmp_path / name)
    stated = {k: tmp_path / v if k == "sidecar" else v for k, v in stated.items()}
    with pytest.raises(BadInput) as caught:
        load(tmp_path / name, **stated)
    assert_one_sentence(caught.value, "r." if "." in name else name, *words)


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
