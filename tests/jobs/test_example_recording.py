"""Example recordings: files as a lab writes them, that give back the truth written beside them."""

import json
import shlex

import numpy as np
import pytest

from srsinv.recording import load
from tests.golden.check import golden_test
from tests.jobs.run import command, outcome

FORMS = ("example_recording",)

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the command leaves."""
    folder = tmp_path_factory.mktemp("example") / "run"
    assert command(folder, "experiment=example_recording") == 0
    return folder


@pytest.mark.full
def test_files(folder):
    truth = json.loads((folder / "truth.json").read_text())
    assert list(truth) == ["known_ridge", "unknown_ridge", "passes"]
    for name in list(truth)[:2]:
        assert (folder / f"{name}.csv").read_text().startswith("Time (ms),Ch A [V],Ch B [V],")
        recording = load(folder / f"{name}.csv")
        assert (recording.channels, recording.signal_unit) == (("Ch A", "Ch B"), "V")
        np.testing.assert_allclose(recording.speed_m_per_s, 0.02, rtol=1e-3)
        # Far from the ridge there is noise alone, before the gain.
        np.testing.assert_allclose(recording.signal[:, :800].std(axis=1), 1.5e-5, rtol=0.1)


@pytest.mark.claim
def test_looked_at_and_fitted(folder):
    known, unknown = (
        f"recording.path={folder / name}.csv" for name in ("known_ridge", "unknown_ridge")
    )
    looked = outcome("experiment=inspect_recording", known)
    assert looked.dataset.attrs["verdict"] == "usable as it is"
    fitted = outcome("experiment=fit_recording", "feature=ridge", unknown).metrics
    assert (fitted["quality"], fitted["warnings"]) == ("good", "none")
    truth = json.loads((folder / "truth.json").read_text())["unknown_ridge"]
    for name, value in truth.items():
        assert abs(fitted[name] - value) < 3 * fitted[f"{name}_stderr"]


@pytest.mark.claim
def test_passes_with_hum_and_drift_follow_what_inspection_offers(folder):
    """The settings that inspection gives are those that give the truth back."""
    path = f"recording.path={folder / 'passes'}.csv"
    looked = outcome("experiment=inspect_recording", path).dataset.attrs
    assert "6 passes, 3 each way" in looked["verdict"]
    assert "hum at 50 and 150 Hz" in looked["verdict"]
    offered = [word for word in shlex.split(looked["next_command"]) if "recording." in word]
    assert any(word.startswith("recording.mains_Hz=") for word in offered)
    fitted = outcome("experiment=fit_recording", "feature=ridge", *offered).metrics
    assert fitted["quality"] == "good"
    truth = json.loads((folder / "truth.json").read_text())["passes"]
    for name, value in truth.items():
        assert abs(fitted[name] - value) < 3 * fitted[f"{name}_stderr"]


def test_settings_are_checked(tmp_path, capsys):
    for override in ("example.ridges.known_ridge.height_m=high", "example.noise_rms_V=no"):
        assert command(tmp_path / "run", "experiment=example_recording", override) == 2
        assert override.partition("=")[0] in capsys.readouterr().err
