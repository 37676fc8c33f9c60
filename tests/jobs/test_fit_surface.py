"""Features of a surface fitted to recordings: those of an independent program against their truth,
a surface of one's own, refusals."""

import json

import numpy as np
import pytest

from tests.jobs.run import outcome
from tests.refusals import refused
from tests.shared import SHARED, needs_shared
from tests.tiers import quick

RECORDINGS = SHARED / "recordings"
NAMES = {
    "ridge_one_element": "ridge",
    "ridge_two_element": "ridge",
    "ridge_varying_speed": "ridge",
    "tape_two_element": "tape",
}
LONG = {*NAMES} - {"ridge_one_element"}


def truth_of(name):
    """What was simulated, by the names that a result has."""
    read = json.loads((RECORDINGS / f"{name}.truth.json").read_text())
    truth = read["features"][0] | {"base_friction": read["base_friction"]}
    if NAMES[name] == "tape":
        (edge,) = read["edge_friction"]
        truth |= {
            "leading_edge_friction": edge["friction"],
            "trailing_edge_friction": read["base_friction"],
            "friction_zone_length_m": edge["length_m"],
        }
    return truth, read


@pytest.fixture(scope="module")
def result_of():
    """Each recording's result, fitted without a start, by facts of the rig that are exact."""
    results, exact = {}, "recording.tolerance=none"

    def of(name):
        if name not in results:
            path = f"recording.path={RECORDINGS / name}.csv"
            given = "experiment=fit_recording", f"feature={NAMES[name]}", exact
            results[name] = outcome(*given, path)
        return results[name]

    return of


@pytest.mark.full
@needs_shared
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.claim) if name in LONG else name for name in NAMES],
)
def test_the_shared_recordings_give_their_truth_without_a_start(result_of, name):
    metrics, (truth, read) = result_of(name).metrics, truth_of(name)
    assert metrics["status"] == "converged"
    parameters = [key for key in truth if f"{key}_stderr" in metrics]
    assert set(truth) - set(parameters) == {"edge_length_m"}
    for key in parameters:
        assert abs(metrics[key] - truth[key]) < 4 * metrics[f"{key}_stderr"], key
    for key in ("height_m", "width_m"):
        bound = max(0.005 * truth[key], 3 * metrics[f"{key}_stderr"])
        assert abs(metrics[key] - truth[key]) < bound, key
    assert abs(metrics["position_m"] - truth["position_m"]) < 10e-6
    one_element = name == "ridge_one_element"
    assert abs(metrics["base_friction"] - truth["base_friction"]) < (0.08 if one_element else 0.03)
    if "leading_edge_friction" in truth:
        error = metrics["leading_edge_friction"] - truth["leading_edge_friction"]
        assert abs(error) < 0.05
    # The noise: white to 3 %, the sliding part as far as some hundred correlation lengths tell.
    assert metrics["noise_rms_V"] == pytest.approx(read["white_noise_rms_V"], rel=0.03)
    sliding = read["sliding_noise_fraction"] * read["signal_rms_V"]
    assert metrics["noise_sliding_rms_V"] == pytest.approx(sliding, rel=0.35)
    assert metrics["log_evidence_nothing"] < metrics[f"log_evidence_{NAMES[name]}"] - 100


@pytest.mark.full
@needs_shared
def test_every_stage_of_a_surface_is_in_the_result(result_of):
    ds = result_of("ridge_one_element").dataset
    p, q = ds["estimate"].values
    nominal, base = 3e4, result_of("ridge_one_element").metrics["base_friction"]
    assert np.all(p >= -nominal * (1 + 1e-12))
    np.testing.assert_allclose(q, base * p, atol=1e-6 * nominal)
    gap, touching = ds["gap"].values, p > -nominal
    assert np.abs(gap[touching]).max() < 1e-12
    assert gap.min() > -1e-12
    assert 1e-6 < gap.max() < ds["height"].values.max()
    assert ds["gap"].attrs["units"] == "m"
    stderr = ds["height_stderr"].values
    top = np.argmax(ds["height"].values)
    height_stderr = result_of("ridge_one_element").metrics["height_m_stderr"]
    assert stderr[top] == pytest.approx(height_stderr, rel=1e-3)


REFUSED = {
    "both kinds": (["feature=[ridge,line_load]"], "ridge", "line_load", "surface", "traction"),
    "no pressure": (["feature=ridge"], "nominal pressure", "recording.nominal_pressure_Pa"),
    "no edge": (
        ["feature=ridge", "+recording.nominal_pressure_Pa=2e4"],
        "feature.ridge.edge_length_m",
    ),
    "free": (["feature=strip_load", "fit.free=[gain]"], "fit.free", "ridge"),
    "start": (
        ["feature=ridge", "recording.nominal_pressure_Pa=2e4", "feature.ridge.edge_length_m=2e-5",
         "fit.start={high: 1.0}"],
        "fit.start", "'high'", "height_m",
    ),
    "window": (
        ["feature=ridge", "recording.nominal_pressure_Pa=2e4", "feature.ridge.edge_length_m=2e-5",
         "recording.contact_window_m=[0,0.001]"],
        "contact window", "recording.contact_window_m",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", quick(REFUSED, min(REFUSED)))
def test_refusals(case):
    overrides, *words = REFUSED[case]
    overrides = [o.removeprefix("+") for o in overrides]
    refused(lambda: outcome("experiment=fit_recording", *overrides), *words)
