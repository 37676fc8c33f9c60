"""Hum, drift and turns of a file: what an inspection finds and the settings that it offers."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording._sidecar import parse
from srsinv.recording.disturbances import disturbances
from srsinv.recording.even import load_even, on_even_times
from srsinv.recording.inspection import inspect
from srsinv.recording.passes import pass_differences, passes_of
from srsinv.recording.template import sidecar_template
from tests.recording.files import write_csv

RATE_HZ, N = 1000.0, 3000
TIME_S = np.arange(N) / RATE_HZ


def table(hum=0.0, drift=0.0, fundamental_Hz=50.0, **changes):
    """Two signals of white noise of one, 50.05 and 150.15 Hz of rms `hum` together, and a walk."""
    rng = np.random.default_rng(3)
    signal = rng.normal(size=(2, N))
    signal += drift / np.sqrt(RATE_HZ) * np.cumsum(rng.normal(size=(2, N)), axis=1)
    phase = 2 * np.pi * 1.001 * fundamental_Hz * TIME_S
    signal += hum * (np.sin(phase) + np.sin(3 * phase))
    columns = {"time_s": TIME_S, "position_mm": 20 * TIME_S,
               "voltage_0_V": signal[0], "voltage_1_V": signal[1]}  # fmt: skip
    return columns | changes


CASES = {
    "clean": ({}, ()),
    "hum": ({"hum": 3.0}, ("recording.mains_Hz=[50,150]",)),
    "hum of 60 Hz": ({"hum": 3.0, "fundamental_Hz": 60.0}, ("recording.mains_Hz=[60,180]",)),
    "drift": ({"drift": 3.0}, ("recording.drift=auto",)),
    "both": ({"hum": 30.0, "drift": 3.0}, ("recording.mains_Hz=[50,150]", "recording.drift=auto")),
}


@pytest.mark.parametrize("case", CASES)
def test_overrides_of_what_was_found(tmp_path, case):
    given, overrides = CASES[case]
    write_csv(tmp_path / "r.csv", table(**given))
    inspection = inspect(tmp_path / "r.csv")
    found = inspection.disturbances
    assert (inspection.refusal, found.overrides) == (None, overrides)
    assert found.hum_rms == pytest.approx(given.get("hum", 0.0), rel=0.05)
    assert found.drift == pytest.approx(given.get("drift", 0.0), rel=0.4)
    assert (found.onwards, found.back) == (1, 0)
    assert found.speed_m_per_s == pytest.approx(0.02, rel=1e-6)


def test_found_in_the_recording_as_it_is_loaded(tmp_path):
    """After the gain, and with the settings that loading needs."""
    columns = table(hum=3.0, drift=3.0)
    columns["voltage_0_V"][4] = np.nan
    write_csv(tmp_path / "r.csv", columns)
    (tmp_path / "r.csv").write_text((tmp_path / "r.csv").read_text().replace("nan", ""))
    inspection = inspect(tmp_path / "r.csv", gain=100.0)
    assert inspection.overrides == ("recording.missing=allow",)
    assert inspection.disturbances.hum_rms == pytest.approx(0.03, rel=0.05)
    recording = on_even_times(load(tmp_path / "r.csv", gain=100.0, missing="allow"))
    np.testing.assert_array_equal(
        inspection.disturbances.drift, disturbances(recording).drift
    )  # fmt: skip


def test_nothing_is_found_where_nothing_can_be_loaded(tmp_path):
    columns = table(hum=3.0)
    del columns["position_mm"]
    write_csv(tmp_path / "r.csv", columns)
    assert inspect(tmp_path / "r.csv").disturbances is None


def test_the_template_suggests_them_as_comments(tmp_path):
    write_csv(tmp_path / "r.csv", table(hum=30.0, drift=3.0))
    template = sidecar_template(inspect(tmp_path / "r.csv"))
    assert not {"mains_Hz", "drift"} & set(parse("r.yaml", template, "YAML"))
    for line in ("mains_Hz: [50,150]", "drift: auto"):
        template = template.replace(f"# {line}", line)
    (tmp_path / "r.yaml").write_text(template)
    sidecar = load(tmp_path / "r.csv").sidecar
    assert (sidecar["mains_Hz"], sidecar["drift"]) == ([50, 150], "auto")
    assert "remove the #" not in sidecar_template(inspect(tmp_path / "r.csv"))


@pytest.mark.parametrize(
    ("position_m", "counts"),
    [
        (TIME_S, (1, 0)),
        (-TIME_S, (0, 1)),
        (np.abs((TIME_S + 0.5) % 1 - 0.5), (3, 3)),
        (np.where(TIME_S < 2, TIME_S, 4 - TIME_S), (1, 1)),
        (np.round(TIME_S, 2) + 0.01 * (np.arange(N) % 2), (1, 0)),
        (np.zeros(N), (0, 0)),
        (np.repeat(np.abs((TIME_S + 0.5) % 1 - 0.5), 30), (3, 3)),
    ],
)
def test_passes_each_way(position_m, counts):
    ways = [each.is_onwards for each in passes_of(position_m)]
    assert (ways.count(True), ways.count(False)) == counts


def test_what_repeats_is_in_no_difference_of_passes():
    """Of a signal that goes with the place nothing is left, of white noise its level."""
    x = np.abs((TIME_S + 0.5) % 1 - 0.5)
    touch, rng = 100 * np.sin(9 * x)[None], np.random.default_rng(0)
    noise = rng.normal(size=touch.shape)
    passes = passes_of(x)
    assert np.max(np.abs(pass_differences(touch, x, passes))) < 0.1
    left = pass_differences(touch + noise, x, passes)
    assert left.shape[1] > 900
    np.testing.assert_allclose(left.std(), 1.0, rtol=0.1)


def turning(amplitude, slip_mm):
    """Six passes of 12 mm over a bump and a texture, with shear that turns over after each turn."""
    rng = np.random.default_rng(5)
    one_mm = 12 * (1 - np.cos(np.pi * np.arange(1200) / 1200)) / 2
    position_mm = np.concatenate([one_mm if i % 2 == 0 else 12 - one_mm for i in range(6)])
    since_mm = np.concatenate([np.abs(part - part[0]) for part in np.split(position_mm, 6)])
    first = np.arange(position_mm.size) < 1200
    way = np.repeat([1.0, -1.0] * 3, 1200)
    speed = np.gradient(position_mm) * RATE_HZ
    touch = np.gradient(np.exp(-((position_mm - 7) ** 2)) + 0.02 * np.sin(3 * position_mm))
    shear = np.where(first, 0.0, amplitude * way * np.abs(speed) / 20 * np.exp(-since_mm / slip_mm))
    time_s = np.arange(position_mm.size) / RATE_HZ
    signal = touch / np.abs(touch).max() + shear
    noise = 0.01 * rng.normal(size=position_mm.size)
    return {"time_s": time_s, "position_mm": position_mm, "voltage_0_V": signal + noise}


@pytest.mark.parametrize(
    ("amplitude", "slip_mm", "least_mm", "most_mm"),
    [(0.0, 0.1, None, None), (2.0, 0.1, 0.1, 1.2), (0.5, 0.3, 0.3, 3.0)],
)
def test_shear_that_turns_over_is_found_and_left_out(
    tmp_path, amplitude, slip_mm, least_mm, most_mm
):
    write_csv(tmp_path / "r.csv", turning(amplitude, slip_mm))
    found = inspect(tmp_path / "r.csv").disturbances
    if least_mm is None:
        assert found.turn_margin_m is None
        return
    assert least_mm < 1e3 * found.turn_margin_m < most_mm
    offered = next(each for each in found.overrides if "turn_margin_m" in each)
    margin_m = float(offered.partition("=")[2])
    known = {"path": str(tmp_path / "r.csv"), "turn_margin_m": margin_m}
    recording = load_even(known, {})
    left_out = np.isnan(recording.signal[0])
    distance_m = np.min([recording.position_m, 0.012 - recording.position_m], axis=0)
    inner = (np.arange(left_out.size) > 600) & (np.arange(left_out.size) < left_out.size - 600)
    still = np.abs(recording.speed_m_per_s) < 0.02 * np.abs(recording.speed_m_per_s).max()
    assert not left_out[distance_m > margin_m + 1e-6].any()
    assert left_out[inner & (distance_m < margin_m - 1e-6) & ~still].all()


def test_a_margin_that_cannot_be_is_refused(tmp_path):
    write_csv(tmp_path / "r.csv", table())
    with pytest.raises(BadInput, match="does not turn"):
        load_even({"path": str(tmp_path / "r.csv"), "turn_margin_m": 1e-3}, {})
    write_csv(tmp_path / "r.csv", turning(0.0, 0.1))
    with pytest.raises(BadInput, match="give a smaller one"):
        load_even({"path": str(tmp_path / "r.csv"), "turn_margin_m": 0.02}, {})
    known = {"path": str(tmp_path / "r.csv"), "turn_margin_m": 1e-3}
    assert np.isfinite(load_even(known, {}).signal).mean() > 0.5


def test_speed_is_that_of_sliding(tmp_path):
    """Without the time for which the sensor stands still."""
    position_mm = 25 * np.clip(TIME_S, 1.0, 2.0)
    write_csv(tmp_path / "r.csv", table(position_mm=position_mm))
    assert inspect(tmp_path / "r.csv").mean_speed_m_per_s == pytest.approx(0.025, rel=0.02)
