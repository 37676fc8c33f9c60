"""Faults of recordings: what each does to a scan, and what the study says of one without any."""

import json

import numpy as np
import pytest

from experiments.robustness.answers import HINDSIGHT, answers
from experiments.robustness.faults import faults, faulty, suits
from experiments.robustness.scans import DEPTH_M, RIDGE_SCENE, SCENES, TrueRig, scan
from srsinv.grid import Open
from tests.jobs.run import outcome

STRIP, ONE, _ = SCENES.values()
WITHOUT = ("experiment=robustness", "method=[tikhonov]", "robustness.draws=1",
           "robustness.faults=[none]")  # fmt: skip


def test_without_fault_the_answer_is_good_and_near_the_best():
    result = outcome(*WITHOUT)
    data, metrics = result.dataset, result.metrics
    assert (data["answer_quality"] == "good").all()
    assert (data["ratio"] < 1.1).all()
    # No rule betters the best weights, up to the last step between weights.
    assert (data["ratio"] > 0.99).all()
    assert (data["coverage"] > 0.75).all()
    assert metrics["no_answer_share_tikhonov"] == 0
    assert metrics["within_share_tikhonov"] == 1
    assert (metrics["faults"], metrics["recordings"]) == (0, 2)


@pytest.mark.full
def test_a_stopped_run_goes_on_and_a_fault_is_of_its_strength(tmp_path):
    rows = tmp_path / "rows.jsonl"
    first = outcome(*WITHOUT, f"robustness.rows={rows}")
    assert len(rows.read_text().splitlines()) == 4
    further = "robustness.faults=[none,stuck_half]"
    again = outcome(*WITHOUT[:-1], further, f"robustness.rows={rows}")
    lines = [json.loads(line)["labels"] for line in rows.read_text().splitlines()]
    assert [each["fault"] for each in lines] == ["none"] * 4 + ["stuck_half"] * 4
    same = again.dataset["error"].sel(fault="none").values
    np.testing.assert_array_equal(same, first.dataset["error"].sel(fault="none").values)
    assert again.metrics["good_share_tikhonov"] == 0.5


def test_shares_count_every_recording_once():
    at = {"draw": 0}
    rows = [
        {**at, "scene": scene, "fault": fault, "method": HINDSIGHT, "error": [0.1, 0.1]}
        for scene in "ab" for fault in ("none", "f") if (scene, fault) != ("b", "f")
    ]  # fmt: skip
    own = {**at, "method": "M", "reasons": ""}
    rows += [
        {**own, "scene": "a", "fault": "none", "error": [0.1] * 2, "coverage": [0.9] * 2,
         "quality": "good"},
        {**own, "scene": "a", "fault": "f", "error": [0.9] * 2, "coverage": [0.9, 0.2],
         "quality": "good"},
        {**own, "scene": "b", "fault": "none", "failure": "no"},
    ]  # fmt: skip
    data = answers(rows, ["a", "b"], ["none", "f"], ["M"], 1)
    shares = {name: float(data[f"{name}_share"].item()) for name in
              ("no_answer", "within", "good", "misleading")}  # fmt: skip
    assert shares == pytest.approx(
        {"no_answer": 1 / 3, "within": 1 / 3, "good": 2 / 3, "misleading": 1 / 3}
    )
    assert (int(data["recordings"]), int(data["faults"])) == (3, 1)


@pytest.mark.full
def test_every_fault_changes_what_is_recorded():
    """In the scene with most faults, and those of a surface in theirs."""
    assert len(faults()) >= 45
    clean = faulty(faults()["none"], STRIP, 0)
    for name, fault in faults().items():
        if name == "none" or not suits(fault, STRIP):
            continue
        made = faulty(fault, STRIP, 0)
        parts = "signal", "time_s", "speed_m_per_s"
        both = [[getattr(each.recording, part) for part in parts] for each in (made, clean)]
        assert not all(map(np.array_equal, *both)), name
        assert np.isfinite(made.recorded).all(), name


@pytest.mark.full
@pytest.mark.parametrize("name", ["modulus_20", "nominal_20", "load_rising"])
def test_faults_of_a_surface(name):
    ridge, fault = SCENES[RIDGE_SCENE], faults()[name]
    assert suits(fault, ridge)
    assert not suits(fault, STRIP)
    made, clean = (faulty(faults()[each], ridge, 0) for each in (name, "none"))
    assert made.signal.shape == clean.signal.shape
    assert np.linalg.norm(made.signal - clean.signal) > 0.01 * np.linalg.norm(clean.signal)


def test_a_fault_of_the_facts_leaves_what_is_stated():
    """The signal is that of the true rig; the sidecar, and the scan's noise, are as ever."""
    made, clean = (faulty(faults()[name], ONE, 3) for name in ("depth_20", "none"))
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(
        made.signal, scan(ONE, rng, TrueRig(depth_m=1.2 * DEPTH_M)).signal
    )
    np.testing.assert_array_equal(made.noise, clean.noise)
    assert made.recording.sidecar == clean.recording.sidecar


def test_a_second_feature_is_part_of_the_truth():
    made, line = faulty(faults()["second_feature"], STRIP, 0), Open(200, 1e-4, 0.0)
    p, q = made.traction(line)
    loads = np.sum(p) * 1e-4, np.sum(scan(STRIP, made.rng).pressure(line)) * 1e-4
    assert loads[0] == pytest.approx(2 * loads[1], rel=1e-9)
    np.testing.assert_allclose(q, STRIP.friction * p)
