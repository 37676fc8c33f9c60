"""Surfaces: their shapes, where edges catch, what repeats, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.scene import SurfaceScene
from srsinv.forward.surface import (
    Bump,
    Cylinder,
    Profile,
    Ridge,
    Ridges,
    Rough,
    SineWave,
    StepDown,
    StepUp,
    Surface,
    Tape,
)
from srsinv.grid import Open, Periodic
from tests.refusals import refused

LINE = Periodic(4000, 1e-5, -0.02 + 5e-6)
X = np.asarray(LINE.x)

HEIGHTS = {
    "ridge": (Ridge(4e-5, 2e-3, 1e-3, 1e-5), 4e-5 * (np.abs(X - 1e-3) < 1e-3)),
    "tape": (Tape(5e-5, 6e-3, 0.0, 2e-5), 5e-5 * (np.abs(X) < 3e-3)),
    "step_up": (StepUp(5e-5, 1e-3), 5e-5 * (X > 1e-3)),
    "step_down": (StepDown(5e-5, 1e-3), 5e-5 * (X < 1e-3)),
    "ridges": (
        Ridges(1e-5, 1e-3, 4e-3, 5e-4),
        1e-5 * (np.abs((X - 5e-4 + 2e-3) % 4e-3 - 2e-3) < 5e-4),
    ),
    "bump": (Bump(2e-5, 1e-3, 2e-3), 2e-5 * np.exp(-((X - 2e-3) ** 2) / 2e-6)),
    "sine": (SineWave(3e-6, 4e-3, 1e-3), 3e-6 * np.cos(np.pi * (X - 1e-3) / 2e-3)),
    "cylinder": (Cylinder(0.05), np.sqrt(0.05**2 - X**2) - 0.05),
    "profile": (
        Profile([-0.01, 0.0, 0.01], [0.0, 1e-5, 0.0]),
        1e-5 * np.maximum(1 - np.abs(X) / 0.01, 0),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("shape", "expected"), HEIGHTS.values(), ids=HEIGHTS)
def test_heights(shape, expected):
    """Away from edges, which rise over some cells: from the window's ends too."""
    jumps = np.abs(np.diff(expected, append=expected[0])) > 1e-6
    near = np.convolve(jumps, np.ones(41), mode="same") > 0
    near[:20] = near[-20:] = True
    np.testing.assert_allclose(np.asarray(shape.height(LINE))[~near], expected[~near], atol=1e-9)


def test_a_cylinder_of_large_radius_is_a_parabola():
    """To (x/R)^2/4 = 1e-10, of heights that are 1e-10 of the radius."""
    np.testing.assert_allclose(Cylinder(1e3).height(LINE), -(X**2) / 2e3, rtol=1.01e-10)


@pytest.mark.parametrize(
    "height",
    [
        lambda v: Cylinder(5e-3 * v).height(LINE),
        lambda v: Rough(1e-6, 4e-3, 1e-3, 0.8 * v).height(LINE),
    ],
    ids=["flat beyond a cylinder", "waves without power"],
)
def test_derivatives_are_finite_where_a_root_is_of_nothing(height):
    def total(v):
        return jnp.sum(height(v) ** 2)

    both = jax.jit(lambda v: (jax.grad(total)(v), jax.jacfwd(total)(v)))(1.0)
    assert np.isfinite(both).all()


def test_an_edge_is_the_profile_of_the_recordings():
    """h = H/2 [tanh((x-x0+W/2)/e) - tanh((x-x0-W/2)/e)]."""
    H, W, x0, e = 3e-5, 1e-3, 2e-4, 4e-5
    h = H / 2 * (np.tanh((X - x0 + W / 2) / e) - np.tanh((X - x0 - W / 2) / e))
    np.testing.assert_allclose(Ridge(H, W, x0, e).height(LINE), h, atol=1e-15)


def test_steps_come_back_where_the_window_ends():
    """What one raises the other lowers; at the seam both rise or fall over the same edge."""
    up, down = StepUp(5e-5, 1e-3, 3e-5), StepDown(5e-5, 1e-3, 3e-5)
    np.testing.assert_allclose(up.height(LINE) + down.height(LINE), 5e-5, atol=1e-18)
    h, e = np.asarray(up.height(LINE)), 3e-5
    from_seam = np.arange(40) * 1e-5 + 5e-6
    fall = 5e-5 / 2 * (1 - np.tanh(from_seam / e))
    np.testing.assert_allclose(h[:40], fall, atol=1e-12)
    np.testing.assert_allclose(h[:-41:-1], 5e-5 - fall, atol=1e-12)


def test_the_leading_edge_is_the_one_met_first():
    tape = Tape(5e-5, 6e-3, 1e-3, 2e-5, 1.1, -0.2, 5e-4)
    left, right = (int(np.argmin(np.abs(X - at))) for at in (-2e-3, 4e-3))
    onwards, back = (Surface([tape], 0.35).friction(LINE, way) for way in (True, False))
    assert onwards[left] == pytest.approx(1.1, abs=1e-3)
    assert onwards[right] == pytest.approx(-0.2, abs=1e-3)
    assert back[right] == pytest.approx(1.1, abs=1e-3)
    assert back[left] == pytest.approx(-0.2, abs=1e-3)
    away = np.abs(X - 1e-3) > 6e-3
    np.testing.assert_allclose(np.asarray(onwards)[away], 0.35, atol=1e-6)
    mu = 0.35 + 0.75 * np.exp(-(((X + 2e-3) / 5e-4) ** 2))
    near = X < 0.0
    np.testing.assert_allclose(np.asarray(onwards)[near], mu[near], atol=1e-9)


def test_an_edge_keeps_its_friction_where_that_follows_the_edge():
    tape = Tape(5e-5, 6e-3, 1e-3, 2e-5, 1.1, -0.2, 5e-4, friction_follows="edge")
    onwards, back = (Surface([tape], 0.35).friction(LINE, way) for way in (True, False))
    np.testing.assert_array_equal(onwards, back)
    assert back[np.argmin(np.abs(X + 2e-3))] == pytest.approx(1.1, abs=1e-3)


@pytest.mark.full
def test_a_texture_is_what_its_spectrum_says():
    """Its rms over seeds, its periodicity, and the same waves on a finer line."""
    shape = Rough(5e-6, 2e-3, 1e-4, 0.8, 3)
    fine = Periodic(8000, 5e-6, -0.02 + 2.5e-6)
    coarse, finer = np.asarray(shape.height(LINE)), np.asarray(shape.height(fine))
    # A coarse cell's centre lies midway between two fine ones: their waves agree.
    k = np.asarray(LINE.k)[1:500]
    half = np.exp(-0.5j * k * 1e-5), np.exp(-0.5j * k * 5e-6)
    ours = np.fft.rfft(coarse)[1:500] * half[0] / 4000
    theirs = np.fft.rfft(finer)[1:500] * half[1] / 8000
    np.testing.assert_allclose(ours, theirs, atol=1e-12 * np.abs(ours).max())
    rms = [np.std(Rough(5e-6, 2e-3, 1e-4, 0.8, seed).height(LINE)) for seed in range(20)]
    assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(5e-6, rel=0.1)
    flat = np.abs(np.fft.rfft(coarse)) ** 2
    assert flat[np.asarray(LINE.k) > 2.01 * np.pi / 1e-4].max() < 1e-20 * flat.max()


@pytest.mark.parametrize("edge", [0.0, 1e-9, 2e-5])
def test_heights_have_finite_derivatives_at_vertical_edges_too(edge):
    def total(values):
        shapes = [Ridge(values[0], values[1], values[2], edge), StepUp(values[0], values[2], edge)]
        return jnp.sum(jnp.sin(300 * LINE.x) * Surface(shapes).height(LINE))

    assert np.all(np.isfinite(jax.jit(jax.grad(total))(jnp.array([1e-5, 1e-3, 5e-6]))))


def test_a_scene_of_a_surface_is_its_contact_and_friction():
    tape = Tape(5e-5, 6e-3, 0.0, 2e-5, 1.1, None, 5e-4)
    scene = SurfaceScene(2e4, [tape], 0.35)
    line = Periodic(1000, 4e-5, -0.02 + 2e-5)
    p, q = np.asarray(scene.traction(line))
    assert p.mean() == pytest.approx(2e4, rel=1e-9)
    np.testing.assert_allclose(q, np.asarray(scene.surface.friction(line)) * p)
    back_p, back_q = np.asarray(scene.traction(line, -1.0))
    np.testing.assert_array_equal(back_p, p)
    # Sliding back over a symmetric tape, everything is mirrored.
    np.testing.assert_allclose(back_q, -q[::-1], atol=1e-3)


REFUSED = {
    "height": (lambda: Ridge(np.nan, 1e-3), "height_m", "nan"),
    "width": (lambda: Ridge(1e-5, 0.0), "width_m", "positive"),
    "edge": (lambda: Ridge(1e-5, 1e-3, 0.0, -1e-6), "edge_length_m", "0 or more"),
    "zone": (lambda: Tape(1e-5, 1e-3, friction_zone_length_m=0.0), "friction_zone_length_m"),
    "follows": (lambda: Tape(1e-5, 1e-3, friction_follows="side"), "friction_follows"),
    "friction": (lambda: Tape(1e-5, 1e-3, leading_edge_friction="much"), "leading_edge_friction"),
    "pitch": (lambda: Ridges(1e-5, 1e-3, -1.0), "pitch_m", "positive"),
    "radius": (lambda: Cylinder(0.0), "radius_m", "positive"),
    "waves": (lambda: Rough(1e-6, 1e-3, 2e-3), "shortest_m", "longest_m"),
    "seed": (lambda: Rough(1e-6, 1e-3, 1e-4, 0.8, 0.5), "seed", "whole"),
    "one sample": (lambda: Profile([0.0], [0.0]), "profile", "2 samples"),
    "columns": (lambda: Profile([0.0, 1.0], [0.0]), "shape", "same length"),
    "unsorted": (lambda: Profile([0.0, 0.0], [0.0, 1.0]), "increase"),
    "not finite": (lambda: Profile([0.0, 1.0], [0.0, np.inf]), "not finite"),
    "no load": (lambda: SurfaceScene(0.0, [Cylinder(0.1)]), "nominal_pressure_Pa", "positive"),
}


@pytest.mark.parametrize("attempt", REFUSED.values(), ids=REFUSED)
def test_refusals(attempt):
    refused(*attempt)


def test_an_open_line_has_the_same_surface():
    line = Open(4000, 1e-5, -0.02 + 5e-6)
    for shape, _ in HEIGHTS.values():
        np.testing.assert_array_equal(shape.height(line), shape.height(LINE))
