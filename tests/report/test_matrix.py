"""Matrices: numbers short enough for their cells, and one panel for each label of a dimension."""

import numpy as np
import pytest

from srsinv import plot
from srsinv.report.data import dataset
from srsinv.report.plot.matrix import compact


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1.234, "1.2"), (-1.234, "−1.2"), (99.6, "100"), (123.4, "123"), (123456, "10⁵"),
     (0.034, "0.03"), (3.4e-5, "3·10⁻⁵"), (2e12, "2·10¹²"), (np.nan, "–"), (np.inf, "inf")],
)  # fmt: skip
def test_a_number_is_short(value, text):
    assert compact(value) == text


def test_each_label_has_a_panel_with_all_its_numbers():
    values = np.array([[[1.0, 2.0], [3.0, np.nan]], [[5.0, 6.0], [7.0, 8.0]]])
    labels = {"side": (["left", "right"], "1"), "row": (["a", "b"], "1"), "way": (["c", "d"], "1")}
    ds = dataset({"change": (("side", "row", "way"), values, "1")}, labels)
    left, right, *_ = plot.matrix(ds, "change", panels="side").axes
    assert [each.get_text() for each in left.texts] == ["1", "2", "3", "–"]
    assert [each.get_text() for each in right.texts] == ["5", "6", "7", "8"]
    assert (left.get_title(loc="left"), right.get_title(loc="left")) == ("left", "right")
