"""The spectral path: on a periodic line each wavenumber is a least-squares problem of its own.

The model over the noise, A = N^(-1/2) G = [A_1, A_2], is orthogonalised once: A_2 = t A_1 + B, B
orthogonal to A_1. Under a prior precision diag(p_1, p_2) the posterior follows in closed form: with
s = p_1 / (|A_1|^2 + p_1), the second pivot of A^H A + P is s |t A_1|^2 + |B|^2 + p_2. All terms are
positive, so that nothing cancels; A^H A + P itself would square the condition number of two nearly
equal elements.

The algebra takes arrays of numpy, as an estimate is made once and compiling takes longer, or those
of jax, which have derivatives and which `solve` compiles.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from ...grid import Line, half_spectrum_weights
from ...known import array_module, by_numpy
from .prior import Prior, Score, Solution
from .problem import LineProblem
from .transforms import to_spectrum

Spectrum = Complex[Any, "row k"]
PerMode = Float[Any, " k"]


class OrthogonalModel(NamedTuple):
    """The whitened model at every wavenumber: its `columns` A_1 and B (e, k), their `squares` (k,),
    `ratio` t, None of one component, and for each component `is_solved` (k,), false at a mean that
    is not solved for."""

    columns: list[Spectrum]
    squares: list[PerMode]
    ratio: Complex[Any, " k"] | None
    is_solved: list[Bool[Any, " k"]]

    @property
    def shared(self) -> PerMode:
        """|t A_1|^2."""
        return self.squares[0] * square(self.ratio)

    @property
    def gains(self) -> list[PerMode]:
        """The squares of A_1 and A_2."""
        first, *others = self.squares
        return [first, *(self.shared + each for each in others)]

    def inner(self, data: Spectrum) -> list[Complex[Any, " k"]]:
        """The inner products of the columns with whitened data (e, k)."""
        return [_inner(column, data) for column in self.columns]


class Pivots(NamedTuple):
    """The pivots of A^H A + P at every wavenumber: of each component (k,) the `inverse`, and the
    fraction that is the `prior`'s; and of the last pivot the fraction that is not A_1's, and that
    is not B's.

    Where a component is not solved for, or neither data nor prior determine it, it is as if its
    prior were infinite.
    """

    inverse: list[PerMode]
    prior: list[PerMode]
    others: list[PerMode]


class ModePosterior(NamedTuple):
    """The posterior at every wavenumber: the mean (k,) of each component, and the rows of the
    covariance and of the resolution. Means that are not solved for leak into the latter."""

    value: list[Complex[Any, " k"]]
    covariance: list[list[Any]]
    resolution: list[list[Any]]
    condition: Any

    def stderr(self, n: int) -> list[Any]:
        """The standard error of each component, the same in each of n cells."""
        variance = (_mean(n, row[c]) for c, row in enumerate(self.covariance))
        return [each**0.5 for each in variance]

    def resolved_dof(self, n: int) -> list[Any]:
        """Effective degrees of freedom of each component: the resolution's trace over n cells."""
        return [n * _mean(n, row[c]) for c, row in enumerate(self.resolution)]


class OrthogonalFactor(NamedTuple):
    """Q's rows of the data and R^-1, [A; P^(1/2)] = Q R, at every wavenumber; zero for a component
    that neither data nor prior determine."""

    top: Complex[np.ndarray, "e c k"]
    inverse: Complex[np.ndarray, "c c k"]


@jax.jit
def solve(problem: LineProblem, prior: Prior) -> Solution:
    """Posterior of the traction on a periodic line with every sample valid.

    The condition number is that of the rows, over all wavenumbers, in Frobenius' norm.
    """
    n, whitener = problem.line.n, problem.whitener
    model = orthogonalised(problem.forward.transfer * whitener[:, None], problem.zero_mean)
    data = jnp.fft.rfft(problem.data) * whitener
    solved = posterior(model, model.inner(data), list(prior.root(problem.line)))
    stderr = jnp.stack(solved.stderr(n))
    covariance, resolution = map(stacked, (solved.covariance, solved.resolution))
    return Solution(
        jnp.fft.irfft(jnp.stack(solved.value), n),
        jnp.broadcast_to(stderr[:, None], (stderr.size, n)),
        covariance,
        jnp.roll(jnp.fft.irfft(resolution, n), n // 2, axis=-1),
        jnp.stack(solved.resolved_dof(n)),
        jax.lax.stop_gradient(solved.condition),
    )


def orthogonalised(model: Complex[Any, "e c k"], zero_mean: Bool[Any, " c"]) -> OrthogonalModel:
    """The whitened model with its second column orthogonal to the first."""
    xp = model.__array_namespace__()
    is_mean = np.arange(model.shape[-1]) == 0
    is_solved = [~(zero_mean[c] & is_mean) for c in range(model.shape[1])]
    first = model[:, 0]
    size = _inner(first, first).real
    if model.shape[1] == 1:
        return OrthogonalModel([first], [size], None, is_solved)
    # In units of its own size: derivatives have the fourth power of a column in a denominator.
    has_gain = size > 0
    scale = 1 / xp.sqrt(xp.where(has_gain, size, 1.0))
    scale = scale if xp is np else jax.lax.stop_gradient(scale)
    unit = first * scale
    over = 1 / xp.where(has_gain, _inner(unit, unit).real, 1.0)
    second, ratio = model[:, 1], 0.0
    for _ in range(2):  # the second sweep restores the orthogonality that the first one loses
        overlap = _inner(unit, second) * over
        second, ratio = second - unit * overlap, ratio + overlap
    squares = [size, _inner(second, second).real]
    return OrthogonalModel([first, second], squares, ratio * scale, is_solved)


def pivots(model: OrthogonalModel, roots: list[PerMode]) -> Pivots:
    """The pivots under a prior of these roots P^(1/2) of each component."""
    xp = model.squares[0].__array_namespace__()

    def over(total, known, *parts):
        # By its root: the derivative of 1/x has x^2, of all sizes that numbers have.
        over_length = xp.where(known, 1 / xp.sqrt(xp.where(known, total, 1.0)), 0.0)
        inverse = over_length * over_length
        return inverse, *(xp.where(known, part * inverse, 1.0) for part in parts)

    pairs = zip(model.is_solved, roots, strict=True)
    prior, *others = (xp.where(is_solved, root, 0.0) ** 2 for is_solved, root in pairs)
    total = model.squares[0] + prior
    inverse, held = over(total, model.is_solved[0] & (total > 0), prior)
    if not others:
        return Pivots([inverse], [held], [held])
    shared, own, prior = model.shared, model.squares[1], others[0]
    total = held * shared + own + prior
    rounding = (8 * xp.finfo(own.dtype).eps) ** 2 * (shared + own + prior)
    parts = prior, own + prior, held * shared + prior
    last, *fractions = over(total, model.is_solved[1] & (total > rounding), *parts)
    return Pivots([inverse, last], [held, fractions[0]], fractions[1:])


def posterior(
    model: OrthogonalModel, inner: list[Complex[Any, " k"]], roots: list[PerMode]
) -> ModePosterior:
    """The posterior from the columns' inner products with the data, and the prior's roots."""
    at = pivots(model, roots)
    first, resolved, t = at.inverse[0], at.inverse[0] * model.squares[0], model.ratio
    if t is None:
        return ModePosterior(
            [first * inner[0]], [[first]], [[resolved]], _condition(model, roots, first)
        )
    last, held = at.inverse[1], at.prior[0]
    back, on = resolved * t, held * t.conj()
    second = last * (on * inner[0] + inner[1])
    beside = -last * back
    variance = first + last * square(back)
    return ModePosterior(
        [first * inner[0] - back * second, second],
        [[variance, beside], [beside.conj(), last]],
        [
            [resolved * at.others[0], at.prior[1] * back],
            [(last * model.squares[0]) * on, last * (held * model.shared + model.squares[1])],
        ],
        _condition(model, roots, variance + last),
    )


def _condition(model: OrthogonalModel, roots: list[PerMode], trace: PerMode):
    """The condition number of [A; P^(1/2)]."""
    xp = trace.__array_namespace__()
    parts = zip(model.is_solved, model.gains, roots, strict=True)
    rows = sum(xp.where(solved, gain + root**2, 0.0) for solved, gain, root in parts)
    return (xp.max(rows) * xp.max(trace)) ** 0.5


def factorise(model: OrthogonalModel, root: Float[np.ndarray, "c k"]) -> OrthogonalFactor:
    """Orthogonalise [A; P^(1/2)], of the prior's root."""
    at = pivots(model, list(root))
    top, inverse = [model.columns[0]], [[at.inverse[0] ** 0.5]]
    if model.ratio is not None:
        top.append(at.prior[0] * model.ratio * model.columns[0] + model.columns[1])
        size, zero = at.inverse[1] ** 0.5, np.zeros_like(at.inverse[0])
        back = at.inverse[0] * model.squares[0] * model.ratio
        inverse = [[*inverse[0], -back * size], [zero, size]]
    scaled = [column * inverse[c][c] for c, column in enumerate(top)]
    return OrthogonalFactor(np.stack(scaled, axis=1), stacked(inverse))


def whitened(problem: LineProblem) -> OrthogonalModel:
    """The orthogonal model of the nearest periodic problem, in double precision where it is
    known."""
    return orthogonalised(white_model(problem), array_module(problem).asarray(problem.zero_mean))


def white_model(problem: LineProblem) -> Complex[Any, "e c k"]:
    """N^(-1/2) G of the nearest periodic problem, in double precision where it is known."""
    forward = problem.forward
    transfer = forward.transfer if forward.is_circular else forward.circulant().transfer
    return array_module(problem).asarray(transfer, complex) * noise_whitener(problem)[:, None]


def noise_whitener(problem: LineProblem) -> Float[Any, "#e k"]:
    """N^(-1/2) in double precision where it is known, one row for all elements or one for each."""
    xp = array_module(problem)
    return 1 / xp.sqrt(xp.asarray(problem.noise, float))


@by_numpy
def prior_root(line: Line, prior: Prior, xp: Any = jnp) -> Float[Any, "c k"]:
    """The prior's root at the line's wavenumbers."""
    return xp.asarray(prior.root(line))


class Reduced(NamedTuple):
    """What scores take of a problem, whatever the prior: the model without its columns, the data
    `along` their directions (re and im, k) in phases that make t real, and the square (k,) of the
    `rest`; `weights` (k,) of a wavenumber in a sum over all `n`."""

    model: OrthogonalModel
    along: list[Float[Any, "2 k"]]
    rest: PerMode
    weights: PerMode
    n: float


def reduced(problem: LineProblem) -> Reduced:
    """Reduce the nearest periodic problem, gaps as zeros."""
    model, n, xp = whitened(problem), problem.line.n, array_module(problem)
    transform = to_spectrum if xp is np else xp.fft.rfft
    left = transform(xp.asarray(problem.data, float)) * noise_whitener(problem)
    ratio, along = model.ratio, []
    for column, size in zip(model.columns, model.squares, strict=True):
        unit = column * xp.where(size > 0, 1 / xp.sqrt(xp.where(size > 0, size, 1.0)), 0.0)
        along.append(_inner(unit, left))
        left = left - unit * along[-1]
    if ratio is not None:
        is_any = square(ratio) > 0
        size = xp.where(is_any, square(xp.where(is_any, ratio, 1.0)) ** 0.5, 0.0)
        along[1] = along[1] * xp.where(is_any, ratio, 1.0) / xp.where(is_any, size, 1.0)
        ratio = size
    parts = [xp.stack([z.real, z.imag]) for z in along]
    weights = n * half_spectrum_weights(n)
    rest = xp.sum(square(left), axis=0)
    return Reduced(model._replace(columns=[], ratio=ratio), parts, rest, weights, float(n))


def score(of: Reduced, root: Float[Array, "c k"]) -> Score:
    """The score of the prior with this root."""
    model, at, z = of.model, pivots(of.model, list(root)), of.along
    freedom, left = at.inverse[0] * model.squares[0], [at.others[0] * z[0]]
    if len(z) == 2:
        mix = at.prior[0] * at.inverse[1] * _safe_root(model.shared * model.squares[1])
        left = [at.prior[0] * left[0] - mix * z[1], at.others[1] * z[1] - mix * z[0]]
        freedom += at.inverse[1] * (at.prior[0] ** 2 * model.shared + model.squares[1])
    residual = sum(e[0] ** 2 + e[1] ** 2 for e in left)
    surprise = sum(a[0] * e[0] + a[1] * e[1] for a, e in zip(z, left, strict=True))
    # log det(G S G^H + N) less its part without G, from the pivots of A^H A + P and of P; a mode
    # that the prior leaves free has no proper evidence and is left out.
    logs = sum(jnp.log(jnp.where(part > 0, part, 1.0)) for part in at.prior)
    power = of.rest + residual
    evidence = (of.weights @ logs - of.weights @ (of.rest + surprise) / of.n) / 2
    whole = of.weights @ power / of.n
    seminorm, pull, movement = (of.weights @ e / of.n for e in _of_solution(model, z, root))
    return Score(whole, of.weights @ freedom, evidence, seminorm, pull, movement, power)


def _of_solution(
    model: OrthogonalModel, along: list[Float[Array, "2 k"]], root: Float[Array, "c k"]
) -> tuple[PerMode, PerMode, PerMode]:
    """Of the solution r at each wavenumber: r^H P r, (P r)^H C P r and |C P r|^2, C the posterior
    covariance; in phases that make t real."""
    each = zip(model.squares, along, strict=True)
    inner = [_safe_root(size) * (z[0] + 1j * z[1]) for size, z in each]
    solved = posterior(model, inner, list(root))
    pulled = [weight**2 * r for weight, r in zip(root, solved.value, strict=True)]
    moved = [
        sum(entry * u for entry, u in zip(row, pulled, strict=True)) for row in solved.covariance
    ]

    def product(one: list[Any], other: list[Any]) -> PerMode:
        return sum((a.conj() * b).real for a, b in zip(one, other, strict=True))

    movement = product(moved, moved).at[0].set(0.0)
    return product(solved.value, pulled), product(pulled, moved), movement


def _safe_root(square: PerMode) -> PerMode:
    """The root, whose derivative at zero is zero."""
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def square(z: Any) -> Any:
    """|z|^2, of real numbers or complex ones."""
    return z.real**2 + z.imag**2


def stacked(rows: list[list[Any]]) -> Complex[Any, "c c k"]:
    """Rows of entries (k,) as a matrix at every wavenumber."""
    xp = rows[0][0].__array_namespace__()
    return xp.stack([xp.stack([each + 0j for each in row]) for row in rows])


def _inner(u: Spectrum, v: Spectrum) -> Complex[Any, " k"]:
    return (u.conj() * v).sum(axis=0)


def _mean(n: int, values: Any) -> Any:
    """The mean over all wavenumbers of n."""
    return half_spectrum_weights(n) @ values.real
