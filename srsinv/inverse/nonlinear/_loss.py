"""Losses rho(r) of a whitened residual r: r^2/2 for Gaussian noise, less for outliers.

Each loss is given by t(r) with t^2/2 = rho, so that least squares of t minimises it. The default
thresholds cost 5 % more variance than least squares where the noise is Gaussian (Huber 1981).
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import refuse

Rows = Float[Array, " n"]


class Loss(eqx.Module):
    """A loss with its threshold in standard deviations of the noise."""

    threshold: eqx.AbstractVar[float]

    @abc.abstractmethod
    def root(self, r: Rows) -> Rows:
        """t(r), of the sign of r."""

    @compiled
    def influence(self, r: Rows) -> tuple[Rows, Rows]:
        """rho' and rho''."""

        def rho(r):
            return 0.5 * jnp.sum(self.root(r) ** 2)

        slope = jax.grad(rho)
        return slope(r), jax.jvp(slope, (r,), (jnp.ones_like(r),))[1]


def _checked(threshold: float) -> float:
    refuse(
        not isinstance(threshold, int | float) or not 0 < threshold < float("inf"),
        f"loss.threshold is {threshold!r}: give a positive number of standard deviations.",
    )
    return float(threshold)


class Squares(Loss):
    """r^2/2: least squares, for Gaussian noise."""

    threshold: float = eqx.field(static=True, default=float("inf"))

    def root(self, r: Rows) -> Rows:
        return r


class Huber(Loss):
    """r^2/2 up to the threshold, linear beyond."""

    threshold: float = eqx.field(static=True, default=1.345, converter=_checked)

    def root(self, r: Rows) -> Rows:
        d, size = self.threshold, jnp.abs(r)
        far = size > d
        outer = jnp.sqrt(jnp.where(far, 2 * d * size - d**2, 1.0))
        return jnp.where(far, jnp.sign(r) * outer, r)


class SoftL1(Loss):
    """d^2 (sqrt(1 + (r/d)^2) - 1): as Huber's, but smooth."""

    threshold: float = eqx.field(static=True, default=1.345, converter=_checked)

    def root(self, r: Rows) -> Rows:
        # hypot, as the square of a value like 1e30 would be infinite, and its weight zero.
        return r * jnp.sqrt(2 / (1 + jnp.hypot(1.0, r / self.threshold)))


class Cauchy(Loss):
    """d^2/2 log(1 + (r/d)^2): outliers hardly count; needs a start near the solution."""

    threshold: float = eqx.field(static=True, default=2.385, converter=_checked)

    def root(self, r: Rows) -> Rows:
        size = jnp.abs(r) / self.threshold
        small, far = size < 1e-2, size > 1e9  # where one more is less than rounding
        w = jnp.where(small, size, 0.0) ** 2
        series = 1 - w / 2 + w**2 / 3
        middle = jnp.log1p(jnp.where(small | far, 1.0, size) ** 2)
        log = jnp.where(far, 2 * jnp.log(jnp.where(far, size, 1.0)), middle)
        grown = jnp.sign(r) * self.threshold * jnp.sqrt(log)
        return jnp.where(small, r * jnp.sqrt(series), grown)


LOSSES = {"squares": Squares, "huber": Huber, "soft_l1": SoftL1, "cauchy": Cauchy}


def loss_of(given: "Loss | str") -> Loss:
    """A loss by its name, or as it is."""
    if isinstance(given, Loss):
        return given
    known = isinstance(given, str) and given in LOSSES
    refuse(not known, f"loss is {given!r}: give one of {', '.join(LOSSES)}.")
    return LOSSES[given]()
