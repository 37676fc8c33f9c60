"""Bursts of catch and snap: what is found of them, how well, and how often one is claimed that is
not there (half an hour).

Elements 1 mm apart slide at 2 cm/s over a strip of pressure, ridges and a rough texture in turn,
512 samples a pass of one second, 1 uV of noise. Bursts come 3 times a second, of 2 kPa rms, each on
0.5 mm of a contact of 10 mm, and decay over 1 to 20 ms. Tractions are simulated on cells a fourth
as wide as those of the inversion; bursts are summed one by one in time, as
experiments/elements/passes.py has it.
"""

import dataclasses
from functools import cache

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import RegularGridInterpolator

import srsinv
from experiments.elements.passes import (
    BurstStatistics,
    TrueBursts,
    burst_signals,
    drawn_bursts,
    in_a_row,
)
from srsinv import (
    BurstEstimate,
    BurstInversion,
    ConstantSpeed,
    Film,
    Motion,
    Open,
    Periodic,
    Problem,
    Sensor,
    Wiener,
)
from srsinv.api import SimulatedProblem
from srsinv.forward.noise import White
from srsinv.forward.surface import Ridges, Rough
from srsinv.inverse.bursts.burst_pass import BurstPass
from srsinv.inverse.bursts.estimate import FoundBursts
from srsinv.inverse.bursts.model import BurstModel
from srsinv.inverse.bursts.rate import LOUD
from srsinv.jobs.trials import Row
from srsinv.modules import with_fields
from tests.claims.study import Study

N, CELL_M, SPEED, RMS_V, FRICTION = 512, 4e-5, 0.02, 1e-6, 0.4
FINER = 4  # samples of a recording in a cell
NEAR = 2  # samples, within which a claim is of a true burst
LINE = Periodic(N, CELL_M, -N * CELL_M / 2)
INTERVAL_S = CELL_M / SPEED
SECONDS = N * INTERVAL_S
STATISTICS = BurstStatistics(3.0, 2000.0, 5e-4, 1e-2, (1e-3, 20e-3))
SCENES = {
    "strip": srsinv.TractionScene(0.0, FRICTION, [srsinv.UniformStrip(2e4, 3e-3)]),
    "ridges": srsinv.SurfaceScene(2e4, [Ridges(30e-6, 2e-4, 2.56e-3)], FRICTION),
    "rough": srsinv.SurfaceScene(2e4, [Rough(5e-6, 2e-3, 1e-4)], FRICTION),
}


@dataclasses.dataclass(frozen=True)
class Setting:
    """Passes of so many elements, with or without bursts, over some of the scenes; `is_recorded`:
    as [`recorded_pass`][] has them."""

    passes: int
    elements: int
    has_bursts: bool = True
    scenes: tuple[str, ...] = tuple(SCENES)
    spacing_m: float = 1e-3
    is_recorded: bool = False

    def facts(self) -> Row:
        """What a row rests on: the fields but for the last two where these are as usual."""
        usual = {"spacing_m": 1e-3, "is_recorded": False}
        of = dataclasses.asdict(self)
        return {name: each for name, each in of.items() if usual.get(name) != each}


SETTINGS = {
    "1 element": Setting(40, 1),
    "2 elements": Setting(40, 2),
    "3 elements": Setting(200, 3),
    "4 elements": Setting(200, 4),
    "6 elements": Setting(40, 6),
    **{
        f"{elements} elements, {scene}, no bursts": Setting(100, elements, False, (scene,))
        for elements in (3, 6)
        for scene in ("ridges", "rough")
    },
    **{
        f"{elements} elements, {pitch} mm apart": Setting(40, elements, spacing_m=1e-3 * pitch)
        for elements, pitch in ((3, 2), (3, 3), (4, 2))
    },
    "4 elements, recorded": Setting(40, 4, is_recorded=True),
    "4 elements, recorded, no bursts": Setting(40, 4, False, is_recorded=True),
}


@cache
def clean(scene: str, of: Setting) -> SimulatedProblem:
    """The signals without noise, and what inverts them; of a recording over twice its length."""
    count, cell = N * FINER, CELL_M / FINER
    line = Periodic(2 * count, cell, -count * cell) if of.is_recorded else LINE
    sensor = Sensor(in_a_row(Film().with_strip_average(), of.elements, of.spacing_m))
    scenario = srsinv.Scenario(SCENES[scene], sensor, ConstantSpeed(SPEED), noises=(White(RMS_V),))
    return srsinv.simulate(scenario, line, friction=FRICTION)


@cache
def d_primes(scene: str, of: Setting) -> RegularGridInterpolator:
    """The signal-to-noise ratio of a burst of a first amplitude of 1 Pa, by its log decay and its
    place."""
    problem = clean(scene, of).problem
    model = BurstModel(problem, STATISTICS.patch_m, STATISTICS.contact_m, STATISTICS.decay_s)
    parts = BurstPass(problem, model, Wiener(scale="evidence"))
    parts.set_levels([])
    places = np.linspace(-0.5, 0.5, 401) * STATISTICS.contact_m
    decays = model.decays(41)
    squares = parts.search.rests[0].squares(model.decaying(decays), model.responses(places))
    return RegularGridInterpolator((np.log(decays), places), np.sqrt(squares))


def one_pass(scene: str, of: Setting, seed: int) -> tuple[BurstEstimate, TrueBursts]:
    """The estimate of one pass, and its bursts."""
    if of.is_recorded:
        return recorded_pass(scene, of, seed)
    made, rng = clean(scene, of), np.random.default_rng(seed)
    problem, truth = made.problem, TrueBursts(*(np.zeros(0),) * 4)
    assert problem.sensor is not None
    assert problem.scan is not None
    if of.has_bursts:
        truth = drawn_bursts(rng, STATISTICS, SECONDS)
    bursts = burst_signals(truth, STATISTICS.patch_m, problem.sensor, LINE, problem.scan)
    noise = rng.normal(0, RMS_V, bursts.shape)
    data = np.asarray(made.signal - problem.mean_signal) + bursts + noise
    estimate = BurstInversion()(with_fields(problem, data=jnp.asarray(data)))
    assert isinstance(estimate, BurstEstimate)
    return estimate, truth


def recorded_pass(scene: str, of: Setting, seed: int) -> tuple[BurstEstimate, TrueBursts]:
    """The same of a recording with `FINER` samples a cell, a tenth of them missing in a row, over
    a surface that goes on beyond the window, whose nominal pressure is not known."""
    cell, rng, count = CELL_M / FINER, np.random.default_rng(seed), N * FINER
    made = clean(scene, of)
    sensor, truth = made.problem.sensor, TrueBursts(*(np.zeros(0),) * 4)
    assert sensor is not None
    if of.has_bursts:
        truth = drawn_bursts(rng, STATISTICS, SECONDS)
    within = slice(count // 2, count // 2 + count)
    x = np.asarray(made.problem.line.x)[within]
    line, scan = Open(count, cell, 0.0), ConstantSpeed(SPEED)
    signal = np.asarray(made.signal)[:, within]
    signal = signal + burst_signals(truth, STATISTICS.patch_m, sensor, line, scan)
    level = RMS_V * np.sqrt(FINER)
    signal = signal + rng.normal(0, level, signal.shape)
    start = rng.integers(0, count * 9 // 10)
    signal[:, start : start + count // 10] = np.nan
    motion = Motion((x - x[0]) / SPEED, x, np.full(count, SPEED))
    problem = Problem(sensor, motion, signal, level, friction=FRICTION, cell_m=CELL_M)
    estimate = BurstInversion()(problem)
    assert isinstance(estimate, BurstEstimate)
    return estimate, truth


def passes(setting: str) -> Row:
    """Of claims the shares within two standard errors and in their 90 % intervals; how many claims
    are false, and how many loud bursts are missed; passes with a false claim in per cent."""
    of, scores, rates, counts = SETTINGS[setting], [], [], np.zeros(4, int)
    for seed in range(of.passes):
        scene = of.scenes[seed % len(of.scenes)]
        estimate, truth = one_pass(scene, of, seed)
        rates.append(estimate.bursts.rate_hz)
        matches = [_match(truth, time) for time in estimate.bursts.time.value]
        d_prime = _true_d_primes(truth, scene, of)
        false, missed = matches.count(-1), set(np.flatnonzero(d_prime > 2 * LOUD)) - set(matches)
        counts += [false, false > 0, np.sum(d_prime > LOUD), len(missed)]
        scores += [_scores(estimate.bursts, j, truth, i) for j, i in enumerate(matches) if i >= 0]
    false, with_false, loud, missed = counts.tolist()
    row: Row = {
        "passes": of.passes,
        "claimed": len(scores) + false,
        "false": false,
        "passes_with_false_percent": 100 * with_false / of.passes,
    }
    if not of.has_bursts:
        return row
    if of.is_recorded:  # some bursts are in the gap
        return row | _shares(np.array(scores))
    true_hz, (mean_hz, _, low, high) = loud / of.passes / SECONDS, np.array(rates).T
    return row | {
        "louder_than_5": loud,
        "missed_louder_than_10": missed,
        "rate_hz": float(np.mean(mean_hz)),
        "true_rate_hz": true_hz,
        "rate_in_90_percent": 100 * float(np.mean((low <= true_hz) & (true_hz <= high))),
        **_shares(np.array(scores)),
    }


def _true_d_primes(truth: TrueBursts, scene: str, of: Setting) -> np.ndarray:
    """The signal-to-noise ratio of each burst."""
    samples = truth.time_s / INTERVAL_S
    left = np.exp((samples - np.ceil(samples)) * INTERVAL_S / truth.decay_s)
    at = np.column_stack([np.log(truth.decay_s), truth.place_m])
    return np.abs(truth.size_Pa) * left * d_primes(scene, of)(at)


def _match(truth: TrueBursts, time_s: float) -> int:
    """The true burst that is nearest in time, -1 where none is within `NEAR` samples."""
    away = np.abs((truth.time_s - time_s + SECONDS / 2) % SECONDS - SECONDS / 2) / INTERVAL_S
    return int(np.argmin(away)) if away.size and away.min() <= NEAR else -1


def _scores(found: FoundBursts, j: int, truth: TrueBursts, i: int) -> list[float]:
    """Of one claim: whether it is located, the error of its place, and of each quantity whether it
    is within two standard errors and in its interval."""
    true = {
        "time": truth.time_s[i],
        "place": truth.place_m[i],
        "size": truth.size_Pa[i],
        "decay": truth.decay_s[i],
    }
    made = [float(found.is_located[j]), abs(found.place.value[j] - truth.place_m[i])]
    for name, value in true.items():
        of = getattr(found, name)
        made.append(float(abs(of.value[j] - value) <= 2 * of.stderr[j]))
        made.append(float(of.low[j] <= value <= of.high[j]))
    return made


def _shares(scores: np.ndarray) -> Row:
    """Means over claims; the error of places is of those that are located."""
    located = scores[:, 0] > 0
    row: Row = {
        "located_percent": 100 * float(np.mean(located)),
        "place_error_mm": 1e3 * float(np.median(scores[located, 1])) if located.any() else None,
    }
    for at, name in enumerate(("time", "place", "size", "decay")):
        within, inside = 100 * scores[:, 2 + 2 * at : 4 + 2 * at].mean(axis=0)
        row |= {f"{name}_within_2_percent": float(within), f"{name}_in_90_percent": float(inside)}
    return row


STUDY = Study(
    "bursts",
    passes,
    lambda: [{"setting": name} for name in SETTINGS],
    rests_on=lambda setting: SETTINGS[setting].facts(),
)
