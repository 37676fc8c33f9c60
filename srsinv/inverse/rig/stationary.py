"""The evidence of a rig's facts in signals of an unknown surface: how probable the signals are
under each depth, gain and angle, with the traction integrated out.

Traction is taken as a stationary function of x, normal, of a spectrum S(k) that nobody knows: its
logarithm is a smooth curve in log k, of free coefficients, for each of p and q. The signals of a
stretch of the scan then have the covariance

    C(x - x') = 1/2pi integral G(k) S(k) G(k)^H exp(i k (x - x')) dk + N,

which is exact for a stretch of a longer surface: nothing wraps around. With the facts c of the rig,
minus the logarithm of the evidence is 1/2 (log det C + y^T C^-1 y), and the Fisher information of
two parameters is 1/2 tr(C^-1 C_i C^-1 C_j) (Kay 1993, Fundamentals of Statistical Signal
Processing, 3.9). Its inverse is the Cramer-Rao bound: of one element S makes up for any depth, of
two the ratio of their signals shows it whatever S is.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Complex, Float

from ...compiled import compiled
from ...forward.scan import ConstantSpeed
from ...forward.sensor import Sensor
from ...grid import wavenumbers
from ...known import Numbers
from ..line.problem import LineProblem
from .error import RigError
from .setup import Setup

BLOCK = 0.4  # of the depth: cells are averaged up to so wide blocks, up to |k| z = 7.9
FINE = 1 / 8  # of the depth: the widest step of the traction, up to |k| z = 25
MOST_BLOCKS = 144  # in a stretch; longer scans are several, taken as independent
ROUNDED = 16  # blocks, so that scans of many lengths share a program
KNOTS = 1.0  # octaves between knots of log S
DEEPEST_WAVE = 16.0  # |k| z of the last knot
# Standard deviations of the prior of what is no fact of the rig, in nats. Spectra of surfaces are
# powers of k, with corners where a size or a contact ends them.
BEND, LEVEL, COHERENCE, WHITE, COLOUR = 1.8, 10.0, 2.0, 0.3, 2.0
FREE_OFFSET = 100.0  # of a signal's rms: the standard deviation of a constant that is not known
SMALLEST = 1e-8  # of the largest gain
DEPTH = "depth_m"
# How far an unknown may be from what is stated: logarithms of depth and gain, angles in radians.
FARTHEST = {"depth": np.log(3.3), "gain": np.log(5.0), "angle": np.pi / 3}


class EvidenceParameters(NamedTuple):
    """What the signals' covariance follows from: the `unknown` facts (log of depth and gains over
    what is stated, angles [rad] beside it), the `facts` (j,) in standard deviations of what is
    stated, coefficients of log `spectra` (c K), the area tangent of p's and q's `coherence`, half
    the logarithms of the `white` noise's power (e,) and of the `colour`'s over it."""

    unknown: Any
    facts: Any
    spectra: Any
    coherence: Any
    white: Any
    colour: Any


class Stretches(NamedTuple):
    """Signals of stretches of a scan, in blocks of cells and units of their white noise.

    - `data`, `observed`, `scale` (s, e, m): zero where a block is missing; `scale`: the noise's
      standard deviation over that of the whole. `columns` (s, e, j, m): what else may be on them,
      of unit variance. `level` (e,): the white noise's standard deviation in a cell, in the
      signal's unit; `colour` (e, 2 m): the covariance of other noise over a circle of lags.
    """

    data: Float[Any, "s e m"]
    observed: Float[Any, "s e m"]
    scale: Float[Any, "s e m"]
    columns: Float[Any, "s e j m"]
    level: Float[Any, " e"]
    colour: Float[Any, "e l"]


class StretchBlocks(NamedTuple):
    """How cells of a line are gathered: `cells` a block, `per_stretch` blocks a stretch, and so
    many `stretches` from the cell `first` on; the traction has `fine` steps to a cell."""

    cells: int
    per_stretch: int
    first: int
    stretches: int
    fine: int

    @classmethod
    def of(cls, problem: LineProblem, depth_m: float) -> "StretchBlocks":
        """Those of a problem's scan."""
        at = np.flatnonzero(problem.observed_cells)
        cell = float(problem.line.cell_m)
        cells = max(int(BLOCK * depth_m / cell), 1)
        count = max(int(at[-1] + 1 - at[0]) // cells, 1)
        stretches = -(-count // MOST_BLOCKS)
        each = -(-count // stretches)
        each += -each % ROUNDED
        return cls(cells, each, int(at[0]), stretches, max(int(np.ceil(cell / FINE / depth_m)), 1))

    def gathered(self, values: Float[np.ndarray, "*row n"]) -> Float[np.ndarray, "*row s m"]:
        """The mean over each block, NaN of one with a missing cell."""
        size = self.stretches * self.per_stretch * self.cells
        own = values[..., self.first : self.first + size]
        padding = [(0, 0)] * (own.ndim - 1) + [(0, size - own.shape[-1])]
        whole = np.pad(own, padding, constant_values=np.nan)
        shape = (*own.shape[:-1], self.stretches, self.per_stretch, self.cells)
        return whole.reshape(shape).mean(axis=-1)

    def averaging(self, k: Float[np.ndarray, " k"], cell_m: float) -> Float[np.ndarray, " k"]:
        """The response of a block's mean at the wavenumbers k."""
        each = np.arange(self.cells) - (self.cells - 1) / 2
        return np.cos(np.outer(k * cell_m, each)).mean(axis=-1)


def stretches_of(problem: LineProblem, blocks: StretchBlocks) -> Stretches:
    """The signals of a problem in blocks."""
    power = np.broadcast_to(
        np.asarray(problem.noise, float), (len(problem.data), problem.line.k.size)
    )
    level, cell = np.sqrt(power[:, -1]), float(problem.line.cell_m)
    signal = (np.asarray(problem.data, float) + np.asarray(problem.mean_signal)) / level[:, None]
    signal = np.where(problem.is_observed, signal, np.nan)
    data = np.moveaxis(blocks.gathered(signal), 0, 1)
    observed = np.isfinite(data)
    scale = np.ones_like(data)
    if problem.noise_scale is not None:
        squares = blocks.gathered(np.asarray(problem.noise_scale, float) ** 2)
        scale = np.sqrt(np.moveaxis(squares, 0, 1))
    columns = np.zeros((*data.shape[:2], 0, data.shape[2]))
    if problem.nuisance is not None:
        own = blocks.gathered(np.asarray(problem.nuisance, float) / level[:, None, None])
        columns = np.moveaxis(own, 2, 0)
    if problem.has_free_offset:
        rms = np.sqrt(np.nanmean(signal**2, axis=1))
        constant = np.ones_like(data) * (FREE_OFFSET * rms)[:, None]
        columns = np.concatenate([columns, constant[:, :, None]], axis=2)
    lags = 2 * blocks.per_stretch * blocks.cells
    waves = np.asarray(wavenumbers(lags, cell))
    own = np.stack([np.interp(waves, np.asarray(problem.line.k)[1:], row[1:]) for row in power])
    own = np.maximum(own / level[:, None] ** 2 - 1, 0.0) * blocks.averaging(waves, cell) ** 2
    colour = np.fft.irfft(own, lags)[:, :: blocks.cells]
    is_there = observed.astype(float)
    filled = (np.where(observed, each, rest) for each, rest in ((data, 0.0), (scale, 1.0)))
    return Stretches(
        *(next(filled), is_there, next(filled)),
        np.where(observed[:, :, None], columns, 0.0),
        level, colour if colour.max() > SMALLEST else colour[:, :0],
    )  # fmt: skip


class StationaryEvidence(eqx.Module):
    """Minus the logarithm of the evidence, with the priors of facts and spectra, as a function of
    the row of all [`EvidenceParameters`][].

    - `sensor`, `scan`, `friction` as stated; `unknown`: names of the unknown facts, as
      [`Setup.changed`][] has them, of the stated `values`; `facts`: names of those with
      tolerances, of `root` (i, j) times numbers of variance one.
    """

    sensor: Sensor
    scan: ConstantSpeed
    friction: Float[Array, ""] | None
    unknown: tuple[str, ...] = eqx.field(static=True)
    values: Float[Array, " u"]
    facts: tuple[str, ...] = eqx.field(static=True)
    fact_values: Float[Array, " i"]
    root: Float[Array, "i j"]
    keeps_area: tuple[bool, ...] = eqx.field(static=True)
    k: Float[Array, " k"]
    step_m: Float[Array, ""]
    averaging: Float[Array, " k"]
    basis: Float[Array, "k b"]
    decay: Float[Array, " b"]
    unit: Float[Array, " c"]
    stretches: Stretches
    stride: int = eqx.field(static=True)
    block_cells: int = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        problem: LineProblem,
        unknown: tuple[str, ...],
        values: tuple[float, ...],
        rig: RigError | None,
    ) -> "StationaryEvidence":
        """That of a problem with its sensor, its rig's facts known to within `rig`."""
        sensor, scan = problem.sensor, problem.scan
        assert sensor is not None
        assert scan is not None
        depth, cell = float(sensor.depth_m), float(problem.line.cell_m)
        blocks = StretchBlocks.of(problem, depth)
        stretches, step = stretches_of(problem, blocks), cell / blocks.fine
        stride = blocks.cells * blocks.fine
        size = 2 * blocks.per_stretch * stride
        k = np.asarray(wavenumbers(size, step))
        basis = _basis(k, blocks.per_stretch * blocks.cells * cell, depth)
        decay = np.linalg.lstsq(basis, 2 * np.minimum(k * depth, DEEPEST_WAVE))[0]
        names = () if rig is None else rig.names
        root = np.zeros((0, 0)) if rig is None else rig.root
        facts = np.zeros(0) if rig is None else rig.values
        keeps = () if rig is None else tuple(rig.keeps_area(name) for name in names)
        model = cls(
            sensor, scan, problem.friction, unknown, jnp.asarray(values, float), names,
            jnp.asarray(facts), jnp.asarray(root), keeps, jnp.asarray(k), jnp.asarray(step),
            jnp.asarray(blocks.averaging(k, cell)),
            jnp.asarray(basis), jnp.asarray(decay),
            jnp.ones(problem.unknowns), jax.tree.map(jnp.asarray, stretches), stride, blocks.cells,
        )  # fmt: skip
        return eqx.tree_at(lambda m: m.unit, model, jnp.asarray(_unit(model)))

    @property
    def sizes(self) -> EvidenceParameters:
        """How many parameters there are of each kind."""
        e, c = len(self.stretches.level), self.unit.size
        has_colour = self.stretches.colour.shape[1] > 0
        return EvidenceParameters(
            len(self.unknown), self.root.shape[1], c * self.basis.shape[1], int(c == 2), e,
            int(has_colour),
        )  # fmt: skip

    def parted(self, x: Float[Any, " m"]) -> EvidenceParameters:
        """A row of parameters by kind."""
        ends = np.cumsum(self.sizes)
        return EvidenceParameters(
            *(x[end - n : end] for n, end in zip(self.sizes, ends, strict=True))
        )

    def setup(self, of: EvidenceParameters) -> Setup:
        """The rig of these parameters."""
        setup, changes = Setup(self.sensor), self.root @ of.facts
        for i, name in enumerate(self.facts):
            setup = setup.changed(name, self.fact_values[i], changes[i], self.keeps_area[i])
        for i, name in enumerate(self.unknown):
            setup = setup.changed(name, self.values[i], self.change(name, i, of.unknown[i]))
        return setup

    def change(self, name: str, i: int, by: Any) -> Any:
        """By how much an unknown fact is changed from what is stated, in its own unit."""
        if name.startswith("angle"):
            return by * (180 / np.pi)
        return self.values[i] * jnp.expm1(by)

    def gain(self, of: EvidenceParameters) -> Complex[Array, "e c k"]:
        """The response of the blocks' means, in units of the white noise of a cell."""
        setup = self.setup(of)
        stage = setup.sensor.output(self.scan.scaled(setup.speed))
        transfer = stage.transfer(self.k / setup.speed)
        if self.friction is not None:
            transfer = transfer[:, :1] + self.friction * transfer[:, 1:]
        return transfer * (self.averaging[None] / self.stretches.level[:, None])[:, None]

    def tilt(self, of: EvidenceParameters) -> Float[Array, "1 b"]:
        """What is added to the coefficients of log S with the depth, as waves decay by exp(-2kz):
        signals then change little with the depth, and searches take few steps."""
        deeper = jnp.zeros(())
        if DEPTH in self.unknown:
            deeper = jnp.expm1(of.unknown[self.unknown.index(DEPTH)])
        return (deeper * self.decay)[None]

    def coefficients(self, of: EvidenceParameters) -> Float[Array, "c b"]:
        """The coefficients of log S."""
        return of.spectra.reshape(self.unit.size, -1) + self.tilt(of)

    def spectra(self, of: EvidenceParameters) -> Float[Array, "c c k"]:
        """The spectra of p and q and their cross spectrum."""
        logs = self.coefficients(of) @ self.basis.T
        roots = jnp.exp(logs / 2) * jnp.sqrt(self.unit)[:, None]
        coherence = jnp.eye(self.unit.size)
        if self.unit.size == 2:
            coherence = coherence + jnp.tanh(of.coherence) * (1 - coherence)
        return roots[:, None] * roots[None] * coherence[..., None]

    def signal_covariance(self, of: EvidenceParameters) -> Float[Array, "e e l"]:
        """The covariance of the traction's signals in blocks, over a circle of twice as many lags
        as a stretch has."""
        gain = self.gain(of)
        power = jnp.einsum("eck,cdk,fdk->efk", gain, self.spectra(of), gain.conj())
        size = 2 * (self.k.size - 1)
        return jnp.fft.irfft(power, size)[..., :: self.stride] / self.step_m

    def covariance(
        self, of: EvidenceParameters
    ) -> tuple[Float[Array, "e m f m"], Float[Array, "e m m"]]:
        """The covariances of the signals of a stretch, and of the noise of each element, its scale
        aside."""
        signal = self.signal_covariance(of)
        m = signal.shape[-1] // 2
        lags = (np.arange(m)[:, None] - np.arange(m)) % (2 * m)
        return jnp.swapaxes(signal[..., lags], 1, 2), self._noise(of, lags)

    def _noise(self, of: EvidenceParameters, lags: np.ndarray) -> Float[Array, "e m m"]:
        """The covariance of the noise of each element in blocks."""
        own = jnp.eye(len(lags))[None] / self.block_cells
        own = jnp.broadcast_to(own, (len(of.white), *lags.shape))
        if of.colour.size:
            own = own + jnp.exp(2 * of.colour) * self.stretches.colour[:, lags]
        return jnp.exp(2 * of.white)[:, None, None] * own

    def of_stretch(self, of: EvidenceParameters, one: Any) -> Float[Array, "em em"]:
        """The covariance of one stretch: of variance one, alone, where a block is missing."""
        signal, noise = self.covariance(of)
        _, observed, scale, columns = one
        e, m = observed.shape
        own = noise * (scale[:, :, None] * scale[:, None, :])
        own = own + jnp.einsum("ejm,ejn->emn", columns, columns)
        whole = signal + jnp.eye(e)[:, None, :, None] * own[:, :, None]
        there = observed.reshape(-1)
        whole = whole.reshape(e * m, e * m) * (there[:, None] * there[None])
        return whole + jnp.diag(1 - there)

    @property
    def _each(self) -> tuple[Any, ...]:
        return self.stretches[:4]

    def __call__(self, x: Float[Numbers, " m"]) -> Float[Array, ""]:
        """The value, a constant aside."""
        of = self.parted(x)

        def value(one: Any) -> Float[Array, ""]:
            factor = jnp.linalg.cholesky(self.of_stretch(of, one))
            white = jax.scipy.linalg.solve_triangular(factor, one[0].reshape(-1), lower=True)
            return jnp.sum(jnp.log(jnp.diag(factor))) + white @ white / 2

        return jnp.sum(jax.lax.map(value, self._each)) + jnp.sum(self.priors(of) ** 2) / 2

    def priors(self, of: EvidenceParameters) -> Float[Array, " r"]:
        """What is known beforehand, as numbers of variance one."""
        each = self.coefficients(of)
        return jnp.concatenate([
            of.facts,
            jnp.ravel(jnp.diff(each, 2, axis=1)) / BEND,
            jnp.ravel(each) / (LEVEL * np.sqrt(each.shape[1])),
            of.coherence / COHERENCE,
            of.white / WHITE,
            of.colour / COLOUR,
        ])  # fmt: skip

    def information(self, x: Float[Numbers, " m"]) -> Float[Array, "m m"]:
        """Fisher's information of the signals and the priors."""

        def of_signals(one: Any) -> Float[Array, "m m"]:
            def whole(x):
                return self.of_stretch(self.parted(x), one)

            factor = jnp.linalg.cholesky(whole(x))
            inverse = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(len(factor)))
            changes = jax.lax.map(
                lambda t: jax.jvp(whole, (x,), (t,))[1] @ inverse, jnp.eye(x.size)
            )
            across = jnp.swapaxes(changes, 1, 2).reshape(x.size, -1)
            return changes.reshape(x.size, -1) @ across.T / 2

        total = jnp.sum(jax.lax.map(of_signals, self._each), axis=0)
        slopes = jax.jacfwd(lambda x: self.priors(self.parted(x)))(x)
        return total + slopes.T @ slopes

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """The range of the parameters."""
        high = np.full(sum(self.sizes), np.inf)
        high[: len(self.unknown)] = [FARTHEST[name.split("_")[0]] for name in self.unknown]
        return -high, high

    def with_spectra(self, power: Float[np.ndarray, "c k"]) -> Float[np.ndarray, " m"]:
        """The parameters of the rig as stated and of these spectra [Pa^2 m] at `k`."""
        x, logs = self.start(), np.log(power / np.asarray(self.unit)[:, None])
        rows = np.linalg.lstsq(np.asarray(self.basis), logs.T)[0].T
        return np.concatenate(self.parted(x)._replace(spectra=rows.ravel()))

    def start(self) -> Float[np.ndarray, " m"]:
        """The rig as stated, under flat spectra at the level of the data."""
        return np.zeros(sum(self.sizes))


@compiled
def gain_of(model: StationaryEvidence, x: Float[Numbers, " m"]) -> Complex[Array, "e c k"]:
    return model.gain(model.parted(x))


def _basis(k: Float[np.ndarray, " k"], length_m: float, depth_m: float) -> np.ndarray:
    """Cubic B-splines in log k, constant beyond the first and the last knot."""
    first, last = np.log2([np.pi / length_m, DEEPEST_WAVE / depth_m])
    count = max(int(np.ceil((last - first) / KNOTS)), 4)
    step = (last - first) / count
    knots = first + step * np.arange(-3, count + 4)
    at = np.clip(np.log2(np.maximum(k, k[1])), first, last - 1e-9)
    return scipy.interpolate.BSpline.design_matrix(at, knots, 3).toarray()


def _unit(model: StationaryEvidence) -> Float[np.ndarray, " c"]:
    """The level of a flat spectrum of each component that alone makes the data's power."""
    data = np.asarray(model.stretches.data)
    power = float(np.sum(data**2) / np.sum(model.stretches.observed))
    gain = np.asarray(gain_of(model, model.start()))
    own = np.sum(np.abs(gain) ** 2, axis=-1).mean(axis=0) / (model.k.size * float(model.step_m))
    return power / np.maximum(own, np.finfo(float).tiny)
