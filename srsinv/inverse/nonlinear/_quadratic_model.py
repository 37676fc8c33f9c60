"""The quadratic model of the cost |f|^2/2 around an accepted point, with or without the residual's
own curvature.

The second derivative of the cost is J^T J + S with S the sum of f_i times the second derivative of
f_i. Gauss and Newton's model leaves S out. Where the residual is large, or J nearly loses rank in
the minimum, S is the larger part (Brown and Dennis, Jennrich and Sampson, penalty I): the search
then needs thousands of steps. The other model has a secant estimate of S, from the Jacobians at two
points alone (Dennis, Gay and Welsch, ACM TOMS 7, 1981, section 3): with s the step, g the gradient,
y = g_new - g_old and y# = g_new - J_old^T f_new,

    S_new = t S + (w v^T + v w^T) - (s^T w) v v^T,   w = y# - t S s,   v = y / y^T s,

sized by t = min(1, |s^T y#| / |s^T S s|). As there, the model that foretold a step better is used
for the next.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._lengths import lengths

# Of the diagonal of S, in the square of D: a column of J that vanishes where S does not sets no
# bound on the variable's step. Between 0.1 and 0.5 the steps over 25 test problems differ by a
# tenth; without it those on penalty I never end.
CURVATURE_FRACTION = 0.25
# Curvature along a step beyond J^T J's, over J^T J's, from which on S is used: half as much makes
# MGH10 (Meyer) slower by a fifth.
LARGE_CURVATURE = 1.0


class Point(eqx.Module):
    """An accepted point: cost |f|^2/2, J = Q R, c = Q^T f, the scale D of the variables, and S."""

    cost: Float[Array, ""]
    q: Float[Array, "r m"]
    root: Float[Array, "m m"]
    c: Float[Array, " m"]
    scale: Float[Array, " m"]
    secant: Float[Array, "m m"]


class QuadraticModel(eqx.Module):
    """The change of the cost by a step p is (|A p + L c|^2 - |L c|^2)/2: `root` A, `lift` L, and
    `scale` D, in which a step is measured."""

    root: Float[Array, "m m"]
    lift: Float[Array, "m m"]
    scale: Float[Array, " m"]

    def fall(self, c: Float[Array, " m"], p: Float[Array, " m"]) -> Float[Array, ""]:
        """Fall of the cost over the step p; `c` is lifted."""
        change = self.root @ p
        return -(jnp.vdot(c, change) + 0.5 * jnp.vdot(change, change))


def no_point(size: int, m: int, dtype) -> Point:
    """Placeholder for the point before the first one, of `size` data."""
    square, row = jnp.zeros((m, m), dtype), jnp.zeros(m, dtype)
    return Point(jnp.array(jnp.inf, dtype), jnp.zeros((max(size, m), m), dtype), square, row, row,
                 square)  # fmt: skip


def linearised(
    residual, cost, jacobian, p, before: Point, remembered: float, is_first: Bool[Array, ""]
) -> Point:
    """The point that the step p reached."""
    m = p.size
    columns = lengths(jacobian)
    unit = positive(columns)
    q, root = jnp.linalg.qr(at_least(m, jacobian / unit))
    residual = at_least(m, residual)
    scale = jnp.maximum(remembered * before.scale, columns)
    point = Point(cost, q, root * unit, q.T @ residual, scale, before.secant)
    secant = _secant(before, point, residual, p)
    # The first point has none before it.
    return eqx.tree_at(lambda at: at.secant, point, jnp.where(is_first, before.secant, secant))


def _secant(before: Point, point: Point, residual, s) -> Float[Array, "m m"]:
    """The estimate of S after the step s."""
    gradient = point.root.T @ point.c
    y_sharp = gradient - before.root.T @ (before.q.T @ residual)
    y = gradient - before.root.T @ before.c
    along, wanted = jnp.abs(s @ before.secant @ s), jnp.abs(jnp.vdot(s, y_sharp))
    size = jnp.where(along > wanted, wanted / jnp.where(along > 0, along, 1.0), 1.0)
    sized = size * before.secant
    rise = jnp.vdot(y, s)
    v = y / jnp.where(rise > 0, rise, 1.0)
    w = y_sharp - sized @ s
    across = jnp.outer(w, v)
    update = across + across.T - jnp.vdot(s, w) * jnp.outer(v, v)
    # In single precision the square of 1e20 is infinite.
    usable = (rise > 0) & jnp.all(jnp.isfinite(update))
    return sized + jnp.where(usable, update, 0.0)


def uses_secant(point: Point, p, fall) -> Bool[Array, ""]:
    """Whether S belongs into the model for the next step, after the cost's fall over the step p
    from a point."""
    change = point.root @ p
    curvature = 0.5 * jnp.vdot(change, change)
    error = jnp.abs(fall + jnp.vdot(point.c, change) + curvature)
    with_secant = jnp.abs(fall + jnp.vdot(point.c, change) + curvature + 0.5 * p @ point.secant @ p)
    return (error > LARGE_CURVATURE * curvature) & (with_secant <= error)


def quadratic_model(point: Point, uses: Bool[Array, ""]) -> QuadraticModel:
    """Gauss and Newton's model, through R as it is; or that with S, through the eigenvectors of its
    second derivative. Eigenvalues that are not positive are raised to rounding: along these the
    step leads downhill from a saddle, as far as the damping lets it."""
    diagonal = jnp.abs(jnp.diagonal(point.secant))
    # Not the root of the squares' sum: they can overflow.
    scale = positive(jnp.hypot(point.scale, jnp.sqrt(CURVATURE_FRACTION * diagonal)))

    def gauss_newton():
        return QuadraticModel(point.root, jnp.eye(scale.size, dtype=scale.dtype), scale)

    def augmented():
        root = point.root / scale
        values, vectors = jnp.linalg.eigh(root.T @ root + point.secant / scale / scale[:, None])
        floor = jnp.finfo(values.dtype).eps * jnp.max(jnp.abs(values))
        roots = jnp.sqrt(jnp.maximum(values, positive(floor)))
        return QuadraticModel(
            roots[:, None] * vectors.T * scale, (vectors / roots).T @ root.T, scale
        )

    return jax.lax.cond(uses, augmented, gauss_newton)


def at_least(m: int, rows):
    """`rows`, padded with zeros where there are fewer data than variables."""
    return jnp.pad(rows, [(0, max(m - rows.shape[0], 0))] + [(0, 0)] * (rows.ndim - 1))


def positive(scale):
    """The scale, with 1 for a variable that has had no effect yet."""
    return jnp.where(scale > 0, scale, 1.0)
