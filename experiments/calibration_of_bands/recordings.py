"""Recordings whose bands are calibrated: of several passes, of a rig that is known to tolerances
only, and by a kernel that was measured."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import srsinv
from srsinv.forward.feature import StripFeature
from srsinv.forward.measured import KernelTable, MeasuredFilm
from srsinv.forward.sensor import Sensor
from srsinv.grid import Periodic, as_real
from srsinv.inverse.estimate import COMPONENTS
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.kernel.evidence import KernelPrior
from srsinv.inverse.kernel.lags import REACH, Lags
from srsinv.inverse.kernel.measure import Place, measure_kernel
from srsinv.inverse.kernel.measured import MeasuredKernel, kernels
from srsinv.inverse.kernel.physics import Physics, default_parameters
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.rig.error import RigError, SensorError, UncertainSetup
from srsinv.inverse.rig.setup import Setup
from srsinv.inverse.rig.tolerance import rig_error_of
from srsinv.inverse.wiener import Exponential
from srsinv.recording.passes import passes_of

from .fits import Ranges, parameter_ranks, real
from .inversions import (
    RELATIVE_NOISE,
    DrawnTraction,
    TimedScan,
    Traction,
    operator_along,
    ranks_in_a_cell,
)
from .ranks import RankedMethod, Ranks, drawn, noisy, normal_rank

STAGE_M = 2e-5  # rms by which the stage is off in each pass


@dataclass(frozen=True)
class RankedPasses(RankedMethod):
    """Wiener's filter of passes to and fro.

    - `stage_m`: rms by which the stage is off in each pass, a normal deviate of its own. Where it
      is above zero, the shift of a pass against the others of its direction is ranked, too.
    - `is_noise_estimated`: whether the level of the noise is an estimate, as a recording's is.
    """

    label: str
    on: TimedScan
    stage_m: float = 0.0
    is_noise_estimated: bool = False
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on, motion = self.on, self.on.motion
        position = np.asarray(motion.position_m)
        passes, record = passes_of(position), on.recorder(on.line)
        noise = SampleNoise(record.noise_rms, is_estimate=self.is_noise_estimated)

        def one() -> dict[str, float]:
            shifts, true = self.stage_m * rng.standard_normal(len(passes)), position.copy()
            for each, shift in zip(passes, shifts, strict=True):
                true[each.samples] -= shift
            moved = srsinv.Motion(motion.time_s, true, motion.speed_m_per_s)
            truth, signal = record.of(operator_along(on.line, on.sensor, moved))(rng)
            grid = on.problem(signal, noise).to_grid()
            found = ranks_in_a_cell(truth, on.prior(grid), rng, np.asarray(grid.observed_cells))
            if not self.stage_m:
                return found
            assert grid.passes is not None
            j = int(rng.integers(len(passes)))
            others = [i for i, each in enumerate(passes) if each.is_onwards == passes[j].is_onwards]
            of_pass = shifts[j] - np.mean(shifts[others]), grid.passes.shifts_m[j]
            return found | {"shift_m": float(normal_rank(*of_pass, grid.passes.shift_stderr_m))}

        return drawn(one, draws)


class DrawnRig(NamedTuple):
    """A rig within its tolerances, along a motion."""

    rig: RigError
    uncertain: UncertainSetup

    @classmethod
    def of(cls, sensor: Sensor, motion: srsinv.Motion) -> "DrawnRig":
        """The default tolerances of a sensor that was made by hand, along a stated speed."""
        known: dict[str, Any] = {"has_measured_positions": False, "nominal_pressure_Pa": None}
        rig = rig_error_of("the rig", {"tolerance": "default"}, sensor, **known)
        assert rig is not None
        uncertain = rig.uncertain(sensor, motion)
        assert uncertain is not None
        return cls(rig, uncertain)

    def __call__(self, rng: np.random.Generator) -> Setup:
        """A draw of the true rig."""
        return self.uncertain(rng.standard_normal(len(self.rig.names)))


@dataclass(frozen=True)
class RankedTolerances(RankedMethod):
    """Wiener's filter of samples of a rig that differs from the stated one within its
    tolerances."""

    on: TimedScan
    label: str = "Wiener, tolerances"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on, line = self.on, self.on.line
        rig, record = DrawnRig.of(on.sensor, on.motion), on.recorder(line)

        def one() -> dict[str, float]:
            true = rig(rng)
            operator = operator_along(line, true.sensor, true.motion(on.motion))
            truth, signal = record.of(operator)(rng)
            grid = on.problem(signal, record.noise_rms, rig.rig).to_grid()
            return ranks_in_a_cell(truth, on.prior(grid), rng, np.asarray(grid.observed_cells))

        return drawn(one, draws)


STRIP_RANGES = Ranges({"position_m": (6e-3, 1.4e-2), "width_m": (2e-3, 4e-3),
                       "pressure_Pa": (3e3, 8e3), "friction": (0.2, 0.6)})  # fmt: skip


@dataclass(frozen=True)
class RankedUncertainFit(RankedMethod):
    """The fit of a strip load by a rig that differs from the stated one within its tolerances."""

    on: TimedScan
    label: str = "Fit of strip load, tolerances"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on, fit = self.on, FeatureFit({"strip": StripFeature()})
        rig = DrawnRig.of(on.sensor, on.motion)

        def one() -> dict[str, float]:
            true, truth = rig(rng), STRIP_RANGES.draw(rng)
            model = FeatureModel.along(true.sensor, true.motion(on.motion))
            own = {name: each for name, each in truth.items() if name != "friction"}
            own["shear_Pa"] = truth["friction"] * truth["pressure_Pa"]
            clean = np.asarray(model.with_features(fit.features)({"strip": real(own)}))
            y, level = noisy(clean, RELATIVE_NOISE, rng)
            return parameter_ranks(truth, fit(on.problem(y, level, rig.rig)).parameters)

        return drawn(one, draws)


KNOWN_CELLS, KNOWN_LENGTH_M, KNOWN_LOAD_N_PER_M, KNOWN_FRICTION = 512, 0.04, 5.0, 0.5
KERNEL_RANGES = Ranges({"gain_1": (0.9, 1.1), "gain_2": (0.9, 1.1), "depth_m": (0.85, 1.15),
                        "tilt_deg": (-4.0, 4.0)})  # fmt: skip
REST = 0.03  # of a kernel's largest value: the scale of what no theory explains


class KnownScan(NamedTuple):
    """Scans along a periodic line by a sensor that differs from the `stated` one.

    `load` (2, n) [Pa]: p and q of a known line load, with a `friction` of `KNOWN_FRICTION`.
    """

    line: Periodic
    stated: Sensor
    scan: srsinv.ConstantSpeed
    load: Traction

    @classmethod
    def of(cls, stated: Sensor, scan: srsinv.ConstantSpeed) -> "KnownScan":
        """With the load in the middle of the line."""
        cell = KNOWN_LENGTH_M / KNOWN_CELLS
        line = Periodic(KNOWN_CELLS, cell, -KNOWN_LENGTH_M / 2)
        pressure = np.where(np.arange(line.n) == line.n // 2, KNOWN_LOAD_N_PER_M / cell, 0.0)
        return cls(line, stated, scan, np.stack([pressure, KNOWN_FRICTION * pressure]))

    def problem(
        self,
        true: Sensor,
        known: Sensor,
        traction: Traction,
        rng: np.random.Generator,
        rig: SensorError | None = None,
    ) -> LineProblem:
        """The problem of a traction that the sensor `true` scans, as one of the sensor `known`."""
        clean = np.asarray(true.operator(self.line, self.scan)(as_real(traction)))
        data, level = noisy(clean, RELATIVE_NOISE, rng)
        of = self.line, known, self.scan, data, np.full(self.line.n // 2 + 1, level**2)
        mean = float(traction[0].mean()), None
        return LineProblem.of_sensor(*of, known_mean_Pa=mean, rig=rig)

    def measured(self, true: Sensor, rng: np.random.Generator) -> MeasuredKernel:
        """The kernel of a sensor by a scan of the load in both directions."""
        both = true.in_both_directions(), self.stated.in_both_directions()
        problem = self.problem(*both, self.load, rng)
        return measure_kernel(problem, self.stated, self.load[0], KNOWN_FRICTION, parameters=None)


@dataclass(frozen=True)
class RankedKernel(RankedMethod):
    """Wiener's filter by a kernel that was measured over a line load, scanned both ways.

    The true kernel is that of a theory whose gains, depth and tilt differ from the stated ones,
    and a draw of the Gaussian process that the measurement takes the rest for. Each draw has a
    measurement of its own, whose kernel is ranked as well.
    """

    sensor: Sensor
    scan: srsinv.ConstantSpeed
    spectrum: Exponential
    label: str = "Wiener, measured kernel"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on = KnownScan.of(self.sensor, self.scan)
        sensors, method = DrawnSensor.of(on), srsinv.Wiener(self.spectrum, self.spectrum)
        traction = DrawnTraction.by(self.spectrum, on.line)

        def one() -> dict[str, float]:
            true, _, kernel = sensors(rng)
            found, truth = on.measured(true, rng), traction(rng)
            truth = truth - truth.mean(axis=-1, keepdims=True)
            problem = on.problem(true, found.sensor(self.sensor), truth, rng, found.error)
            own = ranks_in_a_cell(truth, method(problem), rng)
            return own | _kernel_ranks(kernel, found, rng)

        return drawn(one, draws)


@dataclass(frozen=True)
class RankedTheory(RankedMethod):
    """Gains, depth and tilt of the theory about which a kernel is measured."""

    sensor: Sensor
    scan: srsinv.ConstantSpeed
    label: str = "Theory of a measured kernel"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        on = KnownScan.of(self.sensor, self.scan)
        sensors = DrawnSensor.of(on)

        def one() -> dict[str, float]:
            true, values, _ = sensors(rng)
            return parameter_ranks(values, on.measured(true, rng).parameters)

        return drawn(one, draws)


@dataclass(frozen=True)
class DrawnSensor:
    """Sensors whose kernels are those of a theory, and a rest.

    `physics`: the theory's parameters, which are uniform in `KERNEL_RANGES`; `process`: the waves
    of the rest at the `lags`, times their standard deviations.
    """

    lags: Lags
    physics: Physics
    process: Float[np.ndarray, "e 2 b m"]

    @classmethod
    def of(cls, on: KnownScan) -> "DrawnSensor":
        """About the sensor that is stated, at the lags that are measured."""
        stated, depth, cell = on.stated, float(on.stated.depth_m), float(on.line.cell_m)
        lags = Lags(depth, min(on.line.n * cell / 2, REACH * depth))
        k = lags.wavenumbers(np.pi / cell)
        envelope = Place().envelope(depth)
        peak = np.abs(kernels(stated, stated.elements, lags.x_m)).max(axis=-1)
        prior = KernelPrior(REST * peak, depth, envelope)
        deviations = np.stack([prior.deviations(e, k).reshape(2, -1) for e in range(len(peak))])
        basis = lags.envelope(*envelope)[:, None] * lags.waves(k)
        physics = Physics(stated, default_parameters(stated))
        return cls(lags, physics, deviations[..., None] * basis)

    def __call__(
        self, rng: np.random.Generator
    ) -> tuple[Sensor, dict[str, float], Float[np.ndarray, "e 2 m"]]:
        """A draw of the sensor, with its parameters and its kernels at the lags."""
        stated = dict(zip(self.physics.names, self.physics.stated, strict=True))
        values = KERNEL_RANGES.draw(rng)
        values["depth_m"] *= stated["depth_m"]
        sensor, gains = self.physics.sensor_of(np.array([values[n] for n in self.physics.names]))
        white = rng.standard_normal(self.process.shape[:-1])
        rest = np.einsum("ecb,ecbm->ecm", white, self.process)
        films = tuple(
            MeasuredFilm.of(film, np.full(2, gain), KernelTable.of(self.lags.x_m, own))
            for film, gain, own in zip(sensor.elements, gains, rest, strict=True)
        )
        own = gains[:, None, None] * kernels(sensor, sensor.elements, self.lags.x_m)
        return dataclasses.replace(sensor, elements=films), values, own + rest


def _kernel_ranks(
    kernel: Float[np.ndarray, "e 2 m"], found: MeasuredKernel, rng: np.random.Generator
) -> dict[str, float]:
    """The ranks of a kernel of p and of q at a lag drawn at random."""
    e, lag = int(rng.integers(len(kernel))), int(rng.integers(kernel.shape[-1]))
    rank = normal_rank(kernel[e, :, lag], found.value[e, :, lag], found.stderr[e, :, lag])
    return {f"kernel_{c}": float(each) for c, each in zip(COMPONENTS, rank, strict=True)}
