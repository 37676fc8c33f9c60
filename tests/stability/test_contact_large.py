"""Contact on a quarter of a million cells, against the conditions of contact themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.contact import press
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Periodic
from tests.stability.matrix import PRECISIONS
from tests.tiers import rare

CELL_M, MODULUS_PA, HEIGHT_M = 1e-4, 1e5, 1e-5
MANY = 2**18
# What the solver has to reach, of the gap over the skin's displacement.
TOLERANCE = {name: max(1e-10, 40 * float(np.finfo(name).eps)) for name in PRECISIONS}


def large(name):
    x = (np.arange(MANY) - MANY / 2 + 0.5) / MANY
    wave = HEIGHT_M * np.cos(2 * np.pi * x)
    full = np.pi * MODULUS_PA * HEIGHT_M / (MANY * CELL_M)
    return {
        "half a wave": (wave, full / 2),
        "a few cells": (wave, 1e-9 * full),
        "ridge": (np.where(abs(x) < 0.05, 10 * HEIGHT_M, 0.0), full),
        "impulse": (np.where(np.arange(MANY) == MANY // 2, HEIGHT_M, 0.0), full),
    }[name]


solve_many_cells = jax.jit(
    lambda height, nominal: press(
        Periodic(MANY, CELL_M), HalfSpace(0.5, 0.75 * MODULUS_PA), height, nominal
    )
)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    "name", rare(["half a wave", "a few cells", "ridge", "impulse"], "impulse")
)
def test_a_quarter_of_a_million_cells(name, precision, margin):
    """p >= 0, gap >= 0, gap = 0 where p > 0, and the mean of p, with the gap from p in float64."""
    with jax.enable_x64(precision == "float64"):
        height, nominal = (jnp.asarray(each, precision) for each in large(name))
        contact = solve_many_cells(height, nominal)
    assert contact.status == "converged"
    p, height = np.asarray(contact.pressure_Pa, float), np.asarray(height, float)
    k = 2 * np.pi * np.arange(1, MANY // 2 + 1) / (MANY * CELL_M)
    compliance = 2 / (MODULUS_PA * k) / np.sinc(k * CELL_M / 2 / np.pi)
    moved = np.fft.irfft(np.append(0, compliance) * np.fft.rfft(p), MANY)
    gap = moved - (height - np.max(height))
    gap = gap - np.mean(gap[p > 0])
    assert np.all(p >= 0)
    assert np.mean(p) == pytest.approx(float(nominal), rel=16 * float(np.finfo(precision).eps))
    # As far as it has to converge, and as rounding the pressure moves the skin.
    error = max(np.max(np.abs(gap[p > 0])), -np.min(gap)) / np.ptp(moved)
    bound = 2 * TOLERANCE[precision]
    margin(error, bound)
    assert error < bound
