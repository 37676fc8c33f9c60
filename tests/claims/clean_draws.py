"""How often a clean scan is warned of: `python -m tests.claims.clean_draws` (minutes).

Strips of random place, width, pressure and friction in noise as stated, scanned without any fault
and inverted, or fitted, by every method of faults.py but those of a surface. Writes
results/clean_draws.json: of each method the fraction of draws with any warning, how often each is
given, and what its bands cover.
"""

import dataclasses
import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.method import Method
from tests.claims.faults import METHODS, MethodOnScene, fit_ratios, problem, ratios
from tests.claims.faulty_scans import RIDGE_SCENE, SCENES, Rng, ScannedScene, scan

RESULTS = Path(__file__).parent / "results" / "clean_draws.json"
DRAWS = 125  # of each of the eight methods: a thousand in all
CELL_M = 3e-4  # two and a half in a depth: as wide as they may be, for speed
BAND = 0.9
RANGES = {"position_m": (5e-3, 15e-3), "width_m": (1e-3, 6e-3), "pressure_Pa": (600.0, 2e4)}
GREATEST_FRICTION = 0.8
CHEAP = {name: tried for name, tried in METHODS.items() if tried.scene != RIDGE_SCENE}


def scenes(count: int, elements: int) -> Iterator[tuple[ScannedScene, Rng]]:
    """Scenes with a strip of random parameters, and what its noise is drawn from; positive ranges
    evenly in the logarithm."""
    usual = next(s for s in SCENES.values() if s.elements == elements and not s.is_of_surface)
    for seed in range(count):
        rng = np.random.default_rng([seed, elements])
        truth = {name: float(np.exp(rng.uniform(*np.log(r)))) for name, r in RANGES.items()}
        friction = float(rng.uniform(-GREATEST_FRICTION, GREATEST_FRICTION))
        yield dataclasses.replace(usual, truth=truth, friction=friction), rng


def drawn(tried: MethodOnScene, count: int = DRAWS) -> dict[str, Any]:
    """One method over all draws."""
    words: Counter[str] = Counter()
    warned, inside, method = 0, [], None
    for scene, rng in scenes(count, SCENES[tried.scene].elements):
        method = tried.method(scene) if method is None else method
        estimate, ratio = _answer(method, tried, scene, rng)
        warned += bool(estimate.reasons)
        words.update({re.sub(r"\d[\d.e+-]*", "#", each)[:60] for each in estimate.reasons})
        inside.append(np.mean(np.abs(ratio) <= norm.ppf((1 + BAND) / 2)))
    return {
        "draws": count,
        "warned": warned / count,
        "coverage": round(float(np.mean(inside)), 4),
        "by_warning": dict(words.most_common()),
    }


def _answer(method: Method, tried: MethodOnScene, scene: ScannedScene, rng: Rng):
    made = scan(scene, rng)
    stated = problem(made, tried.known_friction, CELL_M)
    estimate = method(stated)
    if isinstance(estimate, FeatureEstimate):
        return estimate, fit_ratios(scene, estimate)
    return estimate, ratios(made, stated, estimate)


def main() -> None:
    """Measure and write, after each method."""
    rows: dict[str, dict[str, Any]] = {}
    for name, tried in CHEAP.items():
        rows[name] = drawn(tried)
        most = max(row["warned"] for row in rows.values())
        mean = float(np.mean([row["warned"] for row in rows.values()]))
        record = {"band": BAND, "warned_most": most, "warned_mean": mean, "rows": rows}
        RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
