"""Forward model, inversions, fit and contact by numpy, scipy and Tamaas alone, for comparison of
times.

The experiment accuracy_cost takes from here, by the names that rows of its table have, what to
time: `FORWARD`, `inversions`, `FITS` and `contacts`.
"""

import importlib.util
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy.optimize as so
import scipy.sparse.linalg as sla
from numpy.typing import ArrayLike

from srsinv.grid import Convolution
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.line.prior import Prior
from srsinv.inverse.line.problem import LineProblem

TAMAAS_STEPS = 3000

Work = Callable[[], np.ndarray]


def inversions(
    is_circular: bool, tolerances: Sequence[float]
) -> dict[str, Callable[[LineProblem, Prior], Work]]:
    """What finds the traction (c, n) [Pa] that minimises a problem's and a prior's squares."""

    def iterative(tolerance: float, problem: LineProblem, prior: Prior) -> Work:
        return partial(NumpyNormal(problem, prior).conjugate_gradients, tolerance)

    ways = {f"scipy cg, {tolerance:g}": partial(iterative, tolerance) for tolerance in tolerances}
    exact = {"numpy": lambda problem, prior: NumpyNormal(problem, prior).solve}
    return exact | ways if is_circular else ways


def numpy_forward(operator: Convolution, traction: ArrayLike) -> np.ndarray:
    """Signals (e, n) [V] of traction (c, n) [Pa]."""
    transfer, r = np.asarray(operator.transfer), np.asarray(traction)
    return numpy_apply(transfer, r, operator.n, operator.length)


def numpy_apply(transfer: np.ndarray, r: np.ndarray, n: int, length: int) -> np.ndarray:
    """Signals (e, n) [V] of traction (c, n) [Pa] padded to `length`; transfer (e, c, k) [V/Pa]."""
    spectrum = np.fft.rfft(r, length)
    total = sum(transfer[:, c] * spectrum[c] for c in range(len(spectrum)))
    return np.fft.irfft(total, length)[:, :n]


class NumpyNormal:
    """The normal equations (G^T N^-1 G + P) r = G^T N^-1 m, by numpy and scipy alone."""

    def __init__(self, problem: LineProblem, prior: Prior):
        self.n, self.length = problem.line.n, problem.forward.length
        self.transfer = np.asarray(problem.forward.transfer)
        self.circulant = np.asarray(problem.forward.circulant().transfer)
        self.data, self.weight = np.asarray(problem.data), np.asarray(problem.whitener) ** 2
        self.root2 = np.asarray(prior.root(problem.line)) ** 2
        self.zero_mean = np.asarray(problem.zero_mean)
        self.order, self.scale = 0, None
        differences = prior.differences(problem.line)
        if differences is not None and not problem.forward.is_circular:
            self.order, self.scale = differences[0], np.asarray(differences[1])[:, None]

    def _matrices(self) -> np.ndarray:
        """G^H N^-1 G + P at every wavenumber of the nearest periodic problem (k, c, c)."""
        g = np.moveaxis(self.circulant, -1, 0)
        matrix = g.conj().swapaxes(1, 2) @ (np.moveaxis(self.weight, -1, 0)[:, :, None] * g)
        matrix += self.root2.T[:, :, None] * np.eye(self.root2.shape[0])
        # Where the mean is unobservable its row is zero: any diagonal makes it solvable.
        empty = np.abs(np.diagonal(matrix[0])) == 0
        matrix[0] += np.diag(np.where(empty | self.zero_mean, np.abs(matrix[1]).max(), 0.0))
        return matrix

    def _centre(self, r: np.ndarray) -> np.ndarray:
        return r - np.where(self.zero_mean[:, None], r.mean(axis=-1, keepdims=True), 0.0)

    def _right_side(self, y: np.ndarray) -> np.ndarray:
        weighed = np.fft.irfft(self.weight * np.fft.rfft(y), self.n)
        transpose = self.transfer.conj().swapaxes(0, 1)
        return self._centre(numpy_apply(transpose, weighed, self.n, self.length))

    def _penalty(self, r: np.ndarray) -> np.ndarray:
        if self.scale is None:
            return np.fft.irfft(self.root2 * np.fft.rfft(r), self.n)
        padded = np.pad(np.diff(r, self.order), ((0, 0), (self.order, self.order)))
        return (-1) ** self.order * self.scale * np.diff(padded, self.order)

    def solve(self) -> np.ndarray:
        """Traction (c, n) [Pa] on a periodic line: one small system for each wavenumber."""
        spectrum = self.weight * np.fft.rfft(self.data)
        right = np.einsum("eck,ek->kc", self.transfer.conj(), spectrum)
        value = np.linalg.solve(self._matrices(), right[..., None])[..., 0].T
        return self._centre(np.fft.irfft(value, self.n))

    def conjugate_gradients(self, tolerance: float) -> np.ndarray:
        """Traction (c, n) [Pa] on any line, to a relative `tolerance` of the equations' residual.

        The nearest periodic problem is the preconditioner.
        """
        shape, size = (self.root2.shape[0], self.n), self.root2.shape[0] * self.n
        inverse = np.linalg.inv(self._matrices())

        def normal(flat: np.ndarray) -> np.ndarray:
            r = self._centre(flat.reshape(shape))
            signal = numpy_apply(self.transfer, r, self.n, self.length)
            return (self._right_side(signal) + self._centre(self._penalty(r))).ravel()

        def precondition(flat: np.ndarray) -> np.ndarray:
            spectrum = np.fft.rfft(flat.reshape(shape))
            step = np.einsum("kij,jk->ik", inverse, spectrum)
            return self._centre(np.fft.irfft(step, self.n)).ravel()

        value, _ = sla.cg(
            sla.LinearOperator((size, size), normal),
            self._right_side(self.data).ravel(),
            rtol=tolerance,
            M=sla.LinearOperator((size, size), precondition),
        )
        return value.reshape(shape)


class NumpyStrip:
    """The signal of a strip of pressure and shear along a scan, and scipy's fit of it.

    The cells and the spline that distributes an edge among them are as in srsinv; `transfer` (e, c,
    k) and the interpolation (`index`, `weights`, `gain`) are taken from it; parameters are position
    [m], width [m], pressure and shear [Pa].
    """

    def __init__(self, model: FeatureModel):
        field, interpolation = model.operator.field, model.operator.interpolation
        self.x, self.cell = np.asarray(model.line.x), float(model.line.cell_m)
        self.transfer, self.length = np.asarray(field.transfer), field.length
        self.index, self.weights = (
            np.asarray(interpolation.index),
            np.asarray(interpolation.weights),
        )
        self.gain = np.asarray(model.operator.gain)

    def _signal(self, cells: np.ndarray) -> np.ndarray:
        """Signals (e, c, sample) of each component alone with these fractions of the cells (n,)."""
        padded = np.pad(cells, 1, mode="edge")
        cells = cells - (padded[2:] - 2 * cells + padded[:-2]) / 6
        along = np.fft.irfft(self.transfer * np.fft.rfft(cells, self.length), self.length)
        return self.gain * np.sum(self.weights * along[..., self.index], axis=-1)

    def _edges(self, position: float, width: float) -> tuple[np.ndarray, np.ndarray]:
        """Distance, in cells, of each cell inside the left edge and inside the right one."""
        away, half = (self.x - position) / self.cell, width / 2 / self.cell
        return away + half, half - away

    def __call__(self, parameters: np.ndarray) -> np.ndarray:
        """The signal (e, sample)."""
        left, right = self._edges(*parameters[:2])
        return np.einsum("ecs,c->es", self._signal(_rise(left) + _rise(right) - 1), parameters[2:])

    def jacobian(self, parameters: np.ndarray) -> np.ndarray:
        """Its derivative (e, sample, parameter)."""
        left, right = self._edges(*parameters[:2])
        at_left, at_right = _bell(left) / self.cell, _bell(right) / self.cell
        unit = self._signal(_rise(left) + _rise(right) - 1)
        moves = (at_right - at_left, (at_left + at_right) / 2)
        bent = [np.einsum("ecs,c->es", self._signal(move), parameters[2:]) for move in moves]
        return np.stack([*bent, *np.moveaxis(unit, 1, 0)], axis=-1)

    def fit(
        self,
        y: np.ndarray,
        noise_rms: float,
        start: np.ndarray,
        bounds,
        tolerance: float,
        analytic: bool,
    ) -> tuple[np.ndarray, float, int]:
        """Parameters, half the sum of squares and evaluations of the model, by scipy from `start`;
        `bounds` as scipy's."""

        def slope(z: np.ndarray) -> np.ndarray:
            return self.jacobian(z).reshape(-1, 4) / noise_rms

        jacobian: Any = slope if analytic else "2-point"
        solution = so.least_squares(
            lambda z: ((self(z) - y) / noise_rms).ravel(),
            start,
            jac=jacobian,
            bounds=bounds,
            x_scale="jac",
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
        )
        return solution.x, float(solution.cost), int(solution.nfev)


def _bell(t: np.ndarray) -> np.ndarray:
    """The quadratic B-spline."""
    size = np.abs(t)
    return np.where(size < 0.5, 0.75 - size**2, np.maximum(1.5 - size, 0) ** 2 / 2)


def _rise(t: np.ndarray) -> np.ndarray:
    """Its integral, from 0 to 1."""
    t = np.clip(t, -1.5, 1.5)
    tail = (1.5 - np.abs(t)) ** 3 / 6
    return np.where(np.abs(t) < 0.5, 0.5 + 0.75 * t - t**3 / 3, np.where(t < 0, tail, 1 - tail))


def _strip_fit(model: FeatureModel, analytic: bool):
    return partial(NumpyStrip(model).fit, analytic=analytic)


FORWARD = {"numpy": numpy_forward}
# By scipy's slopes and by exact ones, see `NumpyStrip.fit`.
FITS = {
    "scipy, 2-point": partial(_strip_fit, analytic=False),
    "scipy, analytic": partial(_strip_fit, analytic=True),
}


def contacts(tolerances: Sequence[float]) -> dict[str, Callable[..., Work]]:
    """Pressure (n,) [Pa] of a height (n,) [m] on a window [m] under a mean pressure [Pa], of a half
    space of modulus E* [Pa], by Tamaas; none where that is not installed (extra `peers`)."""
    if importlib.util.find_spec("tamaas") is None:
        return {}
    return {f"tamaas, {each:g}": partial(_tamaas_contact, each) for each in tolerances}


def _tamaas_contact(
    tolerance: float, height: np.ndarray, length: float, nominal: float, modulus: float
) -> Work:
    """Polonsky and Keer's conjugate gradients, `tolerance` on the mean of |p gap|."""
    import tamaas  # pyright: ignore[reportMissingImports]

    tamaas.set_log_level(tamaas.LogLevel.error)
    basic = tamaas.model_type.basic_1d
    model = tamaas.ModelFactory.createModel(basic, [length], [height.size])
    model.E, model.nu = modulus, 0.0
    solver = tamaas.PolonskyKeerRey(model, np.array(height, float), tolerance)
    solver.max_iter, solver.dump_freq = TAMAAS_STEPS, TAMAAS_STEPS + 1

    def work() -> np.ndarray:
        model.traction[:] = 0
        if not solver.solve(nominal) <= tolerance:
            raise RuntimeError(f"Tamaas is not converged after {TAMAAS_STEPS} steps")
        return np.ravel(np.array(model.traction))

    return work
