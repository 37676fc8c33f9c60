"""The forward model and both inversions by numpy and scipy alone: what ours are timed against."""

import numpy as np
import scipy.sparse.linalg as sla

from ..inverse.prior import Prior
from ..inverse.problem import Problem
from ..inverse.tikhonov import DerivativePenalty


def numpy_apply(transfer: np.ndarray, r: np.ndarray, n: int, length: int) -> np.ndarray:
    """Signals (e, n) [V] of traction (c, n) [Pa] padded to `length`; transfer (e, c, k) [V/Pa]."""
    spectrum = np.fft.rfft(r, length)
    total = sum(transfer[:, c] * spectrum[c] for c in range(len(spectrum)))
    return np.fft.irfft(total, length)[:, :n]


class NumpyNormal:
    """The normal equations (G^T N^-1 G + P) r = G^T N^-1 m, by numpy and scipy alone."""

    def __init__(self, problem: Problem, prior: Prior):
        self.n, self.length = problem.line.n, problem.forward.length
        self.transfer = np.asarray(problem.forward.transfer)
        self.circulant = np.asarray(problem.forward.circulant().transfer)
        self.data, self.weight = np.asarray(problem.data), np.asarray(problem.whitener) ** 2
        self.root2 = np.asarray(prior.root(problem.line)) ** 2
        self.centred = np.asarray(problem.centred)
        self.order, self.scale = 0, None
        if isinstance(prior, DerivativePenalty) and not problem.forward.is_circular:
            self.order = prior.order
            stretch = float(prior.length_m / problem.line.cell_m) ** (2 * prior.order)
            self.scale = stretch * np.asarray(prior.weights)[:, None]

    def _matrices(self) -> np.ndarray:
        """G^H N^-1 G + P at every wavenumber of the nearest periodic problem (k, c, c)."""
        g = np.moveaxis(self.circulant, -1, 0)
        matrix = g.conj().swapaxes(1, 2) @ (self.weight[:, None, None] * g)
        matrix += self.root2.T[:, :, None] * np.eye(self.root2.shape[0])
        # Where nothing tells the mean its row is empty: any diagonal makes it solvable.
        empty = np.abs(np.diagonal(matrix[0])) == 0
        matrix[0] += np.diag(np.where(empty | self.centred, np.abs(matrix[1]).max(), 0.0))
        return matrix

    def _centre(self, r: np.ndarray) -> np.ndarray:
        return r - np.where(self.centred[:, None], r.mean(axis=-1, keepdims=True), 0.0)

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
