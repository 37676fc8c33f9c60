"""The only module that imports jaxopt, which is no longer maintained and warns so when imported."""

import warnings
from typing import ClassVar

import jax.numpy as jnp

from ._solvers import LimitedMemory, Minimum, Residual, relative, scaled_cost, unit_of


class JaxoptLBFGSB(LimitedMemory):
    """Limited-memory BFGS with bounds of jaxopt: gradients only, no Jacobian."""

    name: ClassVar[str] = "jaxopt LBFGSB"

    def __call__(self, residual: Residual, z0, lower, upper) -> Minimum:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="JAXopt is no longer maintained")
            from jaxopt import LBFGSB

        unit = unit_of(residual, z0)
        cost, scale = scaled_cost(residual, z0)
        tolerance = relative(self.tolerance, z0.dtype)
        method = LBFGSB(
            lambda s: cost(unit * s), tol=tolerance, maxiter=self.max_steps,
            history_size=self.memory,
        )  # fmt: skip
        s, state = method.run(z0 / unit, bounds=(lower / unit, upper / unit))
        # In its own unit a variable can end beyond its bound by rounding.
        point = jnp.clip(unit * s, lower, upper)
        done = state.error <= tolerance
        return Minimum(point, cost(point) * scale / 2, scale / 2, state.iter_num, done)
