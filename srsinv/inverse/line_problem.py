"""A problem on the cells of a line, linear in the traction: what Wiener's filter, Tikhonov's method
and their like solve."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..errors import BadInput, refuse
from ..forward.scan import ConstantSpeed, Motion
from ..forward.sensor import Sensor
from ..grid import Convolution, Line, Operator, as_real
from ..status import Status
from ._line_checks import check, check_estimate, unboxed
from .cells import Window
from .diagnostics import residual_over_noise
from .estimate import COMPONENTS, TractionEstimate
from .means import are_observable, have_zero_mean, less_means
from .sample_noise import Samples, noise_on_line

CHI2, FREEDOM = "chi2_per_freedom", "degrees_of_freedom"


class PassedCells(NamedTuple):
    """The `cells` of a line of n that a scan passed, in the order of time."""

    cells: np.ndarray
    n: int

    def placed(self, values: Float[np.ndarray, "e sample"]) -> Float[np.ndarray, "e n"]:
        """Values of the samples on their cells, NaN on the others."""
        whole = np.full((len(values), self.n), np.nan)
        whole[:, self.cells] = values
        return whole


class LineProblem(eqx.Module):
    """Signals at the cells of a line, their linear model, and further known quantities.

    The model is data = forward(r) + noise with r (c, n) the traction [Pa]: both components
    ("p and q apart"), or p alone where `friction` says q = mu p.

    - `data` (e, n): signal less its known offset and less the signal of the known means; zero where
      it is missing.
    - `noise` (k,): power per sample at `line.k` (see `forward.noise`); infinite at k = 0 where the
      signal's offset is not known, which takes its mean out of the data.
    - `observed` (e, n): mask of valid samples; None means all.
    - `known_mean_Pa`: for each component its mean over the window where it is known, else None.
    - `background_Pa`: for each component a uniform traction that continues beyond the window of an
      open line, which is unobservable; it is added to the estimate. None: not known.
    - `friction`: mu in q = mu p; None leaves p and q apart.
    - `zero_mean` (c,): whether only the deviation from the mean is solved for: where the mean is
      known, and where it is unobservable.
    - `mean_signal` (e, n): the signal of the known means.
    - `warnings`: sentences on the signal, which every estimate takes over.
    - `sensor`, `scan`: what made the signals, one sample a cell at constant speed; `passed`: the
      cells from the first to the last with a sample. None where only the operator is known.

    Raises `BadInput` where shapes disagree, a number is not finite, fewer than three samples are
    valid, the noise is zero, the model is zero, or one element is asked for p and q apart.
    """

    line: Line
    forward: Convolution
    data: Float[Array, "e n"]
    noise: Float[Array, " k"]
    observed: Bool[Array, "e n"] | None
    known_mean_Pa: tuple[Float[Array, ""] | None, Float[Array, ""] | None]
    background_Pa: tuple[Float[Array, ""] | None, Float[Array, ""] | None]
    friction: Float[Array, ""] | None
    zero_mean: Bool[Array, " c"]
    mean_signal: Float[Array, "e n"]
    sensor: Sensor | None
    scan: ConstantSpeed | None
    passed: PassedCells | None
    warnings: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        line: Line,
        forward: Convolution,
        data,
        noise,
        *,
        observed=None,
        known_mean_Pa: Sequence[float | Array | None] = (None, None),
        background_Pa: Sequence[float | Array | None] = (0.0, 0.0),
        friction=None,
        sensor: Sensor | None = None,
        scan: ConstantSpeed | None = None,
        warnings: Sequence[str] = (),
    ):
        self.warnings = tuple(warnings)
        data, noise = as_real(data), as_real(noise)
        check(line, forward, data, noise, observed, friction, known_mean_Pa)
        if friction is not None:
            friction = as_real(friction)
            transfer = forward.transfer[:, :1] + friction * forward.transfer[:, 1:]
            forward = dataclasses.replace(forward, transfer=transfer)
        self.line, self.forward, self.noise, self.friction = line, forward, noise, friction
        observed = None if observed is None or np.all(observed) else jnp.asarray(observed)
        self.observed, self.sensor, self.scan = observed, sensor, scan
        self.passed = None if scan is None else _passed(line.n, observed, scan)
        self.known_mean_Pa = _pair(known_mean_Pa)
        self.background_Pa = _pair(background_Pa)
        self.zero_mean = have_zero_mean(forward, noise, self._known)
        self.mean_signal, self.data = less_means(
            forward, data, observed, self.known_mean_Pa[: self.unknowns]
        )

    @classmethod
    def of_sensor(
        cls, line: Line, sensor: Sensor, scan: ConstantSpeed, data, noise, **known
    ) -> "LineProblem":
        """The problem of a sensor that slides along the line, one sample at each cell; `known` as
        the class takes it."""
        operator = sensor.operator(line, scan)
        return cls(line, operator, data, noise, sensor=sensor, scan=scan, **known)

    def on_line(self) -> "LineProblem":
        """Itself, without the sensor: what is compiled for one problem then serves all sensors."""
        if self.sensor is None:
            return self
        return eqx.tree_at(lambda p: (p.sensor, p.scan, p.passed), self, (None, None, None))

    @property
    def own_line(self) -> Line:
        """The line that the samples are the cells of."""
        return self.line

    @property
    def window(self) -> Window:
        """The stretch that the traction lies in."""
        start = float(self.line.start_m - self.line.cell_m / 2)
        return Window(start, start + self.line.n * float(self.line.cell_m))

    def operator(self, line: Line) -> Operator:
        """From traction on another line to the signals along the scan (see `samples`)."""
        sensor, motion, *_ = self.samples()
        return sensor.operator_along(line, motion, ways=motion.ways)

    def samples(self) -> Samples:
        """The signals from the first to the last cell with a sample, in the order of time."""
        passed, sensor = self.passed, self.sensor
        if passed is None or sensor is None:
            raise BadInput(
                "The problem has an operator and no sensor, and features are fitted along a "
                "sensor's motion: give sensor and scan."
            )
        y = np.where(self.is_observed, np.asarray(self.data + self.mean_signal), np.nan)[
            :, passed.cells
        ]
        noise = noise_on_line(np.asarray(self.noise), self.line.n, y)
        return Samples(sensor, self._motion, y, noise, is_estimate=False)

    @property
    def is_observed(self) -> Bool[np.ndarray, "e n"]:
        """The mask of valid samples."""
        if self.observed is None:
            return np.ones(self.data.shape, bool)
        return np.asarray(self.observed)

    @property
    def observed_cells(self) -> Bool[np.ndarray, " n"]:
        """Cells at which at least one element was sampled."""
        return np.any(self.is_observed, axis=0)

    @property
    def noise_rms(self) -> float:
        """Standard deviation of a sample's noise, an unknown offset aside."""
        return float(np.sqrt(np.mean(np.asarray(self.noise)[1:])))

    @property
    def surrounding_pressure_Pa(self) -> float:
        """The pressure around the features, as far as it is known."""
        known = self.known_mean_Pa[0], self.background_Pa[0]
        return sum(float(each) for each in known if each is not None)

    @property
    def has_free_offset(self) -> bool:
        """Whether each element's signal has a constant that is not known."""
        return not np.isfinite(float(self.noise[0]))

    def restricted_to(self, cells: Bool[np.ndarray, " n"]) -> "LineProblem":
        """The same problem with the samples of these cells alone."""
        observed = jnp.asarray(self.is_observed & cells)
        both = observed, jnp.where(observed, self.data, 0.0)
        is_none = {"is_leaf": lambda leaf: leaf is None}
        return eqx.tree_at(lambda p: (p.observed, p.data), self, both, **is_none)

    @property
    def _motion(self) -> Motion:
        assert self.scan is not None
        assert self.passed is not None
        x, speed = np.asarray(self.line.x)[self.passed.cells], float(self.scan.speed_m_per_s)
        return Motion((x - x[0]) / speed, x, np.full(x.shape, speed))

    @property
    def unknowns(self) -> int:
        """Number of components that are solved for."""
        return self.forward.transfer.shape[1]

    @property
    def separable(self) -> bool:
        """Whether each wavenumber can be treated alone: a periodic line with every sample valid."""
        return self.forward.is_circular and self.observed is None

    @property
    def information(self) -> Float[Array, "c k"]:
        """Fisher information on each component at line.k, sum over elements of |G|^2/N [1/Pa^2], of
        the nearest periodic problem."""
        gain = jnp.abs(self.forward.circulant().transfer * self.whitener) ** 2
        return jnp.sum(gain, axis=0)

    @property
    def whitener(self) -> Float[Array, " k"]:
        """N^(-1/2) at line.k."""
        return 1 / jnp.sqrt(self.noise)

    @property
    def sample_count(self) -> int:
        """Number of valid samples, over all elements."""
        return int(self.data.size if self.observed is None else np.sum(np.asarray(self.observed)))

    @eqx.filter_jit
    def free_offset(self, y: Float[Array, "e n"]) -> Float[Array, "e 1"]:
        """The mean of y over the valid samples, where the signal's offset is not known and absorbs
        it; else zero."""
        is_observed = jnp.ones(y.shape, bool) if self.observed is None else self.observed
        count = jnp.maximum(jnp.sum(is_observed, axis=-1, keepdims=True), 1)
        mean = jnp.sum(jnp.where(is_observed, y, 0.0), axis=-1, keepdims=True) / count
        return jnp.where(jnp.isfinite(self.noise[0]), 0.0, mean)

    @property
    def mean_is_observable(self) -> Bool[Array, " c"]:
        """For each unknown, whether its mean is observable.

        Its gain at k = 0 must not vanish, nor be proportional to another unknown's.
        """
        return are_observable(self.forward, self.noise, self._known)

    @property
    def mean_weights(self) -> Float[Array, "c n"]:
        """The weights of each unknown's mean over the sampled cells where that mean is weakly
        observed, on an open line: its error would mask all others. Else zero."""
        hidden = ~self.zero_mean & ~self.mean_is_observable & (not self.forward.is_circular)
        ones = jnp.ones(self.data.shape, bool) if self.observed is None else self.observed
        cells = jnp.any(ones, axis=0)
        return hidden[:, None] * (cells / jnp.sum(cells))[None, :]

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
        shape = self.unknowns, self.line.n
        stats = {name: unboxed(value) for name, value in stats.items()}
        check_estimate(shape, stderr, status, resolved_dof, warnings, stats)
        unknown = jnp.full(shape, jnp.nan)
        for name, values in {"traction": traction, "stderr": stderr}.items():
            given = np.shape(unknown if values is None else values)
            refuse(
                given != shape,
                f"The {name} has the shape {given}: give (component, cell), as they are solved "
                f"for: {shape}.",
            )
        shown = _shown(self, jnp.asarray(traction), unknown if stderr is None else stderr)
        chi2 = self.chi2(float(resolved_dof), float(shown.squares))
        finite = bool(jnp.all(jnp.isfinite(shown.value)))
        return TractionEstimate(
            line=self.line,
            value=shown.value,
            stderr=shown.stderr,
            fitted=shown.fitted,
            whitened=shown.whitened,
            covariance=None,
            mean_weights=None,
            averaging=None,
            friction=self.friction,
            status=Status(status) if finite else Status.NOT_FINITE,
            warnings=(
                *self.warnings,
                *warnings,
                *residual_over_noise(chi2[CHI2], chi2[FREEDOM] or 0.0),
            ),
            stats=stats | chi2,
        )

    def show(self, traction: Float[Array, "c n"], stderr: Float[Array, "c n"]) -> "Shown":
        """What an estimate shows of a solution: see `Shown`."""
        fitted, value = self.forward(traction), traction
        pairs = zip(self.known_mean_Pa, self.background_Pa, strict=True)
        means = [
            sum((m for m in pair if m is not None), jnp.zeros((), value.dtype)) for pair in pairs
        ]
        if self.friction is not None:
            value = jnp.concatenate([value, self.friction * value])
            stderr = jnp.concatenate([stderr, jnp.abs(self.friction) * stderr])
            means[1] = self.friction * means[0]
        whitened = self.whitened(self.data - fitted)
        return Shown(
            value + jnp.stack(means)[:, None],
            stderr,
            fitted + self.mean_signal + self.free_offset(self.data - fitted),
            whitened,
            jnp.nansum(whitened**2),
        )

    def whitened(self, residual: Float[Array, "e n"]) -> Float[Array, "e n"]:
        """The residual in units of the noise, NaN where a sample is missing."""
        residual = residual - self.free_offset(residual)
        observed = self.observed
        if observed is not None:
            residual = jnp.where(observed, residual, 0.0)
        whitened = jnp.fft.irfft(jnp.fft.rfft(residual) * self.whitener, self.line.n)
        return whitened if observed is None else jnp.where(observed, whitened, jnp.nan)

    def chi2(self, resolved_dof: float, squares: float) -> dict[str, float | None]:
        """Chi-square of the residual per degree of freedom, from the whitened residual's sum of
        squares; None where it is undefined."""
        noise = np.asarray(self.noise)
        offsets = 0 if np.isfinite(noise[0]) else self.data.shape[0]
        freedom = float(self.sample_count - offsets - resolved_dof)
        # With samples missing, a residual whitened with zeros in the gaps is white for white noise
        # alone.
        known = (self.observed is None or not np.ptp(noise[1:])) and freedom >= 1
        return {CHI2: squares / freedom if known else None, FREEDOM: freedom}

    @property
    def _known(self) -> tuple[bool, ...]:
        return tuple(mean is not None for mean in self.known_mean_Pa[: self.unknowns])

    def mean_statement(self) -> dict[str, str]:
        """Origin of the estimate's mean for p and q, in words."""
        return {name: self._mean_of(c) for c, name in enumerate(COMPONENTS)}

    def _mean_of(self, c: int) -> str:
        if c >= self.unknowns:
            return f"follows from p by q = mu p with mu = {self.friction:.4g}"
        known, background = self.known_mean_Pa[c], self.background_Pa[c]
        if background is None:
            return "unobserved: the estimate is the deviation from a background that is not known"
        if known is not None:
            return f"known from outside: {float(known + background):.6g} Pa"
        if bool(self.mean_is_observable[c]):
            return "from the signal"
        if self.forward.is_circular:
            return "unobserved: the signal is blind to it; the estimate is the deviation from it"
        return "weakly observed: only what the window's ends show of it"


class Shown(NamedTuple):
    """Parts of an estimate: p and q [Pa] and their standard error (2, n), the fitted signal and the
    whitened residual (e, n), and the sum of the latter's squares."""

    value: Float[Array, "2 n"]
    stderr: Float[Array, "2 n"]
    fitted: Float[Array, "e n"]
    whitened: Float[Array, "e n"]
    squares: Float[Array, ""]


@eqx.filter_jit
def _shown(problem: LineProblem, traction, stderr) -> Shown:
    return problem.show(traction, stderr)


def _passed(n: int, observed: Array | None, scan: ConstantSpeed) -> PassedCells:
    at = np.arange(n) if observed is None else np.flatnonzero(np.any(observed, axis=0))
    cells = np.arange(at[0], at[-1] + 1)
    return PassedCells(cells if scan.speed_m_per_s > 0 else cells[::-1], n)


def _pair(values: Sequence[float | Array | None]):
    p, q = (None if value is None else as_real(value) for value in values)
    return p, q
