"""Conformal bands from the command line: recordings of passes over known surfaces."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

import srsinv
from srsinv.forward.describe import elements
from srsinv.grid import as_real
from srsinv.recording import Recording, save
from srsinv.recording.known_passes import CalibrationPasses, KnownPass
from tests.jobs.run import command, outcome
from tests.jobs.sidecars import OF_OTHER_FILM as SENSOR
from tests.refusals import refused

SPEED, RATE_HZ, NOISE, PASSES = 0.05, 1000.0, 0.01, 9
LINE = srsinv.Open(400, 5e-5, -1e-2)
TRUE = srsinv.Sensor([
    dataclasses.replace(film, depth_m=1.15 * film.depth_m).with_strip_average()
    for film in elements(SENSOR)
])  # fmt: skip
MOTION = srsinv.Motion.from_speed(np.arange(300) / RATE_HZ, SPEED, -7.5e-3)
FIRST = "pass_0.traction.csv"
FAST = ("method=wiener_evidence", "recording.cell_m=3e-4", "recording.tolerance=none")


def written(path, seed, sensor=SENSOR, speed=SPEED):
    """A recording of a film 15 % deeper than its sidecar states, over two strips; its traction."""
    rng = np.random.default_rng(seed)
    places, sizes = rng.uniform(-5e-3, 5e-3, 2), rng.uniform(1e3, 4e3, 2)
    strips = (srsinv.UniformStrip(p, 1.5e-3, x) for p, x in zip(sizes, places, strict=True))
    p = sum(np.asarray(each.cell_average(LINE)) for each in strips)
    traction = np.stack([p, rng.uniform(0.2, 0.6) * p])
    clean = np.asarray(TRUE.operator_along(LINE, MOTION, directions=(True,))(as_real(traction)))
    signal = clean + NOISE * np.sqrt(np.mean(clean**2)) * rng.standard_normal(clean.shape)
    time_s, facts = np.asarray(MOTION.time_s), {"sensor": sensor, "scan_start_m": -7.5e-3}
    channels = "voltage_0_V", "voltage_1_V"
    save(Recording(signal, time_s, np.full(time_s.size, speed), channels, facts), path)
    return traction


def with_traction(path, seed, **other):
    """The same with its traction beside it."""
    columns = np.column_stack([np.asarray(LINE.x), *written(path, seed, **other)])
    beside = path.with_name(f"{path.stem}.traction.csv")
    np.savetxt(beside, columns, delimiter=",", header="position_m,p_Pa,q_Pa", comments="")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Calibration passes, and `own.csv` beside them."""
    root = tmp_path_factory.mktemp("rig")
    (root / "known").mkdir()
    for seed in range(PASSES):
        with_traction(root / "known" / f"pass_{seed}.csv", seed)
    written(root / "own.csv", 100)
    return root


def overrides(folder, *more):
    return (
        "experiment=invert_recording", f"recording.path={folder / 'own.csv'}", "bands=conformal",
        f"bands.passes={folder / 'known'}", *FAST, *more,
    )  # fmt: skip


@pytest.mark.full
def test_the_command_gives_both_bands(folder, tmp_path):
    """The same values, and standard errors times the factors of `Conformal.of_passes`."""
    assert command(tmp_path / "out", *overrides(folder)) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["conformal_passes"] == PASSES
    data = outcome(*overrides(folder)).dataset
    model, conformal = (data.isel(estimator=i) for i in (0, 1))
    np.testing.assert_array_equal(model["estimate"], conformal["estimate"])
    for component in "pq":
        factor = metrics[f"conformal_factor_{component}_wiener_conformal"]
        ratio = conformal["estimate_stderr"] / model["estimate_stderr"]
        np.testing.assert_allclose(ratio.sel(component=component), factor, rtol=1e-9)
    assert metrics["conformal_factor_q_wiener_conformal"] > 1.5  # the depth is wrong
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Conformal bands" in page


@pytest.fixture
def known(tmp_path):
    """A folder of nine recordings, with a traction beside each."""
    folder = tmp_path / "known"
    folder.mkdir()
    for i in range(PASSES):
        (folder / f"pass_{i}.csv").touch()
        (folder / f"pass_{i}.yaml").touch()
        (folder / f"pass_{i}.traction.csv").write_text("position_m,p_Pa,q_Pa\n0,1,2\n1,1,2\n")
    return folder


def rewritten(file, old, new):
    file.write_text(file.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda known: (known / "pass_0.csv").unlink(), ("8 passes", "9")),
        (lambda known: (known / "pass_0.traction.csv").unlink(), ("pass_0.csv", "traction")),
        (shutil.rmtree, ("known", "folder")),
        (lambda known: rewritten(known / FIRST, "q_Pa", "shear"), (FIRST, "q_Pa")),
        (lambda known: rewritten(known / FIRST, "\n1,", "\n-1,"), (FIRST, "position_m")),
        (lambda known: rewritten(known / FIRST, "1,2\n1", "nan,2\n1"), (FIRST, "p_Pa")),
    ],
)
def test_folders_that_do_not_serve(known, change, words):
    settings = {"passes": str(known), "confidence": 0.9, "share": 0.9}
    made = CalibrationPasses.of(settings)
    assert made is not None
    assert [each.path.name for each in made.passes] == [f"pass_{i}.csv" for i in range(PASSES)]
    change(known)
    refused(lambda: CalibrationPasses.of(settings), *words)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"confidence": 0.95}, ("9 passes", "19")),
        ({"confidence": 1}, ("bands.confidence", "1")),
        ({"share": "two"}, ("bands.share", "two")),
        ({"portion": 0.9}, ("bands", "portion", "share")),
    ],
)
def test_settings_that_do_not_serve(known, settings, words):
    refused(lambda: CalibrationPasses.of({"passes": str(known), **settings}), *words)


def test_without_passes_there_is_no_confidence():
    assert CalibrationPasses.of({"passes": None}) is None
    refused(
        lambda: CalibrationPasses.of({"passes": None, "share": 0.5}), "bands.share", "conformal"
    )


def other_sensor(known):
    with_traction(known / "pass_z.csv", 50, sensor=SENSOR | {"depth_m": 9e-4})


def other_speed(known):
    with_traction(known / "pass_z.csv", 50, speed=1.3 * SPEED)


def one_element(known):
    file, only = known / "pass_0.json", SENSOR["elements"][:1]
    file.write_text(json.dumps({"sensor": SENSOR | {"elements": only}, "scan_start_m": -7.5e-3}))
    rows = [row.rpartition(",")[0] for row in (known / "pass_0.csv").read_text().splitlines()]
    (known / "pass_0.csv").write_text("\n".join(rows))


def short_traction(known):
    file = known / FIRST
    file.write_text("\n".join(file.read_text().splitlines()[:200]))


@pytest.mark.full
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (other_sensor, ("pass_z.csv", "depth_m", "0.0009")),
        (other_speed, ("pass_z.csv", "0.065 m/s", "0.05 m/s")),
        (one_element, ("pass_0.csv", "1 element", "own.csv", "2")),
        (short_traction, ("pass_0.csv", "traction")),
    ],
)
def test_passes_that_do_not_serve(folder, tmp_path, change, words):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    change(copy / "known")
    refused(lambda: outcome(*overrides(copy)), *words)


@pytest.mark.full
def test_relative_tractions_are_not_compared_with_known_ones(folder):
    refused(lambda: outcome(*overrides(folder, "traction_unit=relative")), "traction_unit", "Pa")


def test_cells_have_the_mean_of_a_traction(tmp_path):
    """Of a straight line that of its middle, and beyond its ends their value."""
    rows = "position_m,p_Pa,q_Pa\n0,0,1\n1,10,1\n4,40,1\n"
    (tmp_path / "a.traction.csv").write_text(rows)
    known = KnownPass.beside(tmp_path / "a.csv")
    means = known.cell_means(np.array([-1.0, 0.0, 0.5, 2.5, 4.0, 5.0]))
    np.testing.assert_allclose(means, [[0.0, 2.5, 15.0, 32.5, 40.0], [1.0] * 5])
