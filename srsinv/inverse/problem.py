"""What every inversion starts from: recorded signals, what made them, and what is known."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ..errors import BadInput, echo, is_number, number, of_kind, refuse
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..grid import Line, Operator, as_real
from ..modules import with_fields
from ..recording.mains import MainsLine, waves
from ..recording.passes import Pass, is_within, passes_of
from .gridding.cells import Window, window_around
from .gridding.on_cells import SampledSignals, aligned, on_cells
from .line.problem import LineProblem
from .noise.correlated import with_found_noise
from .noise.facts import with_learned_facts
from .noise.model import SampleNoise, Samples
from .noise.trend import FLEXIBLE, trend_columns
from .nonlinear import WithNuisance
from .rig.error import SensorError


class Problem(eqx.Module):
    """What is inverted: signals of a sensor along a motion, their noise, and known facts.

    - `sensor`: the [`Sensor`][srsinv.Sensor]; `motion`: the [`Motion`][srsinv.Motion] at every
      sample, as `Motion.from_speed(time_s, speed_m_per_s, start_m)`.
    - `signal` (e, sample): as recorded, in the amplifier's unit; NaN marks a missing sample.
    - `noise`: a [`SampleNoise`][], or its level alone, the rms of white noise per sample.
    - `friction`: mu in q = mu p; None leaves p and q apart.
    - `nominal_pressure_Pa` [Pa]: the pressure far from the features, where it is known; a rate
      signal does not show it.
    - `window_m` [m]: (start, end) of the stretch that the traction lies in, around the scan; None:
      the scan and 8 depths beyond its ends.
    - `cell_m` [m]: the width of the cells of methods that solve for the traction on a line; None
      lets the method choose.
    - `mains`: lines of mains on the signals, as [`mains_lines`][] measures them.
    - `rig`: how well a calibration determined the sensor; None: it is taken as exact.
      Estimates carry it into their standard errors.
    - `position_step_m` [m]: to which the motion's positions are rounded; 0: they are exact. Fits
      along the motion have it in their standard errors, as a shift of each direction that is
      uniform over a step, and as noise where the signal changes along x.
    - `modulus_Pa` [Pa]: the skin's Young's modulus, above which no pressure is plausible; None
      where p is relative, or any may be.
    - `name`: for messages. `warnings`: sentences on the signal, which every estimate takes over.

    It is made of numbers that are known, outside `jax.jit`. A method chooses its line, and takes
    the signals as they are (`samples`) or put on cells (`to_grid`). Raises `BadInput` where shapes
    disagree, for a window that is none, and numbers out of their range.
    """

    sensor: Sensor
    motion: Motion
    data: Float[Array, "e sample"]
    observed: Bool[np.ndarray, "e sample"]
    noise: SampleNoise
    friction: Float[Array, ""] | None
    nominal_pressure_Pa: float | None = eqx.field(static=True)
    window_m: tuple[float, float] | None = eqx.field(static=True)
    cell_m: float | None = eqx.field(static=True)
    mains: tuple[MainsLine, ...]
    rig: SensorError | None
    off_place: Float[np.ndarray, "e column sample"]
    position_step_m: float = eqx.field(static=True)
    rounding: Float[np.ndarray, "e sample"] | None
    modulus_Pa: float | None = eqx.field(static=True)
    direction: bool | None = eqx.field(static=True)
    name: str = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        sensor: Sensor,
        motion: Motion,
        signal,
        noise: SampleNoise | float,
        *,
        friction=None,
        nominal_pressure_Pa: Any = None,
        window_m: Any = None,
        cell_m: Any = None,
        mains: Sequence[MainsLine] = (),
        rig: SensorError | None = None,
        position_step_m: float = 0.0,
        modulus_Pa: float | None = None,
        name: str = "the signal",
    ):
        of_kind("sensor", sensor, Sensor, "a Sensor")
        of_kind("motion", motion, Motion, "a Motion, as Motion.from_speed(time_s, speed, start_m)")
        signal = _numbers(name, signal)
        shape = len(sensor.elements), motion.time_s.size
        refuse(
            signal.shape != shape,
            f"{name} has the shape {signal.shape}: give (element, sample), as the sensor and the "
            f"motion have them: {shape}.",
        )
        offset = sensor.amplifier.offset
        self.sensor, self.motion, self.name = sensor, motion, name
        self.warnings, self.direction, self.modulus_Pa = (), None, modulus_Pa
        self.position_step_m, self.rounding = float(position_step_m), None
        self.off_place = np.zeros((len(signal), 0, signal.shape[1]))
        self.observed = np.isfinite(signal)
        known = 0.0 if offset is None else float(offset)
        self.data = as_real(np.where(self.observed, signal - known, 0.0))
        self.noise = noise if isinstance(noise, SampleNoise) else SampleNoise(noise)
        self.noise.check_elements(name, len(signal))
        mu = number("friction", 0.0 if friction is None else friction, "a finite number, or none")
        self.friction = None if friction is None else as_real(mu)
        if nominal_pressure_Pa is not None:
            wanted = "a pressure in Pa that is at least 0, or null where it is not known"
            key = f"{name}: nominal_pressure_Pa"
            nominal_pressure_Pa = float(number(key, nominal_pressure_Pa, wanted, least=0))
        self.nominal_pressure_Pa = nominal_pressure_Pa
        self.window_m = None if window_m is None else _pair(window_m)
        if cell_m is not None:
            cell_m = float(number("cell_m", cell_m, "a positive width in metres", above=0))
        self.cell_m, self.rig, self.mains = cell_m, rig, tuple(mains)

    def with_warnings(self, warnings: Sequence[str]) -> "Problem":
        """The same problem with further warnings."""
        return with_fields(self, warnings=(*self.warnings, *warnings))

    @property
    def background_Pa(self) -> tuple[float | None, float | None]:
        """The uniform pressure and shear that the features lie on, where they are known."""
        return self.nominal_pressure_Pa, None

    @property
    def surrounding_pressure_Pa(self) -> float:
        """The pressure around the features, as far as it is known."""
        return self.nominal_pressure_Pa or 0.0

    @property
    def has_free_offset(self) -> bool:
        """Whether each element's signal has a constant that is not known."""
        return self.sensor.amplifier.offset is None

    @property
    def nuisance_columns(self) -> Float[np.ndarray, "e column sample"]:
        """What else may be in each element's signal, with normal coefficients of variance one: the
        waves of mains, and the errors of aligning passes. An unknown offset belongs to the
        amplifier."""
        if not self.mains:
            return self.off_place
        hum = waves(np.asarray(self.motion.time_s), self.mains, self.noise.rms)
        return np.concatenate([hum, self.off_place], axis=1)

    @property
    def window(self) -> Window:
        """The stretch that the traction lies in."""
        return window_around(
            self.window_m, np.asarray(self.motion.position_m), float(self.sensor.depth_m)
        )

    def operator(self, line: Line) -> Operator:
        """From traction on a line to the signals at every sample."""
        return self.sensor.operator_along(line, self.motion, directions=self.motion.directions)

    def samples(self) -> Samples:
        """The signals along the motion, as a fit takes them: of one direction alone where the
        problem is of one; with the trend beside the noise where a drift was searched."""
        y = np.where(self.observed, np.asarray(self.data), np.nan)
        if self.direction is not None:
            y = np.where(is_within(self._own_passes, y.shape[1]), y, np.nan)
        noise = self.noise.of_fit(self.name, self.motion, y, self.rounding)
        is_estimate = self.noise.is_estimate and not self.noise.causes
        columns = self.nuisance_columns
        if self.noise.is_drift_found:
            time_s = np.asarray(self.motion.time_s, float)
            ends, jumps_s = time_s[[0, -1]], time_s[0] + np.array(self.noise.jumps_s)
            along, jumps = (np.interp(each, ends, [-1.0, 1.0]) for each in (time_s, jumps_s))
            trend = trend_columns(y, along, FLEXIBLE, self.has_free_offset, jumps.tolist())
            columns = np.concatenate([columns, trend], axis=1)
        if not columns.shape[1]:
            return Samples(self.sensor, self.motion, y, noise, is_estimate)
        beside = WithNuisance.of(noise, columns)
        return Samples(self.sensor, self.motion, y, beside, is_estimate, columns)

    def aligned(self) -> "Problem":
        """The same problem for a fit along the motion, with its passes aligned.

        Each pass is shifted so that the signals of its direction agree. What is left of the shifts'
        uncertainty is among the nuisance columns (see gridding/passes.py). The problem itself is
        returned where no direction is passed more than once and no position is rounded, and where a
        pass is too short for cells.
        """
        own = self._own_passes
        if not self.position_step_m and len(own) == len({each.is_onwards for each in own}):
            return self
        rounded_m = self.position_step_m / np.sqrt(12)  # rms of what is uniform over a step
        try:
            motion, columns, rounding = aligned(self._sampled, own, self.cell_m, rounded_m)
        except BadInput:
            return self
        return with_fields(self, motion=motion, off_place=columns, rounding=rounding)

    @property
    def _own_passes(self) -> list[Pass]:
        every = passes_of(np.asarray(self.motion.position_m))
        return [
            each for each in every if self.direction is None or each.is_onwards == self.direction
        ]

    @property
    def _sampled(self) -> SampledSignals:
        """All that is on the samples."""
        y = np.where(self.observed, np.asarray(self.data, float), np.nan)
        known = self.sensor, self.motion, y, self.nuisance_columns, self.noise
        return SampledSignals(self.name, *known)

    def to_grid(self, cell_m: float | None = None) -> LineProblem:
        """The signals put on the cells of an open line over the window.

        Cells are the problem's own `cell_m` wide, or else as given here, or else a sixteenth of the
        depth at most. Where the motion turns its passes are averaged (see gridding/passes.py), and
        each element is there once for each direction; q is that of sliding towards +x. Noise
        whose level is an estimate is estimated anew, with parts that are correlated along the scan
        and that drift (see noise/correlated.py). Raises `BadInput` for a scan shorter than three
        cells.
        """
        noise, is_drifting = self.noise, self.noise.is_drift_found
        is_estimate = (
            noise.is_estimate and not noise.causes and (is_drifting or not noise.has_drift)
        )
        sampled = self._sampled
        if is_estimate:
            sampled = sampled._replace(noise=noise.without_drift)
        on = on_cells(sampled, self.window_m, self.cell_m or cell_m, self.direction)
        # By the passes back alone q is what acts in them.
        friction = self.friction
        if friction is not None and self.direction is False:
            friction = -friction

        def by_rig(sensor: Sensor, rig: SensorError | None) -> LineProblem:
            grid = LineProblem.of_sensor(
                on.line,
                sensor,
                on.scan,
                on.data,
                on.power,
                observed=on.observed,
                nuisance=on.nuisance,
                noise_scale=on.noise_scale,
                known_mean_Pa=(0.0, None),
                background_Pa=(self.nominal_pressure_Pa, None),
                friction=friction,
                passes=on.passes,
                rig=rig,
                scan_start_m=float(np.asarray(self.motion.position_m)[0]),
                modulus_Pa=self.modulus_Pa,
                warnings=(*self.warnings, *(on.passes.warnings if on.passes else ())),
            )
            depth_m = float(sensor.depth_m)
            if not is_estimate:
                return with_learned_facts(grid, depth_m, noise.has_drift)
            return with_found_noise(grid, depth_m, is_drifting)

        return with_fields(by_rig(on.sensor, self.rig), by_rig=by_rig)

    def of_samples(self, samples: slice) -> "Problem":
        """The same problem with these of its samples alone."""
        own = self.motion.of_samples(samples)
        rounding = None if self.rounding is None else self.rounding[:, samples]
        return with_fields(
            self, motion=own, data=self.data[:, samples], observed=self.observed[:, samples],
            off_place=self.off_place[..., samples], rounding=rounding,
        )  # fmt: skip

    def of_direction(self, is_onwards: bool) -> "Problem":
        """The same problem on a line, of the passes towards +x alone, or of those towards -x."""
        return with_fields(self, direction=is_onwards)


def _numbers(name: str, signal: Any) -> Float[np.ndarray, "..."]:
    """The signal as numbers, NaN where a sample is missing."""
    refuse(
        isinstance(signal, Tracer),
        f"{name} is traced, and a problem is made of known numbers: make it outside jax.jit.",
    )
    try:
        values = np.asarray(signal, float)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{name} is no array of numbers: give (element, sample).") from error
    bad = int(np.sum(np.isinf(values)))
    refuse(bad > 0, f"{name} has {bad} infinite samples: give NaN where one is missing.")
    return values


def _pair(window_m: Any) -> tuple[float, float]:
    """The window's start and end."""
    is_pair = isinstance(window_m, list | tuple) and len(window_m) == 2
    is_window = is_pair and all(map(is_number, window_m)) and window_m[0] < window_m[1]
    refuse(
        not is_window,
        f"window_m is {echo(window_m)}: give (start, end) in metres, around the scan.",
    )
    return float(window_m[0]), float(window_m[1])
