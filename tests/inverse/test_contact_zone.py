"""Traction through the finger's contact zone is recovered as well as without one."""

import dataclasses

import jax
import numpy as np
import pytest

from srsinv import config
from srsinv.inverse.estimate import relative_error
from srsinv.inverse.simulated import noisy_problem, problem_of
from tests.effects.test_effects import configuration


@pytest.mark.full
def test_wiener_recovers_pressure_through_a_zone():
    """And not, where the inversion takes the finger to touch everywhere."""
    errors, sims = [], []
    for names in ("[strip_width]", "[strip_width,finite_patch]"):
        cfg = configuration(
            f"effects={names}", "grid.cells=512", "noise=[snr]", "method=[wiener]",
            *(["effects.finite_patch.half_width_m=0.003"] if "patch" in names else []),
        )  # fmt: skip
        sims.append(config.simulation(cfg))
        (method,) = config.methods(cfg).values()
        estimate = method(noisy_problem(sims[-1], jax.random.key(1)))
        truth = np.asarray(sims[-1].traction(sims[-1].line))
        errors.append(relative_error(np.asarray(estimate.value), truth)[0])
    infinite, zoned = sims
    assert errors[1] < 1.2 * errors[0]
    assumed = dataclasses.replace(infinite, scenario=zoned.scenario.replace(sensor=infinite.sensor))
    wrong = method(problem_of(assumed, zoned.signal(), np.mean(truth[0]), jax.random.key(1)))
    assert relative_error(np.asarray(wrong.value), truth)[0] > 1.5 * errors[1]
