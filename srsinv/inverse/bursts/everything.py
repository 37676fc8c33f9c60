"""The covariance of everything but the bursts sought: traction, noise and the rig's errors.

With the traction integrated out, everything else is Gaussian. On a periodic line with every sample
it has the covariance C(k) = G S G^H + N between elements at each wavenumber. N has the noise of the
elements and the bursts that are too small to be found one by one.

An open line is taken as periodic over its window, whose margins are missing samples, as the
evidence for a prior has it (line/near_periodic.py). With Q = C^-1 and m the missing samples, the
inverse over the others is Q - Q_m^T Q_mm^-1 Q_m. Columns U of unknown sizes, normal of variance
one, take a further part by Woodbury's identity. Both parts are low-rank: together V^T V.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float

from ...errors import refuse
from ...grid import half_spectrum_weights
from ..line.gaps import ROUNDED, Gaps
from ..line.prior import Prior
from ..line.problem import LineProblem
from ..line.spectral import prior_root

DIGITS = 1e8  # of the traction's power over the noise, at most, so that C can be inverted
MOST_NUMBERS = 5e7  # in V, 0.4 GB: twice as many are kept at once
FORGOTTEN = 1e-8  # of a burst's largest sample: what is smaller is left out of V b


class Columns(NamedTuple):
    """What is on the samples in the order of time, beside stationary signals: which are `observed`
    (e, n), and columns (j, e, n) of unknown sizes, which are normal of variance one."""

    observed: Bool[np.ndarray, "e n"]
    signals: Float[np.ndarray, "j e n"]

    @property
    def are_none(self) -> bool:
        """Whether all samples are there, and nothing else is on them."""
        return not len(self.signals) and bool(self.observed.all())

    def check(self) -> None:
        """Refuse so many missing samples that no memory holds V."""
        rows = int(np.sum(~self.observed)) + len(self.signals)
        refuse(
            rows * self.observed.size > MOST_NUMBERS,
            f"BurstInversion would need {rows * self.observed.size:.3g} numbers for "
            f"{rows} missing samples, more than {MOST_NUMBERS:.3g}. Give a wider "
            "recording.cell_m, a narrower recording.contact_window_m, or a shorter pass.",
        )


class LowRank:
    """What missing samples and columns take from a stationary precision Q, V^T V.

    `inverse` (k, e, e): Q.
    """

    def __init__(self, inverse: Complex[np.ndarray, "k e e"], columns: Columns):
        self._inverse, self.n = inverse, columns.observed.shape[1]
        self._gaps, every = Gaps.of(columns.observed), slice(None)
        self._lags = np.fft.irfft(np.moveaxis(inverse, 0, -1), self.n)
        self._root = _cholesky(self._gaps.matrix(self._lags, every, every))
        self._columns = np.where(columns.observed, columns.signals, 0.0)
        self._weighed = np.zeros_like(self._columns)
        size = len(self._columns)
        if size:
            spectra = np.einsum("kef,jfk->jek", inverse, np.fft.rfft(self._columns))
            weighed = self._less_gaps(spectra)
            self._weighed = np.where(columns.observed, np.fft.irfft(weighed, self.n), 0.0)
        among = np.einsum("ien,jen->ij", self._columns, self._weighed)
        self._among = _cholesky(np.eye(size) + (among + among.T) / 2)

    @property
    def log_det(self) -> float:
        """Half of the log determinant that it adds to that of C."""
        return sum(float(np.sum(np.log(np.diag(each)))) for each in (self._root, self._among))

    def less(self, spectra: Complex[np.ndarray, "row e k"]) -> Complex[np.ndarray, "row e k"]:
        """The whole precision times signals, from Q times them, `spectra`."""
        spectra = self._less_gaps(spectra)
        if not len(self._columns):
            return spectra
        products = np.einsum("jen,ren->jr", self._columns, np.fft.irfft(spectra, self.n))
        sizes = scipy.linalg.cho_solve((self._among, True), products)
        return spectra - np.einsum("jr,jek->rek", sizes, np.fft.rfft(self._weighed))

    def _less_gaps(self, spectra: Complex[np.ndarray, "row e k"]) -> Complex[np.ndarray, "..."]:
        gaps = self._gaps
        if not gaps.cell.size:
            return spectra
        cells = np.fft.irfft(spectra, self.n)
        filling = scipy.linalg.cho_solve((self._root, True), cells[:, gaps.element, gaps.cell].T)
        placed = np.zeros_like(cells)
        placed[:, gaps.element, gaps.cell] = filling.T
        return spectra - np.einsum("kef,rfk->rek", self._inverse, np.fft.rfft(placed))

    @cached_property
    def _rows(self) -> Float[np.ndarray, "r e n"]:
        """V."""
        gaps, elements = self._gaps, np.arange(len(self._lags))
        lag = (gaps.cell[:, None] - np.arange(self.n)) % self.n
        right = self._lags[gaps.element[:, None, None], elements[None, :, None], lag[:, None]]
        own = [(self._root, right), (self._among, self._weighed)]
        shape = len(elements), self.n
        return np.concatenate([
            scipy.linalg.solve_triangular(root, each.reshape(len(root), -1), lower=True)
            for root, each in own if len(root)
        ]).reshape(-1, *shape)  # fmt: skip

    def squares(
        self, waves: Complex[np.ndarray, "decay k"], samples: np.ndarray, responses: np.ndarray
    ) -> Float[np.ndarray, "m decay place"]:
        """|V b|^2 of bursts of unit amplitude that begin in these successive samples."""
        shapes = np.fft.irfft(waves, self.n)
        size = np.max(np.abs(shapes), axis=0)
        last = int(np.flatnonzero(size > FORGOTTEN * size.max())[-1]) + 1
        width = min(self.n, last + len(samples) - 1)
        at = (samples[0] + np.arange(width)) % self.n
        begun = np.zeros((len(samples), len(shapes), width))
        for j in range(len(samples)):
            begun[j, :, j:] = shapes[:, : width - j]
        rows = self._rows[..., at]
        each = np.tensordot(begun, rows, axes=([2], [2]))  # (m, decay, r, e)
        among = np.einsum("mtre,mtrf->mtef", each, each, optimize=True)
        return np.einsum("ey,mtef,fy->mty", responses, among, responses, optimize=True)

    def every_square(
        self, wave: Complex[np.ndarray, " k"], responses: Float[np.ndarray, "e place"]
    ) -> Float[np.ndarray, "place n"]:
        """|V b|^2 of bursts of one decay that begin in any sample."""
        elements = len(self._lags)
        among = np.zeros((elements, elements, self.n))
        for some in np.array_split(self._rows, max(1, self._rows.size // 1_000_000)):
            each = np.fft.irfft(np.fft.rfft(some) * wave.conj(), self.n)
            among += np.einsum("ren,rfn->efn", each, each, optimize=True)
        return np.einsum("ey,efn,fy->yn", responses, among, responses, optimize=True)


def _cholesky(matrix: Float[np.ndarray, "b b"]) -> Float[np.ndarray, "b b"]:
    """Cholesky's factor, its diagonal raised by rounding."""
    if not len(matrix):
        return np.zeros((0, 0))
    matrix = matrix.copy()
    matrix.flat[:: len(matrix) + 1] *= 1 + ROUNDED * max(len(matrix), 128)
    return np.linalg.cholesky(matrix)


class Everything(NamedTuple):
    """The covariance of everything but the bursts sought: `inverse` C^-1 (k, e, e) in the order of
    time, 0 where the signals' mean is not known, and log det C, `log_det`; n samples. `power`
    (c, k): of the traction. `taken`: what missing samples and columns change, None of none."""

    inverse: Complex[np.ndarray, "k e e"]
    log_det: float
    n: int
    power: Float[np.ndarray, "c k"]
    taken: LowRank | None = None

    @classmethod
    def of(
        cls, problem: LineProblem, prior: Prior, noise: Float[np.ndarray, "k e e"], factor: float
    ) -> "Everything":
        """Of the traction's prior, with its power times `factor`, and of the noise's matrix, with
        all samples there."""
        transfer = np.moveaxis(np.asarray(problem.forward.circulant().transfer), -1, 0)
        root = np.asarray(prior_root(problem.line, prior), float)
        own = np.einsum("kee->k", noise).real / noise.shape[-1]
        gain = np.max(np.abs(transfer) ** 2, axis=(0, 1))
        most = DIGITS * own[1:].min() / np.where(gain > 0, gain, 1.0)
        with np.errstate(divide="ignore"):
            power = np.minimum(factor / root**2, most[:, None])
        power[np.asarray(problem.zero_mean), 0] = 0.0
        total = np.einsum("kec,ck,kfc->kef", transfer, power, transfer.conj()) + noise
        if problem.has_free_offset:
            total[0] = np.eye(len(total[0]))
        if float(problem.scan.direction) < 0:  # pyright: ignore[reportOptionalMemberAccess]
            total = total.conj()
        inverse = np.linalg.inv(total)
        logs = np.linalg.slogdet(total)[1]
        weights = problem.line.n * half_spectrum_weights(problem.line.n)
        if problem.has_free_offset:
            inverse[0], logs[0] = 0.0, 0.0
        return cls(inverse, float(weights @ logs) / 2, problem.line.n, power)

    def over(self, columns: Columns) -> "Everything":
        """The same over the samples that are there, beside columns of unknown sizes."""
        if columns.are_none:
            return self
        taken = LowRank(self.inverse, columns)
        return self._replace(log_det=self.log_det + taken.log_det, taken=taken)

    def weigh(self, spectrum: Complex[np.ndarray, "*row e k"]) -> Complex[np.ndarray, "*row e k"]:
        """C^-1 times spectra."""
        whole = np.einsum("kef,...fk->...ek", self.inverse, spectrum)
        if self.taken is None:
            return whole
        return self.taken.less(whole.reshape(-1, *whole.shape[-2:])).reshape(whole.shape)

    def dot(self, one: np.ndarray, other: np.ndarray) -> Any:
        """The inner products over all samples, (row, row) of spectra (row, e, k)."""
        scaled = one.conj() * half_spectrum_weights(self.n)
        return np.einsum("aek,bek->ab", scaled, other).real

    def squares(
        self, waves: Complex[np.ndarray, "decay k"], responses: Float[np.ndarray, "e place"]
    ) -> Float[np.ndarray, "decay place"]:
        """Q, the inner products with themselves of the signals of bursts of unit amplitude, far
        from missing samples."""
        power = np.abs(waves) ** 2 * half_spectrum_weights(self.n)
        inner = np.einsum("tk,kef->tef", power, self.inverse, optimize=True).real
        return np.einsum("ey,tef,fy->ty", responses, inner, responses, optimize=True)

    def log_likelihood(self, data: Complex[np.ndarray, "e k"]) -> float:
        """Log density of signals of this spectrum, but for a constant."""
        square = self.dot(data[None], self.weigh(data)[None])[0, 0]
        return -0.5 * float(square) - self.log_det
