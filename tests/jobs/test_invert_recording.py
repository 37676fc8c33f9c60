"""Recordings inverted: two shared ones, and one of our own in two formats."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from srsinv.errors import BadInput
from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.describe import elements
from srsinv.forward.film import SampleAverage, StripAverage
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import PressedStrip
from srsinv.grid import Open
from srsinv.inverse.gridding.cells import cell_signals
from srsinv.recorded import motion_of
from srsinv.recording import Recording, save
from tests.golden.check import golden_test
from tests.jobs.run import command, outcome
from tests.jobs.sidecars import OF_OTHER_FILM as SENSOR
from tests.shared import SHARED, needs_shared
from tests.tiers import quick

FORMS = ("invert_recording", "invert_fabricslide")

test_nothing_has_moved = golden_test(FORMS, claims=FORMS[1:])

METHODS = ("wiener", "tikhonov")
RIDGE = SHARED / "recordings" / "ridge_two_element.csv"
VARYING = SHARED / "recordings" / "ridge_varying_speed.csv"
BOARD = SHARED / "recordings" / "fabricslide" / "Board10mm_F120_V-10mmps_0.csv"
NOMINAL_PA = 20e3  # of the ridge's sidecar
SPEED = 0.05


# Wider than by default, as a direct solution costs the cube of their number.
WIDE = ("recording.cell_m=2e-4",)


def of_file(path, *overrides):
    return outcome("experiment=invert_recording", f"recording.path={path}", *overrides)


@pytest.fixture(scope="module")
def ridge(tmp_path_factory):
    """The metrics that the command writes for the shared ridge."""
    folder = tmp_path_factory.mktemp("runs") / "ridge"
    assert command(folder, "experiment=invert_recording", f"recording.path={RIDGE}", *WIDE) == 0
    assert (folder / "report.html").is_file()
    return json.loads((folder / "metrics.json").read_text())


@pytest.mark.full
@needs_shared
@pytest.mark.parametrize("method", METHODS)
def test_pressure_rises_at_the_ridge(ridge, method):
    assert ridge[f"status_{method}"] == "converged"
    assert ridge[f"p_peak_position_m_{method}"] == pytest.approx(0.010, abs=3e-4)
    assert ridge[f"p_peak_Pa_{method}"] > NOMINAL_PA


@pytest.mark.claim
@needs_shared
def test_the_same_ridge_at_a_varying_speed(ridge):
    metrics = of_file(VARYING, *WIDE).metrics
    for method in METHODS:
        assert metrics[f"status_{method}"] == "converged"
        assert metrics[f"p_peak_position_m_{method}"] == pytest.approx(0.010, abs=3e-4)
        assert metrics[f"p_peak_Pa_{method}"] == pytest.approx(
            ridge[f"p_peak_Pa_{method}"], rel=0.1
        )
    assert metrics["noise_rms_V"] == pytest.approx(ridge["noise_rms_V"], rel=0.1)


@pytest.mark.full
@needs_shared
def test_nominal_pressure_of_the_command_line_wins(ridge):
    nominal = ("recording.nominal_pressure_Pa=25e3", "method=wiener_evidence")
    metrics = of_file(RIDGE, *nominal, *WIDE).metrics
    shift = metrics["p_peak_Pa_wiener"] - ridge["p_peak_Pa_wiener"]
    assert shift == pytest.approx(25e3 - NOMINAL_PA, rel=1e-9)
    for same in ("q_peak_Pa_wiener", "p_peak_position_m_wiener"):
        assert metrics[same] == pytest.approx(ridge[same], rel=1e-9)


@pytest.mark.full
@needs_shared
def test_strongest_line_of_a_real_board():
    metrics = outcome(
        "experiment=invert_fabricslide", f"recording.path={BOARD}", "recording.speed_m_per_s=0.01"
    ).metrics
    for method in METHODS:
        assert metrics[f"status_{method}"] == "converged"
        assert 0.0195 < metrics[f"p_line_wavelength_m_{method}"] < 0.0205


@pytest.fixture(scope="module", params=quick(["a pressed strip"]))
def formats(tmp_path_factory):
    """One simulated scan over a pressed strip, saved as CSV and as netCDF, inverted from both."""
    simulated = outcome("grid.line=open", "grid.cells=128", "method=wiener").dataset
    x = simulated["x"].values
    recording = Recording(
        simulated["signal"].values,
        (x - x[0]) / SPEED,
        np.full(x.size, SPEED),
        ("voltage_0_V", "voltage_1_V"),
        {"sensor": SENSOR, "scan_start_m": float(x[0])},
    )
    datasets = {}
    for suffix in ("csv", "nc"):
        path = tmp_path_factory.mktemp("scan") / f"scan.{suffix}"
        save(recording, path)
        datasets[suffix] = of_file(path, "method=wiener").dataset
    return simulated, datasets


def test_formats_agree(formats):
    _, datasets = formats
    csv, nc = (each["estimate"].values for each in datasets.values())
    np.testing.assert_array_equal(csv, nc)


def test_what_was_simulated_is_found(formats):
    simulated, datasets = formats
    x = simulated["x"].values
    estimate = datasets["csv"]["estimate"].sel({"estimator": "Wiener", "component": "p"})
    interpolated = np.interp(x, estimate["x"], estimate)
    truth = simulated["traction"].sel(component="p").values
    inner = np.abs(x) < 0.015
    error = (interpolated - interpolated[inner].mean()) - (truth - truth[inner].mean())
    size = np.linalg.norm((truth - truth[inner].mean())[inner])
    assert np.linalg.norm(error[inner]) < 0.25 * size


# A speed that varies.

TIME = np.arange(0, 0.4, 5e-4)
SPEEDS = {
    "halting": SPEED * np.maximum(0.0, 0.6 + np.cos(2 * np.pi * TIME / 0.4)),
    "towards_minus_x": -SPEED * (0.7 + 0.4 * np.cos(2 * np.pi * TIME / 0.2)),
}


def varying(speed):
    """A scan over a pressed strip at 0 with `speed` (sample,), and what blocks of ten samples at
    its mean speed would hold at any x."""
    spacing = abs(speed.mean()) * (TIME[1] - TIME[0])
    films = [film.with_effect(StripAverage(film.width_m)) for film in elements(SENSOR)]
    average = SampleAverage(10, spacing)
    sensor, blocks = Sensor(films), Sensor([film.with_effect(average) for film in films])
    line = Open(2000, 1e-5, -1e-2)
    travelled = cumulative_trapezoid(speed, TIME, initial=0.0)
    start = -(travelled.min() + travelled.max()) / 2
    p = PressedStrip(2e3, 1e-3, 0.0, 1e-4).cell_average(line)
    traction = jnp.stack([p, 0.5 * np.sign(speed.sum()) * p])
    signal = np.asarray(
        sensor.operator_along(line, Motion(TIME, start + travelled, speed))(traction)
    )
    noise = 2e-9 * np.random.default_rng(2).normal(size=signal.shape)
    facts = {"sensor": SENSOR, "scan_start_m": float(start)}
    scan = Recording(signal + noise, TIME, speed, ("voltage_0_V", "voltage_1_V"), facts)
    steady = np.asarray(blocks.operator(line, ConstantSpeed(speed.mean()))(traction))
    return scan, lambda x: np.stack([np.interp(x, np.asarray(line.x), row) for row in steady])


def in_cells(recording, block):
    return cell_signals(
        recording.name, motion_of(recording), recording.signal, CurrentAmplifier(), block
    )


@pytest.mark.full
@pytest.mark.parametrize("name", SPEEDS)
def test_cells_hold_what_the_mean_speed_would_give(name):
    """All but those that were passed at a crawl. Cells of whole samples, off their centres, would
    miss by 1 %."""
    scan, steady = varying(SPEEDS[name])
    x, cells, *_ = in_cells(scan, 10)
    observed, expected = np.isfinite(cells), steady(x)
    assert np.abs(cells - expected)[observed].max() < 5e-3 * np.abs(expected).max()
    holes = ~observed[:, 2:-2]
    assert holes.any() == (name == "halting")
    assert holes.mean() < 0.2


@pytest.mark.full
def test_a_strip_found_through_a_halt(tmp_path):
    save(varying(SPEEDS["halting"])[0], tmp_path / "scan.nc")
    settings = ("recording.cell_m=1.5e-4", "method=wiener", "effects=[strip_width]")
    metrics = of_file(tmp_path / "scan.nc", *settings).metrics
    assert metrics["status_wiener"] == "converged"
    assert metrics["p_peak_position_m_wiener"] == pytest.approx(0.0, abs=3e-4)


def test_noise_of_a_varying_speed_is_what_repeats_show():
    """Spread of each cell over many draws of the noise, against the numbers that go with it."""
    speed, draws = 0.05 + 0.02 * np.cos(2 * np.pi * TIME / 0.1), 400
    noise = np.random.default_rng(3).normal(size=(draws, TIME.size))
    names = tuple(f"voltage_{i}_V" for i in range(draws))
    recording = Recording(noise, TIME, speed, names)
    cells = in_cells(recording, 8)
    spread = cells.signal.std(axis=0) * np.sqrt(cells.samples)
    assert np.median(spread) == pytest.approx(1, rel=0.05)
    assert np.ptp(cells.white_scale[0]) > 0.3
    np.testing.assert_allclose(spread, cells.white_scale[0], rtol=0.2)


def test_a_scan_of_less_than_three_cells_is_refused():
    scan = varying(SPEEDS["towards_minus_x"])[0]
    with pytest.raises(BadInput, match=r"0\.014 m long, less than 3 cells of 0\.0\d+ m: check"):
        in_cells(scan, TIME.size // 2)


REFUSED = {
    "integrated": (
        SPEEDS["halting"],
        ("amplifier=integrated",),
        r"amplifier=integrated.*amplifier=current",
    ),
}


@pytest.mark.full
@pytest.mark.parametrize("name", REFUSED)
def test_a_varying_speed_that_is_refused(name, tmp_path):
    speed, overrides, sentence = REFUSED[name]
    save(varying(speed)[0], tmp_path / "scan.nc")
    with pytest.raises(BadInput, match=sentence):
        of_file(tmp_path / "scan.nc", *overrides)
