"""How often a clean scan is warned of (minutes).

Strips of random place, width, pressure and friction in noise as stated, scanned without any fault
and inverted, or fitted, by every method of faults.py but those of a surface: of each the fraction
of draws with any warning, of those whose warning is wrong, how often each is given, and what its
bands cover.

Friction near zero leaves hardly any q in the signal. That the signal explains less than half of a
component's variance is right to say where the error found is that large: of these draws the
warning is not wrong.
"""

import dataclasses
import re
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from experiments.robustness.scans import RIDGE_SCENE, SCENES, Rng, ScannedScene, scan
from srsinv.inverse.diagnostics import LEAST_EXPLAINED
from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.method import Method
from srsinv.jobs.trials import Row
from tests.claims.faults import METHODS, MethodOnScene, errors, fit_ratios, problem, ratios
from tests.claims.study import Study, combinations

DRAWS = 125  # of each of the eight methods: a thousand in all
CELL_M = 1.5e-4  # five in a depth, for speed; by default they are eight
BAND = 0.9
RANGES = {"position_m": (5e-3, 15e-3), "width_m": (1e-3, 6e-3), "pressure_Pa": (600.0, 2e4)}
GREATEST_FRICTION = 0.8
CHEAP = {name: tried for name, tried in METHODS.items() if tried.scene != RIDGE_SCENE}
LARGE_ERROR = np.sqrt(1 - LEAST_EXPLAINED)  # of a component, relative
UNRESOLVED = re.compile("The signal resolves .* degrees of freedom of ([pq])")


class DrawOutcome(NamedTuple):
    """Of one draw: its warnings, the errors over the standard errors, and the components of which
    the signal explains less than half of the variance."""

    reasons: tuple[str, ...]
    ratios: np.ndarray
    unresolved: str = ""

    @property
    def is_wrongly_warned(self) -> bool:
        """Whether a warning says another thing than that an unresolved component is that."""
        named = [UNRESOLVED.match(each) for each in self.reasons]
        return any(each is None or each[1] not in self.unresolved for each in named)


def scenes(count: int, elements: int) -> Iterator[tuple[ScannedScene, Rng]]:
    """Scenes with a strip of random parameters, and what its noise is drawn from; positive ranges
    evenly in the logarithm."""
    usual = next(s for s in SCENES.values() if s.elements == elements and not s.is_of_surface)
    for seed in range(count):
        rng = np.random.default_rng([seed, elements])
        truth = {name: float(np.exp(rng.uniform(*np.log(r)))) for name, r in RANGES.items()}
        friction = float(rng.uniform(-GREATEST_FRICTION, GREATEST_FRICTION))
        yield dataclasses.replace(usual, truth=truth, friction=friction), rng


def drawn(method: str, draws: int) -> Row:
    """One method over all draws."""
    words: Counter[str] = Counter()
    tried, every, made = CHEAP[method], [], None
    for scene, rng in scenes(draws, SCENES[tried.scene].elements):
        made = tried.method(scene) if made is None else made
        every.append(_answer(made, tried, scene, rng))
        words.update({re.sub(r"\d[\d.e+-]*", "#", each)[:60] for each in every[-1].reasons})
    limit = norm.ppf((1 + BAND) / 2)
    inside = [np.mean(np.abs(each.ratios) <= limit) for each in every]
    return {
        "warned": sum(bool(each.reasons) for each in every) / draws,
        "warned_wrongly": sum(each.is_wrongly_warned for each in every) / draws,
        "coverage": float(np.mean(inside)),
        "by_warning": dict(words.most_common()),
    }


def _answer(method: Method, tried: MethodOnScene, scene: ScannedScene, rng: Rng) -> DrawOutcome:
    made = scan(scene, rng)
    stated = problem(made, tried.known_friction, CELL_M)
    estimate = method(stated)
    if isinstance(estimate, FeatureEstimate):
        return DrawOutcome(estimate.reasons, fit_ratios(scene, estimate))
    wrong, truth = errors(made, stated, estimate)
    size = np.linalg.norm(wrong, axis=-1) / np.linalg.norm(truth, axis=-1)
    large = [name for name, each in zip("pq", size, strict=True) if each > LARGE_ERROR]
    return DrawOutcome(estimate.reasons, ratios(made, stated, estimate), "".join(large))


def summary(rows: list[Row]) -> Row:
    """Means over the methods."""
    names = "warned", "warned_wrongly"
    means = {f"{name}_mean": float(np.mean([row[name] for row in rows])) for name in names}
    return {"band": BAND, **means}


STUDY = Study("clean_draws", drawn, lambda: combinations(method=CHEAP, draws=[DRAWS]), summary)
