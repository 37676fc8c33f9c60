"""Inspecting a recording: the page, the numbers and the sidecar's template that a run leaves."""

import json
import shlex

import numpy as np
import pytest
import yaml

from srsinv import config
from srsinv.recording import load
from srsinv.report.words import summary
from tests.golden.check import golden_test
from tests.jobs.run import command, composed, outcome
from tests.jobs.run import words as said
from tests.recording.files import write_csv
from tests.shared import SHARED, needs_shared
from tests.tiers import quick

FORMS = ("inspect_recording",)

test_nothing_has_moved = golden_test(FORMS, *FORMS)

RATE_HZ, N = 1000.0, 3000
LINE_HZ = 62.5


def scan(**changes):
    """A signal in mV that clips, a gap of 0.2 s, a position, a column of words."""
    time_s = np.arange(N) / RATE_HZ
    time_s[1500:] += 0.2
    noise = np.random.default_rng(2).normal(size=(2, N))
    tone = np.sin(2 * np.pi * LINE_HZ * np.arange(N) / RATE_HZ)
    table = {
        "time_s": time_s,
        "position_mm": 10 * time_s,
        "voltage_0_mV": (40 * tone + noise[0]).clip(-30, 30),
        "voltage_1_mV": np.round(noise[1] * 8) / 8,
        "note": ["ok"] * N,
    }
    return {name: values for name, values in (table | changes).items() if values is not None}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder that the command leaves, and the recording's own."""
    folder = tmp_path_factory.mktemp("scan")
    (folder / "data").mkdir()
    write_csv(folder / "data" / "scan.csv", scan())
    path = f"recording.path={folder / 'data' / 'scan.csv'}"
    assert command(folder / "run", "experiment=inspect_recording", path) == 0
    return folder


def test_what_a_run_leaves(run):
    assert {p.name for p in (run / "run" / "figures").iterdir()} == {
        "recorded_signals.png", "noise_spectra.png", "recorded_motion.png",
    }  # fmt: skip
    assert (run / "run" / "scan.yaml").is_file()
    assert [p.name for p in (run / "data").iterdir()] == ["scan.csv"]
    page = (run / "run" / "report.html").read_text()
    for words in ("Columns", "about 200 samples lost", "scan.yaml", "polarity", "likely"):
        assert words in page


def test_numbers(run):
    metrics = json.loads((run / "run" / "metrics.json").read_text())
    assert (metrics["samples"], metrics["columns"], metrics["signals"]) == (N, 5, 2)
    assert metrics["sample_rate_hz"] == pytest.approx(RATE_HZ)
    assert (metrics["gaps"], metrics["samples_missing"]) == (1, 200)
    assert metrics["longest_gap_s"] == pytest.approx(0.201)
    assert metrics["flat_stretches_voltage_0_mV"] > 50
    assert metrics["flat_stretches_voltage_1_mV"] == 0
    assert metrics["step_V_voltage_1_mV"] == pytest.approx(0.125e-3)
    assert metrics["strongest_line_Hz_voltage_0_mV"] == pytest.approx(LINE_HZ, abs=RATE_HZ / 256)
    floor = metrics["noise_floor_V_per_sqrt_Hz_voltage_1_mV"]
    assert floor == pytest.approx(1e-3 * np.sqrt(2 / RATE_HZ), rel=0.1)


def test_template_beside_the_recording(run):
    text = (run / "run" / "scan.yaml").read_text()
    assert yaml.safe_load(text)["channels"] == ["voltage_0_mV", "voltage_1_mV"]
    original = load(run / "data" / "scan.csv")
    beside = run / "data" / "scan.yaml"
    beside.write_text(text.replace("polarity: null", "polarity: -1"))
    turned = load(run / "data" / "scan.csv")
    beside.unlink()
    np.testing.assert_array_equal(turned.signal, -original.signal)
    assert turned.channels == original.channels == ("voltage_0_V", "voltage_1_V")


ODD = {
    "no rate": scan(time_s=None),
    "no motion": scan(position_mm=None),
    "bare times": scan(time_s=None, t=28 * np.arange(N)),
    "constant signals": scan(voltage_0_mV=np.ones(N), voltage_1_mV=np.zeros(N)),
    "times that stand still": scan(time_s=np.zeros(N)),
    "no signal": {"time_s": np.arange(N) / RATE_HZ, "speed_m_per_s": np.ones(N)},
    "one sample": {name: values[:1] for name, values in scan().items()},
    "names as they come": scan(voltage_1_mV=None, **{"F/A {N!s}": np.sin(np.arange(N))}),
    "holes": scan(voltage_1_mV=np.where(np.arange(N) % 3, np.nan, 1.5)),
}


@pytest.mark.parametrize("case", quick(ODD, "constant signals"))
def test_odd_files_are_looked_at_and_drawn(tmp_path, case):
    write_csv(tmp_path / "r.csv", ODD[case])
    result = outcome("experiment=inspect_recording", f"recording.path={tmp_path / 'r.csv'}")
    for figure, _ in result.page.figures.values():
        figure.canvas.draw()
    assert yaml.safe_load(result.files["r.yaml"])["gain"] is None
    signals = result.dataset["signal"].values
    assert {f"missing_{name}" for name in signals} <= set(result.metrics)
    assert result.dataset.to_netcdf(engine="h5netcdf")


def test_columns_of_different_length(tmp_path):
    np.savez(tmp_path / "r.npz", **scan(note=None, voltage_1_mV=np.arange(20.0)))
    result = outcome("experiment=inspect_recording", f"recording.path={tmp_path / 'r.npz'}")
    assert any(
        "differ in length" in str(block) for block in summary(result.sections, result.dataset)
    )


@needs_shared
@pytest.mark.parametrize(
    ("name", "signals", "rate_hz", "unit"),
    [
        ("tape_two_element.csv", 2, 5000, "V"),
        ("fabricslide/Board10mm_F120_V-10mmps_0.csv", 16, 35.6, "counts"),
    ],
)
def test_shared_recordings(name, signals, rate_hz, unit):
    path = SHARED / "recordings" / name
    result = outcome("experiment=inspect_recording", f"recording.path={path}")
    assert result.metrics["signals"] == signals
    assert result.metrics["sample_rate_hz"] == pytest.approx(rate_hz, rel=1e-3)
    assert set(result.dataset["signal_unit"].values.tolist()) == {unit}


VERDICTS = {
    "usable": ({}, "usable as it is, once the sidecar", "", "experiment=invert_recording"),
    "missing samples": (
        {"voltage_1_mV": np.where(np.arange(N) == 4, np.nan, np.arange(N))},
        "usable with recording.missing=allow, once", "data row 5 of column voltage_1_mV is empty",
        "recording.missing=allow",
    ),
    "no motion": ({"position_mm": None}, "not usable as it is", "recording.speed_m_per_s", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", quick(VERDICTS, "missing samples"))
def test_verdict_first(tmp_path, case):
    changes, verdict, refusal, following = VERDICTS[case]
    write_csv(tmp_path / "r.csv", scan(**changes))
    (tmp_path / "r.csv").write_text((tmp_path / "r.csv").read_text().replace("nan", ""))
    result = outcome("experiment=inspect_recording", f"recording.path={tmp_path / 'r.csv'}")
    facts = result.dataset.attrs
    assert facts["verdict"].startswith(verdict)
    assert refusal in facts["refusal"]
    assert following in facts["next_command"]
    assert bool(facts["next_command"]) == bool(following)
    first = str(summary(result.sections, result.dataset))
    assert first.index(verdict[:20]) < first.index("sample rate")


def hummed(folder):
    """A recording with hum and drift, there and back, in a folder with a blank in its name, and the
    sidecar of all that an inversion needs."""
    rng = np.random.default_rng(4)
    time_s = np.arange(N) / RATE_HZ
    hum = 20 * np.sin(2 * np.pi * 50.05 * time_s) + 5 * np.sin(2 * np.pi * 150.15 * time_s)
    walk = 5 / np.sqrt(RATE_HZ) * np.cumsum(rng.normal(size=(2, N)), axis=1)
    signal = walk + hum + rng.normal(size=(2, N))
    folder = folder / "my data"
    folder.mkdir()
    table = {"time_s": time_s, "position_mm": 20 * time_s,
             "voltage_0_mV": signal[0], "voltage_1_mV": signal[1]}  # fmt: skip
    write_csv(folder / "r.csv", table)
    element = {"strip_width_m": 7e-4, "active_length_m": 8e-3}
    elements = [element | {"angle_deg": angle} for angle in (0.0, 45.0)]
    sensor = {"depth_m": 1.2e-3, "feedback_resistance_ohm": 1e6, "elements": elements}
    (folder / "r.yaml").write_text(yaml.safe_dump({"sensor": sensor, "gain": 2.0}))
    return folder / "r.csv"


@pytest.mark.full
def test_hum_and_drift_and_the_command_that_takes_them(tmp_path):
    path = hummed(tmp_path)
    result = outcome("experiment=inspect_recording", f"recording.path='{path}'")
    facts, metrics = result.dataset.attrs, result.metrics
    assert facts["verdict"].startswith("usable as it is; hum at 50 and 150 Hz, ")
    assert facts["verdict"].endswith(" times the rest of the signal, and drift")
    assert metrics["mains_Hz_50"] == pytest.approx(50.05, abs=0.1)
    assert metrics["hum_rms_V_voltage_0_mV"] == pytest.approx(1e-3 * 425**0.5 / 8**0.5, rel=0.05)
    assert metrics["drift_V_per_sqrt_s"] == pytest.approx(2.5e-3, rel=0.3)
    assert "texture of such a wavelength" in said(result)
    program, *typed = shlex.split(facts["next_command"])
    assert (program, typed[0]) == ("srsinv", "experiment=invert_recording")
    cfg = composed(*typed)
    problem = config.recorded_problem(cfg, config.recording(cfg))
    assert [round(line.frequency_Hz) for line in problem.mains] == [50, 150]
    assert problem.noise.drift == pytest.approx((metrics["drift_V_per_sqrt_s"],), rel=1e-12)


def test_what_is_stated_is_not_offered_again(tmp_path):
    path = hummed(tmp_path)
    with path.with_suffix(".yaml").open("a") as sidecar:
        sidecar.write("drift: auto\nmains_Hz: [50.0, 150.0]\n")
    result = outcome("experiment=inspect_recording", f"recording.path='{path}'")
    assert result.dataset.attrs["override"] == ""
    assert "and drift" in result.dataset.attrs["verdict"]


def test_the_command_to_go_on_with_repeats_what_was_typed(tmp_path):
    path = hummed(tmp_path)
    typed = ['recording.channels=["voltage_1_mV","voltage_0_mV"]', "recording.gain=[2.0,3.0]",
             "recording.mains_Hz=auto", "sensor.depth_m=0.001"]  # fmt: skip
    result = outcome("experiment=inspect_recording", f"recording.path='{path}'", *typed)
    _, *words = shlex.split(result.dataset.attrs["next_command"])
    assert words[2:] == [typed[0].replace('"', ""), *typed[1:], "recording.drift=auto"]
    recording = config.recording(composed(*words))
    assert recording.channels == ("voltage_1_V", "voltage_0_V")


@pytest.mark.parametrize("turns", [False, True])
def test_one_signal_one_way_needs_a_friction(tmp_path, turns):
    time_s = np.arange(N) / RATE_HZ
    position_mm = 20 * np.abs(time_s - 1.5) if turns else 20 * time_s
    table = scan(time_s=time_s, position_mm=position_mm, voltage_1_mV=None)
    write_csv(tmp_path / "r.csv", table)
    result = outcome("experiment=inspect_recording", f"recording.path={tmp_path / 'r.csv'}")
    facts = result.dataset.attrs
    assert ("friction=MU" in facts["next_command"]) == (not turns)
    assert ("friction MU" in facts["verdict"]) == (not turns)


def test_passes_are_counted(tmp_path):
    position_mm = 100 * np.abs((np.arange(N) / 1000 + 0.5) % 1 - 0.5)
    write_csv(tmp_path / "r.csv", scan(position_mm=position_mm))
    result = outcome("experiment=inspect_recording", f"recording.path={tmp_path / 'r.csv'}")
    assert "6 passes, 3 each way" in result.dataset.attrs["verdict"]
    assert (result.metrics["passes_onwards"], result.metrics["passes_back"]) == (3, 3)
