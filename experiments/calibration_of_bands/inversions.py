"""Inversions whose bands are calibrated: of whole scans, of open ones with gaps, of recorded
samples, live, and of any linear problem."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

import srsinv
from srsinv.errors import refuse
from srsinv.forward.noise import Noise, exponential_spectrum, total_spectrum
from srsinv.forward.operator import MotionOperator
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.grid import Line, Open, as_real
from srsinv.inverse.constrained_estimate import ConstrainedEstimate
from srsinv.inverse.estimate import COMPONENTS, Estimate, TractionEstimate
from srsinv.inverse.line.prior import Prior
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.method import Method
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.error import SensorError
from srsinv.inverse.wiener import Exponential, SpectralPrior

from ..shape_from_traction.shape import shape_band, shape_under
from .ranks import RankedMethod, Ranks, drawn, normal_rank

ZERO = 1e-12  # of a precision's largest eigenvalue: below, the prior says nothing
MISSING = 0.05  # of an open scan's samples
Traction = Float[np.ndarray, "c n"]


@dataclass(frozen=True)
class DrawnTraction:
    """Traction (c, n) [Pa] from a Gaussian prior: `roots` (c, n, n) times white numbers. What the
    prior does not bound is zero."""

    roots: Float[np.ndarray, "c n n"]

    @classmethod
    def of(cls, prior: Prior, line: Line) -> "DrawnTraction":
        """The draws of a prior on a line."""
        units = np.eye(line.n)
        each = [prior.apply(line, as_real(np.stack([unit, unit]))) for unit in units]
        precision, axes = np.linalg.eigh(np.stack(each, axis=1))
        is_bounded = precision > ZERO * precision[:, -1:]
        return cls(
            axes * np.where(is_bounded, np.where(is_bounded, precision, 1.0) ** -0.5, 0.0)[:, None]
        )

    @classmethod
    def by(cls, spectrum: Exponential, line: Line) -> "DrawnTraction":
        """Draws of p and q that are independent, with the same spectrum."""
        own = exponential_spectrum(line.k, line.cell_m, spectrum.correlation_m)
        power = np.asarray(spectrum.rms_Pa**2 * own)
        return cls.of(SpectralPrior(np.stack([power] * len(COMPONENTS))), line)

    def __call__(self, rng: np.random.Generator) -> Traction:
        return np.einsum("cij,cj->ci", self.roots, rng.standard_normal(self.roots.shape[:2]))


@dataclass(frozen=True)
class DrawnScan:
    """A scan along a line with one sample a cell and noise of this `power` (k,).

    Of a periodic line the mean of p is known, `level_Pa`. Of an open one some samples are missing.
    """

    line: Line
    sensor: Sensor
    scan: ConstantSpeed
    power: Float[np.ndarray, " k"]
    first: Traction
    level_Pa: float = 0.0

    @classmethod
    def of(
        cls,
        line: Line,
        sensor: Sensor,
        scan: ConstantSpeed,
        noises: tuple[Noise, ...],
        spectrum: Exponential,
    ) -> "DrawnScan":
        """A scan whose noise is that of the `first` draw, by this spectrum of p and of q."""
        first = DrawnTraction.by(spectrum, line)(np.random.default_rng(0))
        signal = sensor.operator(line, scan)(as_real(first))
        rms = np.sqrt(np.mean(np.asarray(signal) ** 2))
        power = np.asarray(total_spectrum(noises, line, scan, rms))
        refuse(not power.min() > 0, "There is no noise: give noise=[snr] or another one above 0.")
        return cls(line, sensor, scan, power, first)

    @property
    def is_open(self) -> bool:
        """Whether nothing repeats."""
        return isinstance(self.line, Open)

    def problem(self, traction: Traction, rng: np.random.Generator) -> LineProblem:
        """The problem of a traction, with a draw of the noise."""
        signal = np.asarray(self.sensor.operator(self.line, self.scan)(as_real(traction)))
        white = np.fft.rfft(rng.standard_normal(signal.shape))
        data = signal + np.fft.irfft(white * np.sqrt(self.power), self.line.n)
        known: dict[str, Any] = {"known_mean_Pa": (self.level_Pa, None)}
        if self.is_open:
            observed = rng.random(signal.shape) >= MISSING
            data, known = np.where(observed, data, 0.0), {"observed": observed}
        of = self.line, self.sensor, self.scan, data, self.power
        return LineProblem.of_sensor(*of, **known)


def ranks_in_a_cell(
    truth: Traction,
    estimate: Estimate,
    rng: np.random.Generator,
    cells: Bool[np.ndarray, " n"] | None = None,
) -> dict[str, float]:
    """The ranks of p and q in a cell drawn at random from `cells`, a mask, or from all of the
    line; of deviations from a mean where the estimate is one."""
    value, stderr = np.asarray(estimate.value), np.asarray(estimate.stderr)
    off = truth - value
    if isinstance(estimate, TractionEstimate) and estimate.mean_weights is not None:
        weights = np.asarray(estimate.mean_weights)
        off = off - np.sum(weights * off, axis=-1, keepdims=True)
    among = np.arange(value.shape[1]) if cells is None else np.flatnonzero(cells)
    cell = int(among[rng.integers(among.size)])
    if isinstance(estimate, ConstrainedEstimate):
        rank = np.mean(np.asarray(estimate.draws)[:, :, cell] < truth[:, cell], axis=0)
        return dict(zip(COMPONENTS, map(float, rank), strict=True))
    rank = normal_rank(off[:, cell], 0.0, stderr[:, cell])
    return dict(zip(COMPONENTS, map(float, rank), strict=True))


@dataclass(frozen=True)
class RankedInversion(RankedMethod):
    """A method on scans of traction from its own prior, whose weights a rule chooses on the first
    scan, and again on every other.

    `too_narrow`: a factor on its standard errors, to see whether it is found.
    """

    label: str
    method: Method
    on: DrawnScan
    is_quick: bool = True
    too_narrow: float = 1.0

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        first = self.on.problem(self.on.first, np.random.default_rng(1))
        traction = DrawnTraction.of(self.method.prior_fixed_on(first)(first), self.on.line)

        def one() -> dict[str, float]:
            truth = traction(rng)
            if not self.on.is_open:  # of which the mean is known, or not in the signal
                truth = truth - truth.mean(axis=-1, keepdims=True)
            estimate: Any = self.method(self.on.problem(truth, rng))
            stderr = self.too_narrow * np.asarray(estimate.stderr)
            return ranks_in_a_cell(truth, dataclasses.replace(estimate, stderr=stderr), rng)

        return drawn(one, draws)


LEVEL = 2.0  # of the rms of p: its mean, so that draws of p fall below zero in some cells


@dataclass(frozen=True)
class RankedAdmissible(RankedMethod):
    """Wiener's filter of traction by the spectrum that is nowhere below zero, with p >= 0."""

    on: DrawnScan
    spectrum: Exponential
    label: str = "Wiener, admissible"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        level = LEVEL * float(self.spectrum.rms_Pa)
        on = dataclasses.replace(self.on, level_Pa=level)
        method = srsinv.Wiener(self.spectrum, self.spectrum, constraint=srsinv.Admissible())
        traction = DrawnTraction.by(self.spectrum, on.line)

        def one() -> dict[str, float]:
            truth = np.full((2, on.line.n), -np.inf)
            while truth[0].min() < 0:
                truth = traction(rng)
                truth = truth - truth.mean(axis=-1, keepdims=True) + np.array([[level], [0.0]])
            return ranks_in_a_cell(truth, method(on.problem(truth, rng)), rng)

        return drawn(one, draws)


FRICTION = 0.4


@dataclass(frozen=True)
class RankedPressure(RankedMethod):
    """Wiener's filter of traction whose friction is known, q = mu p, and the displacement of the
    skin under it: the profile where the skin touches, here in the middle half of the line."""

    on: DrawnScan
    spectrum: Exponential
    label: str = "Wiener, known friction"

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on, method = self.on, srsinv.Wiener(self.spectrum, self.spectrum)
        traction, line = DrawnTraction.by(self.spectrum, on.line), on.line
        cells = np.arange(line.n)
        touching = (cells >= line.n // 4) & (cells < 3 * line.n // 4)

        def one() -> dict[str, float]:
            p = traction(rng)[0]
            truth = np.stack([p - p.mean(), FRICTION * (p - p.mean())])
            data = np.asarray(on.problem(truth, rng).data)
            known: dict[str, Any] = {"known_mean_Pa": (on.level_Pa, None), "friction": FRICTION}
            of = line, on.sensor, on.scan, data, on.power
            estimate: Any = method(LineProblem.of_sensor(*of, **known))
            shape, stderr = map(np.asarray, shape_band(line, on.sensor.skin, estimate, touching))
            true = np.asarray(shape_under(line, on.sensor.skin, as_real(truth[0])))
            true = true - true[touching].mean()
            own, cell = ranks_in_a_cell(truth, estimate, rng), int(rng.choice(cells[touching]))
            rank = normal_rank(true[cell], shape[cell], stderr[cell])
            return {"p": own["p"], "profile_m": float(rank)}

        return drawn(one, draws)


LENGTH_M, RATE_HZ = 0.02, 4e3  # of scans that are sampled in time
TURN_S = 0.0125  # that a turn between two passes takes
CELLS_PER_DEPTH = 8
BEYOND_DEPTHS = 12  # of traction on both sides of a scan
RELATIVE_NOISE = 0.01  # of the signal's rms


@dataclass(frozen=True)
class TimedScan:
    """A scan at constant speed, sampled evenly in time, of one pass or of several to and fro; p and
    q have one spectrum."""

    sensor: Sensor
    speed_m_per_s: float
    spectrum: Exponential
    passes: int = 1

    @property
    def cell_m(self) -> float:
        """The width of the traction's cells."""
        return float(self.sensor.depth_m) / CELLS_PER_DEPTH

    @cached_property
    def motion(self) -> Motion:
        """The motion at every sample."""
        steady = np.ones(int(LENGTH_M / self.speed_m_per_s * RATE_HZ))
        turn = np.cos(np.linspace(0.0, np.pi, int(TURN_S * RATE_HZ)))
        parts = [(-1) ** i * each for i in range(self.passes) for each in (steady, turn)][:-1]
        speed = self.speed_m_per_s * np.concatenate(parts)
        return Motion.from_speed(np.arange(speed.size) / RATE_HZ, speed, 0.0)

    def problem(
        self, signal: Float[np.ndarray, "e sample"], noise: Any, rig: SensorError | None = None
    ) -> Problem:
        """The problem of such a signal; `rig`: how well the sensor is known."""
        return Problem(self.sensor, self.motion, signal, noise, cell_m=self.cell_m, rig=rig)

    @property
    def line(self) -> Line:
        """The cells that a signal is put on."""
        nothing = np.zeros((len(self.sensor.elements), self.motion.time_s.size))
        return self.problem(nothing, 1.0).to_grid().line

    @property
    def prior(self) -> srsinv.Wiener:
        """The filter of the spectrum."""
        return srsinv.Wiener(self.spectrum, self.spectrum)

    def recorder(self, line: Line) -> "DrawnRecording":
        """The draws on a line."""
        operator = operator_along(line, self.sensor, self.motion)
        traction = DrawnTraction.by(self.spectrum, line)
        bare = DrawnRecording(traction, operator, 0.0)
        _, signal = bare(np.random.default_rng(0))
        level = RELATIVE_NOISE * float(np.sqrt(np.mean(signal**2)))
        return dataclasses.replace(bare, noise_rms=level)


BACKWARD = np.array([[1.0], [-1.0]])  # times p and q of sliding towards +x: those of -x


def operator_along(line: Line, sensor: Sensor, motion: Motion) -> MotionOperator:
    """From traction on a line to the samples along a motion, which may turn."""
    return sensor.operator_along(line, motion, directions=motion.directions)


@dataclass(frozen=True)
class DrawnRecording:
    """Traction on a line and the samples that are recorded of it, with white noise of this rms."""

    traction: DrawnTraction
    operator: MotionOperator
    noise_rms: float

    def of(self, operator: MotionOperator) -> "DrawnRecording":
        """The same draws with the signals of another operator."""
        return dataclasses.replace(self, operator=operator)

    def __call__(self, rng: np.random.Generator) -> tuple[Traction, Float[np.ndarray, "e sample"]]:
        """A draw of the traction [Pa], and of its signal."""
        truth, turns = self.traction(rng), len(self.operator.directions) > 1
        acting = np.stack([truth, BACKWARD * truth]) if turns else truth
        clean = np.asarray(self.operator(as_real(acting)))
        return truth, clean + self.noise_rms * rng.standard_normal(clean.shape)


@dataclass(frozen=True)
class RankedSamples(RankedMethod):
    """Wiener's filter of samples whose noise level is an estimate, as a recording's is."""

    on: TimedScan
    label: str = "Wiener, noise estimated"

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on = self.on
        record = on.recorder(on.line)
        noise = SampleNoise(record.noise_rms, is_estimate=True)

        def one() -> dict[str, float]:
            truth, signal = record(rng)
            return ranks_in_a_cell(truth, on.prior(on.problem(signal, noise)), rng)

        return drawn(one, draws)


@dataclass(frozen=True)
class RankedLive(RankedMethod):
    """Live inversion with a lag of two depths and an adaptive noise level."""

    on: TimedScan
    label: str = "Live, lag of two depths"

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on, depth = self.on, float(self.on.sensor.depth_m)
        state = srsinv.Live(on.sensor, on.prior, lag_m=2 * depth, cell_m=on.cell_m).state()
        beyond = BEYOND_DEPTHS * CELLS_PER_DEPTH
        cells = 2 * beyond + int(np.ceil(LENGTH_M / on.cell_m))
        line = Open(cells, on.cell_m, (0.5 - beyond) * on.cell_m)  # live cells start at x = 0
        record = on.recorder(line)

        def one() -> dict[str, float]:
            (truth, signal), live = record(rng), srsinv.Live.from_state(state)
            pushed = live.push(on.motion.time_s, on.motion.position_m, signal)
            found = srsinv.LiveCells.joined([pushed, live.finish()])
            settled = ~found.is_settling & (found.x_m < LENGTH_M - 2 * depth)
            cell = int(rng.choice(np.flatnonzero(settled)))
            own = beyond + int(found.x_m[cell] / on.cell_m)
            value, stderr = (found.p_Pa, found.q_Pa), (found.p_stderr_Pa, found.q_stderr_Pa)
            each = zip(COMPONENTS, truth[:, own], value, stderr, strict=True)
            return {name: float(normal_rank(t, v[cell], s[cell])) for name, t, v, s in each}

        return drawn(one, draws)


UNKNOWNS, WIDTH, NOISE, CORRELATION = 64, 3.0, 0.02, 6.0  # of a deconvolution, in unknowns


@dataclass(frozen=True)
class RankedLinear(RankedMethod):
    """The posterior of a linear problem: a deconvolution with a Gaussian prior."""

    label: str
    path: str

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        i = np.arange(UNKNOWNS)
        lag = np.abs(i[:, None] - i)
        lag = np.minimum(lag, UNKNOWNS - lag) if self.path == "spectral" else lag
        matrix = np.exp(-0.5 * (lag / WIDTH) ** 2) / WIDTH
        covariance = np.exp(-lag / CORRELATION)
        root, prior = np.linalg.cholesky(covariance), srsinv.GaussianPrior(covariance=covariance)
        method = srsinv.Wiener(path=self.path)

        def one() -> dict[str, float]:
            truth = root @ rng.standard_normal(UNKNOWNS)
            data = matrix @ truth + NOISE * rng.standard_normal(UNKNOWNS)
            estimate = method(srsinv.LinearProblem(matrix, data, NOISE, prior=prior))
            cell = int(rng.integers(UNKNOWNS))
            value, stderr = (
                float(np.asarray(each)[cell]) for each in (estimate.value, estimate.stderr)
            )
            return {"x": float(normal_rank(truth[cell], value, stderr))}

        return drawn(one, draws)
