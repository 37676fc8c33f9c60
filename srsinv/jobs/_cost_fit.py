"""Error against time of the feature fit, with its peers beside it in the same run.

A strip of pressure and shear is fitted to noisy signals: over solver and tolerance, over the number
of starting points, and over the number of signals fitted together.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ..forward.feature import StripFeature
from ..forward.scan import ConstantSpeed, Motion
from ..forward.sensor import Sensor
from ..inverse.features.model import FeatureModel
from ..inverse.nonlinear import JaxoptLBFGSB, OptaxLBFGS, Optimistix, Solver, fit, fit_many
from ..progress import stage
from ..resolution import cell_m
from ..timing import timed
from ._cost_settings import EXACT, FitSettings

FINER = 4  # refinement of the cells of the model that makes the data
CONVERGED_WITHIN = 0.1  # standard errors from the minimum up to which it counts as found
SCAN_M = 0.012
MOST_STEPS = 60  # of a search from a far start: bounds those that reach no minimum
TRUE = {"width_m": 3e-3, "pressure_Pa": 5e3, "shear_Pa": 2e3}
POSITIONS_M = (-6e-4, 6e-4)  # true positions are drawn from here, one for each signal
NEAR = {"position_m": 6e-4, "width_m": -1e-3}  # offset of a solver's start from the truth
WHERE: dict[str, Any] = {"position_range_m": [-SCAN_M / 2, SCAN_M / 2]}
SHAPE = ("position_m", "width_m")
PART = "feature fit"
OURS: dict[str, Callable[..., Solver]] = {
    "optimistix": Optimistix,
    "optax L-BFGS": OptaxLBFGS,
    "jaxopt LBFGSB": JaxoptLBFGSB,
}
# The peers to compare times with: with one start near the minimum, and with far or many ones.
NEAR_PEER, FAR_PEER = "scipy, 2-point", "scipy, analytic"
MEASURES = ("error", "error_cramer_rao", "converged", "first_call_s", "steady_call_s")

Row = dict[str, Any]
# A fit of (y, noise_rms, start, bounds, tolerance): the parameters and half the sum of squares.
PeerFit = Callable[..., tuple[np.ndarray, float]]


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


def rows_of(
    settings: FitSettings,
    repeats: int,
    sensor: Sensor,
    scan: ConstantSpeed,
    seed: int,
    peers: ModuleType | None,
) -> list[Row]:
    """Every measurement."""
    with stage("signals to fit, and their exact minima"):
        task = _task(settings, sensor, scan, seed, peers)
    rows: list[Row] = []
    with stage("fits over solver and tolerance"):
        rows += _tolerances(task, settings, repeats)
    with stage("fits over the number of starts"):
        rows += _starts(task, settings)
    with stage("fits over the number of signals"):
        rows += _batches(task, settings, repeats)
    return rows


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
    others = {} if peers is None else peers.fits(model)
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


def _measured(
    task: FitTask, estimates, sweep: str, family: str, setting: float | int, **more: Any
) -> Row:
    """A row: `estimates` are parameters (signal, 4) of the first signals."""
    away = [task.distance(i, z, task.exact[i]) for i, z in enumerate(estimates)]
    wrong = [task.distance(i, z, task.truth[i]) for i, z in enumerate(estimates)]
    return {
        "part": PART,
        "line": sweep,
        "family": family,
        "size": setting,
        "is_peer": family not in OURS,
        "error": float(np.median(away)),
        "converged": float(np.mean(np.array(away) < CONVERGED_WITHIN)),
        "error_cramer_rao": float(np.sqrt(np.mean(np.square(wrong)))),
        **more,
    }


def _tolerances(task: FitTask, settings: FitSettings, repeats: int) -> Iterator[Row]:
    """One signal from one near start, to several tolerances."""

    def row(family: str, tolerance: float, work, read) -> Row:
        one = timed(work, repeats)
        return _measured(
            task, [read(one.value)], "tolerance", family, tolerance,
            first_call_s=one.first_s, steady_call_s=one.least_s, peer=NEAR_PEER,
        )  # fmt: skip

    for tolerance in settings.tolerances:
        for family, solver in OURS.items():
            given = {**task.options(), "solver": solver(tolerance)}
            initial = _initial(task.start(0))

            def ours(initial=initial, given=given):
                return fit(task.model, initial, task.ys[0], **given)

            yield row(family, tolerance, ours, lambda answer: _row(answer.value))
        for family, other in task.peers.items():

            def peer(tolerance=tolerance, other=other):
                return _best(other, task, 0, [task.start(0)], tolerance)

            yield row(family, tolerance, peer, lambda answer: answer)


def _starts(task: FitTask, settings: FitSettings) -> Iterator[Row]:
    """A few signals, in sequence, from one far start and random ones within the bounds."""
    initial, low, high = _initial(task.far()), *np.array(list(task.bounds.values())).T
    unit = np.random.default_rng(1).uniform(size=(max(settings.starts), 2))
    spread = [dict(zip(SHAPE, z, strict=True)) for z in low + unit * (high - low)]
    for count in settings.starts:
        shapes = [task.far(), *spread][:count]
        listed = {f"strip.{n}": np.array([s[n] for s in shapes[1:]]) for n in SHAPE}
        given = {
            **task.options(),
            "solver": Optimistix(max_steps=MOST_STEPS),
            "starts": listed if count > 1 else None,
            "max_searches": count,
        }

        def ours(i: int, given=given):
            return _row(fit(task.model, initial, task.ys[i], **given).value)

        def peer(i: int, shapes=shapes):
            return _best(task.peers[FAR_PEER], task, i, shapes, min(settings.tolerances))

        for family, work in _both(task, ours, peer):
            ends = [timed(lambda i=i, work=work: work(i), 0) for i in range(settings.signals)]
            times = [one.first_s for one in ends]
            yield _measured(
                task, [one.value for one in ends], "starts", family, count, first_call_s=times[0],
                steady_call_s=float(np.median(times[1:] or times)), peer=FAR_PEER,
            )  # fmt: skip


def _batches(task: FitTask, settings: FitSettings, repeats: int) -> Iterator[Row]:
    """Signals fitted together, from one start each: time for each signal."""
    middle = _initial({"position_m": 0.0, "width_m": TRUE["width_m"]})
    start = middle["strip"]
    for count in settings.batches:

        def ours(count=count):
            fits = fit_many(task.model, middle, task.ys[:count], **task.options())
            return [_row(one.value) for one in fits]

        def peer(count=count):
            tolerance = min(settings.tolerances)
            other = task.peers[FAR_PEER]
            return [_best(other, task, i, [start], tolerance) for i in range(count)]

        for family, work in _both(task, ours, peer):
            one = timed(work, repeats)
            yield _measured(
                task, one.value, "batch", family, count, first_call_s=one.first_s / count,
                steady_call_s=one.least_s / count, peer=FAR_PEER,
            )  # fmt: skip


def _both(task: FitTask, ours: Callable, peer: Callable) -> list[tuple[str, Callable]]:
    """What to time: ours, and the peer's work where it is there."""
    return [("optimistix", ours)] + [(FAR_PEER, peer)] * (FAR_PEER in task.peers)


def _best(fit_one: PeerFit, task: FitTask, i: int, shapes, tolerance: float) -> np.ndarray:
    """The best of a peer's minima from these shapes, with amplitudes of the right size."""
    low, high = np.array(list(task.bounds.values())).T
    box = np.array([*low, -np.inf, -np.inf]), np.array([*high, np.inf, np.inf])
    ends = []
    for shape in shapes:
        inside = np.clip([shape[name] for name in SHAPE], low + 1e-9, high - 1e-9)
        begin = np.array([*inside, TRUE["pressure_Pa"], TRUE["shear_Pa"]])
        ends.append(fit_one(task.ys[i], task.noise_rms, begin, box, tolerance))
    return min(ends, key=lambda end: end[1])[0]
