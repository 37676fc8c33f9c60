"""The data over a known input and the signals that kernels make of it, weighted by the noise.

The prior's means of kernels are here, too: the stated far field, or a theory, each with parameters
that enter linearly.
"""

import dataclasses
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...forward.sensor import Sensor
from ...grid import as_real
from .design import KnownInput, Weights
from .evidence import KernelEnvelope, Products
from .lags import Lags
from .measured import kernels
from .physics import Physics

STEP = 1e-3  # of a parameter's standard deviation, for differences


class Mean(NamedTuple):
    """The prior's mean of the kernels (e, 2, m), its factor `far` (e, 2) on the stated kernels far
    away, its signals (row, n), and the derivatives of all by the parameters t."""

    kernel: Float[np.ndarray, "e 2 m"]
    far: Float[np.ndarray, "e 2"]
    signal: Float[np.ndarray, "row n"]
    kernel_slope: Float[np.ndarray, "c e 2 m"]
    far_slope: Float[np.ndarray, "c e 2"]
    signal_slope: Float[np.ndarray, "c row n"]

    def of(self, parameters: slice) -> "Mean":
        """The same with these of its parameters."""
        return Mean(*self[:3], *(each[parameters] for each in self[3:]))

    def scaled(self, factors: Float[np.ndarray, " c"]) -> "Mean":
        """The same with parameters in units of these factors."""
        return Mean(*self[:3], *((each.T * factors).T for each in self[3:]))

    def joined_with(self, other: "Mean") -> "Mean":
        """The same with the parameters of another as well."""
        both = [np.concatenate([a, b]) for a, b in zip(self[3:], other[3:], strict=True)]
        return Mean(*self[:3], *both)


def far_field(signals: "KernelSignals") -> Mean:
    """What the stated kernels are beyond the lags, as the mean of a kernel that is not known
    within, and its derivatives by a factor on that of each."""
    count, outside = len(signals.stated.elements), 1 - signals.lags.near
    kernel = np.zeros((count, 2, count, 2, signals.lags.taper.size))
    far = np.zeros(kernel.shape[:-1])
    signal = np.zeros((count, 2, *signals.data.shape))
    ones = np.ones(count)
    for c in range(2):
        whole = signals.of_sensor(signals.stated, ones, only=c)
        within = signals.at_lags(signals.lags.near * signals.stated_kernel, only=c)
        for e in signals.elements:
            kernel[e, c, e, c] = outside * signals.stated_kernel[e, c]
            far[e, c, e, c] = 1.0
            rows = signals.known.rows_of(e)
            signal[e, c, rows] = (whole - within)[rows]
    slopes = [each.reshape(2 * count, *each.shape[2:]) for each in (kernel, far, signal)]
    return Mean(*(each.sum(axis=0) for each in slopes), *slopes)


def theory(signals: "KernelSignals", physics: Physics, values: Float[np.ndarray, " c"]) -> Mean:
    """The kernels of a sensor of these physical parameters, and their derivatives by each over its
    standard deviation."""
    step = STEP * physics.deviations

    def at(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sensor, gains = physics.sensor_of(v)
        own = gains[:, None, None] * signals.kernels_of(sensor)
        return own, signals.of_sensor(sensor, gains)

    kernel, signal = at(values)
    slopes = []
    for i, size in enumerate(step):
        ahead, behind = (at(values + sign * size * np.eye(step.size)[i]) for sign in (1, -1))
        slopes.append([(a - b) / (2 * STEP) for a, b in zip(ahead, behind, strict=True)])
    kernel_slope, signal_slope = (np.stack(each) for each in zip(*slopes, strict=True))
    far, far_slope = _factor(signals, kernel), _factor(signals, kernel_slope)
    return Mean(kernel, far, signal, kernel_slope, far_slope, signal_slope)


def _factor(
    signals: "KernelSignals", kernel: Float[np.ndarray, "*c e 2 m"]
) -> Float[np.ndarray, "*c e 2"]:
    """The factor that makes kernels of the stated ones where they are tapered."""
    weights = (1 - signals.lags.taper) * signals.stated_kernel
    size = np.sum(weights * signals.stated_kernel, axis=-1)
    return np.sum(weights * kernel, axis=-1) / np.where(size > 0, size, 1.0)


NYQUIST = 0.9  # of the cells': the shortest wave
AT_ONCE = 64  # lags whose signals are weighed together, as memory goes
Alike = tuple[tuple, bytes]


class KernelSignals:
    """The data over a known input and the signals of kernels of the sensor `stated`, at `lags` and
    by waves of the wavenumbers `k`."""

    def __init__(self, known: KnownInput, stated: Sensor, lags: Lags):
        self.known, self.stated, self.lags = known, stated, lags
        self.k = lags.wavenumbers(NYQUIST * np.pi / float(known.problem.line.cell_m))
        self._waves, self._weights = lags.waves(self.k), Weights(known.problem)
        self._observed = known.problem.is_observed
        data = np.asarray(known.problem.data + known.problem.mean_signal, float)
        self.data = np.where(self._observed, data, 0.0)
        self.stated_kernel = self.kernels_of(stated)
        self._products: dict[tuple[int, KernelEnvelope], np.ndarray] = {}

    @property
    def elements(self) -> range:
        """The numbers of the elements, from 0."""
        return range(len(self.stated.elements))

    @property
    def has_both_ways(self) -> bool:
        """Whether each element passed the input both ways."""
        return all(len(self.known.rows_of(e)) > 1 for e in self.elements)

    @property
    def sample_count(self) -> int:
        """How many of the samples are not taken by an offset."""
        problem = self.known.problem
        return problem.sample_count - problem.has_free_offset * len(self.data)

    @property
    def gain_errors(self) -> Float[np.ndarray, "j row"]:
        """What passes whose gains vary leave open of the gain of each row's mean, relative, in
        independent directions; none where passes agree, or each direction was passed once."""
        passes = self.known.problem.passes
        if passes is None or not passes.gains.covariance.any():
            return np.zeros((0, len(self.data)))
        of_means = passes.gains.of_means
        whole = np.zeros((len(of_means), of_means.shape[2], *of_means.shape[:2]))
        for direction, own in enumerate(of_means):
            whole[direction, :, direction] = own.T
        every = whole.reshape(-1, len(self.data))
        return every[np.any(every, axis=1)]

    def kernels_of(self, sensor: Sensor) -> Float[np.ndarray, "e 2 m"]:
        """The kernels of another sensor's films at the lags."""
        return kernels(sensor, sensor.elements, self.lags.x_m)

    def basis(self, envelope: KernelEnvelope) -> Float[np.ndarray, "2 b m"]:
        """The waves of the kernels of p and of q under an envelope."""
        return self.lags.envelope(*envelope)[:, None] * self._waves[None]

    def of_sensor(
        self, sensor: Sensor, gains: Float[np.ndarray, " e"], only: int | None = None
    ) -> Float[np.ndarray, "row n"]:
        """The exact signals of another sensor in the place of the stated one, or those of `only`
        one component of the traction."""
        films = []
        for row, film in enumerate(self.known.sensor.elements):
            own = sensor.elements[row % len(sensor.elements)]
            for effect in film.effects[self.known.stated[row] :]:
                own = own.with_effect(effect)
            films.append(own.backward() if film.is_backward else own)
        whole = dataclasses.replace(sensor, elements=tuple(films))
        operator = whole.operator(self.known.problem.line, self.known.scan)
        factors = np.array([[1.0], [self.known.effective_friction]])
        if only is not None:
            factors[1 - only] = 0.0
        rows = np.asarray(operator(as_real(factors * self.known.pressure_Pa)))
        return rows * gains[np.arange(len(films)) % gains.size, None]

    def at_lags(self, kernel: Float[np.ndarray, "e 2 m"], only: int) -> Float[np.ndarray, "row n"]:
        """The signals of kernels at the lags, under one component of the traction."""
        rows = []
        for row in range(len(self.data)):
            own = kernel[row % len(kernel), only : only + 1]
            factor = self.known.shear(row) if only else 1.0
            rows.append(factor * self.known.signals(self.lags, own, row)[0])
        return np.stack(rows)

    def less_mean(self, mean: Mean) -> list["ResidualProducts"]:
        """The data about a mean at the lags, of each element."""
        others = np.concatenate([(self.data - mean.signal)[None], mean.signal_slope])
        others = np.where(self._observed, others, 0.0)
        heavy = self._weights(others)
        return [self._less_mean_of(e, others, heavy) for e in self.elements]

    def _less_mean_of(
        self, element: int, others: np.ndarray, heavy: np.ndarray
    ) -> "ResidualProducts":
        rows = self.known.rows_of(element)
        at_lags, own = np.zeros((2, self.lags.x_m.size, len(others))), 0.0
        for row in rows:
            weighed = self._impulses[self._alike(row)].signals @ heavy[:, row].T
            at_lags += np.stack([weighed, self.known.shear(row) * weighed])
            own = own + others[:, row] @ heavy[:, row].T
        return ResidualProducts(self, element, at_lags, np.asarray(own))

    def products_of_waves(self, element: int, envelope: KernelEnvelope) -> Float[np.ndarray, "a a"]:
        """A R^-1 A^T of the signals A (a, .) of the waves of p and then of q of one element."""
        key = element, envelope
        if key not in self._products:
            rows, (p, q) = self.known.rows_of(element), self.basis(envelope)
            among = [self._impulses[self._alike(row)].products for row in rows]
            powers = np.array([self.known.shear(row) for row in rows]) ** np.arange(3)[:, None]
            pp, pq, qq = np.einsum("ir,rlm->ilm", powers, np.stack(among))
            across = p @ pq @ q.T
            self._products[key] = np.block([[p @ pp @ p.T, across], [across.T, q @ qq @ q.T]])
        return self._products[key]

    @cached_property
    def _impulses(self) -> dict[Alike, "Impulses"]:
        """Of the rows that differ in how they are recorded or in their noise."""
        first = {self._alike(row): row for row in reversed(range(len(self.data)))}
        return {key: self._impulses_of(row) for key, row in first.items()}

    def _impulses_of(self, row: int) -> "Impulses":
        signals = self.known.signals(self.lags, np.eye(self.lags.x_m.size), row)
        signals = np.where(self._observed[row], signals, 0.0)
        products = []
        for some in np.array_split(signals, -(-len(signals) // AT_ONCE)):
            whole = np.zeros((len(some), *self.data.shape))
            whole[:, row] = some
            products.append(self._weights(whole)[:, row] @ signals.T)
        products = np.concatenate(products)
        return Impulses(signals, (products + products.T) / 2)

    def _alike(self, row: int) -> Alike:
        """What the signals of a row and their weights are made of."""
        problem = self.known.problem
        noise = np.broadcast_to(np.asarray(problem.noise), (len(self.data), problem.line.k.size))
        parts = [noise[row], self._observed[row]]
        for each in (problem.noise_scale, problem.nuisance):
            parts += [] if each is None else [np.asarray(each)[row]]
        weights = b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
        return self.known.recorded_alike(row), weights


class Impulses(NamedTuple):
    """The signals of one row of kernels that are one at a lag and nothing elsewhere, and their
    products A R^-1 A^T."""

    signals: Float[np.ndarray, "m n"]
    products: Float[np.ndarray, "m m"]


class ResidualProducts(NamedTuple):
    """The data about a mean, and the signals of the mean's parameters, of one element: products
    with signals of kernels at the lags, (2, m, 1 + c), and with each other."""

    signals: KernelSignals
    element: int
    at_lags: Float[np.ndarray, "2 m i"]
    own: Float[np.ndarray, "i i"]

    def under(self, envelope: KernelEnvelope) -> Products:
        """What the evidence goes by, of kernels under an envelope."""
        own, both = self.own, self.signals.basis(envelope) @ self.at_lags
        both = both.reshape(-1, len(own))
        return Products(
            self.signals.products_of_waves(self.element, envelope),
            both[:, 0], both[:, 1:], own[1:, 1:], own[1:, 0], float(own[0, 0]),
        )  # fmt: skip
