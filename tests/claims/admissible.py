"""What p >= 0, with and without a bound on friction, gains over the Gaussian prior, and what bands
cover (360 draws, half an hour).

A draw is a surface of random shape and place, pressed in full or in partial contact, a friction
coefficient of 0.2 to 0.6, and noise. Wiener's levels are chosen by evidence in all cases. Its
correlation lengths are 2 mm, or found by evidence, too (`_length`). For a few draws of each case
the Gaussian posterior that is truncated to p >= 0 stands beside (400 draws of the exact sampler of
tests/reference/truncated.py), which shows why bands are not made from it.
"""

from collections.abc import Callable

import jax
import numpy as np

import srsinv
from srsinv.forward.sensor import two_orientations
from srsinv.forward.surface import Cylinder, Ridge, Rough, SineWave
from srsinv.inverse.estimate import relative_error
from srsinv.inverse.line.constrained import centred_posterior
from srsinv.inverse.line.splitting import PerWave
from srsinv.jobs.trials import Row
from tests.claims.study import Study, combinations
from tests.reference.truncated import truncated_draws

CELLS, WINDOW_M = 256, 0.04
DRAWS, TRUNCATED = 20, 2  # of each case, and of these with the truncated posterior
SNR_DB = (20.0, 30.0, 40.0)
MOST_FRICTION = 1.0
STIFFNESS_PA = 7e5 / 0.75  # E* of the default skin
TOUCHING = 1e-3  # of the mean pressure
Rng = np.random.Generator


def _wave(rng: Rng, low: float, high: float) -> srsinv.SurfaceScene:
    """Westergaard's wave, the load so much of that of full contact."""
    count = int(rng.integers(4, 9))
    wave_m, load = WINDOW_M / count, rng.uniform(low, high)
    height = 2e4 / load * wave_m / (np.pi * STIFFNESS_PA)
    return _scene(rng, 2e4, SineWave(height, wave_m, rng.uniform(0, wave_m)))


def _rough(rng: Rng, longest_m: float, shortest_m: float, rms_m: float, load_Pa: float):
    seed = int(rng.integers(1 << 30))
    return _scene(rng, load_Pa, Rough(rms_m, longest_m, shortest_m, seed=seed))


def _scene(rng: Rng, load_Pa: float, shape) -> srsinv.SurfaceScene:
    return srsinv.SurfaceScene(load_Pa, [shape], rng.uniform(0.2, 0.6))


def _ridge(rng: Rng) -> srsinv.SurfaceScene:
    return _scene(rng, 2e3, Ridge(1e-4, rng.uniform(1e-3, 4e-3), rng.uniform(-5e-3, 5e-3)))


def _cylinder(rng: Rng) -> srsinv.SurfaceScene:
    return _scene(rng, 2e3, Cylinder(10 ** rng.uniform(-2, -1), rng.uniform(-5e-3, 5e-3)))


SCENES: dict[str, Callable[[Rng], srsinv.SurfaceScene]] = {
    "wave, full contact": lambda rng: _wave(rng, 1.1, 2.0),
    "wave, partial contact": lambda rng: _wave(rng, 0.15, 0.7),
    "cylinder": _cylinder,
    "smooth texture, partial contact": lambda rng: _rough(rng, 1e-2, 4e-3, 6e-5, 3e3),
    "ridge": _ridge,
    "rough texture, partial contact": lambda rng: _rough(rng, 4e-3, 4e-4, 1.2e-5, 3e3),
}


def measure(scene: str, snr_dB: float) -> Row:
    """Means over the draws of a case."""
    draws = [_draw(scene, snr_dB, seed) for seed in range(DRAWS)]
    names = {name: None for each in draws for name in each}
    return {name: float(np.mean([d[name] for d in draws if name in d])) for name in names}


def _draw(scene: str, snr_dB: float, seed: int) -> Row:
    rng = np.random.default_rng([list(SCENES).index(scene), int(snr_dB), seed])
    line = srsinv.Periodic(CELLS, WINDOW_M / CELLS, -WINDOW_M / 2)
    sensor, scan = srsinv.Sensor(two_orientations()), srsinv.ConstantSpeed(0.05)
    noise = [srsinv.SignalToNoise(snr_dB)]
    scenario = srsinv.Scenario(SCENES[scene](rng), sensor, scan, noise)
    made = srsinv.simulate(scenario, line, seed=seed)
    truth, cells = np.asarray(made.traction), np.ones(CELLS, bool)
    touching = truth[0] > TOUCHING * truth[0].mean()
    row = {"contact": float(touching.mean())}
    for of_length, correlation in (("", "given"), ("_length", "evidence")):
        plain = srsinv.Wiener(scale="evidence", correlation=correlation)
        gaussian = plain(made.problem)
        row |= _of(gaussian, truth, f"gaussian{of_length}", cells)
        row[f"doubtful{of_length}"] = float(any("correlation" in w for w in gaussian.warnings))
        size = relative_error(np.asarray(gaussian.value), truth)
        for name, most in (("admissible", None), ("with_friction", MOST_FRICTION)):
            method = srsinv.Wiener(
                scale="evidence", correlation=correlation, constraint=srsinv.Admissible(most)
            )
            found, whole = method(made.problem), f"{name}{of_length}"
            row |= _of(found, truth, whole, cells)
            error = relative_error(np.asarray(found.value), truth) / size
            row |= {f"ratio_{c}_{whole}": float(r) for c, r in zip("pq", error, strict=True)}
    if seed < TRUNCATED:
        plain = srsinv.Wiener(scale="evidence")
        size = row["error_p_gaussian"]
        row |= _truncated(made.problem.to_grid(), plain, truth, size)
    return row


def _of(estimate, truth, name: str, cells) -> Row:
    error = relative_error(np.asarray(estimate.value), truth)
    coverage = estimate.coverage(truth, cells)
    return {
        **{f"error_{c}_{name}": float(e) for c, e in zip("pq", error, strict=True)},
        **{f"coverage_{c}_{name}": float(f) for c, f in zip("pq", coverage, strict=True)},
    }


def _truncated(problem, method, truth: np.ndarray, size: float) -> Row:
    """Mean and bands of p of the truncated posterior."""
    prior = method.prior_fixed_on(problem)(problem)
    with jax.enable_x64(True):
        of = centred_posterior(problem, prior, srsinv.Admissible())
        assert isinstance(of.posterior, PerWave)
        lags = np.fft.irfft(np.asarray(of.posterior.covariance)[0, 0], CELLS)
    lag = (np.arange(CELLS)[:, None] - np.arange(CELLS)) % CELLS
    mean = np.asarray(of.mean)[0] + float(of.level[0, 0])
    draws = truncated_draws(mean, lags[lag], np.full(CELLS, float(of.level[0, 0])))
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    inside = (truth[0] >= low) & (truth[0] <= high)
    error = float(relative_error(draws.mean(axis=0), truth[0]))
    return {"ratio_p_truncated": error / size, "coverage_p_truncated": float(inside.mean())}


STUDY = Study("admissible", measure, lambda: combinations(scene=SCENES, snr_dB=SNR_DB))
