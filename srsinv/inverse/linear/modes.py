"""Modes of a linear problem under a prior, in which every weight costs a few sums.

Over the modes z the whitened data are U c z + noise, and the prior's precision of weight w is
(w/unit) s^2. So the posterior has the mean c b / (c^2 + t s^2), with b = U^T data and t = w/unit,
and the variance 1 / (c^2 + t s^2). Where the prior is a root L, these are the modes of the
generalised singular value decomposition, by a QR factorisation of the stacked matrix [A; u L] and a
singular value decomposition of its upper part (Van Loan 1976; Hansen 1998, section 2.1.2). Nothing
is squared, so that singular values count down to rounding.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from ...errors import BadInput, refuse
from ...known import Numbers
from ..line.prior import Score
from ..line.scorer import DirectScores, Scorer, Scores, WeightScores
from .prior import Differences, PriorFactors

HIGHEST = 2.0  # decades of the box above the weight that halves the mode of most information
LOWEST = 2.0  # decades below the weight that halves the informative mode of least information
MOST_BELOW = 8.0  # decades that data may add to these: beyond, N - freedom is rounding
SCANNED = 193  # weights over the box of some 30 decades, in which criteria have several minima
UNDETERMINED = (
    "The data and the prior leave a combination of unknowns undetermined: give order=0 or a prior "
    "of all unknowns."
)
ROUNDING = 16.0  # times eps, below which a wave's share of the prior is zero


class Decomposition(NamedTuple):
    """A model (s, k) and a prior's root (j, k) in modes: model = left c right R, and
    root = ... `prior` right R, with `prior` the norms of its columns.

    - `left` (s, r), `model` (k,), `right` (k, k), `prior` (k,), `triangle` R (k, k); None: 1.
    - `unit`: the weight of the root under which the two were stacked.
    """

    left: Float[Numbers, "s r"]
    model: Float[Numbers, " k"]
    right: Float[Numbers, "k k"]
    prior: Float[Numbers, " k"]
    triangle: Float[Numbers, "k k"] | None
    unit: Float[Numbers, ""]


def decompose(model: Any, root: Any, rank: int, xp: Any = np) -> Decomposition:
    """The modes of a model under a prior's root of this `rank`, None for 1; by numpy or `xp`.

    Raises `BadInput` where the two together have fewer rows than there are unknowns.
    """
    samples, k = model.shape
    if root is None:
        left, values, right = _svd(model, xp)
        return Decomposition(left, values, right, xp.ones(k), None, xp.asarray(1.0))
    refuse(
        samples + root.shape[0] < k,
        f"The data and the prior have {samples + root.shape[0]} rows for {k} unknowns: give order=0"
        " or a prior of more rows.",
    )
    unit = xp.sum(model**2) / xp.sum(root**2)
    q, triangle = xp.linalg.qr(xp.concatenate([model, xp.sqrt(unit) * root]))
    left, values, right = _svd(q[:samples], xp)
    share = xp.sqrt(xp.sum((q[samples:] @ right.T) ** 2, axis=0))
    if rank < k:  # rounding leaves a part of what the root does not hold
        share = xp.where(share <= xp.sort(share)[k - rank - 1], 0.0, share)
    return Decomposition(left, values, right, share, triangle, unit)


def _svd(matrix: Any, xp: Any) -> tuple[Any, Any, Any]:
    """U (s, r), all k singular values, and V^T (k, k)."""
    samples, k = matrix.shape
    left, values, right = xp.linalg.svd(matrix, full_matrices=samples < k)
    return left, xp.pad(values, (0, k - len(values))), right


def box(found: Decomposition, data: Any, xp: Any = np) -> Float[Numbers, "2 1"]:
    """The range of the log10 weight: from above the mode of most information to below that of
    least, among those above rounding; `data`: whitened.

    A mode of the data b is expected under a prior of the weight (c / s b)^2, which may be far below
    what halves it.
    """
    model, prior = found.model, found.prior
    samples, eps = found.left.shape[0], float(np.finfo(model.dtype).eps)
    is_informative = (model > eps * max(samples, len(model)) * xp.max(model)) & (prior > 0)
    safe = xp.where(is_informative, model / xp.where(prior > 0, prior, 1.0), 1.0)
    ratio = 2 * xp.log10(safe) + xp.log10(found.unit)
    along = found.left.T @ data
    along = xp.pad(along, (0, len(model) - len(along)))
    size = xp.clip(2 * xp.log10(xp.maximum(xp.abs(along), 1.0)), 0.0, MOST_BELOW)
    most = xp.max(xp.where(is_informative, ratio, -xp.inf))
    least = xp.min(xp.where(is_informative, ratio - size, xp.inf))
    return xp.stack([least - LOWEST, most + HIGHEST])[:, None]


class Modes(eqx.Module):
    """The modes of whitened data under a prior.

    - `basis` (m, k): the unknown of each mode, less the prior's mean. `inverse_condition`: of the
      basis apart from what spreads it.
    - `model` (k,), `prior` (k,): c and s. `data` (k,): U^T data; `outside` (s,): the data's part
      that no mode explains. `left` (s, r): U.
    - `unit`: the weight of the prior at which t is 1.
    """

    basis: Float[Numbers, "m k"]
    model: Float[Numbers, " k"]
    prior: Float[Numbers, " k"]
    data: Float[Numbers, " k"]
    left: Float[Numbers, "s r"]
    outside: Float[Numbers, " s"]
    unit: Float[Numbers, ""]
    inverse_condition: float = eqx.field(static=True)

    def power(self, weight: Any) -> tuple[Any, Any]:
        """t s^2, and c^2 + t s^2."""
        prior = weight / self.unit * self.prior**2
        return prior, self.model**2 + prior

    def condition(self, weight: float) -> float:
        """The condition number of the stacked system of model and prior."""
        _, total = self.power(weight)
        own = np.sqrt(np.max(total) / np.min(total)) if np.min(total) > 0 else np.inf
        return float(own / self.inverse_condition) if self.inverse_condition > 0 else np.inf


def modes(found: Decomposition, factors: PriorFactors, data: Float[Numbers, " s"]) -> Modes:
    """The modes of a decomposition, for these whitened data.

    Raises `BadInput` where data and prior leave a combination of unknowns undetermined.
    """
    basis, inverse_condition = found.right.T, 1.0
    if found.triangle is not None:
        inverse_condition = inverse_condition_of(found.triangle)
        if inverse_condition < np.finfo(float).eps:
            raise BadInput(UNDETERMINED)
        basis = scipy.linalg.solve_triangular(found.triangle, basis)
    return modes_of_left(
        found.left, data, factors.apply_spread(basis), found.model, found.prior,
        float(found.unit), inverse_condition,
    )  # fmt: skip


def inverse_condition_of(triangle: Any) -> float:
    """LAPACK's estimate of the inverse condition number, in the 1-norm."""
    (estimate,) = scipy.linalg.get_lapack_funcs(("trcon",), (triangle,))
    return float(estimate(triangle)[0])


def modes_of_left(left, data, basis, model, prior, unit, inverse_condition) -> Modes:
    along = left.T @ data
    outside = data - left @ along
    outside = outside - left @ (left.T @ outside)  # once more, as rounding leaves a part
    if left.shape[1] == left.shape[0]:
        outside = np.zeros_like(outside)
    padded = np.pad(along, (0, len(model) - len(along)))
    unit = np.asarray(unit)
    return Modes(basis, model, prior, padded, left, outside, unit, inverse_condition)


def is_circulant(matrix: Float[Numbers, "n m"]) -> bool:
    """Whether each column of a matrix is the one before moved down by one row, the last to the
    first, but for rounding."""
    n, m = matrix.shape
    if n != m:
        return False
    allowed = 100 * np.finfo(float).eps * np.max(np.abs(matrix), initial=0.0)
    moved = np.roll(matrix[:, :1], 1, 0)  # a cheap look before the whole is compared
    if n > 1 and not np.all(np.abs(matrix[:, 1:2] - moved) <= allowed):
        return False
    return bool(
        np.all(np.abs(matrix - scipy.linalg.circulant(np.asarray(matrix)[:, 0])) <= allowed)
    )


def stationary(factors: PriorFactors) -> tuple[np.ndarray, np.ndarray] | None:
    """The gains of K and L at the wavenumbers of a periodic line, where both are circulant; None
    where one is not."""
    m = factors.size
    ones = np.ones(m // 2 + 1)
    spread, root = factors.spread, factors.root
    gain = ones
    if spread is not None and spread.ndim == 1:
        if not np.all(spread == spread[0]):
            return None
        gain = ones * spread[0]
    elif spread is not None:
        covariance = np.asarray(spread) @ np.asarray(spread).T
        if not is_circulant(covariance):
            return None
        gain = np.sqrt(np.maximum(np.fft.rfft(covariance[:, 0]).real, 0.0))
    if root is None:
        return gain, ones
    if isinstance(root, Differences):
        of_root = np.abs(2 * np.sin(np.pi * np.arange(m // 2 + 1) / m)) ** root.order
        return (gain, of_root) if root.wraps and len(root.shape) == 1 else None
    precision = np.asarray(root).T @ np.asarray(root)
    if not is_circulant(precision):
        return None
    return gain, np.sqrt(np.maximum(np.fft.rfft(precision[:, 0]).real, 0.0))


def circulant_modes(
    column: Float[Numbers, " m"],
    gains: tuple[np.ndarray, np.ndarray],
    data: Float[Numbers, " m"],
) -> tuple[Modes, Decomposition]:
    """The modes of a circulant whitened model of this first column, which are waves.

    Raises `BadInput` where a wave is in neither the data nor the prior.
    """
    m = len(column)
    spread, root = gains
    transfer = np.fft.rfft(column) * spread
    size = np.abs(transfer)
    phase = np.where(size > 0, transfer / np.where(size > 0, size, 1.0), 1.0)
    waves, of_wave = _waves(m)
    left = np.fft.irfft(phase[:, None] * np.fft.rfft(waves, axis=0), m, axis=0)
    model, prior = size[of_wave], root[of_wave]
    prior = np.where(prior > ROUNDING * np.finfo(float).eps * np.max(prior), prior, 0.0)
    unit = np.sum(model**2) / np.sum(prior**2)
    refuse(
        bool(np.any((prior == 0) & (model <= m * np.finfo(float).eps * np.max(model)))),
        UNDETERMINED,
    )
    found = Decomposition(left, model, waves.T, np.sqrt(unit) * prior, None, np.asarray(unit))
    basis = spread[of_wave] * waves
    return modes_of_left(left, data, basis, model, found.prior, unit, 1.0), found


def _waves(m: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal cosines and sines (m, m), and the wavenumber of each."""
    k = np.arange(m // 2 + 1)
    inner = np.arange(1, (m - 1) // 2 + 1)
    angle = 2 * np.pi * (np.outer(np.arange(m), k) % m) / m
    is_single = (k == 0) | (2 * k == m)
    cosines = np.cos(angle) * np.sqrt(np.where(is_single, 1.0, 2.0) / m)
    sines = np.sin(angle[:, inner]) * np.sqrt(2 / m)
    return np.concatenate([cosines, sines], axis=1), np.concatenate([k, inner])


class FactorScores(DirectScores):
    """Scores by Cholesky factors, where jax traces the problem."""

    scanned: ClassVar[int | None] = SCANNED


class ModeScores(WeightScores):
    """Scores by sums over modes, in double precision."""

    scanned: ClassVar[int | None] = SCANNED
    together: ClassVar[int] = 3
    is_double: ClassVar[bool] = True
    modes: Modes

    def of(self, factor: Float[Array, " c"]) -> Score:
        own = self.modes
        power, total = own.power(factor[0] ** 2)
        share = power / total
        value, left_over = own.model * own.data / total, share * own.data
        residual = own.outside + own.left @ left_over[: own.left.shape[1]]
        outside = own.outside @ own.outside
        is_held = own.prior > 0
        log_prior = jnp.sum(jnp.log(jnp.where(is_held, share, 1.0)))
        pulling = power * value
        return Score(
            outside + left_over @ left_over,
            jnp.sum(own.model**2 / total),
            (log_prior - outside - left_over @ own.data) / 2,
            value @ pulling,
            jnp.sum(pulling**2 / total),
            jnp.sum((own.basis @ (pulling / total)) ** 2),
            jnp.abs(jnp.fft.rfft(residual)) ** 2,
        )


class ModeScorer(Scorer):
    """Scores of the weight of a linear problem's prior."""

    scores: Scores
    samples: int = eqx.field(static=True)
