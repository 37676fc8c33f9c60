"""Random overrides of scene, sensor, amplifier, line, effects, noise and method.

A structure says which parts there are, and with it which programs are compiled. Its numbers are
drawn by themselves, so that many sets share a program.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

# Ranges of numbers: (low, high), by equal factors where both are above zero, else evenly.
Range = tuple[float, float]
ALWAYS = {
    "scan.speed_m_per_s": (0.01, 0.2),
    "sensor.depth_m": (3e-4, 2e-3),
    "sensor.elements.along.strip_width_m": (2e-4, 1.5e-3),
    "seed": (0, 1000),
}
TRACTION = {"scene.background_pressure_Pa": (5e3, 5e4), "scene.base_friction": (-0.8, 0.8)}
SURFACE = {"scene.nominal_pressure_Pa": (5e3, 5e4), "scene.base_friction": (-0.8, 0.8),
           "skin.youngs_modulus_Pa": (2e5, 5e6)}  # fmt: skip
SCENES: Mapping[str, Mapping[str, Range]] = {
    "scene=pressed_strip": TRACTION | {
        "scene.pressures.strip.pressure_Pa": (5e2, 2e4),
        "scene.pressures.strip.width_m": (1e-3, 6e-3),
        "scene.frictions.up.change": (-0.4, 0.4),
    },
    "scene=strip": TRACTION | {
        "scene.pressures.strip.pressure_Pa": (5e2, 2e4),
        "scene.pressures.strip.position_m": (-5e-3, 5e-3),
    },
    "scene=hertz": {
        "scene.base_friction": (-0.8, 0.8),
        "scene.pressures.cylinder.pressure_Pa": (5e2, 2e4),
        "scene.pressures.cylinder.half_width_m": (1e-3, 6e-3),
    },
    "scene=sinusoid": TRACTION | {
        "scene.pressures.wave.pressure_Pa": (5e2, 5e3),
        "scene.pressures.wave.wavelength_m": (2e-3, 2e-2),
    },
    "scene=ridge": SURFACE | {
        "scene.surfaces.ridge.height_m": (2e-6, 8e-5),
        "scene.surfaces.ridge.width_m": (1e-3, 4e-3),
        "scene.surfaces.ridge.edge_length_m": (3e-4, 6e-4),
    },
    "scene=tape": SURFACE | {
        "scene.surfaces.tape.height_m": (5e-6, 8e-5),
        "scene.surfaces.tape.leading_edge_friction": (0.2, 1.5),
        "scene.surfaces.tape.edge_length_m": (3e-4, 6e-4),
    },
    "scene=rough": SURFACE | {
        "scene.surfaces.rough.rms_m": (1e-6, 1e-5),
        "scene.surfaces.rough.hurst": (0.2, 0.9),
        "scene.surfaces.rough.seed": (0, 100),
    },
    "scene=ridge surface@scene.surfaces.ridge=bump": SURFACE | {
        "scene.surfaces.ridge.height_m": (5e-6, 5e-5),
        "scene.surfaces.ridge.sigma_m": (4e-4, 2e-3),
    },
    "scene=ridge surface@scene.surfaces.ridge=sinusoid": SURFACE | {
        "scene.surfaces.ridge.height_m": (1e-6, 2e-5),
    },
    "scene=ridge surface@scene.surfaces.ridge=step_up": SURFACE | {
        "scene.surfaces.ridge.height_m": (5e-6, 5e-5),
        "scene.surfaces.ridge.edge_length_m": (3e-4, 6e-4),
    },
}  # fmt: skip
SENSORS: Mapping[str, Mapping[str, Range]] = {
    "sensor=two_element": {
        "sensor.elements.upright.offset_m": (-5e-4, 5e-4),
        "sensor.piezo_constants_C_per_N.d1": (1e-11, 4e-11),
    },
    "sensor=one_element": {"friction": (-0.8, 0.8)},
}
AMPLIFIERS: Mapping[str, Mapping[str, Range]] = {
    "amplifier=current": {"amplifier.feedback_resistance_ohm": (1e5, 1e7)},
    "amplifier=integrated": {"amplifier.feedback_resistance_ohm": (1e5, 1e7)},
    "amplifier=charge_dc": {"amplifier.gain_per_C": (1e5, 1e7)},
}
LINES: Mapping[str, Mapping[str, Range]] = {"grid.line=periodic": {}, "grid.line=open": {}}
EFFECTS: Mapping[str, Mapping[str, Range]] = {
    "strip_width": {},
    "element_offsets": {},
    "film_angle": {"tilt_deg": (-20, 20)},
    "layered_skin": {
        "layers.skin.thickness_m": (5e-4, 5e-3),
        "layers.foam.youngs_modulus_Pa": (2e4, 5e6),
    },
    "viscoelastic_skin": {"fractions": (0.05, 2), "times_s": (1e-4, 2e-3)},
    "oblique_features": {"angle_deg": (-50, 50)},
    "amplifier_bandwidth": {"capacitance_F": (1e-11, 1e-8)},
    "antialias_filter": {"cutoff_hz": (50, 1000)},
    "sampling": {"rate_hz": (3e3, 1e4)},
    "quantisation": {"full_scale": (1e-5, 1e-3)},
    "clipping": {"limit": (1e-6, 1e-4)},
    "speed_ripple": {"fraction": (0.01, 0.3), "frequency_hz": (2, 20)},
    "load_drift": {"fraction": (0.01, 0.3)},
    "snap_back": {"rate_hz": (50, 500), "shear_Pa": (10, 500)},
}
NOISES: Mapping[str, Mapping[str, Range]] = {
    "noise=[snr]": {"noise.snr.snr_dB": (10, 70)},
    "noise=[white]": {"noise.white.rms": (1e-8, 1e-5)},
    "noise=[johnson]": {"noise.johnson.temperature_K": (200, 400)},
    "noise=[snr,sliding]": {"noise.sliding.fraction": (1e-3, 0.1)},
}
PRIOR = {"method.wiener.p.rms_Pa": (5e2, 1e4), "method.wiener.q.correlation_m": (5e-4, 5e-3)}
METHODS: Mapping[str, Mapping[str, Range]] = {
    "method=[wiener]": PRIOR,
    "method=[wiener_evidence]": PRIOR,
    "method=[wiener_paper]": {"method.wiener_paper.p.noise_to_signal": (1e-6, 1e-2)},
    "method=[tikhonov] rule=gcv": {"method.tikhonov.length_m": (3e-4, 3e-3)},
    "method=[tikhonov] rule=evidence method.tikhonov.order=2": {},
    "method=[tikhonov] rule=evidence method.tikhonov.order=0": {},
    "method=[tikhonov]": {
        "method.tikhonov.weight_p": (1e-9, 1e-3),
        "method.tikhonov.weight_q": (1e-9, 1e-3),
    },
}
GROUPS = (SCENES, SENSORS, AMPLIFIERS, LINES, NOISES, METHODS)
GRID = "grid.cells={cells} grid.refinement=2"
EFFECT_PROBABILITY = 0.15
IN_TIME = ("sampling", "speed_ripple", "load_drift")
WHOLE = ("seed",)
LISTED = ("fractions", "times_s")


def structure(rng: np.random.Generator) -> str:
    """Which parts there are: overrides in a row."""
    chosen = [_one_of(rng, list(group)) for group in GROUPS]
    effects = [name for name in EFFECTS if rng.uniform() < EFFECT_PROBABILITY]
    if "amplifier=integrated" in chosen:  # has no meaning along a measured motion
        effects = [name for name in effects if name not in IN_TIME]
    grid = GRID.format(cells=_one_of(rng, [48, 63, 64]))
    precision = "precision=float32" if rng.uniform() < 0.1 else "precision=float64"
    return " ".join([*chosen, f"effects=[{','.join(effects)}]", grid, precision])


def numbers(rng: np.random.Generator, structure: str) -> str:
    """Numbers for these parts: overrides in a row."""
    ranges = dict(ALWAYS)
    for group in GROUPS:
        # The longest that the structure begins with or holds: some begin with another one.
        held = [words for words in group if f"{words} " in f"{structure} "]
        ranges |= group[max(held, key=len)]
    for name in _effects(structure):
        ranges |= {f"effects.{name}.{key}": each for key, each in EFFECTS[name].items()}
    return " ".join(f"{key}={_drawn(rng, key, each)}" for key, each in ranges.items())


def _effects(structure: str) -> Sequence[str]:
    (named,) = [word for word in structure.split() if word.startswith("effects=[")]
    return [name for name in named.removeprefix("effects=[").rstrip("]").split(",") if name]


def _drawn(rng: np.random.Generator, key: str, within: Range) -> str:
    low, high = within
    last = key.rpartition(".")[2]
    if last in WHOLE:
        return str(int(rng.integers(int(low), int(high))))
    value = np.exp(rng.uniform(*np.log(within))) if low > 0 else rng.uniform(low, high)
    sign = rng.choice([-1, 1]) if last == "speed_m_per_s" else 1
    text = f"{sign * value:.3g}"
    return f"[{text}]" if last in LISTED else text


def _one_of(rng: np.random.Generator, options: Sequence[Any]) -> Any:
    return options[int(rng.integers(len(options)))]
