"""Film and skin accelerometer in a short form."""

import numpy as np
import pytest

from experiments.skin_acceleration.classify import accuracies, is_right, shrunk_covariance
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run
from tests.refusals import refused

FORMS = ("skin_acceleration",)
KEY = "skin_acceleration"

test_nothing_has_moved = golden_test(FORMS)


@pytest.mark.full
def test_page():
    check_page(short_run(*FORMS))


@pytest.mark.full
def test_an_axis_that_nothing_drives_detects_nothing():
    """And with a film it detects what the film alone does; no sensor is worse with another."""
    least = short_run(*FORMS).dataset["least_size"]
    assert np.isnan(least.sel(event="first contact", detector="tangential accelerometer"))
    assert np.isnan(least.sel(event="slip onset", detector="normal accelerometer"))
    at = least.sel(event="slip onset")
    np.testing.assert_allclose(at.sel(detector="film and normal"), at.sel(detector="film"))
    for axis in ("normal", "tangential"):
        both = least.sel(detector=f"film and {axis}")
        for alone in ("film", f"{axis} accelerometer"):
            one = least.sel(detector=alone)
            assert np.all((both <= one * (1 + 1e-9)) | np.isnan(one))


def test_classes_far_apart_are_told_and_equal_ones_are_not():
    random = np.random.default_rng(1)
    mixing = random.normal(size=(12, 12))
    rows = random.normal(size=(3, 20, 12)) @ mixing  # few enough to be learned by heart
    assert 0.15 < is_right(rows).mean() < 0.5
    apart = rows + 8 * np.arange(3)[:, None, None] * mixing[0]
    assert is_right(apart).mean() > 0.99


def test_correlations_are_shrunk_as_far_as_rows_leave_them_open():
    random = np.random.default_rng(2)
    root = np.linalg.cholesky(0.7 * np.ones((4, 4)) + 0.3 * np.eye(4)) * np.array([1, 2, 3, 4.0])
    many = shrunk_covariance(random.normal(size=(100_000, 4)) @ root.T)
    np.testing.assert_allclose(many, root @ root.T, rtol=0.02, atol=0.02 * many.max())
    few = shrunk_covariance(random.normal(size=(8, 40)))
    assert np.linalg.cond(few) < 1e3
    np.testing.assert_allclose(shrunk_covariance(np.ones((3, 1)) * [[1.0]]), [[1.0]])


def test_an_interval_is_of_surfaces_not_of_scans():
    """A surface that is always right, or never, at all pressures counts once."""
    random = np.random.default_rng(3)
    once = random.uniform(size=(2, 1, 3, 40)) < 0.7
    value, gain = accuracies(once, 0)
    same = accuracies(np.repeat(once, 5, axis=1), 0)
    np.testing.assert_allclose(same[0], value)
    np.testing.assert_allclose(same[1], gain)
    half = (value[:, 2] - value[:, 1]) / 2
    np.testing.assert_allclose(half, 1.645 * np.sqrt(0.21 / 120), rtol=0.25)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["surfaces=9"], ["surfaces is 9", "from 10"]),
        (["sets.mixed.longest_m=[1e-3]"], ["sets.mixed.longest_m", "two or more"]),
        (["sets.mixed.longest_m=[4e-3,2e-3]"], ["sets.mixed", "as many"]),
        (["accelerometer.axis=z"], ["normal, tangential"]),
        (["events.detection=1"], ["detection is 1"]),
        (["events.false_alarms_per_s=1e6"], ["false_alarms_per_s", "up to"]),
        (["accelerometer.noise_density_m_per_s2_per_rtHz=0"], ["above 0"]),
    ],
)
def test_refusals(overrides, words):
    given = [f"{KEY}.{each}" for each in overrides]
    refused(lambda: outcome(*short_form(*FORMS), *given), *words)


def test_an_endless_texture_needs_a_periodic_line():
    refused(lambda: outcome(*short_form(*FORMS), "grid.line=open"), "periodic")
