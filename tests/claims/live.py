"""Live inversion: coverage at each lag, on motions, scenes and noise of many kinds, and its cost
(minutes).

Scans of 30 mm are drawn from the prior (tests/inverse/live/scans.py), at 40 dB with an adaptive
noise level; those of a noise step are at 60 dB on its quiet side. Strips are scenes that no prior
would draw, inverted live and in batch with levels that the evidence chooses on the same scan.
"""

import resource
import time
from collections.abc import Callable

import numpy as np
from scipy.stats import norm

from srsinv import Live, Motion, Problem, Sensor, Wiener
from srsinv.inverse.line.solve import solve
from srsinv.inverse.wiener import Exponential
from srsinv.jobs.trials import Row
from tests.claims.study import Study
from tests.inverse.live.scans import (
    CELL_M,
    DEPTH_M,
    World,
    drawn,
    live,
    paced,
    recorded,
    run,
    steady,
    volts,
    world,
)

LAGS = (0, 1, 2, 4, 8)  # depths
LIMIT = norm.ppf(0.95)
SETTLED = slice(48, -72)  # cells with a settled noise level, and a full lag
STEP_M = 0.015
MOTIONS: dict[str, Callable] = {
    "steady": steady,
    "varying_30_percent": lambda: paced(lambda t: 1 + 0.3 * np.sin(2 * np.pi * t / 0.13)),
    "stop_and_go": lambda: paced(
        lambda t: np.clip(0.5 + 1.2 * np.sin(2 * np.pi * (t / 0.4 + 0.25)), 0, 1)
    ),
}


def scored(scores: list[np.ndarray]) -> Row:
    """Coverage of 90 % bands, and the rms of errors over standard errors, of p and q."""
    every = np.concatenate(scores, axis=1)
    covered, rms = np.mean(np.abs(every) < LIMIT, axis=1), np.sqrt(np.mean(every**2, axis=1))
    return {f"coverage_{c}": float(covered[i]) for i, c in enumerate("pq")} | {
        f"ratio_rms_{c}": float(rms[i]) for i, c in enumerate("pq")
    }


def of_lag(draws: int, lag: int) -> Row:
    """Steady scans from the prior, with a lag of so many depths."""
    made, (time_s, x_m, speed) = live().with_lag(lag * DEPTH_M), steady()
    scores = []
    for seed in range(draws):
        rng = np.random.default_rng([1, seed])
        own = drawn(rng)
        signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
        cells = run(made.with_lag(lag * DEPTH_M), time_s, x_m, signal)
        scores.append(own.scores(cells)[:, SETTLED])
    return scored(scores)


def of_motion(draws: int, motion: str) -> Row:
    """Scans from the prior along a motion, or with missing samples."""
    time_s, x_m, speed = MOTIONS.get(motion, steady)()
    scores = []
    for seed in range(draws):
        rng = np.random.default_rng([2, seed])
        own = drawn(rng)
        signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
        if motion == "missing":
            signal[:, rng.random(x_m.size) < 0.03] = np.nan
            for start in rng.integers(500, x_m.size - 500, 12):
                signal[:, start : start + 50] = np.nan
        scores.append(own.scores(run(live(), time_s, x_m, signal))[:, SETTLED])
    return scored(scores)


def of_step(draws: int, louder: bool) -> Row:
    """A noise step of 20 dB: the level five depths after it, and coverage within three depths."""
    time_s, x_m, speed = steady()
    levels, scores = [], []
    for seed in range(draws):
        rng = np.random.default_rng([3, seed])
        own = drawn(rng)
        quiet = 1e-3 * volts(own)
        noise = np.where((x_m > STEP_M) == louder, 10 * quiet, quiet)
        cells = run(live(), time_s, x_m, recorded(rng, own, x_m, speed, noise))
        after = int(np.argmin(np.abs(cells.x_m - STEP_M - 5 * DEPTH_M)))
        levels.append(20 * np.log10(cells.noise[:, after] / quiet) - (20 if louder else 0))
        scores.append(own.scores(cells)[:, np.abs(cells.x_m - STEP_M) < 3 * DEPTH_M])
    off = np.array(levels)
    within = {"within_1_dB": float(np.mean(np.abs(off) < 1)), "level_mean_dB": float(off.mean())}
    return within | {"level_rms_dB": float(off.std())} | scored(scores)


def strip(rng: np.random.Generator) -> World:
    """A uniform strip of random place, width, pressure and friction, with smooth edges."""
    x = np.arange(round(0.07 / CELL_M)) * CELL_M - 0.02
    place, width = rng.uniform(0.01, 0.02), np.exp(rng.uniform(*np.log([1e-3, 6e-3])))
    edge = 2e-4
    shape = (np.tanh((x - place + width / 2) / edge) - np.tanh((x - place - width / 2) / edge)) / 2
    p = np.exp(rng.uniform(*np.log([600.0, 2e4]))) * shape
    return world(np.stack([p, rng.uniform(-0.8, 0.8) * p]))


def of_strips(draws: int) -> Row:
    """Strips, live with a lag of four depths and in batch, by the same levels."""
    time_s, x_m, speed = steady()
    spectra = [Exponential(1500.0, 2e-3)] * 2
    lives, batches = [], []
    for seed in range(draws):
        rng = np.random.default_rng([4, seed])
        own = strip(rng)
        noise = 1e-2 * float(np.std(recorded(rng, own, x_m, speed, 0.0)))
        signal = recorded(rng, own, x_m, speed, noise)
        problem = Problem(Sensor(), Motion(time_s, x_m, speed), signal, noise, cell_m=CELL_M)
        gridded = problem.to_grid()
        chosen = Wiener(*spectra, scale="evidence").prior_fixed_on(gridded)
        made = Live(Sensor(), chosen, lag_m=4 * DEPTH_M)
        lives.append(own.scores(run(made, time_s, x_m, signal))[:, SETTLED])
        estimate = solve(gridded, chosen(gridded))
        line = np.asarray(estimate.line.x)
        inside = (line > 48 * CELL_M) & (line < 0.03 - 72 * CELL_M)
        truth = np.stack([np.interp(line[inside], own.x_m, row) for row in own.traction])
        value, stderr = (np.asarray(each)[:, inside] for each in (estimate.value, estimate.stderr))
        batches.append((value - truth) / stderr)
    batch = {f"{name}_batch": value for name, value in scored(batches).items()}
    return scored(lives) | batch


def of_cost(chunk: int) -> Row:
    """Time per sample in chunks, and memory over a million samples of one endless scan."""
    rng = np.random.default_rng(5)
    own, (time_s, x_m, speed) = drawn(rng), steady()
    signal = recorded(rng, own, x_m, speed, 1e-2 * volts(own))
    turns = 1_000_000 // x_m.size if chunk > 1 else 4
    inversion, taken, begun = live(), [], 0
    for turn in range(turns):
        for start in range(0, x_m.size, chunk):
            rows = slice(start, start + chunk)
            given = turn * 0.6 + time_s[rows], turn * 0.03 + x_m[rows], signal[:, rows]
            clock = time.perf_counter()
            inversion.push(*given)
            taken.append((time.perf_counter() - clock) / given[0].size)
        taken = taken[-200_000:]
        if turn == 2:
            begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - begun
    return {
        "median_us": 1e6 * float(np.median(taken)),
        "percentile_99_us": 1e6 * float(np.quantile(taken, 0.99)),
        "samples": turns * x_m.size,
        "memory_grown_MB": grown / 1024,
    }


KINDS = {"lag": of_lag, "motion": of_motion, "step": of_step, "strips": of_strips, "cost": of_cost}


def measured(kind: str, **settings) -> Row:
    """One case."""
    return KINDS[kind](**settings)


def cases() -> list[dict]:
    """Every case, by its labels."""
    return [
        *({"kind": "lag", "draws": 500, "lag": lag} for lag in LAGS),
        *({"kind": "motion", "draws": 100, "motion": each} for each in (*MOTIONS, "missing")),
        *({"kind": "step", "draws": 100, "louder": each} for each in (True, False)),
        {"kind": "strips", "draws": 50},
        *({"kind": "cost", "chunk": chunk} for chunk in (10, 1)),
    ]


STUDY = Study("live", measured, cases)
