"""Recordings inverted: two shared ones, and one of our own in two formats."""

import json

import numpy as np
import pytest

from srsinv.recording import Recording, save
from tests.jobs.run import command, outcome
from tests.shared import SHARED, needs_shared

METHODS = ("wiener", "tikhonov")
RIDGE = SHARED / "recordings" / "ridge_two_element.csv"
BOARD = SHARED / "recordings" / "fabricslide" / "Board10mm_F120_V-10mmps_0.csv"
NOMINAL_PA = 20e3  # of the ridge's sidecar
SPEED = 0.05


def of_file(path, *overrides):
    return outcome("experiment=invert_recording", f"recording.path={path}", *overrides)


@pytest.fixture(scope="module")
def ridge(tmp_path_factory):
    """The metrics that the command writes for the shared ridge."""
    folder = tmp_path_factory.mktemp("runs") / "ridge"
    assert command(folder, "experiment=invert_recording", f"recording.path={RIDGE}") == 0
    assert (folder / "report.html").is_file()
    return json.loads((folder / "metrics.json").read_text())


@needs_shared
@pytest.mark.parametrize("method", METHODS)
def test_pressure_rises_at_the_ridge(ridge, method):
    assert ridge[f"result_{method}"] == "converged"
    assert ridge[f"p_peak_position_m_{method}"] == pytest.approx(0.010, abs=3e-4)
    assert ridge[f"p_peak_Pa_{method}"] > NOMINAL_PA


@needs_shared
def test_nominal_pressure_of_the_command_line_wins(ridge):
    found = of_file(RIDGE, "recording.nominal_pressure_Pa=25e3", "method=wiener_evidence").metrics
    shift = found["p_peak_Pa_wiener"] - ridge["p_peak_Pa_wiener"]
    assert shift == pytest.approx(25e3 - NOMINAL_PA, rel=1e-9)
    for same in ("q_peak_Pa_wiener", "p_peak_position_m_wiener"):
        assert found[same] == pytest.approx(ridge[same], rel=1e-9)


@needs_shared
def test_strongest_line_of_a_real_board():
    found = outcome(
        "experiment=invert_fabricslide", f"recording.path={BOARD}", "recording.speed_m_per_s=0.01"
    ).metrics
    for method in METHODS:
        assert found[f"result_{method}"] == "converged"
        assert 0.0195 < found[f"p_line_wavelength_m_{method}"] < 0.0205


@pytest.fixture(scope="module")
def formats(tmp_path_factory):
    """One simulated scan over a pressed strip, saved as CSV and as netCDF, inverted from both."""
    simulated = outcome("grid.line=open", "grid.cells=128", "method=wiener").dataset
    x = simulated["x"].values
    films = [
        {"orientation": name, "strip_width_m": 7e-4, "active_length_m": 8e-3}
        for name in ("1_to_x_3_to_z", "1_to_z_3_to_x")
    ]
    sensor = {
        "depth_m": 7.5e-4,
        "feedback_resistance_ohm": 1e6,
        "piezo_constants_C_per_N": {"d1": 23e-12, "d2": 3e-12, "d3": -33e-12},
        "elements": films,
    }
    recording = Recording(
        simulated["signal"].values,
        (x - x[0]) / SPEED,
        np.full(x.size, SPEED),
        ("voltage_0_V", "voltage_1_V"),
        {"sensor": sensor, "scan_start_m": float(x[0])},
    )
    found = {}
    for suffix in ("csv", "nc"):
        path = tmp_path_factory.mktemp("scan") / f"scan.{suffix}"
        save(recording, path)
        found[suffix] = of_file(path, "method=wiener").dataset
    return simulated, found


def test_formats_agree(formats):
    _, found = formats
    csv, nc = (each["estimate"].values for each in found.values())
    np.testing.assert_array_equal(csv, nc)


def test_what_was_simulated_is_found(formats):
    simulated, found = formats
    x = simulated["x"].values
    estimate = found["csv"]["estimate"].sel({"method": "Wiener", "component": "p"})
    there = np.interp(x, estimate["x"], estimate)
    truth = simulated["traction"].sel(component="p").values
    inner = np.abs(x) < 0.015
    error = (there - there[inner].mean()) - (truth - truth[inner].mean())
    size = np.linalg.norm((truth - truth[inner].mean())[inner])
    assert np.linalg.norm(error[inner]) < 0.25 * size
