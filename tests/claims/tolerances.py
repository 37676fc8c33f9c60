"""What standard errors are worth over rigs drawn from the default tolerances (an hour).

By two elements, each rig drawn anew:

- a strip load, once with the facts estimated beside it, and once with the facts taken as exact and
  the standard errors widened by what each fact moves, |d theta / d c| sigma_c (the Guide to the
  Expression of Uncertainty in Measurement);
- a ridge pressed on, whose signal depends on the skin and the pressure too;
- p and q of a random traction, inverted.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.forward.feature import StripFeature
from srsinv.forward.film import ORIENTATIONS_RAD, Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface_feature import RidgeFeature
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Open, as_real
from srsinv.inverse.estimate import deviation
from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.cells import Window
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.problem import Problem
from srsinv.inverse.quality import Quality
from srsinv.inverse.rig.error import RigError
from srsinv.inverse.rig.setup import Setup
from srsinv.inverse.rig.tolerance import rig_error_of
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.jobs.trials import Row
from tests.claims.study import Study, combinations

SENSOR = Sensor([Film(7.5e-4, each).with_strip_average() for each in ORIENTATIONS_RAD.values()])
FRICTION = 0.4
FAR = 4.0  # standard errors
DRAWS = 25

SCAN = Motion.from_speed(np.arange(240) / 1000, np.full(240, 0.05), -6e-3)
LINE = Open(3000, 1e-5, -1.5e-2)
STRIP = {"position_m": 4e-4, "width_m": 3e-3, "pressure_Pa": 4e3, "friction": FRICTION}
FIT = FeatureFit({"strip": StripFeature()})

RIDGE_SCAN = Motion.from_speed(np.arange(300) / 1000, np.full(300, 0.05), -7.5e-3)
WINDOW, EDGE_M, NOMINAL_PA = Window(-1e-2, 1e-2), 5e-5, 2e4
RIDGE = {"height_m": 4e-5, "width_m": 6e-4, "position_m": 4e-4, "base_friction": FRICTION}
RIDGE_FIT = FeatureFit({"ridge": RidgeFeature(edge_length_m=EDGE_M)})

# Of p, and of the part of q that is no friction: rms [Pa], and over what they are correlated.
RMS_PA, OWN_RMS_PA, LENGTH_M = 2e3, 3e2, 1e-3
PERIOD_M, MODES = 5e-2, 500

Scores = Mapping[str, tuple[float, float]]
Field = Callable[[np.ndarray], np.ndarray]


def tolerances(nominal_pressure_Pa: float | None = None) -> RigError:
    """The defaults for this rig."""
    made = rig_error_of(
        "the rig",
        {"tolerance": "default"},
        SENSOR,
        has_measured_positions=False,
        nominal_pressure_Pa=nominal_pressure_Pa,
    )
    assert made is not None
    return made


def setups(rig: RigError, scan: Motion, rng: np.random.Generator, draws: int) -> list[Setup]:
    """Rigs drawn from their tolerances."""
    known = rig.uncertain(SENSOR, scan)
    assert known is not None
    return [known(rng.normal(size=len(rig.names))) for _ in range(draws)]


def level(clean: Float[np.ndarray, "e sample"], snr_dB: float) -> float:
    """White noise so far below a signal's peak."""
    return float(np.abs(clean).max()) * 10 ** (-snr_dB / 20)


# --- a strip load -----------------------------------------------------------------------------


def strip(snr_dB: float, seed: int, draws: int) -> Row:
    """Scores of a strip's parameters, both ways."""
    rng, rig = np.random.default_rng(seed), tolerances()
    noise = level(_strip_signal(Setup(SENSOR)), snr_dB)
    joint, wider = [], []
    for setup in setups(rig, SCAN, rng, draws):
        clean = _strip_signal(setup)
        y = clean + noise * rng.normal(size=clean.shape)
        estimate = FIT(Problem(SENSOR, SCAN, y, noise, rig=rig))
        joint.append((estimate.parameters, estimate.quality))
        wider.append(_widened(Problem(SENSOR, SCAN, y, noise), rig))
    return scores(joint, STRIP) | scores(wider, STRIP, "_widened")


def _strip_signal(setup: Setup) -> Float[np.ndarray, "e sample"]:
    """The strip's signals, on cells of a fit's own width or less."""
    load = UniformStrip(STRIP["pressure_Pa"], STRIP["width_m"], STRIP["position_m"])
    p = np.asarray(load.cell_average(LINE))
    return _signal(np.stack([p, FRICTION * p]), setup)


def _signal(traction: Float[np.ndarray, "2 n"], setup: Setup) -> Float[np.ndarray, "e sample"]:
    operator = setup.sensor.operator_along(LINE, setup.motion(SCAN))
    return np.asarray(operator(as_real(traction)))


def _widened(problem: Problem, rig: RigError) -> tuple[Scores, Quality]:
    """The parameters of the fit by facts that are exact, with wider errors."""
    estimate = FIT(problem)
    model, own = estimate.model, estimate.fit
    assert own is not None

    def moved(setup: Setup) -> Float[np.ndarray, "e sample"]:
        return np.asarray(model.with_setup(setup, SCAN)(own.value))

    fit = own
    for column in rig.columns(SENSOR, np.asarray(model(own.value)), moved):
        fit = fit.with_error(own.moves(column))
    return model.loading.report(estimate.features, fit), estimate.quality


# --- a ridge ----------------------------------------------------------------------------------


def ridge(snr_dB: float, seed: int, draws: int) -> Row:
    """Scores of a ridge's parameters."""
    rng, rig = np.random.default_rng(seed), tolerances(NOMINAL_PA)
    noise = level(ridge_signal(Setup(SENSOR)), snr_dB)
    found = []
    for setup in setups(rig, RIDGE_SCAN, rng, draws):
        clean = ridge_signal(setup)
        y = clean + noise * rng.normal(size=clean.shape)
        estimate: FeatureEstimate = RIDGE_FIT(ridge_problem(y, noise, rig))
        found.append((estimate.parameters, estimate.quality))
    return scores(found, RIDGE)


def ridge_problem(y: Float[np.ndarray, "e sample"], noise: float, rig: RigError) -> Problem:
    """The problem of a ridge's signals, by a rig that is so well known."""
    known: dict[str, Any] = {"nominal_pressure_Pa": NOMINAL_PA, "window_m": tuple(WINDOW)}
    return Problem(SENSOR, RIDGE_SCAN, y, noise, rig=rig, **known)


def ridge_signal(setup: Setup) -> Float[np.ndarray, "e sample"]:
    """The ridge's signals, on cells of half a fit's own width."""
    pressure, motion = NOMINAL_PA * float(setup.nominal_pressure), setup.motion(RIDGE_SCAN)
    model = FeatureModel.on_window(setup.sensor, motion, WINDOW, EDGE_M / 10, pressure)
    model = model.with_features(RIDGE_FIT.features)
    own = {**RIDGE, "edge_length_m": EDGE_M + float(setup.edge_length_by_m)}
    friction = own.pop("base_friction")
    return np.asarray(model({**model.loading.common(), "ridge": own, "base_friction": friction}))


def scores(found: list[tuple[Scores, Quality]], truth: Mapping[str, float], way: str = "") -> Row:
    """The rms of errors in standard errors and the mean standard error of each parameter, the
    largest error of an answer that is good, and how many are."""
    z = np.array([[(read[k][0] - true) / read[k][1] for k, true in truth.items()]
                  for read, _ in found])  # fmt: skip
    stderr = np.mean([[read[k][1] for k in truth] for read, _ in found], axis=0)
    good = np.array([quality is Quality.GOOD for _, quality in found])
    rms = np.sqrt(np.mean(z**2, axis=0))
    row: Row = {f"ratio_{name}{way}": float(r) for name, r in zip(truth, rms, strict=True)}
    row |= {f"stderr_{name}{way}": float(s) for name, s in zip(truth, stderr, strict=True)}
    row[f"good{way}"] = int(good.sum())
    row[f"worst_good{way}"] = float(np.max(np.abs(z[good]), initial=0.0))
    return row


# --- p and q ----------------------------------------------------------------------------------


def traction(snr_dB: float, seed: int, draws: int) -> Row:
    """Scores of p and q on the cells that were passed, less their means: the rms of errors in
    standard errors, what 90 % bands cover, how many cells of good answers are far off and of how
    many, and how many answers are good."""
    rng, rig = np.random.default_rng(seed), tolerances()
    z, good = [], []
    for setup in setups(rig, SCAN, rng, draws):
        draw = field(rng), field(rng)

        def at(x: np.ndarray, draw: tuple[Field, Field] = draw) -> np.ndarray:
            p, own = (rms * each(x) for rms, each in zip((RMS_PA, OWN_RMS_PA), draw, strict=True))
            return np.stack([p, FRICTION * p + own])

        clean = _signal(at(np.asarray(LINE.x)), setup)
        noise = level(clean, snr_dB)
        y = clean + noise * rng.normal(size=clean.shape)
        known = SampleNoise([noise] * len(clean), is_estimate=True)
        grid = Problem(SENSOR, SCAN, y, known, rig=rig).to_grid()
        estimate, cells = Tikhonov(1)(grid), grid.observed_cells
        value, stderr = estimate.deviation(cells)
        truth = deviation(at(np.asarray(grid.line.x)), cells)
        z.append((deviation(value, cells) - truth) / stderr[:, cells])
        good.append(estimate.quality is Quality.GOOD)
    each = np.stack(z)
    row: Row = {}
    for name, own in zip("pq", np.moveaxis(each, 1, 0), strict=True):
        row[f"ratio_{name}"] = float(np.sqrt(np.mean(own**2)))
        row[f"covered_90_{name}"] = float(np.mean(np.abs(own) < 1.6449))
    of_good = np.abs(each[np.array(good)])
    row |= {"far_good": int(np.sum(of_good > FAR)), "cells_good": of_good.size}
    return row | {"good": int(np.sum(good)), "worst_good": float(np.max(of_good, initial=0.0))}


def field(rng: np.random.Generator) -> Field:
    """A random field of rms one, correlated as exp(-|x| / LENGTH_M), as a function of x [m]."""
    k = 2 * np.pi / PERIOD_M * np.arange(1, MODES)
    spectrum = 1 / (1 + (k * LENGTH_M) ** 2)
    sizes = np.sqrt(spectrum / spectrum.sum()) * rng.normal(size=(2, k.size))
    return lambda x: sizes[0] @ np.cos(np.outer(k, x)) + sizes[1] @ np.sin(np.outer(k, x))


MEASURED = {"strip": strip, "ridge": ridge, "traction": traction}
SEEDS = {
    ("strip", 40.0): [11, 12], ("strip", 60.0): [11, 12],
    ("ridge", 40.0): [11, 12], ("ridge", 60.0): [11, 12],
    ("traction", 40.0): [11, 12], ("traction", 60.0): [11, 12],
}  # fmt: skip


def drawn(of: str, snr_dB: float, seed: int, draws: int) -> Row:
    """The scores of so many rigs."""
    return MEASURED[of](snr_dB, seed, draws)


STUDY = Study(
    "tolerances",
    drawn,
    lambda: [
        case
        for (of, snr_dB), seeds in SEEDS.items()
        for case in combinations(of=[of], snr_dB=[snr_dB], seed=seeds, draws=[DRAWS])
    ],
)
