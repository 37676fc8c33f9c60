"""Minimise a Gaussian posterior's exponent over admissible tractions, or beside edges, by ADMM.

The minimum of

    1/2 (r - m)^T H (r - m) + sum_c w_c |D r_c|_1  over r + level in a set of every cell's own

is found by splitting (Boyd et al. 2011): each step solves with H + rho, which the posterior's own
factors do, and projects every cell by itself. The duality gap bounds the distance to the minimum in
H's norm. A cell is off by at most this distance times its own standard error (Cauchy-Schwarz).
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from ...grid import Line
from .constraint import Constraint, shrunk

RELAXATION = 1.8  # of a step; the fewest steps of 1, 1.6 and 1.8 in nearly every scene tried
UNBALANCED = 2.0  # ratio of the two residuals beyond which the penalty is changed
MOST_CHANGES = 12  # of the penalty: with one that stays, ADMM converges
MOST_PENALTY = 4.0  # factor of one change

Traction = Float[Array, "draw c n"]


class GaussianPosterior(eqx.Module):
    """A Gaussian posterior on a line: its precision H, and systems with H + rho."""

    line: eqx.AbstractVar[Line]
    steps: eqx.AbstractVar[int]  # between two checks, of about the cost of one factor

    @abc.abstractmethod
    def weigh(self, r: Traction) -> Traction:
        """H r."""

    @abc.abstractmethod
    def spread(self, r: Traction) -> Traction:
        """H^-1 r, zero along means that are known."""

    @abc.abstractmethod
    def damped(self, rho: Float[Array, " c"], edge: Float[Array, " c"], order: int) -> Array:
        """The inverse of H + rho + edge D^T D, D the differences of this order, as `times` takes
        it."""

    @abc.abstractmethod
    def times(self, inverse: Array, r: Traction) -> Traction:
        """What `damped` gave, times r."""

    @abc.abstractmethod
    def draw(self, key: Any, count: int) -> Traction:
        """Draws of covariance H^-1 about zero."""


class PerWave(GaussianPosterior):
    """A posterior whose wavenumbers are independent, of 2x2 blocks or numbers.

    `precision`, `covariance` (c, c, k), the latter zero where `is_solved` (c, k) is false.
    """

    precision: Complex[Array, "c c k"]
    covariance: Complex[Array, "c c k"]
    is_solved: Bool[Array, "c k"]
    line: Line
    steps: int = eqx.field(static=True, default=8)

    def weigh(self, r: Traction) -> Traction:
        return self._times(self.precision, r)

    def spread(self, r: Traction) -> Traction:
        return self._times(self.covariance, r)

    def damped(self, rho: Float[Array, " c"], edge: Float[Array, " c"], order: int) -> Array:
        symbol = (2 * jnp.sin(self.line.k * self.line.cell_m / 2)) ** (2 * order)
        own = jnp.where(self.is_solved, rho[:, None] + edge[:, None] * symbol, 0.0)
        return inverse_of_blocks(self.precision + _diagonal(own), self.is_solved)

    def times(self, inverse: Array, r: Traction) -> Traction:
        return self._times(inverse, r)

    def draw(self, key: Any, count: int) -> Traction:
        c, n = len(self.covariance), self.line.n
        white = jax.random.normal(key, (count, c, n))
        return self._times(roots_of_blocks(self.covariance), white)

    def _times(self, matrix: Complex[Array, "c c k"], r: Traction) -> Traction:
        # A sum of products: faster than a batched matrix product.
        spectrum = jnp.fft.rfft(r)
        columns = range(len(matrix))
        rows = [sum(matrix[i, j] * spectrum[:, j] for j in columns) for i in columns]
        return jnp.fft.irfft(jnp.stack(rows, axis=1), self.line.n)


class Dense(GaussianPosterior):
    """A posterior of dense matrices, for any line.

    `precision`, `covariance` (m, m) of all components' cells in a row; `root` (m, j), of which
    `covariance` is the product with its transpose; `is_free` (c,): whether a component's mean is
    not fixed.
    """

    precision: Float[Array, "m m"]
    covariance: Float[Array, "m m"]
    root: Float[Array, "m j"]
    is_free: Bool[Array, " c"]
    line: Line
    steps: int = eqx.field(static=True, default=40)

    def weigh(self, r: Traction) -> Traction:
        return self._times(self.precision, r)

    def spread(self, r: Traction) -> Traction:
        return self._times(self.covariance, r)

    def damped(self, rho: Float[Array, " c"], edge: Float[Array, " c"], order: int) -> Array:
        n, unit = self.line.n, jnp.eye(self.line.n)
        differences = self.line.differences(unit, order).T
        blocks = [
            a * unit + b * differences.T @ differences for a, b in zip(rho, edge, strict=True)
        ]
        whole = self.precision + jax.scipy.linalg.block_diag(*blocks)
        # Where a component has no penalty and a fixed mean, that mean has no precision at all.
        fixed = jnp.where(self.is_free, 0.0, jnp.mean(jnp.diagonal(self.precision)))
        whole = whole + jnp.kron(jnp.diag(fixed), jnp.full((n, n), 1 / n))
        root = jnp.linalg.cholesky(whole)
        return jax.scipy.linalg.cho_solve((root, True), jnp.eye(len(whole)))

    def times(self, inverse: Array, r: Traction) -> Traction:
        return self._centred(self._times(inverse, self._centred(r)))

    def draw(self, key: Any, count: int) -> Traction:
        white = jax.random.normal(key, (count, self.root.shape[1]))
        return (white @ self.root.T).reshape(count, len(self.is_free), self.line.n)

    def _centred(self, r: Traction) -> Traction:
        mean = jnp.mean(r, axis=-1, keepdims=True)
        return r - jnp.where(self.is_free[:, None], 0.0, mean)

    def _times(self, matrix: Float[Array, "m m"], r: Traction) -> Traction:
        return (r.reshape(len(r), -1) @ matrix.T).reshape(r.shape)


def _diagonal(rows: Float[Array, "c k"]) -> Float[Array, "c c k"]:
    return jnp.eye(len(rows))[:, :, None] * rows[None]


def inverse_of_blocks(
    matrix: Complex[Array, "c c k"], is_solved: Bool[Array, "c k"]
) -> Complex[Array, "c c k"]:
    """The inverse of Hermitian 1x1 or 2x2 blocks over the components that are solved for; zero for
    the others."""
    solved = is_solved[:, None] & is_solved[None]
    matrix = jnp.where(solved, matrix, _diagonal(1.0 - is_solved))
    if len(matrix) == 1:
        return jnp.where(solved, 1 / matrix, 0.0)
    (a, b), (b_conj, d) = matrix
    # By the second pivot, which keeps the digits that a determinant loses.
    pivot = (d - b_conj * b / a).real
    over = 1 / pivot
    rows = [[1 / a + b * b_conj / a**2 * over, -b / a * over], [-b_conj / a * over, over + 0j]]
    return jnp.where(solved, jnp.stack([jnp.stack(row) for row in rows]), 0.0)


def roots_of_blocks(matrix: Complex[Array, "c c k"]) -> Complex[Array, "c c k"]:
    """The lower Cholesky factors of Hermitian 1x1 or 2x2 blocks that are not negative."""
    first = jnp.sqrt(matrix[0, 0].real)
    if len(matrix) == 1:
        return first[None, None] + 0j
    below = jnp.where(first > 0, matrix[1, 0] / jnp.where(first > 0, first, 1.0), 0.0)
    last = jnp.sqrt(jnp.maximum(matrix[1, 1].real - jnp.abs(below) ** 2, 0.0))
    return jnp.stack([jnp.stack([first + 0j, 0j * first]), jnp.stack([below, last + 0j])])


class Penalised(NamedTuple):
    """What is minimised over, besides the posterior: `level` (c, 1) [Pa], which makes r the whole
    traction; `is_fixed` (c,), whether r has the mean zero; the weights `edges` (c,) of the absolute
    differences; `rho` (c,) and `edge_rho` (c,), the penalties to begin with, 0 where nothing is
    split."""

    level: Float[Array, "c 1"]
    is_fixed: Bool[Array, " c"]
    edges: Float[Array, " c"]
    rho: Float[Array, " c"]
    edge_rho: Float[Array, " c"]


class SplitMinimum(NamedTuple):
    """The minima (draw, c, n), the bound on each one's distance in standard errors (draw,), and the
    number of steps."""

    value: Traction
    distance: Float[Array, " draw"]
    steps: Any


class _State(NamedTuple):
    """The splits `z` of r and `dz` of its differences, their scaled multipliers, r of the last
    step, the penalties, how it stands, and the inverse under the penalties before they changed."""

    z: Traction
    u: Traction
    dz: Float[Array, "draw c m"]
    du: Float[Array, "draw c m"]
    r: Traction
    rho: Float[Array, " c"]
    edge_rho: Float[Array, " c"]
    distance: Float[Array, " draw"]
    rounds: Any
    inverse: Array
    is_changed: Any


@eqx.filter_jit
def minimise(
    posterior: GaussianPosterior,
    centre: Traction,
    constraint: Constraint,
    penalised: Penalised,
    tolerance: Any,
    most_steps: Any,
) -> SplitMinimum:
    """The minima about each `centre` m (draw, c, n), all within `tolerance` standard errors unless
    `most_steps` are done."""
    line, order = posterior.line, constraint.laplace_order
    level = penalised.level
    right = posterior.weigh(centre)

    def differences(r):
        return _differences(line, r, order)

    def step(now: _State, inverse) -> _State:
        rho, edge_rho = now.rho[:, None], now.edge_rho[:, None]
        onwards = jnp.where(rho > 0, RELAXATION, 1.0)  # a component that is not split is r itself
        pull = rho * (now.z - now.u)
        if order:
            pull = pull + _transposed(line, edge_rho * (now.dz - now.du), order)
        r = posterior.times(inverse, right + pull)
        ahead = onwards * r + (1 - onwards) * now.z + now.u
        z = constraint.project(ahead + level, now.rho) - level
        now = now._replace(z=z, u=ahead - z, r=r)
        if not order:
            return now
        ahead = RELAXATION * differences(r) + (1 - RELAXATION) * now.dz + now.du
        dz = shrunk(ahead, penalised.edges[:, None] / edge_rho)
        return now._replace(dz=dz, du=ahead - dz)

    def admissible(now: _State) -> Traction:
        """r itself beside edges; else the split, stretched to the mean that is known: it stays in
        its cone."""
        if order:
            return now.r
        whole = now.z + level
        mean = jnp.mean(whole[:, :1], axis=-1, keepdims=True)
        known = penalised.is_fixed[0] & (mean > 0) & constraint.bounds_pressure
        return whole * jnp.where(known, level[0, 0] / jnp.where(known, mean, 1.0), 1.0) - level

    def distance(now: _State) -> Float[Array, " draw"]:
        """The root of twice the duality gap, each part of which is positive by itself."""
        x, is_fixed = admissible(now), penalised.is_fixed[:, None]
        pull = now.rho[:, None] * now.u
        gap = -jnp.sum(pull * (x + level), axis=(1, 2)) * float(constraint.bounds_pressure)
        if order:
            multiplier, d = now.edge_rho[:, None] * now.du, differences(x)
            gap = gap + jnp.sum(penalised.edges[:, None] * jnp.abs(d) - multiplier * d, axis=(1, 2))
            pull = pull + _transposed(line, multiplier, order)
        off = x - centre
        mean = jnp.where(is_fixed, jnp.mean(off, axis=-1, keepdims=True), 0.0)
        slope, spread = posterior.weigh(off) + pull, off - mean + posterior.spread(pull)
        # A mean that is still off its known value costs so much by its multiplier.
        of_means = jnp.abs(jnp.sum(mean * pull, axis=-1))
        gap = gap + jnp.sum(slope * spread, axis=(1, 2)) / 2 + jnp.sum(of_means, axis=-1)
        return jnp.sqrt(2 * jnp.maximum(gap, 0.0))

    def going(now: _State):
        enough = jnp.all(now.distance <= tolerance)
        return ~enough & (now.rounds * posterior.steps < most_steps)

    def round_of_steps(now: _State) -> _State:
        # A dense factor takes as long as a thousand steps.
        inverse = jax.lax.cond(
            now.is_changed,
            lambda: posterior.damped(now.rho, now.edge_rho, order),
            lambda: now.inverse,
        )
        before = jax.lax.fori_loop(0, posterior.steps - 1, lambda _, s: step(s, inverse), now)
        after = step(before, inverse)
        after = after._replace(distance=distance(after), rounds=now.rounds + 1, inverse=inverse)
        return _balanced(before, after, differences(after.r) if order else after.dz)

    z = constraint.project(centre + level, penalised.rho) - level
    dz = differences(z) if order else jnp.zeros((len(z), 1, 1))
    first = _State(
        z, jnp.zeros_like(z), dz, jnp.zeros_like(dz), z, penalised.rho, penalised.edge_rho,
        jnp.full(len(z), jnp.inf), jnp.zeros((), int),
        posterior.damped(penalised.rho, penalised.edge_rho, order), jnp.zeros((), bool),
    )  # fmt: skip
    end = jax.lax.while_loop(going, round_of_steps, first)
    return SplitMinimum(admissible(end), end.distance, end.rounds * posterior.steps)


def _balanced(before: _State, after: _State, differences: Any) -> _State:
    """The state with penalties under which both residuals of the next steps are about as large."""
    may_change = after.rounds <= MOST_CHANGES

    def factor(off, moved):
        ratio = jnp.linalg.norm(off) / jnp.maximum(jnp.linalg.norm(moved), 1e-300)
        change = jnp.clip(jnp.sqrt(ratio), 1 / MOST_PENALTY, MOST_PENALTY)
        is_off = (ratio > UNBALANCED) | (ratio < 1 / UNBALANCED)
        return jnp.where(may_change & is_off, change, 1.0)

    is_split = (after.rho > 0)[:, None]
    of_cells = factor(is_split * (after.r - after.z), is_split * (after.z - before.z))
    of_edges = factor(differences - after.dz, after.dz - before.dz)
    return after._replace(
        u=after.u / of_cells,
        rho=after.rho * of_cells,
        du=after.du / of_edges,
        edge_rho=after.edge_rho * of_edges,
        is_changed=(of_cells != 1) | (of_edges != 1),
    )


def _differences(line: Line, r: Traction, order: int) -> Float[Array, "draw c m"]:
    return jax.vmap(lambda each: line.differences(each, order))(r)


def _transposed(line: Line, values: Float[Array, "draw c m"], order: int) -> Traction:
    """The transpose of differences of this order."""
    draws, c, _ = values.shape
    like = jax.ShapeDtypeStruct((draws, c, line.n), values.dtype)
    (r,) = jax.linear_transpose(lambda each: _differences(line, each, order), like)(values)
    return r
