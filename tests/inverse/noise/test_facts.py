"""Facts of a rig that two elements' signals tell, beside their tolerances."""

import dataclasses

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES, scan
from srsinv.inverse.estimate import relative_error
from srsinv.inverse.line.rig_bands import stderr_by_source
from srsinv.inverse.noise.facts import with_learned_facts
from srsinv.inverse.noise.whittle import CellSignals, Likelihood, SpectralBands
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.recorded import problem_of, ready
from tests.inverse.noise.test_correlated import DEPTH_M, ONE, TWO
from tests.tiers import quick

CELL_M = 2e-4
METHOD = Tikhonov(1)


def on_cells(made, tolerance):
    """The problem of a scan on cells with the sidecar's `tolerance`."""
    recording = ready(made.recording)
    stated = dataclasses.replace(recording, sidecar={**recording.sidecar, "tolerance": tolerance})
    friction = made.scene.friction if made.scene.elements == 1 else None
    return problem_of(stated, friction=friction, cell_m=CELL_M).to_grid()


def error(made, problem):
    """The relative errors of p and q."""
    estimate, cells = METHOD(problem), problem.observed_cells
    pressure = made.pressure(problem.line)
    truth = np.stack([pressure, made.scene.friction * pressure])
    return relative_error(np.asarray(estimate.value), truth, cells)


@pytest.mark.parametrize("fault", quick(["angle_5", "gain_of_one_10"], "angle_5"))
def test_a_fact_that_is_off_is_told_and_no_longer_wrong(fault):
    made = faulty(faults()[fault], SCENES[TWO], 0)
    exact, told = on_cells(made, "none"), on_cells(made, "default")
    assert not told.warnings
    assert exact.warnings
    p, q = error(made, told) / error(made, exact)
    assert p < 0.9  # of long waves, which both elements transmit alike, less is wrong
    assert q < 0.6


def test_a_rig_that_is_right_is_as_it_is_stated_and_its_bands_narrower():
    made = scan(SCENES[TWO], np.random.default_rng(0))
    exact, told = on_cells(made, "none"), on_cells(made, "default")
    np.testing.assert_array_equal(told.forward.transfer, exact.forward.transfer)
    estimate = METHOD(told)
    parts = stderr_by_source(estimate)
    total = np.sqrt(sum(part**2 for part in parts.values()))
    np.testing.assert_allclose(total, estimate.stderr, rtol=1e-6)
    # By its tolerance alone the second element's offset would be most of the error of q.
    q = {source: np.sqrt(np.mean(part[1] ** 2)) for source, part in parts.items()}
    assert q["offset_2_m"] < 0.1 * q["noise"]


def test_one_element_tells_no_fact():
    problem = on_cells(scan(SCENES[ONE], np.random.default_rng(0)), "default")
    assert with_learned_facts(problem, DEPTH_M, False) is problem


def test_slopes_by_facts_are_those_of_differences():
    problem = on_cells(scan(SCENES[TWO], np.random.default_rng(0)), "none")
    bands = SpectralBands.of(CellSignals.of(problem, DEPTH_M))
    rng = np.random.default_rng(1)
    shape = (*bands.gain.shape[:2], 3, *bands.gain.shape[2:])
    facts = 0.05 * bands.gain[:, :, None] * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    likelihood = Likelihood(bands, False, False, facts=facts)
    x = 0.3 * rng.normal(size=np.concatenate(likelihood.greatest()[1]).size)
    slopes, off = likelihood(x)[1], 1e-5 * np.eye(x.size)
    differences = [(likelihood(x + o)[0] - likelihood(x - o)[0]) / 2e-5 for o in off]
    assert slopes == pytest.approx(np.array(differences), rel=1e-5, abs=1e-4)
