"""Kernels measured by the command over a known ridge, and what inversions make of them.

The rig is not as its sidecar has it: its films lie deeper, turned, and average over more than their
strips.
"""

import dataclasses
import json

import numpy as np
import pytest

from srsinv.forward.film import StripAverage
from srsinv.grid import Open
from srsinv.inverse.estimate import coverage_90, relative_error
from srsinv.inverse.kernel.measured import as_netcdf, kernels, load_kernel
from tests.claims.raw_files import Rig, model_of, pressure, write
from tests.golden.check import golden_test
from tests.jobs.run import ROOT, check_page, command, outcome, short_form, short_run, words
from tests.tiers import quick

EXAMPLE = ROOT / "srsinv" / "examples" / "strip_two_element.csv"
TILT_DEG, BLUR_M, STATED_DEPTH_M = 4.0, 3e-4, 0.8e-3
WIDE = ("recording.cell_m=2e-4",)  # a direct solution costs the cube of their number
INSIDE_M = 0.013
HOLD = "fit.hold={height_m:2e-5,width_m:2e-3,base_friction:0.35}"


class Turned(Rig):
    """A rig whose films are turned and average over more than their strips."""

    @property
    def sensor(self):
        def changed(film):
            turned = dataclasses.replace(film, angle_rad=film.angle_rad + np.deg2rad(TILT_DEG))
            return turned.with_effect(StripAverage.at_depth(BLUR_M, float(film.depth_m)))

        return super().sensor.with_films(changed)


def sidecar(rig):
    """What the laboratory takes the rig for."""
    films = ((0.0, 0.0), (rig.angle_deg, rig.offset_m))[: len(rig.gains)]
    elements = [
        {"angle_deg": angle, "offset_m": offset, "strip_width_m": 7e-4, "active_length_m": 8e-3}
        for angle, offset in films
    ]
    return {
        "gain": list(rig.gains),
        "nominal_pressure_Pa": rig.nominal_pressure_Pa,
        "contact_window_m": [-0.02, 0.02],
        "sensor": {"depth_m": STATED_DEPTH_M, "feedback_resistance_ohm": 1e6, "strips": 2,
                   "elements": elements},
        "skin": {"youngs_modulus_Pa": 7e5, "poisson_ratio": 0.5},
        "feature": {"edge_length_m": 1e-5},
    }  # fmt: skip


def laboratory(folder, **settings):
    """Its rig, and the paths of its recordings of both ridges."""
    rig = Turned("turned", rate_hz=1000.0, noise=0.005, **settings)
    paths = write(rig, folder, model_of(rig))
    for path in paths.values():
        path.with_suffix(".yaml").write_text(json.dumps(sidecar(rig)))
    return rig, paths


def measured(paths, folder, *overrides):
    """The metrics of a measurement whose run is in `folder`."""
    known = f"recording.path={paths['known']}"
    form = "experiment=measure_kernel", known, "feature=ridge", HOLD
    assert command(folder, *form, *overrides) == 0
    return json.loads((folder / "metrics.json").read_text())


FORMS = ("measure_kernel",)

test_nothing_has_moved = golden_test(FORMS, claims=FORMS)


@pytest.mark.full
def test_one_way_shows_the_sum_alone():
    result = short_run("measure_kernel")
    metrics = result.metrics
    assert metrics["quality"] == "doubtful"
    assert "one direction" in str(metrics["warnings"])
    assert not metrics["has_both_ways"]
    assert float(metrics["kernel_error_sum_1"] or 1.0) < 0.1
    assert "(doubtful)" in result.title
    check_page(result)
    said = words(result)
    assert "relative to the known feature" in said
    assert "operator=measured operator.path=kernel.nc" in said
    assert "gain from pass to pass is not known" in said
    assert metrics["gain_spread_1"] is None


@pytest.mark.full
def test_the_kernel_is_written_and_read(tmp_path):
    """One of the data alone replaces an earlier one; what is written is what the run has."""
    target = tmp_path / "kernel.nc"
    target.write_bytes(short_run("measure_kernel").files["kernel.nc"])
    alone = outcome(*short_form("measure_kernel"), "kernel.parameters=[]", f"kernel.write={target}")
    assert target.read_bytes() == alone.files["kernel.nc"]
    assert [each.name for each in tmp_path.iterdir()] == ["kernel.nc"]
    assert "gain_1" not in alone.metrics
    assert not {"Fitted theory"} & {
        each.heading for each in alone.sections if each.is_met(alone.dataset)
    }
    kernel = load_kernel(target)
    assert not kernel.has_both_ways
    assert kernel.friction == pytest.approx(alone.metrics["base_friction"])


REFUSED = {
    "another file": (["kernel.write={lab}/other.nc"], "not as a measurement of a kernel wrote it"),
    "another suffix": (["kernel.write={lab}/kernel.csv"], "ends in .nc"),
    "no folder": (["kernel.write={lab}/none/kernel.nc"], "no folder"),
    "two features": (["feature=[strip_load,line_load]"], "2 features"),
    "a name": (["kernel.parameters=[stiffness]"], "kernel.parameters names 'stiffness'"),
    "no list": (["kernel.parameters=3"], "kernel.parameters is 3"),
    "nothing held": (["fit.hold=null"], "of the feature must be known"),
    "no pressure": (["feature=ridge", "fit.hold={{height_m:1e-5,width_m:1e-3}}",
                     "+feature.ridge.edge_length_m=1e-5", "recording.nominal_pressure_Pa=null"],
                    "nominal pressure on the surface is not known"),
}  # fmt: skip
AFTER_MEASURING = {"too short": (["sensor.depth_m=2e-3"], "scan further")}


@pytest.mark.full
@pytest.mark.parametrize(
    "case",
    [
        *quick(REFUSED, "another file", "a name"),
        *(pytest.param(each, marks=pytest.mark.claim) for each in AFTER_MEASURING),
    ],
)
def test_refused(tmp_path, capsys, case):
    other = tmp_path / "other.nc"
    other.write_bytes(b"mine")
    overrides, said = (REFUSED | AFTER_MEASURING)[case]
    typed = [each.format(lab=tmp_path) for each in overrides]
    keys = {each.partition("=")[0] for each in typed}
    form = [each for each in short_form("measure_kernel") if each.partition("=")[0] not in keys]
    assert command(tmp_path / "refused", *form, *typed) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "refused").exists()
    assert other.read_bytes() == b"mine"


@pytest.mark.full
def test_a_file_that_is_no_kernel_is_refused_by_inversions(tmp_path, capsys):
    (tmp_path / "kernel.nc").write_bytes(b"no kernel")
    one = tmp_path / "one.nc"
    kernel = load_kernel_of(short_run("measure_kernel"), tmp_path / "two.nc")
    first = dataclasses.replace(
        kernel, value=kernel.value[:1], stderr=kernel.stderr[:1], factors=kernel.factors[:, :1],
        far=kernel.far[:1], far_factors=kernel.far_factors[:, :1],
    )  # fmt: skip
    one.write_bytes(as_netcdf(first))
    form = "experiment=invert_recording", f"recording.path={EXAMPLE}", "operator=measured"
    for path, said in (
        (tmp_path / "absent.nc", "there is no such file"),
        (tmp_path / "kernel.nc", "kernel.nc"),
        (one, "The measured kernel has 1 elements, but the sensor has 2"),
    ):
        assert command(tmp_path / "run", *form, f"operator.path={path}") == 2
        assert said in capsys.readouterr().err


def load_kernel_of(result, path):
    path.write_bytes(result.files["kernel.nc"])
    return load_kernel(path)


@pytest.mark.claim
def test_a_wrong_rig_is_measured_and_inverted_by(tmp_path):
    """One film, half as deep again as stated, turned and blurred, which theory has not."""
    rig, paths = laboratory(tmp_path, gains=(95.0,), passes=4)
    metrics = measured(paths, tmp_path / "run")
    assert metrics["quality"] == "good"
    assert metrics["has_both_ways"]
    assert metrics["chi2_per_freedom_kernel"] < 1.2
    assert metrics["chi2_per_freedom_theory"] > 20
    assert metrics["residual_repeating_share_theory"] > 0.9
    assert metrics["residual_repeating_share_kernel"] < 0.2
    assert abs(metrics["tilt_deg"] - TILT_DEG) < 4 * metrics["tilt_deg_stderr"]
    kernel = load_kernel(tmp_path / "run" / "kernel.nc")
    x = kernel.lags.x_m
    truth = kernels(rig.sensor, rig.sensor.elements, x + metrics["position_m"])
    error = np.abs(kernel.value - truth)
    assert np.all(error < 4 * kernel.stderr + 0.01 * np.abs(truth).max(axis=-1, keepdims=True))
    # Of the other ridge the kernel's inversion has the pressure, where theory has not.
    off, covered, good = {}, {}, {}
    for name, model in {
        "theory": (),
        "kernel": ("operator=measured", f"operator.path={tmp_path}/run/kernel.nc"),
    }.items():
        form = "experiment=invert_recording", f"recording.path={paths['unknown']}", *WIDE
        data = outcome(*form, "method=[tikhonov]", "rule=evidence", *model).dataset
        good[name] = data["quality"].item() == "good"
        ahead_m = metrics["position_m"] if model else 0.0
        off[name], covered[name] = accuracy(rig, data, ahead_m)
    assert good["kernel"]
    assert off["kernel"] < 0.95 * off["theory"]
    assert covered["kernel"] > 0.8


def accuracy(rig, data, ahead_m):
    """The error of p where the stage has been and how much of it the bands cover, at places
    relative to those of the kernel."""
    x = data["x"].values
    line = Open(x.size, float(x[1] - x[0]), float(x[0]))
    truth = np.interp(x + ahead_m, x, pressure(model_of(rig), rig, line))
    cells = np.abs(x) < INSIDE_M
    p, stderr = (data[name].values[0, 0] for name in ("estimate", "estimate_stderr"))
    return relative_error(p, truth, cells), coverage_90(p, stderr, truth, cells)
