"""What standard errors of fits are worth over rigs drawn from the default tolerances (minutes).

A strip load over two elements, each rig drawn anew: once with the facts estimated beside the strip,
and once with the facts taken as exact and the standard errors widened by what each fact moves,
|d theta / d c| sigma_c (the Guide to the Expression of Uncertainty in Measurement).
"""

import numpy as np
from jaxtyping import Float

from srsinv.forward.feature import StripFeature
from srsinv.forward.film import ORIENTATIONS_RAD, Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Open, as_real
from srsinv.inverse.diagnostics import Quality
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.error import RigError
from srsinv.inverse.rig.setup import Setup
from srsinv.inverse.rig.tolerance import rig_error_of
from srsinv.jobs.trials import Row
from tests.claims.study import Study, combinations

DRAWS = 50
SCAN = Motion.from_speed(np.arange(240) / 1000, np.full(240, 0.05), -6e-3)
SENSOR = Sensor([Film(7.5e-4, each).with_strip_average() for each in ORIENTATIONS_RAD.values()])
LINE = Open(3000, 1e-5, -1.5e-2)
TRUTH = {"position_m": 4e-4, "width_m": 3e-3, "pressure_Pa": 4e3, "friction": 0.4}
FIT = FeatureFit({"strip": StripFeature()})
Scores = dict[str, tuple[float, float]]


def tolerances() -> RigError:
    """The defaults for this rig."""
    made = rig_error_of(
        "the rig",
        {"tolerance": "default"},
        SENSOR,
        has_measured_positions=False,
        nominal_pressure_Pa=None,
    )
    assert made is not None
    return made


def signal(setup: Setup) -> Float[np.ndarray, "e sample"]:
    """The strip's signals, on cells of a fit's own width or less."""
    p = np.asarray(
        UniformStrip(TRUTH["pressure_Pa"], TRUTH["width_m"], TRUTH["position_m"]).cell_average(LINE)
    )
    operator = setup.sensor.operator_along(LINE, setup.motion(SCAN))
    return np.asarray(operator(as_real(np.stack([p, TRUTH["friction"] * p]))))


def widened(problem: Problem, rig: RigError) -> tuple[Scores, Quality]:
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


def drawn(snr_dB: float, seed: int, draws: int) -> Row:
    """The rms of errors in standard errors and the mean standard error of each parameter, both
    ways, the largest error of an answer that is good, and how many are."""
    rng, rig = np.random.default_rng(seed), tolerances()
    known = rig.uncertain(SENSOR, SCAN)
    assert known is not None
    level = float(np.abs(signal(Setup(SENSOR))).max()) * 10 ** (-snr_dB / 20)
    scores: dict[str, list[list[float]]] = {"joint": [], "widened": []}
    stderr: dict[str, list[list[float]]] = {"joint": [], "widened": []}
    good: dict[str, list[bool]] = {"joint": [], "widened": []}
    for _ in range(draws):
        clean = signal(known(rng.normal(size=len(rig.names))))
        y = clean + level * rng.normal(size=clean.shape)
        joint = FIT(Problem(SENSOR, SCAN, y, level, rig=rig))
        answers = {
            "joint": (joint.parameters, joint.quality),
            "widened": widened(Problem(SENSOR, SCAN, y, level), rig),
        }
        for way, (read, quality) in answers.items():
            scores[way].append([(read[name][0] - TRUTH[name]) / read[name][1] for name in TRUTH])
            stderr[way].append([read[name][1] for name in TRUTH])
            good[way].append(quality is Quality.GOOD)
    row: Row = {}
    for way, rows in scores.items():
        each = np.array(rows)
        rms, mean = np.sqrt(np.mean(each**2, axis=0)), np.mean(stderr[way], axis=0)
        row |= {f"ratio_{name}_{way}": float(r) for name, r in zip(TRUTH, rms, strict=True)}
        row |= {f"stderr_{name}_{way}": float(s) for name, s in zip(TRUTH, mean, strict=True)}
        row[f"good_{way}"] = int(np.sum(good[way]))
        row[f"worst_good_{way}"] = float(np.max(np.abs(each[good[way]]), initial=0.0))
    return row


STUDY = Study(
    "tolerances",
    drawn,
    lambda: combinations(snr_dB=[40.0, 60.0], seed=[11, 12], draws=[DRAWS]),
)
