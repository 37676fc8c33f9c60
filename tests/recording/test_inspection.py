"""A look at a file: what is found is what was put in, and the template can be used."""

import numpy as np
import pytest
import yaml

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording._health import clipping, quantisation_step, segment_length, spectrum
from srsinv.recording._sidecar import parse
from srsinv.recording._timing import timing
from srsinv.recording.inspection import inspect
from srsinv.recording.template import blanks, sidecar_template
from tests.recording.files import (
    COLUMNS,
    FORMATS,
    SPEED,
    TIME_S,
    WITHOUT_TIMES,
    N,
    columns,
    write,
    write_csv,
)
from tests.tiers import quick

NOISE = np.random.default_rng(5).normal(size=8192)


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_can_be_looked_at(tmp_path, format):
    inspection = inspect(write(format, tmp_path))
    assert inspection.rate_hz == pytest.approx(1000, rel=1e-9)
    assert len(inspection.signals) == 2
    for name, signal in inspection.signals.items():
        assert signal.unit == ("full scale" if name.startswith("channel") else "V")


ROLES = [
    ("time_ms", np.arange(N), "time", "ms", "the column's name"),
    ("timestamp", 500 + 28 * np.arange(N), "time", "ms", "a guess"),
    ("timestamp", 20_000 * np.arange(N), "time", "us", "a guess"),
    ("t", TIME_S, "time", "s", "a guess"),
    ("position_um", TIME_S, "position", "um", "the column's name"),
    ("speed_mm_per_s", SPEED, "speed", "mm/s", "the column's name"),
    ("velocity", SPEED, "other", "not stated", "its name is of a speed, and its unit"),
    ("velocity (rpm)", SPEED, "other", "rpm", "its name is of a speed"),
    ("voltage_3_mV", TIME_S, "signal", "mV", "the column's name"),
    ("load_cell", TIME_S, "other", "not stated", "in no unit of voltage"),
    ("note", ["x"] * N, "other", "not stated", "no numbers"),
]


@pytest.mark.parametrize(("name", "values", "role", "unit", "reason"), ROLES)
def test_roles_and_units(tmp_path, name, values, role, unit, reason):
    table = columns(**({f"{role}_s": None, f"{role}_m_per_s": None} if role != "other" else {}))
    write_csv(tmp_path / "r.csv", table | {name: values})
    (column,) = [c for c in inspect(tmp_path / "r.csv").columns if c.name == name]
    assert (column.role, column.unit) == (role, unit)
    assert column.reason.startswith(reason)


def test_names_that_load_would_not_know(tmp_path):
    write_csv(tmp_path / "r.csv", {"channel1": range(N), "temperature": range(N)})
    inspection = inspect(tmp_path / "r.csv")
    assert list(inspection.signals) == ["channel1"]
    assert (inspection.rate_hz, inspection.time_s) == (None, None)
    assert inspection.signals["channel1"].unit == "counts"
    with pytest.raises(BadInput):
        load(tmp_path / "r.csv")
    write_csv(tmp_path / "r.csv", {"a": range(N), "b": range(N)})
    assert list(inspect(tmp_path / "r.csv").signals) == ["a", "b"]


def test_numbers_of_a_column_with_holes(tmp_path):
    write_csv(tmp_path / "r.csv", columns(voltage_0_V=[3, -4, "", "x", "nan", *[0] * 7]))
    (column,) = [c for c in inspect(tmp_path / "r.csv").columns if c.name == "voltage_0_V"]
    assert (column.samples, column.missing) == (12, 3)
    assert (column.least, column.greatest) == (-4, 3)
    assert column.mean == pytest.approx(-1 / 9)
    assert column.rms == pytest.approx(5 / 3)


def test_gaps_and_disorder():
    time_s = np.arange(100) * 0.01
    time_s[40:] += 0.05
    time_s[70] = time_s[68]
    summary = timing(time_s)
    assert summary.rate_hz == pytest.approx(100)
    assert summary.disorder == (71,)
    first, second = summary.gaps
    assert (first.row, first.missing) == (40, 5)
    assert (first.start_s, first.length_s) == pytest.approx((0.39, 0.06))
    assert second.row == 71
    assert timing(np.array([1.0, 1.0, np.nan])) is None


def test_jitter_is_relative_and_leaves_gaps_out():
    steps = np.where(np.arange(1000) % 2, 0.9e-3, 1.1e-3)
    steps[500] = 1.0
    summary = timing(np.concatenate([[0], np.cumsum(steps)]))
    assert summary.jitter_rms == pytest.approx(0.1, rel=1e-2)
    assert len(summary.gaps) == 1


CLIPPED = [
    (np.sin(np.arange(400) / 9).clip(-0.9, 0.9), "likely", True),
    (np.sin(np.arange(400) / 9).clip(-0.9, 2), "likely", True),
    (np.sin(np.arange(400) / 9), "no", False),
    (np.array([0, 1, 2, 5, 5, 5, 5, 2, 1.0]), "perhaps (one flat extreme)", True),
    (np.ones(50), "no", False),
    (np.full(50, np.nan), "no", False),
]


@pytest.mark.parametrize(("values", "verdict", "flat"), CLIPPED)
def test_clipping(values, verdict, flat):
    clipped = clipping(values)
    assert (clipped.verdict, bool(clipped.stretches)) == (verdict, flat)
    for start, stop in clipped.stretches:
        assert np.ptp(values[start:stop]) == 0
        assert values[start] in (values.min(), values.max())


STEPS = [
    (np.round(NOISE * 40) * 2.5e-4, 2.5e-4),
    (np.array([0.0, 6.0, 10.0, 4.0]), 2.0),
    (NOISE, None),
    (np.round(NOISE, 7), None),  # so many steps are digits of a file
    (np.ones(9), None),
    (np.array([np.nan, 1.0, 1.5]), 0.5),
]


@pytest.mark.parametrize(("values", "step"), STEPS)
def test_quantisation_step(values, step):
    estimate = quantisation_step(values)
    assert estimate == (None if step is None else pytest.approx(step, rel=1e-9))


@pytest.mark.parametrize("scale", [1e-200, 1e-12, 1.0, 1e9, 1e200])
def test_noise_floor_and_line(scale):
    """White noise of rms s at rate f has the amplitude density s sqrt(2 / f)."""
    rate_hz, tone_hz = 2000.0, 123.0
    tone = 0.5 * np.sin(2 * np.pi * tone_hz * np.arange(NOISE.size) / rate_hz)
    estimate = spectrum(scale * (3 + NOISE + tone), rate_hz, 1024)
    assert estimate.floor == pytest.approx(scale * np.sqrt(2 / rate_hz), rel=0.03)
    (line,) = estimate.lines
    assert line.frequency_hz == pytest.approx(tone_hz, abs=rate_hz / 1024)
    assert line.amplitude == pytest.approx(0.5 * scale, rel=0.05)
    assert line.over_surroundings > 10


@pytest.mark.parametrize("samples", quick([256, 400, 700, 1500, 4000], 400))
def test_noise_floor_of_white_noise_however_short(samples):
    """The median of a mean of few periodograms is below the mean: by 30 % in power for one, by
    2 % for fifteen. On average over draws the floor is the noise's own."""
    rng, segment = np.random.default_rng(samples), segment_length(samples)
    draws = 400_000 // samples
    floors = [
        spectrum(values, 2000.0, segment).floor ** 2 for values in rng.normal(size=(draws, samples))
    ]
    assert np.sqrt(np.mean(floors)) == pytest.approx(np.sqrt(2 / 2000.0), rel=0.012)


@pytest.mark.parametrize("values", [np.ones(99), NOISE[:9], np.full(99, np.nan)])
def test_no_spectrum_of_nothing(values):
    assert spectrum(values, 1.0, 64) is None


# The template


@pytest.mark.parametrize("format", FORMATS)
def test_template_unfilled_is_harmless(tmp_path, format):
    path = write(format, tmp_path)
    stated = {"speed_m_per_s": 0.05} if format in WITHOUT_TIMES else {}
    without_template = load(path, **stated)
    path.with_suffix(".yaml").write_text(sidecar_template(inspect(path)))
    got = load(path, **stated)
    for name in ("signal", "time_s", "speed_m_per_s"):
        np.testing.assert_array_equal(getattr(got, name), getattr(without_template, name))
    assert (got.channels, got.signal_unit) == (
        without_template.channels,
        without_template.signal_unit,
    )


def test_template_of_a_bare_file_says_what_is_missing(tmp_path):
    path = tmp_path / "a: b.csv"
    write_csv(path, {"timestamp": 28 * np.arange(N), "channel1": range(N), "ch#2": range(N)})
    inspection = inspect(path)
    template = parse("template", sidecar_template(inspection), "YAML")
    assert (template["time_unit"], template["signal_unit"]) == ("ms", "counts")
    assert template["channels"] == ["channel1"]
    for key in blanks(inspection):
        part = template
        for name in key.split("."):
            part = part[0] if isinstance(part, list) else part
            assert name in part, key
            part = part[name]
        assert part is None
    path.with_suffix(".yaml").write_text(sidecar_template(inspection))
    with pytest.raises(BadInput, match=r"recording\.speed_m_per_s=\.\.\."):
        load(path)
    filled = sidecar_template(inspection).replace("speed_m_per_s: null", "speed_m_per_s: 0.01")
    path.with_suffix(".yaml").write_text(filled)
    np.testing.assert_allclose(load(path).time_s, 0.028 * np.arange(N), rtol=1e-14)


def test_template_quotes_names_that_look_like_numbers(tmp_path):
    path = tmp_path / "r.csv"
    names = ["1e5", "null", "2024-05-01", "a: b", "0x1F"]
    write_csv(path, {"time_s": TIME_S, "speed_m_per_s": TIME_S + 1} | dict.fromkeys(names, TIME_S))
    path.with_suffix(".yaml").write_text(sidecar_template(inspect(path, channels=names)))
    assert load(path).channels == tuple(names)


def test_template_keeps_what_is_known(tmp_path):
    path = write("csv", tmp_path)
    facts = {
        "gain": 10.0,
        "sensor": {"depth_m": 1e-5, "strips": 2, "elements": [{"offset_m": 1e-5}, {}]},
        "skin": {"model": "half_space"},
        "description": "Zoë: #1",
        "contact_window_m": [-1e-5, 1.0],
        "feature": {},
    }
    path.with_suffix(".yaml").write_text(yaml.safe_dump(facts))
    inspection = inspect(path, polarity=-1)
    template = parse("template", sidecar_template(inspection), "YAML")
    assert {key: template[key] for key in facts if key not in ("sensor", "feature")} == {
        key: facts[key] for key in facts if key not in ("sensor", "feature")
    }
    assert template["sensor"] == facts["sensor"] | {"feedback_resistance_ohm": None}
    assert template["feature"] == facts["feature"] | {"edge_length_m": None}
    assert template["polarity"] == -1
    assert not {"gain", "polarity", "sensor.depth_m"} & set(blanks(inspection))


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ({"channels": ["voltage_2_V"]}, "no column 'voltage_2_V'"),
        ({"gain": 0}, "gain is 0"),
    ],
)
def test_what_is_stated_has_to_be_right(tmp_path, stated, words):
    write_csv(tmp_path / "r.csv", COLUMNS)
    with pytest.raises(BadInput, match=words):
        inspect(tmp_path / "r.csv", **stated)
