"""Linear operators as they are given: a matrix, a function with its adjoint, one of lineax, one of
scipy. Each becomes a map with `forward`, `adjoint` and `matrix`, whose linearity is checked once.
"""

import abc
import math
import sys
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float

from ...errors import BadInput, echo, refuse
from ...known import Numbers, is_traced

Shape = tuple[int, ...]
EXACT = 1e-6  # relative: to which an operator is to be linear, and its adjoint the adjoint
KINDS = (
    "a matrix, a JAX function together with adjoint=, a lineax operator or a scipy LinearOperator"
)


class LinearMap(eqx.Module):
    """Base of linear maps from unknowns of one shape to data of another, of real numbers.

    `forward`, `adjoint` and `matrix` are to be defined.
    """

    unknown_shape: eqx.AbstractVar[Shape]
    data_shape: eqx.AbstractVar[Shape]
    by_jax: ClassVar[bool]  # whether jax can trace it

    @abc.abstractmethod
    def forward(self, x: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        """The data of an unknown."""

    @abc.abstractmethod
    def adjoint(self, y: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        """The transposed map."""

    @abc.abstractmethod
    def matrix(self) -> Float[Numbers, "sample m"]:
        """The map as a matrix between flat arrays."""

    @property
    def sizes(self) -> tuple[int, int]:
        """How many samples and unknowns there are."""
        return math.prod(self.data_shape), math.prod(self.unknown_shape)


class MatrixMap(LinearMap):
    """A matrix (sample, m); data of any shape are taken as flat."""

    by_jax: ClassVar[bool] = True
    values: Float[Numbers, "sample m"]
    unknown_shape: Shape = eqx.field(static=True)
    data_shape: Shape = eqx.field(static=True)

    def forward(self, x: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        return (self.values @ x.reshape(-1)).reshape(self.data_shape)

    def adjoint(self, y: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        return self.values.T @ y.reshape(-1)

    def matrix(self) -> Float[Numbers, "sample m"]:
        return self.values


class FunctionMap(LinearMap):
    """A function of jax and its adjoint."""

    by_jax: ClassVar[bool] = True
    function: Callable[..., Any]
    transposed: Callable[..., Any]
    unknown_shape: Shape = eqx.field(static=True)
    data_shape: Shape = eqx.field(static=True)

    def forward(self, x: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        return self.function(x)

    def adjoint(self, y: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        return self.transposed(y)

    def matrix(self) -> Float[Numbers, "sample m"]:
        samples, m = self.sizes
        if samples < m:
            rows = jnp.eye(samples).reshape(samples, *self.data_shape)
            return jax.vmap(self.transposed)(rows).reshape(samples, m)
        columns = jnp.eye(m).reshape(m, *self.unknown_shape)
        return jax.vmap(self.function)(columns).reshape(m, samples).T


class ScipyMap(LinearMap):
    """An operator of scipy: its `LinearOperator`, or a sparse matrix."""

    by_jax: ClassVar[bool] = False
    operator: Any = eqx.field(static=True)
    unknown_shape: Shape = eqx.field(static=True)
    data_shape: Shape = eqx.field(static=True)

    def forward(self, x: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        return np.asarray(self.operator @ np.asarray(x).reshape(-1)).reshape(self.data_shape)

    def adjoint(self, y: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
        return np.asarray(self.operator.T @ np.asarray(y).reshape(-1))

    def matrix(self) -> Float[Numbers, "sample m"]:
        if scipy.sparse.issparse(self.operator):
            return np.asarray(self.operator.toarray(), float)
        return np.asarray(self.operator @ np.eye(self.sizes[1]), float)


def as_map(operator: Any, adjoint: Any, data_shape: Shape) -> LinearMap:
    """The operator as a [`LinearMap`][] to data of this shape.

    Raises `BadInput` for what is no operator, for shapes that disagree, for a function that is not
    linear and for an adjoint that is none.
    """
    made = _map(operator, adjoint, data_shape)
    refuse(
        0 in made.unknown_shape,
        f"operator has unknowns of the shape {made.unknown_shape}: give one with an unknown or "
        "more.",
    )
    if isinstance(made, MatrixMap):
        values = made.values
        refuse(
            not is_traced(values) and not np.all(np.isfinite(values)),
            "operator has entries that are not finite: give a matrix of finite numbers.",
        )
    else:
        _check(made)
    return made


def _map(operator: Any, adjoint: Any, data_shape: Shape) -> LinearMap:
    is_function = callable(operator) and not hasattr(operator, "shape")
    lineax = sys.modules.get("lineax")
    is_lineax = lineax is not None and isinstance(operator, lineax.AbstractLinearOperator)
    refuse(
        adjoint is not None and (is_lineax or not is_function),
        "operator has an adjoint of its own: leave adjoint out, which belongs to a function.",
    )
    if is_lineax:
        return _of_lineax(operator, data_shape)
    given: Any = operator  # of classes whose types differ between versions of scipy
    if scipy.sparse.issparse(operator) or isinstance(operator, scipy.sparse.linalg.LinearOperator):
        samples, m = given.shape
        _check_size(samples, data_shape)
        refuse(np.dtype(given.dtype or float).kind == "c", _COMPLEX)
        return ScipyMap(operator=operator, unknown_shape=(m,), data_shape=data_shape)
    if is_function:
        refuse(
            not callable(adjoint),
            "operator is a function without an adjoint: give adjoint=, a function from data to "
            "unknowns, or a lineax.FunctionLinearOperator, which makes its own.",
        )
        return _of_function(operator, adjoint, data_shape)
    return _of_matrix(operator, data_shape)


_COMPLEX = (
    "operator has complex numbers: give a real one, with real and imaginary parts as rows of "
    "their own."
)


def _check_size(samples: int, data_shape: Shape) -> None:
    refuse(
        samples != math.prod(data_shape),
        f"operator gives {samples} samples and data has the shape {data_shape}: give data of "
        f"{samples} samples.",
    )


def _of_matrix(operator: Any, data_shape: Shape) -> MatrixMap:
    try:
        values = operator if isinstance(operator, jax.Array) else np.asarray(operator)
    except ValueError:  # rows of several lengths
        values = np.zeros(0)
    refuse(values.dtype.kind == "c", _COMPLEX)
    is_matrix = values.ndim == 2 and values.dtype.kind in "fiub"
    refuse(not is_matrix, f"operator is {echo(operator)}: give {KINDS}.")
    _check_size(values.shape[0], data_shape)
    values = jnp.asarray(values, float) if is_traced(values) else np.asarray(values, float)
    return MatrixMap(values=values, unknown_shape=values.shape[1:], data_shape=data_shape)


def _of_lineax(operator: Any, data_shape: Shape) -> FunctionMap:
    structures = operator.in_structure(), operator.out_structure()
    refuse(
        not all(isinstance(each, jax.ShapeDtypeStruct) for each in structures),
        "operator maps trees of arrays: give a lineax operator from one array to one array.",
    )
    unknown, data = structures
    refuse("c" in (unknown.dtype.kind, data.dtype.kind), _COMPLEX)
    _check_shape("operator", "data", data.shape, data_shape)
    return FunctionMap(
        function=operator.mv,
        transposed=operator.transpose().mv,
        unknown_shape=unknown.shape,
        data_shape=data_shape,
    )


def _of_function(function: Any, adjoint: Any, data_shape: Shape) -> FunctionMap:
    unknown = _shape_of("adjoint", adjoint, data_shape)
    _check_shape("operator", "data", _shape_of("operator", function, unknown), data_shape)
    return FunctionMap(
        function=_as_leaf(function),
        transposed=_as_leaf(adjoint),
        unknown_shape=unknown,
        data_shape=data_shape,
    )


def _as_leaf(function: Any) -> Callable[..., Any]:
    """A function that may stand in a tree: a module of equinox as it is, with its arrays."""
    made: Any = function if isinstance(function, eqx.Module) else jax.tree_util.Partial(function)
    return made


def _shape_of(name: str, function: Any, shape: Shape) -> Shape:
    """The shape of what a function makes of an array of this shape."""
    try:
        made = jax.eval_shape(function, jax.ShapeDtypeStruct(shape, jnp.result_type(float)))
    except (TypeError, ValueError, jax.errors.JAXTypeError) as error:
        reason = " ".join(str(error).split())[:160]
        raise BadInput(
            f"{name} cannot be traced by jax with an array of shape {shape} ({reason}): write it "
            "in jax.numpy, or give a scipy LinearOperator."
        ) from error
    refuse(
        not isinstance(made, jax.ShapeDtypeStruct),
        f"{name} gives {echo(made)}: let it give one array.",
    )
    refuse(made.dtype.kind == "c", _COMPLEX)
    return made.shape


def _check_shape(name: str, of: str, made: Shape, wanted: Shape) -> None:
    refuse(
        made != wanted,
        f"{name} gives the shape {made} and {of} has {wanted}: let the two be the same.",
    )


def _check(given: LinearMap) -> None:
    """Refuse a map that is not linear, and an adjoint that is none, by random arrays."""
    draw = np.random.default_rng(0).standard_normal
    x, other, y = draw(given.unknown_shape), draw(given.unknown_shape), draw(given.data_shape)
    if given.by_jax:
        x, other, y = map(jnp.asarray, (x, other, y))
    of_x, of_other = given.forward(x), given.forward(other)
    combined, of_y = given.forward(2 * x - 3 * other), given.adjoint(y)
    if is_traced(of_x, of_other, combined, of_y):
        return
    of_x, of_other, combined = (
        np.asarray(each, float).ravel() for each in (of_x, of_other, combined)
    )
    of_y = np.asarray(of_y, float).ravel()
    finite = all(np.all(np.isfinite(each)) for each in (of_x, of_other, combined, of_y))
    refuse(not finite, "operator gives numbers that are not finite: let it give finite ones.")
    allowed = max(EXACT, 1e3 * float(jnp.finfo(jnp.result_type(float)).eps))
    wrong = np.linalg.norm(combined - 2 * of_x + 3 * of_other)
    size = 2 * np.linalg.norm(of_x) + 3 * np.linalg.norm(of_other)
    refuse(
        bool(wrong > allowed * size),
        f"operator is not linear: operator(2 x - 3 z) differs from 2 operator(x) - 3 operator(z) "
        f"by {wrong / max(size, 1e-300):.2g} of its size. Give its linear part, and add the rest "
        "to the data.",
    )
    ahead, back = of_x @ np.asarray(y).ravel(), np.asarray(x).ravel() @ of_y
    norms = max(
        np.linalg.norm(of_x) * np.linalg.norm(y), np.linalg.norm(np.asarray(x)) * _norm(of_y)
    )
    refuse(
        bool(abs(ahead - back) > allowed * norms),
        f"adjoint is not the adjoint of operator: the products y . operator(x) and adjoint(y) . x "
        f"are {ahead:.6g} and {back:.6g}. Give the transposed map.",
    )


def _norm(values: np.ndarray) -> float:
    return float(np.linalg.norm(values))


def matrix_of(given: LinearMap) -> Float[Array, "sample m"] | Float[np.ndarray, "sample m"]:
    """The map's matrix, of numpy where it is known."""
    with jax.ensure_compile_time_eval():  # under jit it is known, too, where only data are not
        values = given.matrix()
    return values if is_traced(values) else np.asarray(values, float)
