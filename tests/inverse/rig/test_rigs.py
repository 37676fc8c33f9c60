"""Calibrations of random rigs whose signals an independent simulator makes: intervals that cover
as they say, and no parameter off on average.

The rigs are those of `python -m tests.claims.rigs`, made quick: strips of no width, 600 samples
over fifteen depths, two strips and one way. The signals are those of line_rig.py.
"""

from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.quality import Quality
from srsinv.inverse.rig.calibration import calibrate
from srsinv.modules import with_fields
from tests.claims.rig_scans import RIDGE, Rig, Setup, random_rig
from tests.claims.rigs import BAND, LIMIT, pulls
from tests.reference.line_rig import Strip, rate, ridge_loads

QUICK = Setup(samples=600, scan_depths=15.3, window_depths=19.9, average=False)
RESISTANCE_OHM, AREA_M2 = 1e6, 2 * 0.7e-3 * 8e-3  # two strips each
MODULUS_PA = 7e5 / (1 - 0.5**2)
FALSE_ALARM = 1e-4  # of each bound: four of each of seven parameters, one draw in 350 in all


@lru_cache
def recorded(seed: int) -> tuple[Rig, np.ndarray]:
    """A rig and its signals (e, sample) [V] over its known ridge, without noise."""
    rig = random_rig(np.random.default_rng([seed, 7]), setup=QUICK)
    depth, ridge = rig.stated.depth_m, rig.known
    shape = ridge["height_m"], ridge["width_m"], ridge["position_m"], RIDGE.edge_m
    places, loads = ridge_loads(
        *shape, rig.window_m(depth), MODULUS_PA, rig.nominal_pressure_Pa
    )  # fmt: skip
    motion, (own, angle, offset) = rig.motion(depth), rig.strips
    x, speed = np.asarray(motion.position_m), np.asarray(motion.speed_m_per_s)
    strips = [Strip(own, 0.0, 0.0, 0.0, AREA_M2),
              Strip(own, np.deg2rad(angle), offset, 0.0, AREA_M2)]  # fmt: skip
    slopes = [rate(strip, x, np.sign(speed), places, loads, rig.friction) for strip in strips]
    return rig, np.array(rig.gains)[:, None] * RESISTANCE_OHM * speed * slopes


def pulls_of(seed: int, snr_db: float) -> dict[str, float]:
    rig, clean = recorded(seed)
    rng = np.random.default_rng([seed, int(snr_db)])
    gains = np.array(rig.gains)[:, None]
    noise = np.sqrt(np.mean((clean / gains) ** 2)) / 10 ** (snr_db / 20)
    signal = clean + gains * noise * rng.normal(size=clean.shape)
    depth = rig.stated.depth_m
    held = {name: rig.known[name] for name in ("height_m", "width_m")}
    made = calibrate(rig.problem(signal, depth, rig.sensor(rig.stated)), RIDGE, held)
    assert made.quality is not Quality.FAILED
    return pulls(rig, made)


@pytest.mark.claim
@pytest.mark.parametrize(("rigs", "snr_db"), [(40, db) for db in (30.0, 45.0, 60.0)])
def test_intervals_of_random_rigs_cover(rigs, snr_db):
    """Of intervals, squares and means, by chance beyond the bound once in 10^4."""
    every = [pulls_of(seed, snr_db) for seed in range(rigs)]
    least, most = chi2.ppf([FALSE_ALARM, 1 - FALSE_ALARM], rigs)
    for name in every[0]:
        own = np.array([each[name] for each in every])
        assert np.sum(np.abs(own) <= LIMIT) >= binom.ppf(FALSE_ALARM, rigs, BAND), name
        assert least < np.sum(own**2) < most, name
        assert abs(np.sum(own)) < norm.isf(FALSE_ALARM / 2) * np.sqrt(rigs), name


@pytest.mark.claim
def test_errors_of_a_ridge_hold_what_its_cells_are_off():
    """Half as wide cells move it by most of that: at 80 dB beyond the errors of the noise."""
    rig, clean = recorded(2)
    clean = clean / np.array(rig.gains)[:, None]
    problem = rig.problem(clean, rig.stated.depth_m, rig.sensor(rig.strips))
    noise = float(np.sqrt(np.mean(clean**2))) / 1e4
    fitted = FeatureFit({"one": RIDGE})(with_fields(problem, noise=SampleNoise(noise)))
    truth = rig.known | {"base_friction": rig.friction}
    for name, (value, error) in fitted.parameters.items():
        assert abs(value - truth[name]) < 1.5 * error < 1e-3 * abs(truth[name]), name
