"""Samples put on cells: what a cell has where the motion slows down."""

import numpy as np

from srsinv.inverse.gridding.cells import fitted_on

SPEED_M_PER_S, RATE_HZ, CELL_M = 0.05, 4e3, 1e-4
LENGTH_M = 0.01


def test_the_cell_at_a_turn_has_the_signal_of_its_centre():
    """A signal that is straight along x is the same line on the cells, the last one before the turn
    among them. Its samples are the slower the farther they are, and so is their weight."""
    steady = np.ones(int(LENGTH_M / SPEED_M_PER_S * RATE_HZ))
    gain = np.concatenate([steady, np.cos(np.linspace(0.0, np.pi / 2, 25))])
    x = np.cumsum(gain) * SPEED_M_PER_S / RATE_HZ
    for turned in (False, True):  # the turn is at the last cell, or at the first
        at, a = (x[-1] - x[::-1], gain[::-1]) if turned else (x, gain)
        edges = np.arange(at[0], at[-1] - CELL_M / 4, CELL_M)
        edges += at[-1] - edges[-1] if not turned else 0.0
        values, *_ = fitted_on(edges, at, a, (a * (1.0 + 200.0 * at))[None])
        known = np.isfinite(values[0])
        assert known[0 if turned else -1]
        line = 1.0 + 200.0 * (edges[1:] + edges[:-1]) / 2
        np.testing.assert_allclose(values[0, known], line[known], atol=2e-5)
