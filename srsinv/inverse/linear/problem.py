"""A linear inverse problem of any operator: data = operator(x) + noise."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy
import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float

from ...errors import BadInput, echo, of_kind, refuse
from ...known import Numbers, is_traced, namespace
from .operator import LinearMap, as_map
from .prior import GaussianPrior


class LinearProblem(eqx.Module):
    """Any linear inverse problem: data = operator(x) + noise, with or without a prior of x.

    `srsinv.invert` takes it, and so do `Tikhonov` and `Wiener`.

    - `operator`: a matrix (sample, m), which the penalty takes as periodic where it is known and
      circulant; a JAX function of one array; a lineax operator; or a scipy
      `LinearOperator` or sparse matrix.
    - `data`: an array of any shape; NaN where a sample is missing. Data that jax traces are taken
      as complete.
    - `noise`: the standard deviation of the noise, one number or an array of the data's shape; or
      its covariance (sample, sample), of the data as a flat array.
    - `prior`: a [`GaussianPrior`][srsinv.GaussianPrior] of x; None: there is none.
    - `adjoint`: of a function, from data to unknowns. Its result has the shape of x.
    - `name`: of the problem, in titles.

    Raises `BadInput` where shapes disagree, for an operator that is not linear, for an adjoint that
    is none, for noise that is not positive, and where no sample is left.
    """

    operator: LinearMap
    data: Float[Numbers, "..."]
    noise: Float[Numbers, "..."]
    noise_root: Float[Numbers, "s s"] | None
    prior: GaussianPrior | None
    name: str = eqx.field(static=True)
    missing: tuple[int, ...] = eqx.field(static=True)

    def __init__(
        self,
        operator: Any,
        data: Any,
        noise: Any,
        *,
        prior: Any = None,
        adjoint: Any = None,
        name: Any = "Linear problem",
    ):
        self.name = of_kind("name", name, str, 'a text, such as "Deconvolution"')
        values = _numbers("data", data)
        refuse(
            not is_traced(values) and bool(np.any(np.isinf(values))),
            "data has infinite values: give finite numbers, and NaN where a sample is missing.",
        )
        self.missing = ()
        if not is_traced(values):
            is_missing = np.isnan(values)
            refuse(bool(is_missing.all()), "data has no sample that is not NaN: give one or more.")
            self.missing = tuple(np.flatnonzero(is_missing).tolist())
            values = np.where(is_missing, 0.0, values)
        self.data = values
        self.operator = as_map(operator, adjoint, values.shape)
        self.noise = _numbers("noise", noise)
        self.noise_root = self._checked_noise()
        self.prior = prior
        if prior is not None:
            of_kind("prior", prior, GaussianPrior, "a GaussianPrior, such as GaussianPrior(1.0)")

    def _checked_noise(self) -> Float[Numbers, "s s"] | None:
        """The Cholesky factor of the valid samples' noise, where that is a covariance."""
        noise, (samples, _) = self.noise, self.operator.sizes
        is_known = not is_traced(noise)
        refuse(
            is_known and not np.all(np.isfinite(noise)),
            "noise has values that are not finite: give finite numbers.",
        )
        if noise.shape in ((), self.data.shape):
            refuse(
                is_known and not np.all(noise > 0),
                "noise has values that are not positive: give standard deviations above 0.",
            )
            return None
        refuse(
            noise.shape != (samples, samples),
            f"noise has the shape {noise.shape}: give one number, the shape {self.data.shape} of "
            f"the data, or a covariance ({samples}, {samples}).",
        )
        if (observed := self.observed) is not None:
            noise = noise[np.ix_(observed, observed)]
        if not is_known:
            return jnp.linalg.cholesky(noise)
        size = np.max(np.abs(noise))
        refuse(
            not np.all(np.abs(noise - noise.T) <= 1e-10 * size),
            "noise is a covariance that is not symmetric: give (noise + noise.T) / 2.",
        )
        try:
            return scipy.linalg.cholesky(noise, lower=True)
        except scipy.linalg.LinAlgError as error:
            raise BadInput(
                "noise is a covariance with eigenvalues that are not positive: add a small "
                "variance to its diagonal."
            ) from error

    @property
    def observed(self) -> Bool[np.ndarray, " sample"] | None:
        """Which of the flat samples are valid; None: all."""
        if not self.missing:
            return None
        mask = np.ones(self.data.size, bool)
        mask[list(self.missing)] = False
        return mask

    @property
    def sample_count(self) -> int:
        """How many samples are valid."""
        return self.data.size - len(self.missing)

    def whiten(self, rows: Float[Numbers, "sample ..."]) -> Float[Numbers, "s ..."]:
        """Flat samples, and columns of them, as valid ones in units of the noise."""
        rows = rows if (observed := self.observed) is None else rows[observed]
        if self.noise_root is not None:
            return solve_triangular(self.noise_root, rows, lower=True)
        return (rows.T / self._stderr).T

    def transpose_white(self, rows: Float[Numbers, " s"]) -> Float[Numbers, " sample"]:
        """The transposed map of [`LinearProblem.whiten`][]."""
        if self.noise_root is not None:
            values = solve_triangular(self.noise_root, rows, lower=True, trans=1)
        else:
            values = rows / self._stderr
        return self.at_samples(values, 0.0).ravel()

    @property
    def _stderr(self) -> Float[Numbers, "..."]:
        """The noise's standard deviation, of the valid samples."""
        if self.noise.ndim == 0:
            return self.noise
        flat, observed = self.noise.ravel(), self.observed
        return flat if observed is None else flat[observed]

    @property
    def valid_data(self) -> Float[Numbers, " s"]:
        """The data of the valid samples, flat."""
        flat = self.data.reshape(-1)
        return flat if (observed := self.observed) is None else flat[observed]

    def at_samples(
        self, values: Float[Numbers, " s"], missing: float = np.nan
    ) -> Float[Numbers, "..."]:
        """Values of the valid samples in the data's shape."""
        if (observed := self.observed) is None:
            return values.reshape(self.data.shape)
        whole = scattered(values, np.flatnonzero(observed), self.data.size, missing)
        return whole.reshape(self.data.shape)


def scattered(
    values: Float[Numbers, " s"], at: Any, size: int, missing: float = 0.0
) -> Float[Numbers, " n"]:
    """A row of this size with the values at these places, and `missing` elsewhere."""
    if namespace(values) is np:
        whole = np.full(size, missing)
        whole[at] = values
        return whole
    return jnp.full(size, missing).at[at].set(values)


def solve_triangular(matrix: Any, rows: Any, lower: bool = False, trans: int = 0) -> Any:
    """The solution of a triangular system, by numpy or jax, whichever the arrays are of."""
    linalg: Any = scipy.linalg if namespace(matrix, rows) is np else jax.scipy.linalg
    return linalg.solve_triangular(matrix, rows, lower=lower, trans=trans)


def _numbers(name: str, value: Any) -> Float[Numbers, "..."]:
    if is_traced(value):
        return jnp.asarray(value, float)
    try:
        values = np.asarray(value)
        is_complex = values.dtype.kind == "c"
        values = np.zeros(0) if is_complex else np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{name} is {echo(value)}: give an array of numbers.") from error
    refuse(
        is_complex,
        f"{name} has complex numbers: give real and imaginary parts as samples of their own.",
    )
    refuse(values.size == 0, f"{name} is empty: give one number or more.")
    return values
