"""Samples gathered on cells: every sample counts once, and nowhere but where it was."""

import numpy as np
import pytest

from srsinv.inverse.live.cells import CORRELATED, CellStream, fourth_differences, slopes

CELL_M, SPEED = 1e-4, 0.05


def gathered(time_s, x_m, signal, speed=None):
    stream = CellStream.starting(CELL_M, True, np.array([0.0, 2.0]), 1, 0, 1.0)
    speed = np.full(x_m.size, SPEED) if speed is None else speed
    rows = np.stack([time_s, x_m, speed, signal])
    return [*stream.push(rows), *stream.close()]


def steady(count, spacing_m):
    x_m = spacing_m * np.arange(count)
    return x_m / SPEED, x_m


@pytest.mark.parametrize("spacing", [0.03, 0.21, 0.77, 1.7])
def test_every_sample_counts_once(spacing):
    """The samples that have neighbours, at any spacing, also over cells without one."""
    time_s, x_m = steady(300, spacing * CELL_M)
    cells = gathered(time_s, x_m, np.ones(300))
    assert sum(float(cell.samples[0]) for cell in cells) == pytest.approx(296)
    if spacing > 1:  # each in one cell
        assert {float(cell.samples[0]) for cell in cells} == {0.0, 1.0}
    assert [cell.number for cell in cells] == list(range(cells[0].number, cells[-1].number + 1))


def test_signal_place_and_information_are_those_of_least_squares():
    time_s, x_m = steady(2000, 0.02 * CELL_M)
    speed = SPEED * (1 + 0.3 * np.sin(5e3 * x_m))
    slope = 3.0 + 40.0 * x_m
    cells = gathered(time_s, x_m, 2.0 * speed * slope, speed)[1:-1]
    for cell in cells:
        signal, place = (each[0] / cell.information[0] for each in (cell.projection, cell.place))
        assert signal == pytest.approx(3.0 + 40.0 * place, rel=1e-9)
        assert place == pytest.approx((cell.number + 0.5) * CELL_M, abs=0.05 * CELL_M)


def test_missing_rows_leave_their_cells_empty():
    """The samples beside a gap do not reach into it."""
    time_s, x_m = steady(1000, 0.05 * CELL_M)
    kept = (x_m < 20.3 * CELL_M) | (x_m > 30.6 * CELL_M)
    cells = {cell.number: cell for cell in gathered(time_s[kept], x_m[kept], np.ones(kept.sum()))}
    assert all(cells[number].samples[0] == 0 for number in range(21, 30))
    assert cells[20].samples[0] == pytest.approx(6, abs=0.6)
    assert cells[30].samples[0] == pytest.approx(8, abs=0.6)


def test_fourth_differences_are_noise_alone():
    """Of white noise they have its variance; of a cubic they are zero."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=20_000)
    time_s, x_m = steady(20_000, 0.05 * CELL_M)
    cells = gathered(time_s, x_m, 0.3 * noise)
    squares, freedom = (sum(float(getattr(cell, name)[0]) for cell in cells)
                        for name in ("squares", "freedom"))  # fmt: skip
    assert squares / freedom == pytest.approx(0.09, rel=4 * np.sqrt(2 / freedom))
    assert freedom == pytest.approx(20_000 / CORRELATED, rel=1e-3)
    t = np.linspace(-1, 1, 50)
    assert np.abs(fourth_differences((t**3 - 2 * t**2 + t)[None])).max() < 1e-12


def test_speed_of_rounded_positions():
    time_s = np.cumsum(np.random.default_rng(1).uniform(0.8, 1.2, 200)) * 1e-4
    x_m = SPEED * time_s + 3.0 * time_s**2
    exact = SPEED + 6.0 * time_s[2:-2]
    assert np.allclose(slopes(time_s, x_m), exact, rtol=2e-2)
    rounded = np.round(x_m / 1e-6) * 1e-6
    central = (rounded[3:-1] - rounded[1:-3]) / (time_s[3:-1] - time_s[1:-3])
    own = slopes(time_s, rounded)
    assert np.std(own - exact) < 0.6 * np.std(central - exact)
