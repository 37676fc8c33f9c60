"""What `effects=auto` leaves out of 100 random scenes, at three tolerances, against its bound.

It takes hours. A row says how many effects are `off`, how many of these change anything
(`off_active`), the `bound` on what they change together and the `error`, what they do change.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import jax
import numpy as np

from srsinv import config
from srsinv.forward.trace import difference, pair
from srsinv.jobs.trials import Row
from tests.claims.random_scenes import configuration
from tests.claims.study import Study, combinations

SCENES = 100
TOLERANCES = (0.1, 0.01, 0.001)

# Numbers at which an effect changes nothing: what is left out stays in the program at these, so
# that hundreds of simulations share few programs. Others are left out as they are.
SILENT: Mapping[str, Mapping[str, Any]] = {
    "film_angle": {"tilt_deg": 0.0},
    "viscoelastic_skin": {"fractions": [1e-200], "times_s": [1e-3]},
    "oblique_features": {"angle_deg": 0.0},
    "amplifier_bandwidth": {"capacitance_F": 1e-200},
    "antialias_filter": {"cutoff_hz": 1e17},
    "speed_ripple": {"fraction": 0.0},
    "load_drift": {"fraction": 0.0},
}


@lru_cache(maxsize=1)
@jax.enable_x64(True)
def measured(scene: int, is_silenced: bool = True) -> Mapping[float, Row]:
    """One scene, by tolerance; with `is_silenced` what is off is there at silent numbers."""
    return measured_of(configuration(scene), is_silenced)


def measured_of(cfg: config.Config, is_silenced: bool) -> Mapping[float, Row]:
    """The scene of a configuration, by tolerance."""
    rows, done, key = {}, {}, jax.random.key(0)
    full = config.simulation(cfg)
    for tolerance in TOLERANCES:
        screening = config.screened({**cfg, "tolerance": tolerance})[1]
        assert screening is not None
        if screening.on not in done:
            select = _silenced if is_silenced else config.select_effects
            less = config.simulation(select(cfg, screening.on))
            whole, reduced = pair(full, less, key)
            done[screening.on] = difference(reduced, whole)
        off = [name for name in cfg["effects"] if name not in screening.on]
        rows[tolerance] = {
            "off": len(off),
            "off_active": sum(screening.relative_change_bounds[name] > 0 for name in off),
            "bound": screening.bound,
            "error": done[screening.on],
        }
    return rows


def summary(rows: list[Row]) -> Row:
    """What README and docs say of the rows."""
    changed = [row for row in rows if row["error"]]
    by_tolerance = {f"{t:g}": [r for r in rows if r["tolerance"] == t] for t in TOLERANCES}

    def means(name: str) -> Row:
        return {t: float(np.mean([r[name] for r in own])) for t, own in by_tolerance.items()}

    return {
        "scenes": len({row["scene"] for row in rows}),
        "error_over_bound_max": max((r["error"] / r["bound"] for r in changed), default=0.0),
        "error_over_tolerance_max": max(row["error"] / row["tolerance"] for row in rows),
        "bound_over_error_median": float(np.median([r["bound"] / r["error"] for r in changed])),
        "effects_off_mean": means("off"),
        "effects_off_active_mean": means("off_active"),
    }


def _silenced(cfg: Mapping[str, Any], on: frozenset[str]) -> config.Config:
    effects = {
        name: node if name in on else {**node, **SILENT[name]}
        for name, node in cfg["effects"].items()
        if name in on or name in SILENT
    }
    return {**cfg, "effects": effects}


STUDY = Study(
    "screening",
    lambda scene, tolerance: measured(scene)[tolerance],
    lambda: combinations(scene=range(SCENES), tolerance=TOLERANCES),
    summary,
)
