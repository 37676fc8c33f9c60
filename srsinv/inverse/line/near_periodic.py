"""The nearest periodic problem, with the samples that are missing taken as missing.

Without gaps its posterior covariance is C^-1, C = G^H N^-1 G + P at each wavenumber. Of the
complete signal d, Q d with Q = (N + G P^-1 G^H)^-1 is what the model does not expect. Samples that
are missing are what makes Q d vanish there, and the traction's covariance grows by
(C^-1 G^H N^-1)_m Q_mm^-1 (N^-1 G C^-1)_m. Q_mm, over the missing samples m alone, is near its
blocks of neighbours: conjugate gradients solve it in a few steps.

It is all in numpy and in double precision: a recording is solved once, and compiling takes longer.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float

from ...grid import as_real, half_spectrum_weights
from .gaps import MOST_STEPS, BlockInverse, Gaps, Map, conjugate_gradients, missing_shapes
from .prior import Prior, Score
from .problem import LineProblem
from .spectral import factorise, noise_whitener, orthogonalised, prior_root, white_model
from .transforms import adjoint, from_spectrum, times, to_spectrum

INNER_TOLERANCE = 1e-10
WIDTH = 2.5  # rms lags of the kernel
SCORE_TOLERANCE = 1e-4

Matrices = Complex[np.ndarray, "row column k"]


class PeriodicModel:
    """The nearest periodic problem as it is whatever the prior, its gaps as they are.

    - `white` (#e, k): N^-1/2; `model` (e, c, k): N^-1/2 G, and the same `orthogonal`; `data`
      (e, k): the signals' spectrum.
    """

    def __init__(self, problem: LineProblem, gaps: Gaps):
        self.line, self.gaps = problem.line, gaps
        self.white, self.model = noise_whitener(problem), white_model(problem)
        self.orthogonal = orthogonalised(self.model, np.asarray(problem.zero_mean))
        self._signals = problem.data

    @cached_property
    def data(self) -> Complex[np.ndarray, "e k"]:
        return to_spectrum(np.asarray(self._signals, float))


class NearPeriodic:
    """The nearest periodic problem under a prior.

    - `covariance` (c, c, k): C^-1, zero where neither data nor prior determine a mode;
      `expected` (e, c, k): N^-1 G C^-1; `unexpected` (e, e, k): Q, and `smooth` the same with its
      mean as that of long waves, for a mean is of all samples, and joins all that are missing.
    """

    def __init__(self, periodic: PeriodicModel, prior: Prior):
        self.gaps, self.n = periodic.gaps, periodic.line.n
        self.white, self.model = periodic.white, periodic.model
        self.root = np.asarray(prior_root(periodic.line, prior), float)
        top, inverse = factorise(periodic.orthogonal, self.root)
        each = self.white[:, None]
        self.inverse, self.top = inverse, top
        self.covariance = np.einsum("ijk,ljk->ilk", inverse, inverse.conj())
        self.expected = each * np.einsum("ecj,icj->eij", top, inverse.conj())
        within = np.einsum("ecj,fcj->efj", top, top.conj())
        self.unexpected = each * self.white * (np.eye(len(top))[..., None] - within)
        self.smooth = self.unexpected.copy()
        self.smooth[..., 0] = self.unexpected[..., 1].real
        self.step = np.real(self.unexpected[..., 0] - self.smooth[..., 0]) / self.n

    @cached_property
    def width_cells(self) -> float:
        """Over how many cells the model's response decays."""
        lag = np.minimum(np.arange(self.n), self.n - np.arange(self.n))
        power = np.sum(self.lags(self.model) ** 2, axis=(0, 1))
        return max(1.0, WIDTH * float(np.sqrt(lag**2 @ power / power.sum())))

    @property
    def half_wave_cells(self) -> float:
        """Half the shortest wave that is resolved, at most the response's width."""
        resolved = half_spectrum_weights(self.n) @ np.sum(np.abs(self.top) ** 2, axis=(0, 1))
        return float(min(max(1.0, self.top.shape[1] / resolved), self.width_cells))

    def lags(self, matrices: Matrices) -> Float[np.ndarray, "row column n"]:
        """The circular kernel of matrices at each wavenumber."""
        return from_spectrum(matrices, self.n)

    def blocks(self) -> BlockInverse:
        """The inverses of Q's blocks of missing samples."""
        return self.gaps.inverses(self.lags(self.smooth))

    def over_gaps_inverse(self) -> Map:
        """The inverse of Q over the missing samples: whole where these are few, else by conjugate
        gradients from its blocks' and what couples them."""
        whole = self.gaps.whole_inverse(self.lags(self.unexpected))
        if whole is not None:
            return whole
        blocks, like = self.blocks(), np.zeros(self.gaps.cell.size)
        shapes = missing_shapes(self.over_gaps, blocks, np.copy, like)
        return lambda values: self.filled(
            values, lambda each: blocks(each) + shapes.times(each), INNER_TOLERANCE
        )

    def over_gaps(self, values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Q over the missing samples, times values at these."""
        signal = to_spectrum(self.gaps.placed(values))
        return self.gaps.picked(from_spectrum(times(self.unexpected, signal), self.n))

    def filled(
        self, right: Float[np.ndarray, " m"], filler: Map, tolerance: float
    ) -> Float[np.ndarray, " m"]:
        """Q_mm^-1 times values at the missing samples, `filler` nearly that inverse."""
        return conjugate_gradients(self.over_gaps, filler, right, tolerance, MOST_STEPS).value

    def covariance_times(
        self, r: Float[np.ndarray, "c n"], over_gaps_inverse: Map
    ) -> Float[np.ndarray, "c n"]:
        """The posterior covariance times r."""
        spectrum = to_spectrum(r)
        out = times(self.covariance, spectrum)
        if self.gaps.cell.size:
            signal = self.gaps.picked(from_spectrum(times(self.expected, spectrum), self.n))
            filling = to_spectrum(self.gaps.placed(over_gaps_inverse(signal)))
            out = out + times(adjoint(self.expected), filling)
        return from_spectrum(out, self.n)

    def resolved_dof(self, blocks: BlockInverse) -> Float[np.ndarray, " c"]:
        """Effective degrees of freedom of each component: the trace of its resolution."""
        return np.array([self._resolved(blocks, [c]) for c in range(len(self.inverse))])

    def freedom(self, blocks: BlockInverse) -> float:
        """The degrees of freedom of all components."""
        return self._resolved(blocks, range(len(self.inverse)))

    def _resolved(self, blocks: BlockInverse, components: Sequence[int]) -> float:
        """The missing samples take from these components the trace of
        Q_mm^-1 (Q G)_c (N^-1 G C^-1)_c^H."""
        # N^-1/2 G C^-1
        filters = np.einsum("eck,ick->eik", self.top, self.inverse[components].conj())
        model = self.model[:, components]
        weights = half_spectrum_weights(self.n)
        whole = self.n * np.einsum("eik,eik,k->", filters.conj(), model, weights).real
        if not self.gaps.cell.size:
            return whole
        left = model - np.einsum("eck,fck,fik->eik", self.top, self.top.conj(), model)
        taken = np.einsum("eik,fik->efk", left, filters.conj())
        return whole - self._trace(blocks, self.white[:, None] * self.white * taken)

    def _trace(self, blocks: BlockInverse, matrices: Matrices) -> float:
        """The trace of Q_mm^-1 times a convolution, over the blocks."""
        matrices = (matrices + adjoint(matrices)) / 2  # the rest has no trace
        each = self.gaps.block_matrices(self.lags(matrices))
        total = sum(of.trace_with(m) for of, m in zip(blocks.inverses, each, strict=True))
        sums = self.row_sums(blocks)
        each = [to_spectrum(s) for s in sums.swapaxes(0, 1)]
        weights = half_spectrum_weights(self.n)
        of_mean = [
            [np.sum(weights * np.real(g.conj() * times(matrices, f))) for g in each] for f in each
        ]
        return total - float(np.sum(self.of_mean(sums) * np.array(of_mean)))

    def row_sums(self, blocks: BlockInverse) -> Float[np.ndarray, "e f n"]:
        """The inverse over the blocks, summed over the missing samples of each element f: at the
        missing samples of e, on their cells."""
        elements = range(len(self.model))
        ones = [blocks.solved((self.gaps.element == f).astype(float)) for f in elements]
        return np.stack([self.gaps.placed(row) for row in ones], axis=1)

    def log_determinant(self, blocks: BlockInverse) -> float:
        """The logarithm of the determinant of Q_mm^-1."""
        of_mean = np.eye(len(self.step)) + self.step @ self.row_sums(blocks).sum(axis=-1)
        return blocks.log_determinant() - float(np.linalg.slogdet(of_mean)[1])

    def of_mean(self, row_sums: Float[np.ndarray, "e f n"]) -> Float[np.ndarray, "f g"]:
        """F in T - V F V^T, the inverse of Q over the missing samples where T is that of `smooth`
        and V has its `row_sums`: the two differ by the same number for all samples."""
        return np.linalg.solve(
            np.eye(len(self.step)) + self.step @ row_sums.sum(axis=-1), self.step
        )


class PriorScore:
    """The prior's score over the samples that are there, an open line taken as periodic; each term
    is computed when a criterion asks for it.

    With d completed so that Q d vanishes where samples are missing, the residual is N Q d, and the
    data's square under the model is d^T Q d. The determinants are Q's and N^-1's over the blocks of
    missing samples; the latter is the same for all priors.
    """

    def __init__(self, periodic: PeriodicModel, prior: Prior):
        self._near, gaps = NearPeriodic(periodic, prior), periodic.gaps
        self._blocks, self._weights = self._near.blocks(), half_spectrum_weights(self._near.n)
        self._spectrum = periodic.data
        self._surprise = times(self._near.unexpected, self._spectrum)
        if gaps.cell.size:
            right = gaps.picked(from_spectrum(self._surprise, self._near.n))
            filling = self._near.filled(right, self._blocks.solved, SCORE_TOLERANCE)
            unexpected = times(self._near.unexpected, to_spectrum(gaps.placed(filling)))
            self._surprise = self._surprise - unexpected

    @property
    def whole(self) -> Score:
        """All terms."""
        return Score(*(as_real(getattr(self, name)) for name in Score._fields))

    @property
    def residual(self) -> float:
        level = np.where(self._near.white > 0, self._near.white, np.inf)
        return float(np.sum(self._weights * np.abs(self._surprise / level) ** 2))

    @property
    def freedom(self) -> float:
        return self._near.freedom(self._blocks)

    @property
    def log_evidence(self) -> float:
        near, weights = self._near, self._weights
        square = float(np.sum(weights * np.real(self._surprise.conj() * self._spectrum)))
        diagonal = np.abs(np.einsum("cck->ck", near.inverse)) * near.root
        ratio = np.sum(np.log(np.where(diagonal > 0, diagonal, 1.0)), axis=0)
        determinant = near.log_determinant(self._blocks)
        return near.n * float(weights @ ratio) - square / 2 + determinant / 2

    @cached_property
    def _pulling(self) -> Complex[np.ndarray, "c k"]:
        """P r = G^H N^-1/2 of the whitened residual."""
        return times(adjoint(self._near.model), self._whitened)

    @property
    def _whitened(self) -> Complex[np.ndarray, "e k"]:
        white = self._near.white
        return np.where(white > 0, self._surprise / np.where(white > 0, white, 1.0), 0.0)

    @cached_property
    def _slope(self) -> Complex[np.ndarray, "c k"]:
        """C P r."""
        near = self._near
        pulling = from_spectrum(self._pulling, near.n)
        return to_spectrum(near.covariance_times(pulling, near.over_gaps_inverse()))

    @property
    def seminorm(self) -> float:
        root = self._near.root
        over = np.where(root > 0, self._pulling / np.where(root > 0, root, 1.0), 0.0)
        return float(np.sum(self._weights * np.abs(over) ** 2))

    @property
    def pull(self) -> float:
        return float(np.sum(self._weights * np.real(self._pulling.conj() * self._slope)))

    @property
    def movement(self) -> float:
        return float(np.sum((self._weights * np.abs(self._slope) ** 2)[:, 1:]))

    @property
    def periodogram(self) -> Float[np.ndarray, " k"]:
        return np.sum(np.abs(self._whitened) ** 2, axis=0)
