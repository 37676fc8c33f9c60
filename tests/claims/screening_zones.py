"""What `effects=auto` leaves out of ten random scenes under a finger of finite width, against its
bound.

The scenes are those of tests/claims/screening.py with `BESIDE` alone of its effects, a contact zone
of half a depth to 100 depths, and ridges on every other finger. A row is as there. It takes a few
minutes.
"""

from collections.abc import Mapping
from functools import lru_cache

import jax
import numpy as np

from srsinv import config
from srsinv.jobs.trials import Row
from tests.claims.random_scenes import configuration
from tests.claims.screening import TOLERANCES, measured_of, summary
from tests.claims.study import Study, combinations

SCENES = 10
EFFECTS = "srsinv.effects"
BESIDE = ("strip_width", "element_offsets", "film_angle", "antialias_filter", "quantisation")


@lru_cache(maxsize=1)
@jax.enable_x64(True)
def measured(scene: int) -> Mapping[float, Row]:
    """One scene, by tolerance."""
    rng = np.random.default_rng([scene, 1])
    cfg = config.select_effects(configuration(scene), BESIDE)
    half = cfg["sensor"]["depth_m"] * float(10 ** rng.uniform(-0.3, 2.0))
    profile = str(rng.choice(["hertz", "foundation"]))
    cfg["effects"]["finite_patch"] = {
        "_target_": f"{EFFECTS}.finite_patch.FinitePatch",
        "profile": profile,
        "half_width_m": half,
    }
    if scene % 2:
        cfg["effects"]["fingerprint"] = {
            "_target_": f"{EFFECTS}.fingerprint.Fingerprint",
            "modulation": float(10 ** rng.uniform(-5, 0)),
            "pitch_m": float(rng.uniform(4e-4, 2e-3)),
        }
    return measured_of(cfg, is_silenced=True)


STUDY = Study(
    "screening_zones",
    lambda scene, tolerance: measured(scene)[tolerance],
    lambda: combinations(scene=range(SCENES), tolerance=TOLERANCES),
    summary,
)
