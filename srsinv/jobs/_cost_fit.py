"""Feature fit: over solver and tolerance, the number of starting points, and the number of signals
fitted together.

A strip of pressure and shear is fitted to noisy signals, by srsinv and by its peers.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import chain, zip_longest
from types import ModuleType
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..forward.feature import StripFeature
from ..forward.scan import ConstantSpeed, Motion
from ..forward.sensor import Sensor
from ..inverse.features.model import FeatureModel
from ..inverse.nonlinear import (
    Fit,
    JaxoptLBFGSB,
    OptaxLBFGS,
    Optimistix,
    Solver,
    fit,
    fit_many,
)
from ..resolution import cell_m
from ._cost_settings import CONVERGED_WITHIN, EXACT, CostSettings, FitSettings
from ._cost_trials import cost_trial, failure_of
from .trials import Row, Trial

FINER = 4  # refinement of the cells of the model that makes the data
SCAN_M = 0.012
MOST_STEPS = 60  # of a search from a far start: bounds those that reach no minimum
TRUE = {"width_m": 3e-3, "pressure_Pa": 5e3, "shear_Pa": 2e3}
POSITIONS_M = (-6e-4, 6e-4)  # true positions are drawn from here, one for each signal
NEAR = {"position_m": 6e-4, "width_m": -1e-3}  # offset of a solver's start from the truth
WHERE: dict[str, Any] = {"position_range_m": [-SCAN_M / 2, SCAN_M / 2]}
SHAPE = ("position_m", "width_m")
PART = "fit"
OURS: dict[str, Callable[..., Solver]] = {
    "optimistix": Optimistix,
    "optax L-BFGS": OptaxLBFGS,
    "jaxopt LBFGSB": JaxoptLBFGSB,
}
# The peers to compare times with: from one start near the minimum, and from far or many ones.
NEAR_PEER, FAR_PEER = "scipy, 2-point", "scipy, analytic"

# A fit of (y, noise_rms, start, bounds, tolerance): the parameters, half the sum of squares, and
# evaluations of the model.
PeerFit = Callable[..., tuple[np.ndarray, float, int]]


class Fitted(NamedTuple):
    """The parameters (4,) that a fit ends with, how often it evaluated the model, and why it is no
    answer."""

    value: np.ndarray
    evaluations: float
    failure: str = ""


@dataclass(frozen=True)
class FitTask:
    """Signals to fit, the model, and each signal's exact minimum with its covariance; `peers` by
    name.

    `ys` (signal, e, sample) [V]; `truth`, `exact` (signal, 4): position, width, pressure, shear;
    `factor` (signal, 4, 4): the inverse of a Cholesky factor of the covariance.
    """

    model: FeatureModel
    peers: Mapping[str, PeerFit]
    bounds: dict[str, tuple[float, float]]
    ys: Float[np.ndarray, "signal e sample"]
    noise_rms: float
    truth: Float[np.ndarray, "signal 4"]
    exact: Float[np.ndarray, "signal 4"]
    factor: Float[np.ndarray, "signal 4 4"]

    def start(self, i: int) -> dict[str, float]:
        """A shape near that of signal i."""
        true = dict(zip(SHAPE, self.truth[i], strict=False))
        return {name: float(true[name] + NEAR[name]) for name in SHAPE}

    def far(self) -> dict[str, float]:
        """A shape far from that of every signal."""
        return {name: self.bounds[f"strip.{name}"][0] for name in SHAPE}

    def distance(self, i: int, point: np.ndarray, other: np.ndarray) -> float:
        """Distance of two points in standard errors: the rms over the parameters."""
        return float(np.linalg.norm(self.factor[i] @ (point - other)) / 2)

    def options(self) -> dict[str, Any]:
        """Options of every fit by srsinv."""
        return {"noise": self.noise_rms, "bounds": self.bounds, "linear": self.model.linear}


def trials(
    settings: CostSettings, sensor: Sensor, scan: ConstantSpeed, seed: int, peers: ModuleType | None
) -> Iterator[Trial]:
    """Fits over solver and tolerance, over the number of starts, and of signals at once."""
    own = settings.fit
    task = cache(lambda: _task(own, sensor, scan, seed, peers))
    names = [] if peers is None else list(peers.FITS)
    rest = {"signals": own.signals, "batches": list(own.batches), "tolerance": min(own.tolerances)}
    sweeps = (
        _tolerances(task, own, names), _batches(task, own, names), _starts(task, own, names),
    )  # fmt: skip
    for trial in chain.from_iterable(zip_longest(*sweeps)):
        if trial is not None:
            yield dataclasses.replace(trial, rests_on=rest)


Task = Callable[[], FitTask]


def _task(
    settings: FitSettings, sensor: Sensor, scan: ConstantSpeed, seed: int, peers: ModuleType | None
) -> FitTask:
    x = np.linspace(-SCAN_M / 2, SCAN_M / 2, settings.samples)
    speed = abs(float(scan.speed_m_per_s))
    motion = Motion((x - x[0]) / speed, x, np.full(x.shape, speed))
    cell = cell_m("timed_load", float(sensor.depth_m))
    model, fine = (
        FeatureModel.along(sensor, motion, cell / n).with_features({"strip": StripFeature(**WHERE)})
        for n in (1, FINER)
    )
    rng = np.random.default_rng(seed)
    positions = rng.uniform(*POSITIONS_M, max(settings.signals, *settings.batches))
    truth = np.array([[at, *TRUE.values()] for at in positions])
    clean = np.asarray(jax.jit(jax.vmap(lambda z: fine(_tree(z))))(truth))
    noise_rms = float(np.sqrt(np.mean(clean**2)) * 10 ** (-settings.snr_dB / 20))
    ys = clean + noise_rms * rng.normal(size=clean.shape)
    depth = float(sensor.depth_m)
    bounds = {
        "strip.position_m": (-SCAN_M / 2, SCAN_M / 2),
        "strip.width_m": (0.1 * depth, SCAN_M),
    }
    minima = _exact(model, ys, noise_rms, bounds)
    others = {} if peers is None else {name: of(model) for name, of in peers.FITS.items()}
    return FitTask(model, others, bounds, ys, noise_rms, truth, *minima)


def _exact(model: FeatureModel, ys, noise_rms: float, bounds) -> tuple[np.ndarray, np.ndarray]:
    """Each signal's exact minimum (signal, 4), and the inverse of a Cholesky factor of its
    covariance (signal, 4, 4)."""
    fits = fit_many(
        model,
        _tree(np.array([0.0, *TRUE.values()])),
        ys,
        noise=noise_rms,
        bounds=bounds,
        linear=model.linear,
        starts={"strip.position_m": np.linspace(*POSITIONS_M, 7)},
        solver=Optimistix(EXACT),
        max_searches=2,
    )
    order = [fits[0].names.index(f"strip.{name}") for name in ("position_m", *TRUE)]
    covariance = np.array([f.covariance[np.ix_(order, order)] for f in fits])
    return np.array([_row(f.value) for f in fits]), np.linalg.inv(np.linalg.cholesky(covariance))


def _tree(z) -> dict[str, dict[str, Any]]:
    return {"strip": dict(zip(("position_m", *TRUE), z, strict=True))}


def _row(value) -> np.ndarray:
    return np.array([float(value["strip"][name]) for name in ("position_m", *TRUE)])


def _initial(shape: Mapping[str, float]) -> dict[str, dict[str, float]]:
    return {"strip": {**shape, "pressure_Pa": 0.0, "shear_Pa": 0.0}}


# --- three sweeps ----------------------------------------------------------------------------


def _trial(
    task: Task, sweep: str, family: str, size: int | float, work: Callable[[FitTask], list[Fitted]],
    peer: str, count: int = 1,
) -> Trial:  # fmt: skip
    """A trial whose work fits the first signals of the task."""
    return cost_trial(
        PART, PART, sweep, family, size,
        prepare=lambda: partial(work, task()), score=lambda ends: _score(task(), ends),
        peer=peer, is_peer=family not in OURS, count=count,
    )  # fmt: skip


def _score(task: FitTask, ends: Sequence[Fitted]) -> Row:
    away = [task.distance(i, end.value, task.exact[i]) for i, end in enumerate(ends)]
    wrong = [task.distance(i, end.value, task.truth[i]) for i, end in enumerate(ends)]
    failures = [end.failure for end in ends]
    return {
        "error": float(np.median(away)),
        "converged": float(np.mean(np.array(away) < CONVERGED_WITHIN)),
        "error_cramer_rao": float(np.sqrt(np.mean(np.square(wrong)))),
        "applications": float(np.mean([end.evaluations for end in ends])),
        "failure": failures[0] if all(failures) else "",
    }


def _tolerances(task: Task, settings: FitSettings, names: Sequence[str]) -> Iterator[Trial]:
    """One signal from one near start, to several tolerances."""
    for tolerance in sorted(settings.tolerances, reverse=True):
        for family in (*OURS, *names):
            work = partial(_near, family=family, tolerance=tolerance)
            yield _trial(task, "tolerance", family, tolerance, work, NEAR_PEER)


def _near(task: FitTask, family: str, tolerance: float) -> list[Fitted]:
    if family not in OURS:
        return [_best(task.peers[family], task, 0, [task.start(0)], tolerance)]
    solver, initial = OURS[family](tolerance), _initial(task.start(0))
    return [_ended(fit(task.model, initial, task.ys[0], **task.options(), solver=solver))]


def _starts(task: Task, settings: FitSettings, names: Sequence[str]) -> Iterator[Trial]:
    """A few signals, in sequence, from one far start and random ones within the bounds."""
    tolerance = min(settings.tolerances)
    for count in sorted(settings.starts):
        for family in _both(names):
            work = partial(
                _far, family=family, count=count, signals=settings.signals, tolerance=tolerance
            )
            yield _trial(task, "starts", family, count, work, FAR_PEER, settings.signals)


def _far(
    task: FitTask, family: str, count: int, signals: int, tolerance: float
) -> list[Fitted]:  # fmt: skip
    low, high = np.array(list(task.bounds.values())).T
    unit = np.random.default_rng(1).uniform(size=(count, 2))
    spread = [dict(zip(SHAPE, z, strict=True)) for z in low + unit * (high - low)]
    shapes = [task.far(), *spread][:count]
    if family not in OURS:
        other = task.peers[family]
        return [_best(other, task, i, shapes, tolerance) for i in range(signals)]
    listed = {f"strip.{n}": np.array([s[n] for s in shapes[1:]]) for n in SHAPE}
    given = {
        **task.options(),
        "solver": Optimistix(max_steps=MOST_STEPS),
        "starts": listed if count > 1 else None,
        "max_searches": count,
    }
    initial = _initial(task.far())
    return [_ended(fit(task.model, initial, task.ys[i], **given)) for i in range(signals)]


def _batches(task: Task, settings: FitSettings, names: Sequence[str]) -> Iterator[Trial]:
    """Signals fitted together, from one start each: time for each signal."""
    tolerance = min(settings.tolerances)
    for count in sorted(settings.batches):
        for family in _both(names):
            work = partial(_together, family=family, count=count, tolerance=tolerance)
            yield _trial(task, "batch", family, count, work, FAR_PEER, count)


def _together(task: FitTask, family: str, count: int, tolerance: float) -> list[Fitted]:
    middle = _initial({"position_m": 0.0, "width_m": TRUE["width_m"]})
    if family not in OURS:
        other, start = task.peers[family], [middle["strip"]]
        return [_best(other, task, i, start, tolerance) for i in range(count)]
    return [*map(_ended, fit_many(task.model, middle, task.ys[:count], **task.options()))]


def _both(names: Sequence[str]) -> list[str]:
    """Families of a sweep: ours, and the peer's where it is there."""
    return ["optimistix"] + [FAR_PEER] * (FAR_PEER in names)


def _ended(end: Fit) -> Fitted:
    return Fitted(_row(end.value), float(end.stats["iterations"]), failure_of(end.status))


def _best(fit_one: PeerFit, task: FitTask, i: int, shapes, tolerance: float) -> Fitted:
    """The best of a peer's minima from these shapes, with amplitudes of the right size."""
    low, high = np.array(list(task.bounds.values())).T
    box = np.array([*low, -np.inf, -np.inf]), np.array([*high, np.inf, np.inf])
    ends = []
    for shape in shapes:
        inside = np.clip([shape[name] for name in SHAPE], low + 1e-9, high - 1e-9)
        begin = np.array([*inside, TRUE["pressure_Pa"], TRUE["shear_Pa"]])
        ends.append(fit_one(task.ys[i], task.noise_rms, begin, box, tolerance))
    value, _ = min((end[:2] for end in ends), key=lambda end: end[1])
    return Fitted(value, float(sum(end[2] for end in ends)))
