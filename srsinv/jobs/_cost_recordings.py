"""Recordings: from samples of a scan to p and q, by the number of samples.

The scan is as long as its samples: the scene lies in its middle, 3 % of the samples are missing,
and what inverts them sees a recording, on cells that it chooses itself.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache, partial

import numpy as np

from ..forward.scan import Motion
from ..forward.simulation import Simulation
from ..inverse.estimate import COMPONENTS, Estimate, deviation, relative_error
from ..inverse.method import Method
from ..inverse.problem import Problem
from ._cost_settings import CostSettings
from ._cost_trials import cost_trial, failure_of, relative
from .trials import Row, Trial, Work

PART = "recordings"
MISSING, NOISE = 0.03, 0.01  # of the samples; of the signal's rms over the scene

ScanOf = Callable[[int], Simulation]  # by the number of samples, one to a cell of an open line


def trials(
    scanned: ScanOf,
    settings: CostSettings,
    methods: Mapping[str, Method],
    seed: int,
    friction: float | None,
    cell_m: float,
) -> Iterator[Trial]:
    """Every method as it is configured, at every number of samples, `cell_m` apart."""
    problem = lru_cache(1)(partial(_problem, scanned, seed, friction))
    for samples in sorted(settings.recording_samples):
        for name, method in methods.items():
            yield cost_trial(
                PART, PART, "open", name.lower(), samples,
                prepare=partial(_work, problem, samples, method),
                score=partial(_score, scanned, samples), rests_on={"cell_m": cell_m},
            )  # fmt: skip


def _work(problem: Callable[[int], Problem], samples: int, method: Method) -> Work:
    return partial(method, problem(samples))


def _problem(scanned: ScanOf, seed: int, friction: float | None, samples: int) -> Problem:
    """The scan as a recording: white noise, and samples missing at random."""
    sim, rng = scanned(samples), np.random.default_rng(seed)
    x, speed = np.asarray(sim.line.x), float(sim.scan.speed_m_per_s)
    order = slice(None) if speed > 0 else slice(None, None, -1)
    signal = np.asarray(sim.signal(), float)[:, order]
    rms = NOISE * float(np.sqrt(np.max(np.mean(signal**2, axis=1))))
    noisy = signal + rms * rng.standard_normal(signal.shape)
    noisy[rng.uniform(size=signal.shape) < MISSING] = np.nan
    position = x[order]
    time_s = np.abs(position - position[0]) / abs(speed)
    motion = Motion(time_s, position, np.full(samples, speed))
    half = float(sim.line.cell_m) / 2
    window = float(x[0]) - half, float(x[-1]) + half
    return Problem(sim.sensor, motion, noisy, rms, friction=friction, window_m=window)


def _score(scanned: ScanOf, samples: int, estimate: Estimate) -> Row:
    """Against the truth on the estimate's cells, as deviations from the mean."""
    rows = 2 if estimate.parameters or getattr(estimate, "friction", None) is None else 1
    truth = np.asarray(scanned(samples).traction(estimate.line), float)[:rows]
    value = np.asarray(estimate.value, float)[:rows]
    errors = relative_error(value, truth)
    measures: Row = {
        "error": relative(deviation(value), deviation(truth)),
        "applications": 2.0 * estimate.stats.get("iterations", np.nan),
        "failure": failure_of(estimate.status),
    }
    return measures | {f"error_{c}": float(e) for c, e in zip(COMPONENTS, errors, strict=False)}
