"""The problem that Wiener's filter and Tikhonov's method solve: signals on the cells of a line,
linear in the traction, and the checks of its input.

Quantities that follow from its arrays alone are in model.py.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from numbers import Real
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ...errors import BadInput, all_of_kind, choice, echo, number, refuse
from ...forward.scan import ConstantSpeed, Motion
from ...forward.sensor import Sensor
from ...grid import Convolution, Line, Operator, Periodic, as_real
from ...known import array_module, in_jax, in_numpy, is_traced, outside_traces
from ...modules import with_fields
from ...status import Status
from ..diagnostics import beyond_modulus, residual_over_noise, unchecked_residual
from ..estimate import Numbers, TractionEstimate
from ..gridding.cells import Window
from ..gridding.passes import AveragedPasses
from ..noise.model import Samples, noise_on_line
from ..noise.whitener import residual_squares
from ..rig.error import SensorError
from ..rig.setup import Setup
from .model import CHI2, FREEDOM, LineModel, chi2, have_zero_mean, less_means
from .shared import SharedNoise, usable


def check(line, forward, data, noise, observed, friction, known_mean_Pa) -> None:
    """Raise `BadInput` for arrays that make no [`LineProblem`][]: shapes, samples, noise, means."""
    elements = forward.transfer.shape[0]
    is_observed = _checked_shapes((elements, line.n), line, data, noise, observed)
    refuse(
        friction is None and elements < 2,
        "One element cannot determine both p and q: give friction (q = mu p) or a second element.",
    )
    count = int(np.sum(np.any(is_observed, axis=0)))
    refuse(count < 3, f"There are only {count} samples: give at least 3.")
    if not isinstance(data, Tracer):
        bad = is_observed & ~np.isfinite(np.asarray(data))
        refuse(
            bool(bad.any()),
            f"The data have {int(bad.sum())} samples that are nan or infinite: mark them "
            "as missing in observed, or correct them.",
        )
    if not isinstance(noise, Tracer):
        _check_noise(np.asarray(noise))
    means = zip(("known mean of p", "known mean of q"), known_mean_Pa, strict=True)
    for name, value in (("friction", friction), *means):
        refuse(
            value is not None and not isinstance(value, Tracer) and not np.isfinite(value),
            f"The {name} is {value}: give a finite number.",
        )
    if not isinstance(forward.transfer, Tracer):
        refuse(
            not bool(np.any(np.asarray(forward.transfer))),
            "The model's signal is zero for every traction: give a speed and a gain other than 0.",
        )


def _checked_shapes(shape: tuple[int, int], line, data, noise, observed) -> np.ndarray:
    """The mask of valid samples, of this shape as the data."""
    refuse(
        data.shape != shape,
        f"The data have shape {data.shape}: the model expects (element, sample) = {shape}.",
    )
    refuse(
        noise.shape not in ((1, *line.k.shape), (shape[0], *line.k.shape)),
        f"The noise has shape {noise.shape}: give its power at the {line.n // 2 + 1} wavenumbers "
        "line.k, one row for all elements or one for each.",
    )
    is_observed = np.ones(shape, bool) if observed is None else np.asarray(observed)
    refuse(
        is_observed.shape != shape,
        f"observed has shape {is_observed.shape}: give one truth value for each of {shape}.",
    )
    return is_observed


def _check_noise(power: np.ndarray) -> None:
    is_free = np.isinf(power[:, 0]).all()
    usable = (power > 0) & np.isfinite(power)
    usable[:, 0] |= is_free
    row, worst = np.unravel_index(int(np.argmin(usable)), power.shape)
    refuse(
        not usable.all(),
        f"The noise is {power[row, worst] or 'zero'} at wavenumber number {worst}: give a power "
        "above 0 (infinite at number 0 alone, for an offset that is not known).",
    )


def check_nuisance(shape: tuple[int, ...], columns: Any) -> None:
    """Refuse columns that are not finite, or not of the data's shape."""
    if columns is None or isinstance(columns, Tracer):
        return
    fits = columns.ndim == 3 and (columns.shape[0], columns.shape[2]) == shape
    refuse(
        not fits or not bool(np.isfinite(np.asarray(columns)).all()),
        f"The nuisance has the shape {columns.shape}: give finite numbers (element, column, "
        f"sample), of the {shape[0]} elements and {shape[1]} samples of the data.",
    )


def check_noise_scale(shape: tuple[int, ...], scale: Any) -> None:
    """Refuse factors on the noise that are not positive, or not of the data's shape."""
    if scale is None or isinstance(scale, Tracer):
        return
    values = np.asarray(scale)
    refuse(
        values.shape != shape or not bool(np.all(np.isfinite(values) & (values > 0))),
        f"noise_scale is {echo(values)}: give a positive factor on the noise's standard deviation "
        f"for each of the samples, {shape}.",
    )


def unboxed(value: Any) -> Any:
    """A number of an array as Python's; anything else as it is."""
    return value.item() if getattr(value, "ndim", None) == 0 else value


def check_estimate(
    shape: tuple[int, int],
    parts: Mapping[str, Any],
    status: Any,
    resolved_dof: Any,
    warnings: Any,
    stats: Mapping[str, Any],
) -> None:
    """Refuse what a method says of its solution of this shape, `traction` and `stderr` (None where
    there is none) by name, where it cannot be."""
    choice("status", status, list(Status))
    wanted = f"a number from 0 to {math.prod(shape)}, of as many unknowns"
    number("resolved_dof", resolved_dof, wanted, least=0, most=math.prod(shape))
    all_of_kind("warnings", warnings, str, "sentences")
    for name, value in stats.items():
        refuse(
            not (value is None or isinstance(value, str | Real)),
            f"stats has {name} = {echo(value)}: give a number or a word.",
        )
    given = {name: np.asarray(values) for name, values in parts.items() if values is not None}
    for name, values in given.items():
        refuse(
            values.shape != shape,
            f"The {name} has the shape {values.shape}: give (component, cell), as they are solved "
            f"for: {shape}.",
        )
    stderr = given.get("stderr", np.zeros(shape))
    refuse(
        bool(np.any((stderr < 0) | np.isinf(stderr))),
        "stderr has negative or infinite numbers: give NaN where it is not known.",
    )


class ScannedCells(NamedTuple):
    """The `cells` of a line of n that a scan passed, in the order of time."""

    cells: np.ndarray
    n: int

    def placed(self, values: Float[np.ndarray, "e sample"]) -> Float[np.ndarray, "e n"]:
        """Values of the samples on their cells, NaN on the others."""
        whole = np.full((len(values), self.n), np.nan)
        whole[:, self.cells] = values
        return whole


class LineProblem(LineModel):
    """A problem on a line: signals at its cells, their linear model, and further known quantities.

    `srsinv.simulate` makes one, and so does [`Problem.to_grid`][srsinv.Problem.to_grid]. The model
    is data = forward(r) + noise with r (c, n) the traction [Pa]: both components ("p and q apart"),
    or p alone where `friction` says q = mu p.

    - `line`: the cells. `forward`: the linear map from r to the signals (e, n).
    - `data` (e, n): signal less its known offset and less the signal of the known means; zero where
      it is missing.
    - `noise` (k,), or (e, k) where it is not the same in all elements: power per sample at `line.k`
      (see `forward.noise`); infinite at k = 0 where the signals' offsets are not known, which takes
      their means out of the data. It is kept with one row for all, or one for each.
    - `observed` (e, n): mask of valid samples; None means all.
    - `shared_noise`: the part of the noise that elements share, as a [`SharedNoise`][] whose powers
      in the elements `noise` is. None: elements are independent.
    - `noise_scale` (e, n): the noise's standard deviation in each cell in units of that of `noise`,
      slowly varying or not; 1 where a sample is missing. None means 1 everywhere.
    - `nuisance` (e, column, n): what else may be on each element's signal, of unknown sizes that
      are normal of variance one. None: nothing.
    - `known_mean_Pa` (c,) [Pa]: of each component its mean over the window, None where it is not
      known.
    - `background_Pa` (c,) [Pa]: of each component a uniform traction that continues beyond the
      window of an open line, which is unobservable; it is added to the estimate. None: not known.
    - `friction`: mu in q = mu p; None leaves p and q apart.
    - `zero_mean` (c,): whether only the deviation from the mean is solved for: where the mean is
      known, and where it is unobservable.
    - `mean_signal` (e, n): the signal of the known means.
    - `warnings`: sentences on the signal, which every estimate takes over.
    - `sensor`, `scan`: what made the signals, one sample a cell at constant speed; `scanned`: the
      cells from the first to the last with a sample. None where only the operator is known.
    - `passes`: what averaging found, where the signals are means over passes.
    - `rig`: how well a calibration determined the sensor; None: it is taken as exact.
    - `by_rig`: the same signals as a problem of another sensor and another error of its rig, with
      noise that is found anew, as a [`Problem`][] has it. None: the noise stays.
    - `modulus_Pa` [Pa]: the skin's Young's modulus, as a [`Problem`][] has it.
    - `signal_unit`: of `data`; "1" where only the operator is known.
    - `rig_sources`: the source of the error in each of these directions.
    - `rig_stretch_m` [m]: how far one standard deviation of the rig moves the sensor in each cell.
    - `rig_changes`: the model's change by one standard deviation of the rig, the elements of one
      direction after those of another. None: no rig.
    - `rig_rows` (k, j): the independent directions of the rig's error, as sums of the j changes.
      None: each change is one.

    Raises `BadInput` where shapes disagree, a number is not finite, fewer than three samples are
    valid, the noise is zero, the model is zero, or one element is asked for p and q apart.
    """

    line: Line
    forward: Convolution
    data: Float[Array, "e n"]
    noise: Float[Array, "#e k"]
    observed: Bool[Numbers, "e n"] | None
    noise_scale: Float[Array, "e n"] | None
    shared_noise: SharedNoise | None
    nuisance: Float[Array, "e column n"] | None
    known_mean_Pa: tuple[Float[Array, ""] | None, Float[Array, ""] | None]
    background_Pa: tuple[Float[Array, ""] | None, Float[Array, ""] | None]
    friction: Float[Array, ""] | None
    zero_mean: Bool[Array, " c"]
    mean_signal: Float[Array, "e n"]
    sensor: Sensor | None
    scan: ConstantSpeed | None
    scanned: ScannedCells | None
    passes: AveragedPasses | None
    rig: SensorError | None
    rig_changes: Convolution | None
    rig_stretch_m: Float[np.ndarray, "j n"] | None
    rig_rows: Float[np.ndarray, "k j"] | None
    rig_sources: tuple[str, ...] = eqx.field(static=True)
    modulus_Pa: float | None = eqx.field(static=True)
    signal_unit: str = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True)
    by_rig: Callable[[Sensor, SensorError | None], "LineProblem"] | None = eqx.field(static=True)

    def __init__(
        self,
        line: Line,
        forward: Convolution,
        data,
        noise,
        *,
        observed=None,
        noise_scale=None,
        shared_noise: SharedNoise | None = None,
        nuisance=None,
        known_mean_Pa: Sequence[float | Array | None] = (None, None),
        background_Pa: Sequence[float | Array | None] = (0.0, 0.0),
        friction=None,
        sensor: Sensor | None = None,
        scan: ConstantSpeed | None = None,
        passes: AveragedPasses | None = None,
        rig: SensorError | None = None,
        rig_changes: Convolution | None = None,
        rig_stretch_m=None,
        rig_sources: Sequence[str] = (),
        modulus_Pa: float | None = None,
        warnings: Sequence[str] = (),
    ):
        self.modulus_Pa = modulus_Pa
        self.warnings, self.passes, self.rig = tuple(warnings), passes, rig
        data, noise = as_real(data), as_real(noise)
        noise = noise if noise.ndim == 2 else jnp.atleast_2d(noise)
        check(line, forward, data, noise, observed, friction, known_mean_Pa)
        self.noise_scale = None if noise_scale is None else as_real(noise_scale)
        check_noise_scale(data.shape, self.noise_scale)
        self.nuisance = None if nuisance is None else as_real(nuisance)
        check_nuisance(data.shape, self.nuisance)
        if friction is not None:
            friction = as_real(friction)
            forward = of_pressure(forward, friction)
            rig_changes = None if rig_changes is None else of_pressure(rig_changes, friction)
        self.rig_changes, self.rig_stretch_m = rig_changes, rig_stretch_m
        self.rig_rows, self.rig_sources, self.by_rig = None, tuple(rig_sources), None
        self.line, self.forward, self.noise, self.friction = line, forward, noise, friction
        if observed is not None:
            observed = np.asarray(observed, bool)
            observed = None if observed.all() else observed
        others = self.noise_scale, self.nuisance
        self.shared_noise, further = usable(shared_noise, observed, others)
        self.warnings = (*self.warnings, *further)
        self.observed, self.sensor, self.scan = observed, sensor, scan
        self.signal_unit = "1" if sensor is None else sensor.amplifier.unit
        self.scanned = None
        if scan is not None and not is_traced(scan):  # a fit takes the order of time
            self.scanned = _scanned(line.n, observed, scan)
        self.known_mean_Pa = _pair(known_mean_Pa)
        self.background_Pa = _pair(background_Pa)
        self.zero_mean = have_zero_mean(forward, noise, self._known)
        self.mean_signal, self.data = less_means(
            forward, data, observed, self.known_mean_Pa[: self.unknowns]
        )

    @classmethod
    def of_sensor(
        cls,
        line: Line,
        sensor: Sensor,
        scan: ConstantSpeed,
        data,
        noise,
        rig: SensorError | None = None,
        scan_start_m: float | None = None,
        **known,
    ) -> "LineProblem":
        """The problem of a sensor that slides along the line, with one sample at each cell.

        `known`: further arguments of the class. `scan_start_m` [m]: where the scan starts; None: in
        the first cell.
        """
        operator = sensor.operator(line, scan)
        of_signal = None if rig is None else rig.of_signals
        if of_signal is not None:
            own = np.asarray(operator.transfer)

            def transfer(setup: Setup):
                return setup.sensor.operator(line, scan.scaled(setup.speed)).transfer

            moved = of_signal.columns(sensor, own, transfer)
            changes = in_jax(moved.reshape(-1, *own.shape[1:]))
            known["rig_changes"] = dataclasses.replace(operator, transfer=changes)
            known["rig_sources"] = of_signal.sources(len(moved))
            speed = of_signal.moves("speed", len(moved))
            if speed.any():
                start = float(line.start_m) if scan_start_m is None else scan_start_m
                known["rig_stretch_m"] = speed[:, None] * (np.asarray(line.x) - start)
        return cls(line, operator, data, noise, sensor=sensor, scan=scan, rig=rig, **known)

    def to_grid(self) -> "LineProblem":
        """The same problem without its sensor, so that all sensors share its compiled programs."""
        if self.sensor is None:
            return self
        none = dict.fromkeys(("sensor", "scan", "scanned", "passes", "rig", "by_rig"))
        return with_fields(self, **none)

    def without_warnings(self) -> "LineProblem":
        """The same problem without its warnings. Programs are compiled for each text: without
        texts, problems share them."""
        return with_fields(self, warnings=(), by_rig=None)

    def with_rig(self, sensor: Sensor, rig: SensorError | None) -> "LineProblem":
        """The same signals as a problem of another sensor, its rig known to within `rig`."""
        if self.by_rig is not None:
            return self.by_rig(sensor, rig)
        assert self.scan is not None
        assert self.scanned is not None
        cells = self.scanned.cells
        return LineProblem.of_sensor(
            self.line,
            sensor,
            self.scan,
            self.data + self.mean_signal,
            self.noise,
            rig=rig,
            scan_start_m=float(np.asarray(self.line.x)[cells[0]]),
            observed=self.observed,
            noise_scale=self.noise_scale,
            shared_noise=self.shared_noise,
            nuisance=self.nuisance,
            known_mean_Pa=self.known_mean_Pa,
            background_Pa=self.background_Pa,
            friction=self.friction,
            passes=self.passes,
            modulus_Pa=self.modulus_Pa,
            warnings=self.warnings,
        )

    def rig_signals(self, traction: Float[Any, "c n"]) -> Float[Numbers, "k e n"]:
        """The changes of the signals of a traction by one standard deviation of the rig, in each
        independent direction; 0 where samples are missing. None: the rig is exact."""
        changes, rows = self.changed_signals(traction), self.rig_rows
        return (
            changes if rows is None else array_module(changes).einsum("kj,jen->ken", rows, changes)
        )

    def changed_signals(self, traction: Float[Any, "c n"]) -> Float[Numbers, "j e n"]:
        """The same for each of `rig_changes`, whose independent sums `rig_rows` has."""
        if self.rig_changes is None:
            return np.zeros((0, *self.data.shape))
        operators, stretch_m = (self.rig_changes, self.forward), self.rig_stretch_m
        xp = array_module(operators, traction, self.line)
        if xp is np:
            operators, traction = in_numpy(operators), np.asarray(traction)
        signals = xp.asarray(operators[0](traction), float).reshape(-1, *self.data.shape)
        if stretch_m is not None:
            # At another speed the sensor is elsewhere, the further the longer it has moved.
            own = xp.asarray(operators[1](traction), float)
            slope = xp.gradient(own, axis=-1) / xp.asarray(self.line.cell_m)
            signals = signals + xp.asarray(stretch_m)[:, None] * slope
        return xp.where(self.is_observed, signals, 0.0)

    @property
    def nominal_pressure_Pa(self) -> Any:
        """The pressure far from the features [Pa], None where it is not known: on a periodic line
        the mean, on an open one what goes on beyond its ends."""
        background, mean = self.background_Pa[0], self.known_mean_Pa[0]
        if isinstance(self.line, Periodic) and mean is not None:
            return mean if background is None else mean + background
        # A simulation on an open line holds what is beyond its background, without that itself.
        is_simulated = mean is not None and background is not None and not np.any(background)
        return None if is_simulated else background

    @property
    def window(self) -> Window:
        """The stretch that the traction lies in."""
        start = float(self.line.start_m - self.line.cell_m / 2)
        return Window(start, start + self.line.n * float(self.line.cell_m))

    def operator(self, line: Line) -> Operator:
        """From traction on another line to the signals along the scan (see `samples`)."""
        sensor, motion, *_ = self.samples()
        return sensor.operator_along(line, motion, directions=motion.directions)

    def samples(self) -> Samples:
        """The signals from the first to the last cell with a sample, in the order of time."""
        scanned, sensor = self.scanned, self.sensor
        if scanned is None or sensor is None:
            raise BadInput(
                "The problem has an operator but no sensor, which a feature fit needs: give "
                "sensor and scan."
            )
        signal = self.data + self.mean_signal
        xp = array_module(signal)
        y = xp.where(self.is_observed, xp.asarray(signal), xp.nan)[:, scanned.cells]
        scale = np.ones(()) if self.noise_scale is None else self.noise_scale[:, scanned.cells]
        observed = self.is_observed[:, scanned.cells]
        noise = noise_on_line(self.noise, self.line.n, observed, scale)
        return Samples(sensor, self._motion, y, noise, is_estimate=False)

    def restricted_to(self, cells: Bool[np.ndarray, " n"]) -> "LineProblem":
        """The same problem with the samples of these cells alone."""
        observed = self.is_observed & cells
        both = observed, jnp.where(observed, self.data, 0.0)
        is_none = {"is_leaf": lambda leaf: leaf is None}
        cut = eqx.tree_at(lambda p: (p.observed, p.data), self, both, **is_none)
        return with_fields(cut, by_rig=None)

    @property
    def _motion(self) -> Motion:
        assert self.scan is not None
        assert self.scanned is not None
        with outside_traces():
            x, speed = np.asarray(self.line.x)[self.scanned.cells], float(self.scan.speed_m_per_s)
            return Motion((x - x[0]) / speed, x, np.full(x.shape, speed))

    def estimate(
        self,
        traction: Float[Array, "c n"],
        stderr: Float[Array, "c n"] | None = None,
        *,
        status: Status | str = Status.CONVERGED,
        resolved_dof: float = 0.0,
        warnings: Sequence[str] = (),
        **stats: Any,
    ) -> TractionEstimate:
        """The estimate that a method ends with.

        - `traction` [Pa]: of the components solved for, less their known means; `stderr` [Pa]: its
          standard error, None where the method gives none.
        - `resolved_dof`: effective degrees of freedom that the method fitted.
        - `warnings`: sentences; `stats`: further numbers and words, by name.

        Raises `BadInput` for what has another shape or cannot be.
        """
        stats = {name: unboxed(value) for name, value in stats.items()}
        given = {"traction": traction, "stderr": stderr}
        check_estimate((self.unknowns, self.line.n), given, status, resolved_dof, warnings, stats)
        unknown = jnp.full(np.shape(traction), jnp.nan)
        parts = self.without_warnings().estimate_parts(
            jnp.asarray(traction), unknown if stderr is None else stderr
        )
        squares = chi2(self, float(resolved_dof), residual_squares(self, parts))
        of_residual = squares[CHI2], squares[FREEDOM] or 0.0
        over_noise = (*unchecked_residual(squares[CHI2]), *residual_over_noise(*of_residual))
        p, p_stderr = (np.asarray(each)[0] for each in (parts.value, parts.stderr))
        p_stderr = np.where(np.isfinite(p_stderr), p_stderr, 0.0)
        beyond = beyond_modulus(p, p_stderr, self.modulus_Pa, float(resolved_dof))
        finite = bool(jnp.all(jnp.isfinite(parts.value)))
        return TractionEstimate(
            line=self.line,
            value=parts.value,
            stderr=parts.stderr,
            fitted=parts.fitted,
            whitened=parts.whitened,
            friction=self.friction,
            mean_unobserved=self.mean_unobserved,
            signal_unit=self.signal_unit,
            status=Status(status) if finite else Status.NOT_FINITE,
            warnings=(*self.warnings, *warnings, *over_noise, *beyond),
            stats=stats | squares,
        )


def of_pressure(operator: Convolution, friction: Float[Array, ""]) -> Convolution:
    """The operator from p alone, with q = mu p."""
    transfer = operator.transfer[:, :1] + friction * operator.transfer[:, 1:]
    return dataclasses.replace(operator, transfer=transfer)


def _scanned(n: int, observed: np.ndarray | None, scan: ConstantSpeed) -> ScannedCells:
    at = np.arange(n) if observed is None else np.flatnonzero(np.any(np.asarray(observed), axis=0))
    cells = np.arange(at[0], at[-1] + 1)
    return ScannedCells(cells if float(scan.speed_m_per_s) > 0 else cells[::-1], n)


def _pair(values: Sequence[float | Array | None]):
    p, q = (None if value is None else _number(value) for value in values)
    return p, q


def _number(value: float | Array) -> Array:
    """An array of the number, which stays known where jax traces other things."""
    with nullcontext() if is_traced(value) else outside_traces():
        return as_real(value)
