"""Solvers that minimise the sum of squares, behind one interface, so that their cost can be
compared."""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...errors import number, of_kind, refuse, whole
from ._lengths import lengths
from ._uncertainty import CONVERGED

# Where the derivative jumps: the standard errors within which a minimum can be located.
ROUGH = 100.0
ROUGH_STEPS = 200  # there: a search that ends takes 10 to 180, others creep along the jumps
PART = 0.5  # of that: where a search ends, as steps beyond it follow the jumps
OUT_OF_BOX = 1e-6  # of a start: by which only rounding puts a minimum out of its bounds
EXACT = 1e-6  # of the jumps of a derivative: its error between two of them

Residual = Callable[[Float[Array, " m"]], Float[Array, " n"]]


class Minimum(eqx.Module):
    """End of a solver's run: the point (m,), half the sum of squares there and at the start,
    iterations, and whether it reports convergence."""

    point: Float[Array, " m"]
    cost: Float[Array, ""]
    start_cost: Float[Array, ""]
    iterations: Int[Array, ""]
    done: Bool[Array, ""]


class Solver(eqx.Module):
    """Base of solvers: min |residual(z)|^2 over lower <= z <= upper, from z0.

    A call is pure, for `jax.jit` and `jax.vmap`.

    `tolerance` [1] is relative, of the step and of the gradient; None takes 1e-10 in float64 and
    1e-5 in float32. `max_steps` bounds the iterations; where the residual's derivative jumps there
    are at most 200.
    """

    name: ClassVar[str]
    tolerance: eqx.AbstractVar[float | None]
    max_steps: eqx.AbstractVar[int]

    @abc.abstractmethod
    def __call__(self, residual: Residual, z0, lower, upper) -> Minimum:
        """The minimum reached from z0 (m,)."""

    @property
    def near_enough(self) -> float:
        """Distance from the linearised minimum, in standard errors, within which a search has
        converged."""
        return CONVERGED

    @property
    def derivative_rounding(self) -> float:
        """Relative rounding of a derivative, where that exceeds the precision's."""
        return 0.0

    @property
    def has_batch(self) -> bool:
        """Whether `_batch` is the same method for many data at once."""
        return False

    def tolerating(self, rounding: float) -> "Solver":
        """The same solver for a residual that is smooth only beyond this fraction of its size."""
        del rounding
        return self


def reached(solver: Solver, residual: Residual, z0: Float[Array, " m"], box: Any) -> Minimum:
    """The minimum that a solver, which may be a stranger's, reaches from z0 within the box (lower,
    upper); not done where it is out of it."""
    name, wanted = f"what {type(solver).__name__} gives", "a Minimum of srsinv.inverse.nonlinear"
    given = of_kind(name, solver(residual, z0, *box), Minimum, wanted)
    minimum: Minimum = jax.tree.map(jnp.asarray, given)
    refuse(
        minimum.point.shape != z0.shape,
        f"{name} has a point of the shape {minimum.point.shape}: give one like z0, {z0.shape}.",
    )
    slack = OUT_OF_BOX * (1 + jnp.abs(z0))
    within = (box[0] - slack <= minimum.point) & (minimum.point <= box[1] + slack)
    return eqx.tree_at(lambda m: m.done, minimum, minimum.done & jnp.all(within))


def known_tolerance(value: Any) -> float | None:
    """`value`, which is refused unless it is between 0 and 1, or None."""
    if value is None:
        return None
    wanted = "a number between 0 and 1, or null for what the precision allows"
    return float(number("solver.tolerance", value, wanted, above=0, below=1))


def known_count(name: str, value: Any) -> int:
    """`value`, the key `name`, which is refused unless it is a whole number from 1."""
    return whole(f"solver.{name}", value, "a whole number from 1", least=1)


def relative(tolerance: Any, dtype) -> Any:
    """The tolerance, or the default for the precision."""
    if tolerance is not None:
        return tolerance
    return 1e-10 if np.finfo(dtype).eps < 1e-12 else 1e-5


class Optimistix(Solver):
    """Levenberg and Marquardt's method inside the bounds, on optimistix: the default.

    `rounding` [1]: the fraction of a residual within which its derivative jumps; None where it is
    smooth.
    """

    name: ClassVar[str] = "optimistix"
    tolerance: float | None
    max_steps: int = eqx.field(static=True)
    rounding: float | None

    def __init__(self, tolerance: Any = None, max_steps: Any = 2000, rounding: Any = None):
        # As numpy's numbers, which are inputs of a program: it serves any of them.
        tolerance = known_tolerance(tolerance)
        self.tolerance = None if tolerance is None else np.float64(tolerance)
        self.max_steps = known_count("max_steps", max_steps)
        wanted = "a number between 0 and 1, or null for a smooth model"
        self.rounding = (
            None
            if rounding is None
            else np.float64(number("solver.rounding", rounding, wanted, above=0, below=1))
        )

    @property
    def near_enough(self) -> float:
        return max(CONVERGED, ROUGH * (self.rounding or 0.0))

    @property
    def derivative_rounding(self) -> float:
        return EXACT * (self.rounding or 0.0)

    @property
    def has_batch(self) -> bool:
        return self.rounding is None

    def tolerating(self, rounding: float) -> "Solver":
        # Its square, the relative error of the cost there, limits how well a minimum is located.
        tolerance = rounding**2 if self.tolerance is None else self.tolerance
        return dataclasses.replace(
            self,
            tolerance=tolerance,
            rounding=self.rounding or rounding,
            max_steps=min(self.max_steps, ROUGH_STEPS),
        )

    def __call__(self, residual: Residual, z0, lower, upper) -> Minimum:
        # With optimistix, a fifth of a second that inversions do not need.
        import optimistix as optx

        from ._levenberg_marquardt import BoundedLevenbergMarquardt

        rtol = relative(self.tolerance, z0.dtype)
        bends = self.rounding is None
        near = 0.0 if self.rounding is None else PART * ROUGH * self.rounding
        method = BoundedLevenbergMarquardt(
            lower=lower, upper=upper, rtol=rtol, bends=bends, near=near
        )
        solution = optx.least_squares(
            lambda z, _: residual(z), method, z0, max_steps=self.max_steps, throw=False
        )
        done = solution.result == optx.RESULTS.successful
        steps = jnp.asarray(solution.stats["num_steps"])
        state = solution.state
        return Minimum(solution.value, state.point.cost, state.begun, steps, done)


class LimitedMemory(Solver):
    """A solver by gradients alone that remembers its last `memory` steps."""

    tolerance: float | None = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    memory: int = eqx.field(static=True)

    def __init__(self, tolerance: Any = None, max_steps: Any = 2000, memory: Any = 20):
        self.tolerance = known_tolerance(tolerance)
        self.max_steps = known_count("max_steps", max_steps)
        self.memory = known_count("memory", memory)


class OptaxLBFGS(LimitedMemory):
    """Limited-memory BFGS of optax: gradients only, no Jacobian. Bounds by a change of variables.

    A variable between two bounds is their middle plus half their distance times a sine, one with a
    single bound leaves it as sqrt(1 + s^2) - 1: both reach the bound itself at a finite s.
    """

    name: ClassVar[str] = "optax L-BFGS"

    def __call__(self, residual: Residual, z0, lower, upper) -> Minimum:
        import optax  # which takes a tenth of a second, and few ask for

        tolerance = relative(self.tolerance, z0.dtype)
        unit = unit_of(residual, z0)
        to_box, from_box = _box(lower / unit, upper / unit)
        cost, scale = scaled_cost(residual, z0)

        def of(s):
            return cost(unit * to_box(s))

        optimiser = optax.lbfgs(memory_size=self.memory)
        value_and_grad = optax.value_and_grad_from_state(of)

        def step(carry):
            s, state, _, count = carry
            value, gradient = value_and_grad(s, state=state)
            updates, state = optimiser.update(
                gradient, state, s, value=value, grad=gradient, value_fn=of
            )
            flat = jnp.linalg.norm(gradient) <= tolerance
            still = jnp.linalg.norm(updates) <= tolerance * (jnp.linalg.norm(s) + tolerance)
            return s + updates, state, flat | still, count + 1

        def going(carry):
            s, _, done, count = carry
            return ~done & (count < self.max_steps) & jnp.all(jnp.isfinite(s))

        s0 = from_box(z0 / unit)
        carry = s0, optimiser.init(s0), jnp.array(False), jnp.array(0)
        s, _, done, count = jax.lax.while_loop(going, step, carry)
        point = jnp.clip(unit * to_box(s), lower, upper)
        return Minimum(point, cost(point) * scale / 2, scale / 2, count, done & jnp.isfinite(scale))


def unit_of(residual: Residual, z0) -> Float[Array, " m"]:
    """Unit of each variable: a move that changes the residual by its length at z0, so that
    gradients and steps are numbers about one there whatever the data's unit."""
    columns, start = lengths(jax.jacfwd(residual)(z0)), lengths(residual(z0))
    usable = jnp.isfinite(columns) & (columns > 0)
    return jnp.where(start > 0, start, 1.0) / jnp.where(usable, columns, 1.0)


def scaled_cost(residual: Residual, z0):
    """The sum of squares over its value at z0, so that a tolerance is relative, and that value."""
    start = residual(z0)
    scale = jnp.maximum(jnp.vdot(start, start), jnp.finfo(z0.dtype).tiny)

    def cost(z):
        r = residual(z)
        return jnp.vdot(r, r) / scale

    return cost, scale


def _box(lower, upper):
    """The maps from free variables s to the box, and back."""
    below, above = jnp.isfinite(lower), jnp.isfinite(upper)
    low, high = jnp.where(below, lower, 0.0), jnp.where(above, upper, 0.0)
    # Bounds equal within the precision give an interval of width 0, not 1.
    middle, half = (low + high) / 2, jnp.where(below & above, (high - low) / 2, 1.0)

    def to_box(s):
        rise = jnp.sqrt(1 + s**2) - 1
        between = jnp.where(below & above, middle + half * jnp.sin(s), s)
        return jnp.where(
            below & ~above, low + rise, jnp.where(above & ~below, high - rise, between)
        )

    def from_box(z):
        def away(distance):
            return jnp.sqrt((jnp.maximum(distance, 1e-3) + 1) ** 2 - 1)

        # Away from the bound itself, where the change of variables is flat.
        scaled = (z - middle) / jnp.where(half > 0, half, 1.0)
        between = jnp.arcsin(jnp.clip(scaled, -0.999, 0.999))
        between = jnp.where(below & above, between, z)
        one_sided = jnp.where(below & ~above, away(z - low), away(high - z))
        return jnp.where(below ^ above, one_sided, between)

    return to_box, from_box
