"""Straight passes over ridges and gratings in the plane, against models of another form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.forward.filter import FirstOrder
from srsinv.forward.oblique import turned, turned_scan
from srsinv.forward.planar import (
    Circle,
    GratingLoad,
    ObliqueGrating,
    ObliqueRidge,
    PathScan,
    RidgeRow,
    StraightPass,
)
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import as_real
from tests.forward.setups import largest_error
from tests.refusals import refused

TURNS, PLACES = (0.0, np.pi / 4, 2.2), ((2.5e-3, 0.0), (0.0, 2.5e-3), (-1e-3, -2e-3))
FILMS = tuple(
    Film(0.75e-3, 0.2, 0.7e-3, 4e-3, turn_rad=turn, offset_m=x, offset_y_m=y).with_strip_average()
    for turn, (x, y) in zip(TURNS, PLACES, strict=True)
)
SENSOR = Sensor(FILMS)


@pytest.mark.full
def test_pass_along_x_is_the_oblique_model():
    """The films' exact kernel along the normal of features turned by 0.6."""
    angle, friction, width = 0.6, -0.4, 4e-4
    path = StraightPass(0.0, 0.05, 0.2, 64, middle_x_m=1e-3)
    ours = PathScan(SENSOR, path)(ObliqueRidge(angle, 3e-4, 1.5, width, friction))
    stage = turned(SENSOR, angle).output(turned_scan(ConstantSpeed(0.05), angle))
    xi = path.crossing(as_real(angle)).place_m - 3e-4
    each = jax.jit(lambda x, cell: stage.cell_response(x, cell))(xi, jnp.asarray(width))
    expected = 1.5 / width * (each[:, 0] + friction * each[:, 1])
    assert largest_error(ours, expected) < 1e-9


@pytest.mark.parametrize("path", [StraightPass(0.4, 0.05, 0.2, 32), Circle(8e-3, samples=32)],
                         ids=["pass", "circle"])  # fmt: skip
def test_grating_is_a_row_of_ridges(path):
    """A Fourier series of all ridges against ridges one by one and their mean load beyond."""
    scan, place = PathScan(SENSOR, path), (as_real(2e-4), as_real(3e-3), as_real(5e-4))

    @jax.jit
    def both(angle):
        return scan.unit(angle, GratingLoad(*place)), scan.unit(angle, RidgeRow(*place, 41))

    series, row = both(jnp.asarray(0.7))
    assert largest_error(series, row) < 1e-4


@pytest.mark.full
def test_heading_turns_with_everything():
    """A finger, a feature and a pass that are turned together give the same signal."""

    def signal(by):
        c, s = np.cos(by), np.sin(by)
        films = [
            Film(0.75e-3, 0.2, 0.7e-3, 4e-3, turn_rad=turn + by, offset_m=c * x - s * y,
                 offset_y_m=s * x + c * y).with_strip_average()
            for turn, (x, y) in zip(TURNS, PLACES, strict=True)
        ]  # fmt: skip
        path = StraightPass(0.3 + by, 0.05, 0.2, 32)
        return PathScan(Sensor(films), path)(ObliqueRidge(1.1 + by, 3e-4, friction=-0.4))

    assert largest_error(signal(0.8), signal(0.0)) < 1e-10


@pytest.mark.full
def test_filter_converges_with_the_samples():
    """It is exact for a signal that is linear between samples: the error falls as their square."""
    sensor, ridge = Sensor(FILMS, filters=[FirstOrder(5e-3)]), ObliqueRidge(0.5, 2e-4)
    path = StraightPass(0.0, 0.05, 0.2, 32)
    signals = [
        np.asarray(PathScan(sensor, path.finer(times))(ridge))[:, ::times] for times in (1, 2, 16)
    ]
    first, second = (np.abs(signal - signals[-1]).max() for signal in signals[:-1])
    assert 3 < first / second < 5


def test_coarser_pass_stands_at_the_means():
    path = StraightPass(0.3, 0.05, 0.2, 101, 1e-3, 2e-3)
    place, angle = np.asarray(path.crossing(as_real(0.2)).place_m), as_real(0.2)
    means = place[:96].reshape(-1, 8).mean(axis=1)
    np.testing.assert_allclose(path.coarser(8).crossing(angle).place_m, means, atol=1e-15)
    np.testing.assert_allclose(path.finer(3).crossing(angle).place_m[::3], place, atol=1e-15)


def test_refused():
    refused(lambda: StraightPass(0.0, -0.05), "pass.speed_m_per_s")
    refused(lambda: ObliqueGrating(0.0, 0.0, 2e-3, ridges=4), "odd whole number")
