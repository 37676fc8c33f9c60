"""What a rule's choice of the weights costs over the best weights, and what its bands cover.

Tikhonov's method of first order, and on a smooth bump of second order, too, p and q apart, on
simulated scenes in white noise at three signal-to-noise ratios (minutes). For every draw of the
noise the oracle takes the two weights of least error, which needs the truth.

The discrepancy principle smooths more than the other rules, and this study shows why. With H the
influence matrix, I - H = (I + G S G^T)^-1 in units of the noise, so that data drawn from the model
leave

    E |(I - H) y|^2 = tr((I - H) (I + G S G^T) (I - H)) = tr(I - H),

over the samples that are there and less one for each offset that is fitted. Morozov's target, the
samples, neglects tr H. With tr H the target is met in the mean, but the chi-square's own standard
deviation, root 2 (samples - tr H), is as large as tr H: in a draw whose noise is by chance as loud,
weights that fit most of the noise are taken. And one number cannot tell two weights: the oracle of
weights moved together costs up to 1.6 itself.
"""

import dataclasses
import math
from functools import lru_cache
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import norm

from srsinv import config
from srsinv.forward.scene import TractionScene
from srsinv.forward.traction import Pressure
from srsinv.inverse.line import direct, spectral
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.rule import Choice, Evidence, GeneralisedCrossValidation, Rule
from srsinv.inverse.line.scorer import Scorer
from srsinv.inverse.line.solve import choose_path
from srsinv.inverse.simulated import noisy_problem
from srsinv.inverse.tikhonov import Penalties, Tikhonov
from srsinv.jobs.trials import Row
from tests.claims.study import Study, combinations
from tests.jobs.run import composed

SNR_DB = (20.0, 30.0, 40.0)
DRAWS, DRAWS_OF_GAPS = 40, 4  # of the noise
BAND = 0.9
MOST_FITTED = 0.9  # of the samples, where the discrepancy principle may end
MISSING = 0.1  # of the samples, in the scene without some
GAPS = "strip, open line, samples missing"
SCENES = {  # the last on the direct path, the others on the spectral one
    "pressed strip": ("scene=pressed_strip", "grid.cells=256"),
    "strip": ("scene=strip", "grid.cells=256"),
    "cylinder": ("scene=hertz", "grid.cells=256"),
    "ridge": ("scene=ridge", "grid.cells=256"),
    "smooth bump": ("scene=hertz", "grid.cells=256"),
    "smooth bump, second order": ("scene=hertz", "grid.cells=256"),
    "strip, friction known": ("scene=strip", "grid.cells=256", "friction=0.4"),
    GAPS: ("scene=strip", "grid.cells=64", "grid.length_m=0.01", "grid.start_m=-0.005",
           "grid.line=open"),
}  # fmt: skip


ORDERS = {"smooth bump, second order": 2}  # of the penalty; 1 in the other scenes


class SmoothBump(Pressure):
    """p = P exp(-x^2 / 2 w^2), which has no edge."""

    pressure_Pa: float = 2e4
    width_m: float = 2e-3

    def primitive(self, x):
        size = self.pressure_Pa * self.width_m * math.sqrt(math.pi / 2)
        return size * jax.scipy.special.erf(x / (math.sqrt(2) * self.width_m))


class Discrepancy(Rule):
    """Morozov's principle (1966), both weights moved together: the whitened residual is the number
    of samples; or, `less_fitted`, that less the degrees of freedom of the fit."""

    name: ClassVar[str] = "discrepancy principle"
    less_fitted: bool

    def choose(self, scorer: Scorer, box) -> Choice:
        """Where the residual meets its target first, coming from the strong end, linear between
        scanned weights. Where it nowhere does, as with less noise taken up than there is by chance,
        the weights at which it is nearest; not those that fit nearly all, where 0 meets 0."""
        problem, fractions = scorer.problem, np.linspace(1, 0, 81)
        low, high = np.asarray(box)
        score = scorer(jnp.asarray(low + fractions[:, None] * (high - low)))
        offsets = problem.data.shape[0] if problem.has_free_offset else 0
        fitted = np.asarray(score.freedom) + offsets
        proper = fitted < MOST_FITTED * problem.sample_count
        target = problem.sample_count - (fitted if self.less_fitted else 0.0 * fitted)
        excess = np.log(np.asarray(score.residual)[proper] / target[proper])
        below = np.flatnonzero(excess < 0)
        if below.size == 0 or below[0] == 0:
            fraction = fractions[np.argmin(np.abs(excess))]
        else:
            at = below[0] - np.array([0, 1])
            fraction = np.interp(0.0, excess[at], fractions[at])
        return Choice(jnp.asarray(low + fraction * (high - low)), "converged")


RULES = {
    "gcv": GeneralisedCrossValidation(),
    "evidence": Evidence(),
    "discrepancy": Discrepancy(False),
    "discrepancy less tr H": Discrepancy(True),
}


ORACLES = ("oracle", "oracle of weights moved together")
DEPTH_M = 0.75e-3  # the length that goes with a penalty's weight
ORACLE_STEPS = (1.0, 0.5, 0.25)  # decades, of the search for the best weights


class Draw(NamedTuple):
    """Of p and q less their means: squared errors [Pa^2], and the share of cells in their bands."""

    square: float
    covered: float


@lru_cache(maxsize=1)
def problems(scene: str, snr_dB: float, draws: int) -> tuple[np.ndarray, list[LineProblem]]:
    """The true traction (2, n) less its mean over the samples' stretch, and noisy problems."""
    cfg = composed(*SCENES[scene], f"noise.snr.snr_dB={snr_dB}")
    sim, friction = config.simulation(cfg), config.friction(cfg)
    if scene.startswith("smooth bump"):
        bump = TractionScene(0.0, 0.4, (SmoothBump(),))
        sim = dataclasses.replace(sim, scenario=sim.scenario.replace(scene=bump))
    keys = jax.random.split(jax.random.key(0), draws)
    made = [noisy_problem(sim, key, friction) for key in keys]
    if scene == GAPS:
        observed = np.random.default_rng(0).random(made[0].data.shape) > MISSING
        made = [with_gaps(problem, observed) for problem in made]
    return np.asarray(sim.traction(sim.line)), made


def with_gaps(problem: LineProblem, observed: np.ndarray) -> LineProblem:
    """The same problem with the samples that are there alone."""
    parts = (jnp.where(observed, problem.data, 0.0), jnp.asarray(observed))
    return eqx.tree_at(
        lambda p: (p.data, p.observed), problem, parts, is_leaf=lambda leaf: leaf is None
    )


def deviation(values):
    """Less the mean of each component, to which the signal is blind."""
    return values - values.mean(axis=-1, keepdims=True)


def draw(problem: LineProblem, truth: np.ndarray, method: Tikhonov) -> Draw:
    """The method's error and coverage."""
    estimate = method(problem)
    wrong = deviation(np.asarray(estimate.value) - truth)
    inside = np.abs(wrong) <= norm.ppf((1 + BAND) / 2) * np.asarray(estimate.stderr)
    return Draw(float(np.mean(wrong**2)), float(np.mean(inside)))


@eqx.filter_jit
def squares(problem: LineProblem, white: direct.Whitened | None, truth, log_weights, order: int):
    """The mean squared error (b,) of what is solved for under each row of log10 weights (b, c)."""
    family = Penalties(jnp.asarray(DEPTH_M), order)

    def one(weights):
        prior = family(weights)
        solved = (
            spectral.solve(problem, prior) if white is None else direct.solve(problem, prior, white)
        )
        return jnp.mean(deviation(solved.value - truth[: problem.unknowns]) ** 2)

    return jax.lax.map(one, log_weights, batch_size=None if white is not None else 64)


def best_weights(
    problem: LineProblem, truth: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """log10 of the weights of least error, and of those of least error along the box's diagonal.

    The first by a scan in decades, then grids ever closer about the best; the second by a scan.
    """
    white = direct.whiten(problem) if choose_path(problem, "auto") == "direct" else None
    most = np.log10(np.max(np.asarray(problem.information), axis=-1))

    def best(points):
        tried = squares(problem, white, jnp.asarray(truth), jnp.asarray(points), order)
        return points[np.argmin(tried)]

    along = best(most + np.arange(-12.0, 4.1, ORACLE_STEPS[-1])[:, None])

    def best_of(axes):
        return best(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes)))

    centre = best_of(most[:, None] + np.arange(-12.0, 4.1, 2.0))
    for step in ORACLE_STEPS:
        centre = best_of(centre[:, None] + step * np.arange(-1, 2))
    return centre, along


@lru_cache(maxsize=1)
def oracles(scene: str, snr_dB: float, draws: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The best weights of every draw, by the names of `ORACLES`."""
    truth, made = problems(scene, snr_dB, draws)
    return [best_weights(problem, truth, ORDERS.get(scene, 1)) for problem in made]


@lru_cache(maxsize=2)  # of the oracle, and of a rule
def mean_draw(scene: str, snr_dB: float, rule: str, draws: int) -> Draw:
    """The mean over all draws by a rule or an oracle."""
    truth, made = problems(scene, snr_dB, draws)
    order = ORDERS.get(scene, 1)
    if rule in RULES:
        methods = [Tikhonov(order, rule=RULES[rule])] * draws
    else:
        best = [each[ORACLES.index(rule)] for each in oracles(scene, snr_dB, draws)]
        methods = [Tikhonov(order, *(float(10.0**one) for one in each)) for each in best]
    every = [draw(problem, truth, by) for problem, by in zip(made, methods, strict=True)]
    return Draw(*map(float, np.mean(every, axis=0)))


def measured(scene: str, snr_dB: float, rule: str, draws: int) -> Row:
    """Root mean square error over the oracle's, and coverage of the bands."""
    own, best = (mean_draw(scene, snr_dB, each, draws) for each in (rule, ORACLES[0]))
    return {"error_over_oracle": np.sqrt(own.square / best.square), "coverage": own.covered}


def cases() -> list[Row]:
    """Every rule in every scene."""
    every = combinations(scene=SCENES, snr_dB=SNR_DB, rule=(*ORACLES, *RULES))
    return [each | {"draws": DRAWS_OF_GAPS if each["scene"] == GAPS else DRAWS} for each in every]


def summary(rows: list[Row]) -> Row:
    """Of every rule: the largest error over the oracle's, and the least and the mean coverage."""
    worst = {}
    for name in dict.fromkeys(row["rule"] for row in rows):
        own = [row for row in rows if row["rule"] == name]
        coverage = [row["coverage"] for row in own]
        worst[name] = {
            "largest_error_over_oracle": max(row["error_over_oracle"] for row in own),
            "least_coverage": min(coverage),
            "mean_coverage": float(np.mean(coverage)),
        }
    return {"band": BAND, "worst": worst}


STUDY = Study("rules", measured, cases, summary)
