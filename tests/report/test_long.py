"""Long curves by their extremes, and many panels in columns."""

import numpy as np
import pytest

from srsinv import plot

N = 100_003


def test_a_short_curve_is_as_it_is():
    x, y = np.arange(10.0), np.sin(np.arange(10.0))
    assert plot.extremes(x, y) == (x, y)


@pytest.mark.parametrize("at", [0, 51_234, N - 1], ids=["first", "within", "last"])
def test_a_single_peak_in_a_long_curve_is_not_lost(at):
    y = np.where(np.arange(N) == at, 7.0, 0.0)
    x, drawn = plot.extremes(np.arange(N) / 1e3, y)
    assert x.size == drawn.size <= 6002
    assert drawn.max() == 7.0
    assert abs(x[np.argmax(drawn)] - at / 1e3) < 0.05


def test_missing_stretches_of_a_long_curve_are_missing():
    y = np.where(np.arange(N) < N // 2, np.nan, 1.0)
    x, drawn = plot.extremes(np.arange(float(N)), y)
    assert np.isnan(drawn[x < N // 2 - 100]).all()
    assert (drawn[x > N // 2] == 1.0).all()


@pytest.mark.parametrize(("count", "shape"), [(1, [1]), (4, [1] * 4), (5, [2, 2, 1])])
def test_few_panels_have_the_full_width(count, shape):
    panel = plot.Panel(
        [plot.Curve([1.0, 2.0])], plot.PanelAxis("x"), plot.PanelAxis("y"), [0.0, 1.0]
    )
    grid = plot.in_columns([panel] * count)
    assert [len(row) for row in grid] == shape
    figure = plot.panels(grid)
    labelled = [axes for axes in figure.axes if axes.get_xlabel()]
    assert len(labelled) == max(shape)
