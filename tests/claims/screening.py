"""What `effects=auto` leaves out of 100 random scenes, at three tolerances, against its bound.

    python -m tests.claims.screening [FIRST LAST]

writes tests/claims/results/screening.json, scene by scene: scenes that it holds are not run again.
Delete it, or name scenes, to run them anew.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from srsinv import config
from srsinv.command.programs import release_programs
from srsinv.forward.trace import difference, pair
from tests.claims.random_scenes import configuration

RESULTS = Path(__file__).parent / "results" / "screening.json"
SCENES = 100
TOLERANCES = (0.1, 0.01, 0.001)
MOST_MAPS = 30_000  # of memory: Linux ends a process that asks for 65530

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


class ScreenedScene(NamedTuple):
    """One scene at one tolerance: how many effects are off, that change anything (`active`) or not,
    the bound on what they change together and what they do change."""

    scene: int
    tolerance: float
    off: int
    off_active: int
    bound: float
    error: float


def measured(scene: int, is_silenced: bool = True) -> list[ScreenedScene]:
    """One scene at every tolerance; with `is_silenced` what is off is there at silent numbers."""
    rows, done = [], {}
    with jax.enable_x64(True):
        cfg, key = configuration(scene), jax.random.key(0)
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
            active = sum(screening.relative_change_bounds[name] > 0 for name in off)
            rows.append(
                ScreenedScene(
                    scene, tolerance, len(off), active, screening.bound, done[screening.on]
                )
            )
    return rows


def summary(rows: list[ScreenedScene]) -> dict[str, Any]:
    """What README and docs say of the rows."""
    changed = [row for row in rows if row.error > 0]
    by_tolerance = {f"{t:g}": [r for r in rows if r.tolerance == t] for t in TOLERANCES}
    return {
        "scenes": len({row.scene for row in rows}),
        "error_over_bound_max": max(row.error / row.bound for row in changed),
        "error_over_tolerance_max": max(row.error / row.tolerance for row in rows),
        "bound_over_error_median": float(np.median([r.bound / r.error for r in changed])),
        "effects_off_mean": {
            t: float(np.mean([r.off for r in s])) for t, s in by_tolerance.items()
        },
        "effects_off_active_mean": {
            t: float(np.mean([r.off_active for r in s])) for t, s in by_tolerance.items()
        },
    }


def _silenced(cfg: Mapping[str, Any], on: frozenset[str]) -> config.Config:
    effects = {
        name: node if name in on else {**node, **SILENT[name]}
        for name, node in cfg["effects"].items()
        if name in on or name in SILENT
    }
    return {**cfg, "effects": effects}


def main(first: int, last: int, afresh: bool) -> None:
    """Run the scenes that are not there yet, or all of them anew."""
    held = json.loads(RESULTS.read_text())["rows"] if RESULTS.exists() else []
    rows = {(row["scene"], row["tolerance"]): ScreenedScene(**row) for row in held}
    done = set() if afresh else {scene for scene, _ in rows}
    for scene in (each for each in range(first, last) if each not in done):
        new_rows = measured(scene)
        rows |= {(row.scene, row.tolerance): row for row in new_rows}
        text = json.dumps(
            {**summary(list(rows.values())), "rows": [rows[at]._asdict() for at in sorted(rows)]},
            indent=1,
        )
        RESULTS.parent.mkdir(exist_ok=True)
        RESULTS.write_text(text + "\n")
        print(*new_rows, sep="\n", flush=True)
        release_programs(MOST_MAPS)


if __name__ == "__main__":
    named = [int(each) for each in sys.argv[1:3]]
    main(*(named or (0, SCENES)), afresh=bool(named))
