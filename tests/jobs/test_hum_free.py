"""The signal less its hum, averaged over passes: a feature far below the hum is there again."""

from typing import Any

import numpy as np
import pytest

from srsinv.forward.scan import Motion
from srsinv.jobs._hum_free import hum_free_variables
from srsinv.recording.mains import MainsLine

TIME_S = np.arange(8000) / 1000.0
NOISE = 0.05


def scan(position_m: np.ndarray, mains: tuple[MainsLine, ...]) -> tuple[Any, ...]:
    """A scan of one element, its lines of mains, its noise, its data under hum ten times its
    feature, and the feature."""
    fitted = np.exp(-((position_m / 1e-3) ** 2))[None]
    hum = 10.0 * np.sqrt(2) * np.sin(2 * np.pi * 50.0 * TIME_S + 0.3)
    data = fitted + hum + NOISE * np.random.default_rng(0).normal(size=fitted.shape)
    data[0, 100:110] = np.nan
    motion = Motion(TIME_S, position_m, np.gradient(position_m, TIME_S))
    return motion, mains, NOISE, data, fitted


LINE = (MainsLine(50.0, 0.05, np.array([10.0])),)
THERE_AND_BACK_M = 5e-3 * (np.abs((TIME_S % 4.0) - 2.0) - 1.0)


@pytest.mark.parametrize(("position_m", "directions"), [
    (THERE_AND_BACK_M, 2), (np.linspace(-5e-3, 5e-3, TIME_S.size), 1),
])  # fmt: skip
def test_the_feature_is_there_without_the_hum(position_m, directions):
    variables, coordinates = hum_free_variables(*scan(position_m, LINE), "V")
    by, signal, unit = variables["hum_free_signal"]
    fit = variables["hum_free_fit"][1]
    assert by == ("direction", "element", "place")
    assert unit == "V"
    assert signal.shape[-1] == len(coordinates["place"][0])
    scanned = np.isfinite(signal).any(axis=(1, 2))
    assert scanned.sum() == directions
    np.testing.assert_allclose(signal[scanned], fit[scanned], atol=8 * NOISE)


def test_without_a_line_of_mains_nothing_is_added():
    assert hum_free_variables(*scan(THERE_AND_BACK_M, ()), "V") == ({}, {})
