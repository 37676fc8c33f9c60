"""The calibration of a rig by the command, and the sidecar that it leaves."""

import json

import numpy as np
import pytest

from srsinv.recorded import problem_of
from srsinv.recording import load
from srsinv.recording._sidecar import parse
from tests.golden.check import golden_test
from tests.jobs.run import ROOT, command, outcome, short_form, short_run

FORMS = ("calibrate",)

test_nothing_has_moved = golden_test(FORMS)

EXAMPLE = ROOT / "srsinv" / "examples" / "strip_two_element.csv"
HOLD = "fit.hold={height_m:2e-5,width_m:2e-3}"
TRUE = {"gain_1": 95.0, "gain_2": 110.0, "depth_m": 1.2e-3, "angle_2_deg": 45.0,
        "offset_2_m": 1.5e-3, "base_friction": 0.35}  # fmt: skip


def facts_in(text):
    """What a sidecar's text states."""
    return parse("the sidecar", text, "YAML")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Recordings of two ridges, channel B of the other sign, and a rig that is known roughly."""
    folder = tmp_path_factory.mktemp("lab")
    few = "example.sample_rate_hz=500", "example.rig.contact_window_m=[-0.012,0.012]"
    assert command(folder / "example", "experiment=example_recording", *few) == 0
    rig = facts_in((folder / "example" / "known_ridge.yaml").read_text())
    del rig["gain"]
    rig["sensor"]["depth_m"] = 1.1e-3
    rig["sensor"]["elements"][1] |= {"angle_deg": 41.0, "offset_m": 1.3e-3}
    for name in ("known_ridge", "unknown_ridge"):
        rows = np.loadtxt(folder / "example" / f"{name}.csv", delimiter=",", skiprows=1)
        rows[:, 2] *= -1
        header = "Time (ms),Ch A [V],Ch B [V],Stage pos (mm)"
        np.savetxt(folder / f"{name}.csv", rows, "%.7g", ",", header=header, comments="")
    (folder / "nominal.json").write_text(json.dumps(rig))
    return folder


@pytest.fixture(scope="module")
def run(lab):
    """What the command leaves in the folder `run`; the sidecar is rig.yaml."""
    path, sidecar = f"recording.path={lab}/known_ridge.csv", f"recording.sidecar={lab}/nominal.json"
    write = f"calibration.write={lab}/rig.yaml"
    overrides = path, sidecar, write, "feature=ridge", HOLD
    assert command(lab / "run", "experiment=calibrate", *overrides) == 0
    return lab


@pytest.mark.full
def test_the_rig_is_found(run):
    metrics = json.loads((run / "run" / "metrics.json").read_text())
    assert metrics["quality"] == "good"
    for name, value in TRUE.items():
        assert abs(metrics[name] - value) < 3.5 * metrics[f"{name}_stderr"], name
    page = (run / "run" / "report.html").read_text()
    assert "Held as known: ridge: height_m 2e-05, width_m 0.002" in page
    assert {each.name for each in (run / "run" / "figures").iterdir()} == {
        "fit.png", "correlation.png",
    }  # fmt: skip


@pytest.mark.full
def test_the_sidecar_is_finished_and_gives_the_other_ridge(run):
    text = (run / "rig.yaml").read_text()
    assert text == (run / "run" / "calibration.yaml").read_text()
    facts = facts_in(text)
    assert facts["polarity"] == [1, -1]
    known = facts["rig_error"]
    assert known["parameters"] == ["angle_2_deg", "depth_m", "gain_1", "gain_2", "offset_2_m"]
    variance = np.diag(np.array(known["covariance"], float))
    np.testing.assert_allclose(np.sqrt(variance), known["stderr"], rtol=1e-9)
    path = run / "unknown_ridge.csv"
    first = load(path, sidecar=run / "nominal.json").signal
    factors = np.array([[known["values"][2]], [-known["values"][3]]])
    np.testing.assert_allclose(load(path, sidecar=run / "rig.yaml").signal, first / factors)
    nominal = f"recording.sidecar={run}/nominal.json"
    form = "experiment=fit_recording", f"recording.path={path}", nominal, "feature=ridge"
    fitted = outcome(*form, f"recording.calibration={run}/rig.yaml")
    for name, value in {"height_m": 2.5e-5, "width_m": 1.5e-3}.items():
        assert abs(fitted.metrics[name] - value) < 3.5 * fitted.metrics[f"{name}_stderr"]
    # The calibration's errors are in: a gain of 3 % is not taken as exact.
    assert fitted.dataset.attrs["rig_error"].startswith("angle_2_deg, depth_m, gain_1")


@pytest.mark.full
def test_the_sidecar_holds_the_rig_alone():
    """Nothing of the known recording's day: noise, hum, stretches, motion, load."""
    of_the_day = (
        "recording.quiet_s=[0,0.1]", "recording.mains_Hz=[50]", "recording.detrend=constant",
        "recording.ways=onwards", "recording.nominal_pressure_Pa=0",
    )  # fmt: skip
    written = facts_in(outcome(*short_form("calibrate"), *of_the_day).files["calibration.yaml"])
    file = {"channels", "signal_unit"}
    assert written.keys() - file == {"gain", "polarity", "sensor", "skin", "rig_error"}


@pytest.mark.claim
def test_a_stated_gain_is_counted_in(lab):
    """Gains are those of the file's numbers, whatever the sidecar said of them before."""
    form = short_form("calibrate")
    first = short_run("calibrate").metrics
    stated = outcome(*form, "recording.gain=[2,0.5]")
    assert stated.metrics["gain_1"] == pytest.approx(first["gain_1"], rel=2e-4)
    assert stated.metrics["gain_2_stderr"] == pytest.approx(first["gain_2_stderr"], rel=0.03)
    written = facts_in(stated.files["calibration.yaml"])
    assert written["gain"] == pytest.approx([first["gain_1"], first["gain_2"]], rel=2e-4)


REFUSED = {
    "another file": (["calibration.write={lab}/nominal.yaml"], "no calibration wrote"),
    "another suffix": (["calibration.write={lab}/rig.csv"], "ends in .yaml"),
    "no folder": (["calibration.write={lab}/none/rig.yaml"], "no folder"),
    "in both": (["fit.free=[depth_m]", "fit.hold={{depth_m:1e-3,width_m:1e-3,pressure_Pa:1e3}}"],
                "both in fit.free and in fit.hold"),
    "two features": (["feature=[strip_load,line_load]"], "2 features"),
    "a start": (["+fit.start={{width_m:1e-3}}"], "fit.start"),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("case", REFUSED)
def test_refused(lab, capsys, case):
    (lab / "nominal.yaml").write_text("gain: 1\n")
    overrides, words = REFUSED[case]
    typed = [each.format(lab=lab) for each in overrides]
    keys = {each.partition("=")[0] for each in typed}
    form = [each for each in short_form("calibrate") if each.partition("=")[0] not in keys]
    assert command(lab / "refused", *form, *typed) == 2
    assert words in capsys.readouterr().err
    assert not (lab / "refused").exists()
    assert (lab / "nominal.yaml").read_text() == "gain: 1\n"
    assert EXAMPLE.is_file()


@pytest.mark.claim
def test_a_doubtful_one_says_so_in_its_sidecar(lab):
    """A strip taken for twice as wide as it is."""
    form = [each for each in short_form("calibrate") if not each.startswith("fit.hold")]
    held = "fit.hold={width_m:0.0076,pressure_Pa:6000}", f"calibration.write={lab}/wide.yaml"
    assert outcome(*form, *held).metrics["quality"] == "doubtful"
    recording = load(EXAMPLE, calibration=lab / "wide.yaml")
    (first, *_) = problem_of(recording).warnings
    assert first.startswith("The rig's calibration was doubtful: ")


@pytest.mark.full
def test_a_signal_in_counts_is_calibrated(lab):
    """Its gain is in counts per volt."""
    rows = np.loadtxt(lab / "known_ridge.csv", delimiter=",", skiprows=1)
    rows[:, 1:3] *= 3276.8
    header = "Time (ms),Ch A,Ch B,Stage pos (mm)"
    np.savetxt(lab / "counts.csv", rows, "%.7g", ",", header=header, comments="")
    sidecar = f"recording.sidecar={lab}/nominal.json"
    path = f"recording.path={lab}/counts.csv"
    metrics = outcome("experiment=calibrate", path, sidecar, "feature=ridge", HOLD).metrics
    assert abs(metrics["gain_1"] / 3276.8 - 95) < 3.5 * metrics["gain_1_stderr"] / 3276.8
    assert metrics["noise_rms_counts"] > 1


@pytest.mark.full
def test_an_inversion_carries_its_errors_into_its_bands(run):
    exact = facts_in((run / "rig.yaml").read_text())
    del exact["rig_error"]
    (run / "exact.json").write_text(json.dumps(exact))
    path = "experiment=invert_recording", f"recording.path={run}/unknown_ridge.csv"
    nominal, wide = f"recording.sidecar={run}/nominal.json", "recording.cell_m=3e-4"
    given = *path, nominal, wide, "method=tikhonov"
    carried = outcome(*given, f"recording.calibration={run}/rig.yaml").dataset
    without = outcome(*given, f"recording.calibration={run}/exact.json").dataset
    np.testing.assert_array_equal(carried["estimate"], without["estimate"])
    p = carried["estimate"].values[0, 0]
    more, own = (each["estimate_stderr"].values[0, 0] for each in (carried, without))
    assert np.all(more > own)
    assert more[np.argmax(p)] > 1.01 * own[np.argmax(p)]  # its noise is larger than the rig's error
    assert "gain_1" in carried.attrs["rig_error"]
