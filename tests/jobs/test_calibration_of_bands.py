"""Whether bands are calibrated: ranks that are uniform, and ranks that are not."""

import numpy as np
import pytest

import srsinv
from experiments.calibration_of_bands import inversions
from experiments.calibration_of_bands.inversions import (
    BACKWARD,
    DrawnScan,
    TimedScan,
)
from experiments.calibration_of_bands.methods import ranked_methods
from experiments.calibration_of_bands.ranks import RankTest, normal_rank
from experiments.calibration_of_bands.recordings import DrawnRig, DrawnSensor, KnownScan
from srsinv.forward.film import ORIENTATIONS_RAD, Film
from srsinv.grid import as_real
from srsinv.inverse.kernel.measured import kernels
from srsinv.inverse.wiener import Exponential
from tests.golden.check import golden_test
from tests.jobs.run import check_page, composed, short_run
from tests.refusals import refused

FORMS = ("calibration_of_bands", "calibration_of_bands_recordings")
test_nothing_has_moved = pytest.mark.full(golden_test(FORMS, claims=FORMS[1:]))

SENSOR = srsinv.Sensor(
    [Film(7.5e-4, each).with_strip_average() for each in ORIENTATIONS_RAD.values()]
)
SPECTRUM = Exponential(1500.0, 2e-3)
OF_SETTINGS = "experiment=calibration_of_bands", "grid.cells=64"


def ranks(draws: int, bias: float = 0.0, size: float = 1.0) -> np.ndarray:
    """Of truths that are normal about the value with another bias and size than stated."""
    return normal_rank(bias + size * np.random.default_rng(0).standard_normal(draws), 0.0, 1.0)


def test_the_p_value_of_uniform_ranks_is_uniform():
    """So that one in a thousand methods is rejected at 1e-3; few ranks are joined in fewer bins."""
    rng = np.random.default_rng(1)
    for draws in (30, 400):
        found = [RankTest.of(rng.random(draws), 20).p_value for _ in range(400)]
        low, high = np.quantile(found, [0.1, 0.9])
        assert 0.06 < low < 0.14
        assert 0.85 < high <= 1.0


@pytest.mark.parametrize("broken", [{"size": 1.4}, {"size": 0.7}, {"bias": 0.4}])
def test_wrong_bands_are_found(broken):
    assert RankTest.of(ranks(400), 20).p_value > 1e-3
    assert RankTest.of(ranks(400, **broken), 20).p_value < 1e-4


def test_the_coverage_and_the_band_of_counts():
    """Of normal errors 1.4 times those stated: 2 Phi(1.645 / 1.4) - 1 = 76 %."""
    test = RankTest.of(ranks(20_000, size=1.4), 20)
    np.testing.assert_allclose(test.coverage, 0.7599, atol=0.01)
    np.testing.assert_allclose(test.density.mean(), 1.0)
    low, high = RankTest.of(ranks(20_000), 20).band
    assert 0.85 < low < 1.0 < high < 1.15


@pytest.mark.full
def test_page_and_verdicts():
    result = short_run("calibration_of_bands")
    check_page(result)
    metrics = result.metrics
    assert metrics["methods_calibrated"] == metrics["methods"] == 6
    assert metrics["broken_is_found"]
    assert 0.86 < float(metrics["coverage_of_all"] or 0.0) < 0.94


def methods(*overrides):
    return ranked_methods(composed(*OF_SETTINGS, *overrides))


def test_models_are_built_of_the_chosen_methods_alone(monkeypatch):
    """A quick one does not wait for the others. The settings of all are checked nevertheless."""
    built = []

    def counted(line, *rest):
        built.append(line.kind)
        return DrawnScan.of(line, *rest)

    monkeypatch.setattr(inversions.DrawnScan, "of", staticmethod(counted), raising=True)
    own = "calibration_of_bands"
    (pitch,) = methods(f"{own}.methods=[PITCH OF A BOARD]")
    assert (pitch.label, built) == ("Pitch of a board", [])
    for setting, *words in (
        ("broken=-1", "broken", "-1"),
        ("prior.rms_Pa=0", "rms_Pa", "0"),
        ("surface_window=none", "surface_window"),
        ("ranges.strip_load.width_m=3", "width_m", "3"),
    ):
        attempt = f"{own}.methods=[pitch of a board]", f"{own}.{setting}"
        refused(lambda attempt=attempt: methods(*attempt), *words)
    refused(lambda: methods(f"{own}.methods=[nobody]"), "nobody", "'pitch of a board'")


@pytest.mark.full
def test_passes_are_drawn_as_a_recording_has_them():
    """Without noise, what is left on the cells is far below the noise of a draw. Shear that did not
    turn with the motion would leave as much as the signal."""
    on = TimedScan(SENSOR, 0.05, SPECTRUM, passes=3)
    assert on.motion.directions == (True, False)
    record = on.recorder(on.line)
    truth, _ = record(np.random.default_rng(0))
    clean = np.asarray(record.operator(as_real(np.stack([truth, BACKWARD * truth]))))
    grid = on.problem(clean, record.noise_rms).to_grid()
    left = np.asarray(grid.forward(as_real(truth)) - grid.data)[np.asarray(grid.is_observed)]
    assert np.sqrt(np.mean(left**2)) < grid.noise_rms


@pytest.mark.full
def test_drawn_rigs_differ_by_their_tolerances():
    """The depth by 5 %, the speed by 1 %; the stated ones stay as they are."""
    motion = srsinv.Motion.from_speed(np.arange(50) / 1e3, 0.05, 0.0)
    rig, rng = DrawnRig.of(SENSOR, motion), np.random.default_rng(3)
    drawn = [rig(rng) for _ in range(300)]
    depth = np.array([float(each.sensor.depth_m) for each in drawn]) / 7.5e-4
    speed = np.array([float(each.speed) for each in drawn])
    np.testing.assert_allclose([depth.mean(), speed.mean()], 1.0, atol=0.01)
    np.testing.assert_allclose([depth.std(), speed.std()], [0.05, 0.01], rtol=0.15)


@pytest.mark.full
def test_drawn_kernels_are_those_of_their_sensors():
    """What is ranked is what makes the signals: the kernel of the sensor, from a narrow load."""
    on = KnownScan.of(SENSOR, srsinv.ConstantSpeed(0.05))
    drawn = DrawnSensor.of(on)
    sensor, values, kernel = drawn(np.random.default_rng(1))
    own = kernels(sensor, sensor.elements, drawn.lags.x_m)
    np.testing.assert_allclose(own, kernel, atol=1e-3 * np.abs(kernel).max())
    assert set(values) == {"gain_1", "gain_2", "depth_m", "tilt_deg"}
