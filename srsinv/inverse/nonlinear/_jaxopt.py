"""The one place that knows jaxopt, which is no longer maintained and says so when imported."""

import warnings
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from ._solvers import (
    Minimum,
    Residual,
    Solver,
    check_settings,
    relative,
    scaled_cost,
    unit_of,
)


class JaxoptLBFGSB(Solver):
    """Limited-memory BFGS with bounds of jaxopt: gradients only, no Jacobian."""

    name: ClassVar[str] = "jaxopt LBFGSB"
    tolerance: float | None = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    memory: int = eqx.field(static=True)

    def __init__(self, tolerance: Any = None, max_steps: Any = 2000, memory: Any = 20):
        check_settings(self.name, tolerance, max_steps=max_steps, memory=memory)
        self.tolerance, self.max_steps, self.memory = tolerance, max_steps, memory

    def __call__(self, residual: Residual, z0, lower, upper) -> Minimum:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="JAXopt is no longer maintained")
            from jaxopt import LBFGSB

        unit = unit_of(residual, z0)
        cost, _ = scaled_cost(residual, z0)
        tolerance = relative(self.tolerance, z0.dtype)
        method = LBFGSB(
            lambda s: cost(unit * s), tol=tolerance, maxiter=self.max_steps,
            history_size=self.memory,
        )  # fmt: skip
        s, state = method.run(z0 / unit, bounds=(lower / unit, upper / unit))
        # Back in its own unit a variable can end a rounding beyond its bound.
        return Minimum(jnp.clip(unit * s, lower, upper), state.iter_num, state.error <= tolerance)
