"""The iterative path where jax traces its problem: numpy solves it on the host, and its value has
derivatives by the implicit function theorem.

Of H r = b, with H = G^T R^-1 G + P and b = G^T R^-1 m, the derivative is H^-1 (db - dH r): one more
solution for each direction. The bands are approximations and have no derivatives: these are NaN.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...known import in_numpy
from . import iterative
from .prior import Prior, Solution
from .problem import LineProblem
from .rig_bands import direction_count

TIGHT, STEPS = 1e-13, 500  # of conjugate gradients in coloured noise with samples missing

Known = tuple[LineProblem, Prior]


@eqx.filter_custom_jvp
def solve(known: Known, tolerance: float) -> Solution:
    """The solution of a problem under a prior to a relative tolerance, NaN where it does not
    converge, or where its system is too ill-conditioned."""
    problem = known[0]
    arrays, rest = eqx.partition(known, eqx.is_array)
    c, n = problem.unknowns, problem.line.n
    shapes = (
        (c, n),
        (c, n),
        (c, c, n // 2 + 1),
        (c, c, n),
        (c,),
        (),
        (direction_count(problem), c, n),
    )
    kinds = [float, float, complex, *[float] * 4]
    each = zip(shapes, kinds, strict=True)
    arrays_like: list[Any] = [jax.ShapeDtypeStruct(s, jnp.result_type(kind)) for s, kind in each]
    like = Solution(*arrays_like)
    if problem.rig_changes is None:
        like = like._replace(rig_errors=None)
    of = partial(_solved_by_numpy, rest, tolerance)
    return jax.pure_callback(of, like, arrays, vmap_method="sequential")


@solve.def_jvp
def _with_slopes(primals: Any, tangents: Any) -> tuple[Solution, Solution]:
    (known, tolerance), (change, _) = primals, tangents
    solution = solve(known, tolerance)
    _, moved = eqx.filter_jvp(_left_over, (known, solution.value), (change, None))
    arrays, rest = eqx.partition(known, eqx.is_array)

    def by_numpy(_: Any, right: Array) -> Array:
        like = jax.ShapeDtypeStruct(right.shape, right.dtype)
        of = partial(_times_covariance, rest, tolerance)
        return jax.pure_callback(of, like, arrays, right, vmap_method="sequential")

    equations = partial(_equations, known)
    slope = jax.lax.custom_linear_solve(equations, moved, by_numpy, symmetric=True)
    unknown = jax.tree.map(lambda each: jnp.full_like(each, jnp.nan), solution)
    return solution, unknown._replace(value=slope)


def _known(rest: Any, arrays: Any) -> Known:
    return eqx.combine(jax.tree.map(np.asarray, arrays), rest)


def _solved_by_numpy(rest: Any, tolerance: float, arrays: Any) -> Solution:
    """The solution on the host."""
    problem, prior = _known(rest, arrays)
    solution, _, converged, _ = iterative.solve(problem, prior, tolerance)
    is_answer = converged and (problem.separable or float(solution.condition) < iterative.TRUSTED)
    if not is_answer:
        solution = jax.tree.map(lambda each: np.full(np.shape(each), np.nan), solution)
    return in_numpy(solution)


def _times_covariance(rest: Any, tolerance: float, arrays: Any, right: Any) -> np.ndarray:
    """The posterior covariance times the right side, on the host."""
    return iterative.times_covariance(*_known(rest, arrays), np.asarray(right), tolerance)


def _centred(problem: LineProblem, r: Float[Array, "c n"]) -> Float[Array, "c n"]:
    mean = jnp.mean(r, axis=-1, keepdims=True)
    return r - jnp.where(jnp.asarray(problem.zero_mean)[:, None], mean, 0.0)


def _left_over(known: Known, r: Float[Array, "c n"]) -> Float[Array, "c n"]:
    """b - H r."""
    problem, prior = known
    r = _centred(problem, r)
    weighed = Residual.of(problem, problem.data - problem.forward(r)).weighed
    pull = jnp.asarray(prior.apply(problem.line, r))
    return _centred(problem, problem.forward.adjoint(weighed) - pull)


def _equations(known: Known, r: Float[Array, "c n"]) -> Float[Array, "c n"]:
    """H r."""
    problem, prior = known
    r = _centred(problem, r)
    weighed = Residual.of(problem, problem.forward(r)).weighed
    pull = jnp.asarray(prior.apply(problem.line, r))
    return _centred(problem, problem.forward.adjoint(weighed) + pull)


class Residual(NamedTuple):
    """A residual apart: the expected `signal` (e, n) of the nuisance columns C in it, the degrees
    of freedom `dof` that they take, and (R + C C^T)^-1 times the residual, `weighed` (e, n)."""

    signal: Float[Array, "e n"]
    dof: Float[Array, ""]
    weighed: Float[Array, "e n"]

    @classmethod
    def of(cls, problem: LineProblem, y: Float[Array, "e n"]) -> "Residual":
        """The residual y of a problem."""
        weighed = _weighed(problem, y)
        if problem.nuisance is None:
            return cls(jnp.zeros_like(y), jnp.zeros(()), weighed)
        columns = jnp.where(problem.is_observed[:, None], jnp.asarray(problem.nuisance), 0.0)
        each = jax.vmap(partial(_weighed, problem), in_axes=1, out_axes=1)(columns)
        among = jnp.einsum("ein,ejn->eij", columns, each) + jnp.eye(columns.shape[1])
        products = jnp.einsum("ein,en->ei", columns, weighed)
        # One element after the other: batched LAPACK on a CPU may wait for itself.
        inverse = jax.lax.map(jnp.linalg.inv, among)
        sizes = jnp.einsum("eij,ej->ei", inverse, products)
        signal = jnp.einsum("ei,ein->en", sizes, columns)
        dof = columns.shape[0] * columns.shape[1] - jnp.trace(inverse, axis1=1, axis2=2).sum()
        return cls(signal, dof, weighed - jnp.einsum("ei,ein->en", sizes, each))

    def squares(self, y: Float[Array, "e n"]) -> Float[Array, ""]:
        """Sum of squares, in units of the noise, of what the columns leave of the residual y: there
        (R + C C^T)^-1 y = R^-1 (y - signal)."""
        return jnp.sum(self.weighed * (y - self.signal))


def _weighed(problem: LineProblem, y: Float[Array, "e n"]) -> Float[Array, "e n"]:
    """R^-1 y over the samples that are there, an unknown offset projected out."""
    noise = jnp.asarray(problem.noise)
    is_free = ~jnp.all(jnp.isfinite(noise[:, 0]))
    power = noise.at[:, 0].set(jnp.where(is_free, noise[:, 1], noise[:, 0]))
    scale = 1.0 if problem.noise_scale is None else jnp.asarray(problem.noise_scale)

    def filtered(spectrum: Array, y: Array) -> Array:
        return jnp.fft.irfft(jnp.fft.rfft(y) * spectrum, problem.line.n)

    def inverse(y: Array) -> Array:
        if problem.observed is None:
            return filtered(1 / power, y / scale) / scale
        there = jnp.asarray(problem.observed)

        def covariance(y: Array) -> Array:
            return jnp.where(there, scale * filtered(power, jnp.where(there, scale * y, 0.0)), y)

        def nearly(y: Array) -> Array:
            return jnp.where(
                there, filtered(1 / power, jnp.where(there, y / scale, 0.0)) / scale, y
            )

        y = jnp.where(there, y, 0.0)
        found, _ = jax.scipy.sparse.linalg.cg(covariance, y, tol=TIGHT, maxiter=STEPS, M=nearly)
        return jnp.where(there, found, 0.0)

    one = jnp.asarray(problem.is_observed, y.dtype)
    of_one, y = inverse(one), inverse(y)
    offset = jnp.sum(y, axis=-1, keepdims=True) / jnp.sum(of_one, axis=-1, keepdims=True)
    return y - jnp.where(is_free, offset * of_one, 0.0)
