"""Surfaces through contact, in short forms: the paper's tape, textures, the profile under p."""

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.film import Film
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scenario import Scenario
from srsinv.forward.scene import SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.simulation import Simulation
from srsinv.forward.surface import Tape
from srsinv.grid import Periodic
from srsinv.inverse.solved_contact import SolvedContact, cell_averages
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

FORMS = ("fig13_tape", "textures", "shape_from_traction")

test_nothing_has_moved = golden_test(FORMS, claims=FORMS)


def run(name, *overrides):
    """The outcome of an experiment in its short form."""
    return outcome(*short_form(name), *overrides)


@pytest.fixture(scope="module")
def outcomes():
    return {name: short_run(name) for name in FORMS}


@pytest.mark.full
def test_the_caught_edge_stands_out(outcomes):
    metrics = outcomes["fig13_tape"].metrics
    assert metrics["antisymmetry_leading"] > 3 * metrics["antisymmetry_trailing"]
    # The plate's own friction tells the edges apart too; the catch adds to that.
    assert metrics["antisymmetry_leading"] > 1.2 * metrics["antisymmetry_leading_base_friction"]
    for edge in ("leading", "trailing"):
        noisy = metrics[f"antisymmetry_{edge}_with_noise"]
        assert noisy == pytest.approx(metrics[f"antisymmetry_{edge}"], rel=0.05)


@pytest.mark.full
def test_edges_are_alike_without_friction(outcomes):
    metrics = outcomes["fig13_tape"].metrics
    leading, trailing = (
        metrics[f"antisymmetry_{edge}_frictionless"] for edge in ("leading", "trailing")
    )
    assert leading == pytest.approx(trailing, rel=1e-6)


@pytest.mark.full
def test_contact_only_pushes(outcomes):
    metrics = outcomes["fig13_tape"].metrics
    assert metrics["contact"] == "converged"
    assert 0 <= metrics["pressure_min_Pa"] < metrics["pressure_max_Pa"]


@pytest.mark.full
def test_tape_is_fitted(outcomes):
    metrics = outcomes["fig13_tape"].metrics
    assert metrics["fit"] == "converged"
    assert metrics["chi2_per_freedom"] == pytest.approx(1.0, abs=0.25)
    for name in ("leading_edge_friction", "trailing_edge_friction", "base_friction", "height_m",
                 "width_m", "position_m"):  # fmt: skip
        error = abs(metrics[name] - metrics[f"{name}_true"])
        assert error < 4 * metrics[f"{name}_stderr"], name
    assert metrics["leading_edge_friction_stderr"] < 0.01


def _solve_contact(speed_m_per_s: float) -> SolvedContact:
    """A tape pressed on, periodic, slid over at this speed."""
    tape = Tape(50e-6, 0.008, edge_length_m=4e-5, leading_edge_friction=1.1)
    scene = SurfaceScene(2e4, [tape], 0.35)
    sensor = Sensor([Film(), Film(angle_rad=np.pi / 2)])
    line, fine = Periodic(128, 0.02 / 128, -0.01), Periodic(768, 0.02 / 768, -0.01)
    scenario = Scenario(scene, sensor, ConstantSpeed(speed_m_per_s))
    return SolvedContact(Simulation(scenario, line, fine, 6))


def test_sliding_back_is_the_mirror_image():
    """The other edge leads, and a film feels the same later as sooner."""
    forward, back = (_solve_contact(speed).signal() for speed in (0.05, -0.05))
    mirrored = -np.arange(128) % 128  # x = 0 is a cell's centre
    np.testing.assert_allclose(
        back[:, mirrored], forward, rtol=0, atol=1e-7 * float(jnp.abs(forward).max())
    )


def test_what_is_pressed_once_is_what_the_simulation_feels():
    contact = _solve_contact(0.05)
    sim = contact.sim
    expected = sim.signal()
    np.testing.assert_allclose(
        contact.signal(), expected, rtol=0, atol=1e-9 * float(jnp.abs(expected).max())
    )
    fine = np.asarray(sim.traction(sim.fine))
    np.testing.assert_allclose(contact.fine_traction(), fine, rtol=1e-9, atol=1e-4)
    np.testing.assert_allclose(contact.traction().mean(axis=-1), fine.mean(axis=-1))


@pytest.mark.parametrize("refinement", [1, 3, 4])
def test_cell_averages_are_about_the_wide_cells_centres(refinement):
    x = np.arange(12 * refinement) / refinement
    wave = np.cos(2 * np.pi * x / 12)
    averages = cell_averages(wave, refinement)
    attenuation = averages[0]  # by how much averaging lowers a wave
    assert 0.95 < attenuation <= 1
    np.testing.assert_allclose(
        averages, attenuation * np.cos(2 * np.pi * np.arange(12) / 12), atol=1e-12
    )


@pytest.mark.full
def test_textures_are_told_apart_when_pressed_fully(outcomes):
    metrics = outcomes["textures"].metrics
    assert metrics["accuracy"] > 0.8
    assert metrics["accuracy_light_linear_law"] < 0.5


@pytest.mark.full
def test_spectra_lie_in_their_bands(outcomes):
    metrics, ds = outcomes["textures"].metrics, outcomes["textures"].dataset
    assert metrics["coverage_90"] == pytest.approx(0.9, abs=0.05)
    usable = ds["usable"].values == 1
    assert usable.sum(axis=1).min() >= 4
    for t, name in enumerate(ds["texture"].values):
        assert metrics[f"contact_fraction_full_{name}"] > 0.99
        assert metrics[f"height_power_ratio_full_{name}"] == pytest.approx(1.0, abs=0.3)
        assert metrics[f"height_power_ratio_light_{name}"] < 0.6
        # Long waves of the mean over the draws: its scatter is that of all of them.
        first = np.flatnonzero(usable[t])[1:4]
        ratio = (ds["height_density_mean"] / ds["height_density_expected"]).values[0, t, first]
        assert np.all((ratio > 0.4) & (ratio < 2.0))


@pytest.mark.full
@pytest.mark.parametrize(("name", "rms_m"), [("ridge", 2e-6), ("cylinder", 1e-6)])
def test_profiles_come_back(outcomes, name, rms_m):
    metrics = outcomes["shape_from_traction"].metrics
    assert metrics[f"contact_{name}"] == metrics[f"recovery_{name}"] == "converged"
    assert metrics[f"rms_error_m_{name}"] < rms_m < 0.1 * metrics[f"height_range_m_{name}"]
    assert metrics[f"rms_exact_pressure_m_{name}"] < 0.2 * metrics[f"rms_error_m_{name}"]
    assert metrics[f"coverage_{name}"] > 0.5


@pytest.mark.full
@pytest.mark.parametrize("name", FORMS)
def test_page_is_whole(outcomes, name):
    check_page(outcomes[name], images=["texture_confusion"])


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "override", "words"),
    [
        ("fig13_tape", "scene=ridge", "scene is not one tape"),
        ("fig13_tape", "scene=strip", "give one of a surface"),
        ("fig13_tape", "fig13_tape.around_edge_m=0.008", "around_edge_m is 0.008"),
        ("textures", "sensor=two_element", "has 2 elements"),
        ("textures", "friction=null", "friction is null"),
        ("textures", "grid.line=open", "grid.line is open"),
        ("textures", "textures.draws=0", "textures.draws is 0"),
        ("textures", "textures.stretch_m=0.05", "textures.stretch_m is 0.05"),
        ("shape_from_traction", "shape_from_traction.scenes=null", "scenes is null"),
        ("shape_from_traction", "method=[wiener,tikhonov]", "names 2"),
    ],
)
def test_refused(name, override, words):
    overrides = [
        o for o in short_form(name) if not (override.startswith("scene=") and "scene" in o)
    ]
    overrides += ["feature.tape.edge_length_m=2e-5"] * override.startswith("scene=")
    with pytest.raises(BadInput, match=words):
        outcome(*overrides, override)
