"""Random scenes: every kind of load, surface and skin, and effects of random strength.

All have the same shapes (cells, elements, layers, and a few counts of samples), so that
few programs are compiled for many scenes.
"""

from typing import Any

import numpy as np

from srsinv.parts import merged
from tests.jobs.run import composed

Rng = np.random.Generator

CELLS, REFINEMENT, WINDOW_M = 256, 2, 0.04
SAMPLES_A_CELL = (0.5, 1.0, 1.0)  # of the finer line's cells: with aliasing, and without
STAND_SAMPLES, RAMP_SAMPLES = 32, 16  # spent standing still or sliding back, and turning


def configuration(seed: int) -> dict[str, Any]:
    """The configuration of one scene, without a tolerance."""
    names = ["noise=[]", "effects=auto", f"grid.cells={CELLS}", f"grid.refinement={REFINEMENT}"]
    rng = np.random.default_rng(seed)
    cfg = merged(composed(*names), _setting(rng, seed))
    cfg["effects"] = {**cfg["effects"]}
    if cfg["effects"]["reversal"]["duration_s"]:  # a skin that relaxes is refused beside it
        del cfg["effects"]["viscoelastic_skin"]
    del cfg["tolerance"]
    return cfg


def _setting(rng: Rng, seed: int) -> dict[str, Any]:
    speed = _power(rng, -2, -0.5)
    is_current = rng.random() < 0.75
    is_surface = seed % 2 == 1
    # Films whose rules of quadrature have the same number of nodes.
    depth = _power(rng, -3.03, -2.75)
    width = depth * _power(rng, -2, 0)
    # Half the pressure over the film's charge constant, and for a rate signal over a millimetre.
    typical = 1e6 * 23e-12 * 0.008 * width * 2e3 * (speed / 1e-3 if is_current else 1.0)
    rate_amplifier = {"_target_": "srsinv.forward.amplifier.CurrentAmplifier"}
    charge_amplifier = {"_target_": "srsinv.forward.amplifier.ChargeReadout", "gain_per_C": 1e6}
    return {
        "scene": _surface_scene(rng, seed // 2) if is_surface else _load_scene(rng, seed // 2),
        "skin": {
            "_target_": "srsinv.forward.skin.HalfSpace",
            "poisson_ratio": float(rng.choice([0.5, rng.uniform(0.3, 0.5)])),
            "youngs_modulus_Pa": _power(rng, 5, 6.5),
        },
        "scan": {"speed_m_per_s": float(speed * rng.choice([1, 1, 1, -1]))},
        "amplifier": rate_amplifier if is_current else charge_amplifier,
        "sensor": _sensor(rng, depth, width),
        "effects": _effects(rng, speed, typical),
    }


def _sensor(rng: Rng, depth: float, width: float) -> dict[str, Any]:
    offsets = rng.permutation([1.0, -0.3]) * _some(rng, 0.3, -6, -3)
    return {
        "depth_m": depth,
        "elements": {
            "along": {"strip_width_m": width, "offset_m": float(offsets[0])},
            "upright": {"strip_width_m": width, "offset_m": float(offsets[1])},
        },
    }


def _effects(rng: Rng, speed: float, typical: float) -> dict[str, Any]:
    cell, passage = WINDOW_M / CELLS / REFINEMENT, WINDOW_M / speed
    rate = float(rng.choice(SAMPLES_A_CELL)) * speed / cell
    stand = {
        "at_s": rng.uniform(0.2, 0.6) * passage,
        "duration_s": STAND_SAMPLES / rate,
        "ramp_s": RAMP_SAMPLES / rate,
    }
    stop = rng.random()
    skin = {"thickness_m": _power(rng, -3, -1.8), "poisson_ratio": rng.uniform(0.3, 0.5)}
    foam = {"thickness_m": _power(rng, -2.7, -1.7), "poisson_ratio": rng.uniform(0.2, 0.5)}
    skin["youngs_modulus_Pa"] = _power(rng, 5, 6.5)
    foam["youngs_modulus_Pa"] = skin["youngs_modulus_Pa"] * _power(rng, -2, 2)
    return {
        "film_angle": {"tilt_deg": _power(rng, -4, 1)},
        "layered_skin": {"layers": {"skin": skin, "foam": foam}},
        "viscoelastic_skin": {
            "fractions": [_power(rng, -4, 0)],
            "times_s": [_power(rng, -5, -1)],
        },
        "oblique_features": {"angle_deg": _some(rng, 0.5, -2, 1.7)},
        "amplifier_bandwidth": {"capacitance_F": _power(rng, -13, -9)},
        "antialias_filter": {
            "cutoff_hz": _power(rng, 2, 5),
            "filter_order": 4,
        },
        "sampling": {"rate_hz": rate},
        "quantisation": {
            "bits": int(rng.integers(8, 25)),
            "full_scale": typical * _power(rng, 0, 3),
        },
        "clipping": {"limit": typical * _power(rng, -1, 3)},
        # Whole periods in a passage: the number of samples stays.
        "speed_ripple": {
            "fraction": _power(rng, -6, -0.5),
            "frequency_hz": float(rng.integers(1, 20)) / passage,
        },
        "standstill": {**stand, "duration_s": stand["duration_s"] if stop < 0.15 else 0.0},
        "reversal": {**stand, "duration_s": stand["duration_s"] if stop > 0.9 else 0.0},
        "load_drift": {"fraction": _power(rng, -6, -0.5), "period_s": _power(rng, -1, 1)},
        "snap_back": {
            "rate_hz": float(rng.choice([0.0, 200.0])),
            "shear_Pa": _power(rng, -2, 3),
        },
    }


def _load_scene(rng: Rng, kind: int) -> dict[str, Any]:
    pressure, position = _power(rng, 2, 4), rng.uniform(-0.01, 0.01)
    width, edge = _power(rng, -3.3, -2), _power(rng, -4, -3)
    loads = (
        {"_target_": "PressedStrip", "width_m": width, "edge_m": edge, "position_m": position},
        {"_target_": "UniformStrip", "width_m": width, "position_m": position},
        {"_target_": "Hertz", "half_width_m": width, "position_m": position},
        {"_target_": "Sinusoid", "wavelength_m": WINDOW_M / int(rng.integers(3, 40))},
        {"_target_": "LineLoad", "position_m": position},
        {"_target_": "Step", "position_m": position},
        {"_target_": "Bars", "pitch_m": WINDOW_M / int(rng.integers(4, 20))},
    )
    load = dict(loads[kind % len(loads)])
    size = {"load_N_per_m": pressure * 1e-3} if kind % 7 == 4 else {"pressure_Pa": pressure}
    step = {"change": rng.uniform(-0.3, 0.3), "position_m": rng.uniform(-0.015, 0.015)}
    return {
        "_target_": "srsinv.forward.scene.TractionScene",
        "background_pressure_Pa": _power(rng, 3.5, 4.5),
        "base_friction": rng.uniform(0, 0.8),
        "pressures": {
            "load": {**load, **size, "_target_": f"srsinv.forward.traction.{load['_target_']}"}
        },
        "frictions": {
            "step": {
                "_target_": "srsinv.forward.traction.FrictionStep",
                "edge_m": _power(rng, -4, -3), **step,
            }
        },
    }  # fmt: skip


def _surface_scene(rng: Rng, kind: int) -> dict[str, Any]:
    height, position = _power(rng, -6.5, -4), rng.uniform(-0.01, 0.01)
    edge, wide = {"edge_length_m": _power(rng, -4.5, -3.3)}, {"width_m": _power(rng, -3.3, -2)}
    at = {"position_m": position}
    own = {"friction_zone_length_m": 6e-4}
    surfaces = (
        {"_target_": "Bump", "height_m": height, "sigma_m": _power(rng, -3.5, -2.7), **at},
        {"_target_": "Cylinder", "radius_m": _power(rng, -2.5, -1), **at},
        {"_target_": "Ridge", "height_m": height, **wide, **edge, **at},
        {"_target_": "Ridges", "height_m": height, "width_m": 4e-4, "pitch_m": 2e-3, **edge},
        {"_target_": "Rough", "rms_m": height / 4, "longest_m": 4e-3, "shortest_m": 4e-4,
         "seed": kind},
        {"_target_": "SineWave", "height_m": height,
         "wavelength_m": WINDOW_M / int(rng.integers(4, 30))},
        {"_target_": "StepUp", "height_m": height, "edge_friction": 0.8, **edge, **at, **own},
        {"_target_": "StepDown", "height_m": height, **edge, **at, **own},
        {"_target_": "Tape", "height_m": height, "leading_edge_friction": 1.1, **wide, **edge,
         **at, **own},
        {"_target_": "Profile", "position_m": list(np.linspace(-0.019, 0.019, 40)),
         "profile_m": list(height * rng.standard_normal(40))},
    )  # fmt: skip
    surface = dict(surfaces[kind % len(surfaces)])
    target = f"srsinv.forward.surface.{surface['_target_']}"
    return {
        "_target_": "srsinv.forward.scene.SurfaceScene",
        "nominal_pressure_Pa": _power(rng, 3.5, 4.5),
        "base_friction": rng.uniform(0, 0.8),
        "surfaces": {"surface": {**surface, "_target_": target}},
    }


def _power(rng: Rng, low: float, high: float) -> float:
    return float(10 ** rng.uniform(low, high))


def _some(rng: Rng, part: float, low: float, high: float) -> float:
    """Nothing in this part of all scenes."""
    value = _power(rng, low, high)
    return 0.0 if rng.random() < part else value
