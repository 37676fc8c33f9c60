"""Signals over a known input as data, and those of kernels, weighed by the noise."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...forward.sensor import Sensor
from ...grid import as_real
from .design import KnownInput, Weights
from .evidence import Envelope, Products
from .lags import Lags
from .means import Mean
from .measured import kernels

NYQUIST = 0.9  # of the cells': the shortest wave
Recorded = tuple[tuple, bytes]
Waves = tuple[np.ndarray, np.ndarray, np.ndarray]  # their signals, these weighed, and the products


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

    @property
    def elements(self) -> range:
        """The numbers of the elements, from 0."""
        return range(len(self.stated.elements))

    @property
    def has_both_ways(self) -> bool:
        """Whether each element passed the input both ways."""
        return all(len(self.known.rows_of(e)) > 1 for e in self.elements)

    def kernels_of(self, sensor: Sensor) -> Float[np.ndarray, "e 2 m"]:
        """The kernels of another sensor's films at the lags."""
        return kernels(sensor, sensor.elements, self.lags.x_m)

    def basis(self, envelope: Envelope) -> Float[np.ndarray, "2 b m"]:
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
        whole = Sensor(films, sensor.skin, sensor.amplifier, sensor.filters)
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

    def products(self, envelope: Envelope, mean: Mean) -> list[Products]:
        """What the evidence goes by, of each element, with kernels about a mean."""
        waves: dict[Recorded, Waves] = {}
        return [self._products_of(e, envelope, mean, waves) for e in self.elements]

    def _products_of(
        self, element: int, envelope: Envelope, mean: Mean, waves: dict[Recorded, Waves]
    ) -> Products:
        rows = self.known.rows_of(element)
        # Elements that are recorded alike have the same signals of the waves.
        key = self.known.recorded_alike(rows), self._noise_of(rows)
        if key not in waves:
            signals = self._signals_of_waves(rows, envelope)
            weighed = self._weights(signals)[:, rows].reshape(len(signals), -1)
            flat = signals[:, rows].reshape(len(signals), -1)
            products = flat @ weighed.T
            waves[key] = flat, weighed, (products + products.T) / 2
        flat, weighed, products = waves[key]
        others = np.concatenate([(self.data - mean.signal)[None], mean.signal_slope])
        others = np.where(self._observed, others, 0.0)
        rest = others[:, rows].reshape(len(others), -1)
        heavy = self._weights(others)[:, rows].reshape(len(others), -1)
        both, own = weighed @ rest.T, rest @ heavy.T
        return Products(
            products, both[:, 0], both[:, 1:], own[1:, 1:], own[1:, 0], float(own[0, 0])
        )

    def _noise_of(self, rows: Sequence[int]) -> bytes:
        """What the weights of these rows are made of."""
        problem = self.known.problem
        noise = np.broadcast_to(np.asarray(problem.noise), (len(self.data), problem.line.k.size))
        parts = [noise[rows], self._observed[rows]]
        for each in (problem.noise_scale, problem.nuisance):
            parts += [] if each is None else [np.asarray(each)[rows]]
        return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)

    def _signals_of_waves(
        self, rows: Sequence[int], envelope: Envelope
    ) -> Float[np.ndarray, "a row n"]:
        basis = self.basis(envelope)
        size = basis.shape[1]
        signals = np.zeros((2 * size, *self.data.shape))
        for row in rows:
            shear = self.known.shear(row)
            signals[:size, row] = self.known.signals(self.lags, basis[0], row)
            signals[size:, row] = shear * self.known.signals(self.lags, basis[1], row)
        return np.where(self._observed, signals, 0.0)
