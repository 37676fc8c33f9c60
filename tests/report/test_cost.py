"""Error against time: one line for each family, from its smallest size to its largest."""

import numpy as np
import pytest

from srsinv import plot
from srsinv.report.data import dataset
from srsinv.report.plot.cost import pareto

SIZES = (1024, 256, 4096)
SCALES = {"open": 2.0, "periodic": 1.0, "exact": 0.0}


@pytest.fixture(scope="module")
def axes():
    cases = [(family, n, top / n) for family, top in SCALES.items() for n in SIZES]
    family, size, error = zip(*cases, strict=True)
    ds = dataset(
        {"error": ("case", error, "1"), "size": ("case", size, "1"),
         "steady_call_s": ("case", 1e-8 * np.array(size), "s")},
        {"family": ("case", list(family), "1")},
    )  # fmt: skip
    (axes,) = plot.cost(ds, quantity="relative error").axes
    return axes


def test_each_family_has_a_line_by_size_and_what_is_exact_has_none(axes):
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    del lines["not beaten"]
    assert set(lines) == {"open", "periodic"}
    for family, points in lines.items():
        sizes = np.sort(SIZES)
        np.testing.assert_allclose(points, np.stack([1e-2 * sizes, SCALES[family] / sizes], 1))


def test_sizes_stand_at_the_ends_of_each_line(axes):
    assert [each.get_text() for each in axes.texts] == ["256", "4096"] * 2


def test_the_error_has_the_name_that_is_given(axes):
    assert axes.get_ylabel() == "relative error"


def test_the_front_is_what_nothing_beats():
    time = np.array([3.0, 1.0, 2.0, 2.0, 5.0, 4.0])
    error = np.array([0.5, 9.0, 4.0, 6.0, 0.5, 0.1])
    np.testing.assert_array_equal(pareto(time, error), [1, 2, 0, 5])
    assert pareto(time[:0], error[:0]).size == 0


@pytest.mark.parametrize("errors", [[2.3e-14], [0.1, 0.1 + 1e-16], [0.3, 0.29]])
def test_errors_that_differ_by_rounding_lie_on_one_level(errors):
    ds = dataset(
        {"error": ("case", errors, "1"), "size": ("case", np.arange(1, 1 + len(errors)), "1"),
         "steady_call_s": ("case", 1e-3 * np.arange(1, 1 + len(errors)), "s")},
        {"family": ("case", ["one"] * len(errors), "1")},
    )  # fmt: skip
    (axes,) = plot.cost(ds).axes
    low, high = axes.get_ylim()
    assert low < min(errors) / 4
    assert high > 4 * max(errors)


def test_a_failure_without_an_error_is_a_cross_at_the_rim():
    ds = dataset(
        {"error": ("case", [1e-2, np.nan], "1"), "size": ("case", [1, 2], "1"),
         "steady_call_s": ("case", [1e-3, 4e-3], "s")},
        {"family": ("case", ["one", "one"], "1"), "failure": ("case", ["", "not converged"], "1")},
    )  # fmt: skip
    (axes,) = plot.cost(ds, failure="failure").axes
    (cross,) = (line for line in axes.lines if line.get_marker() == "x")
    assert cross.get_label() == "failed"
    assert cross.get_xdata()[0] == pytest.approx(4.0)
    assert cross.get_ydata()[0] == pytest.approx(axes.get_ylim()[1])
