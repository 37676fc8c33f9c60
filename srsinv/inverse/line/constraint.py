"""What is known of the traction beside its spectrum: it does not pull, friction bounds it, it has
edges.

A contact cannot pull, so p >= 0, and Coulomb's law bounds the shear, |q| <= mu p. Where a surface
touches in part, much of the line has no traction at all, which no Gaussian prior knows. A
constraint restricts a method's Gaussian prior to what is admissible; edges replace it by one whose
differences of neighbouring cells are Laplace's.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...errors import number, of_kind, refuse, whole

Traction = Float[Array, "*draw c n"]
FEWEST_DRAWS = 19  # of which the least and the greatest are the ends of a 90 % band
MOST_DRAWS = 10_000


class Constraint(eqx.Module):
    """Base of constraints: the set that the whole traction lies in, and the order of differences
    that have Laplace's distribution.

    - `draws`: how many draws of the posterior the bands are made from.

    `project` is to be defined.
    """

    draws: eqx.AbstractVar[int]
    is_active: ClassVar[bool] = True  # whether anything is known beside the Gaussian prior
    bounds_pressure: ClassVar[bool] = False  # whether p >= 0

    @property
    def greatest_friction(self) -> float | None:
        """The greatest |q|/p; None where shear is not bounded."""
        return None

    @property
    def laplace_order(self) -> int:
        """Order of the differences whose prior is Laplace's; 0 where none is."""
        return 0

    @abc.abstractmethod
    def project(self, traction: Traction, weights: Float[Array, " c"]) -> Traction:
        """The admissible traction nearest to `traction` (..., c, n) [Pa] in every cell, by squares
        with `weights` (c,) of the components."""


class Gaussian(Constraint):
    """No constraint: a method's Gaussian prior as it is."""

    is_active: ClassVar[bool] = False
    draws: int = eqx.field(static=True, default=FEWEST_DRAWS, init=False)

    def project(self, traction: Traction, weights: Float[Array, " c"]) -> Traction:
        del weights
        return traction


class Admissible(Constraint):
    """A contact does not pull, p >= 0, and Coulomb's law bounds the shear, |q| <= mu p.

    - `friction_max`: the greatest friction coefficient mu, above 0; None: shear is not bounded.
    - `draws`: how many draws of the posterior the bands are made from, from 19.

    Raises `BadInput` for other values.
    """

    bounds_pressure: ClassVar[bool] = True
    friction_max: float | None = eqx.field(static=True)
    draws: int = eqx.field(static=True)

    def __init__(self, friction_max: Any = None, draws: Any = 199):
        if friction_max is not None:
            wanted = "a positive friction coefficient, or null where shear is not bounded"
            friction_max = float(number("prior.friction_max", friction_max, wanted, above=0))
        self.friction_max = friction_max
        self.draws = _checked_draws(draws)

    @property
    def greatest_friction(self) -> float | None:
        return self.friction_max

    def project(self, traction: Traction, weights: Float[Array, " c"]) -> Traction:
        p = traction[..., :1, :]
        if self.friction_max is None or traction.shape[-2] == 1:
            return jnp.concatenate([jnp.maximum(p, 0.0), traction[..., 1:, :]], axis=-2)
        return onto_cone(traction, self.friction_max, weights)


class Edges(Constraint):
    """A traction of plateaus, or of straight pieces, between sharp edges.

    Differences of neighbouring cells have Laplace's distribution, of the variance that they have
    under the method's Gaussian prior: of order 1, the total variation; of order 2, sparse changes
    of slope.

    - `order`: of the differences, 1 or 2.
    - `draws`: how many draws of the noise the bands are made from, from 19; a draw takes a hundred
      times as long as one of [`Admissible`][].

    Bands hold the noise's errors alone.

    Raises `BadInput` for other values.
    """

    order: int = eqx.field(static=True)
    draws: int = eqx.field(static=True)

    def __init__(self, order: Any = 1, draws: Any = 19):
        self.order = whole("prior.order", order, "1 or 2", least=1, most=2)
        self.draws = _checked_draws(draws)

    @property
    def laplace_order(self) -> int:
        return self.order

    def project(self, traction: Traction, weights: Float[Array, " c"]) -> Traction:
        del weights
        return traction


def checked_constraint(key: str, given: Any) -> Constraint:
    """The constraint of a method's argument, [`Gaussian`][] where it is None."""
    wanted = (
        "a constraint, such as Admissible(), or on the command line prior=admissible, edges or "
        f"gaussian in place of {key}"
    )
    return of_kind(key, Gaussian() if given is None else given, Constraint, wanted)


def refuse_constraint(constraint: Constraint) -> None:
    """Refuse a constraint where a Gaussian prior alone is taken."""
    refuse(
        constraint.is_active,
        f"{type(constraint).__name__} is no Gaussian prior, which this needs: give prior=gaussian, "
        "or leave the method's constraint out.",
    )


def _checked_draws(draws: Any) -> int:
    wanted = f"a whole number from {FEWEST_DRAWS} to {MOST_DRAWS}"
    return whole("prior.draws", draws, wanted, least=FEWEST_DRAWS, most=MOST_DRAWS)


def onto_cone(traction: Traction, friction_max: Any, weights: Float[Array, " c"]) -> Traction:
    """The traction (..., 2, n) with |q| <= `friction_max` p nearest to `traction` in every cell, by
    squares with `weights` (2,): itself, a point of the cone's side, or nothing."""
    p, q = traction[..., 0, :], traction[..., 1, :]
    # In units in which both components weigh the same.
    ratio = weights[1] / weights[0]
    slope = friction_max * friction_max * ratio
    along = jnp.maximum((p + ratio * friction_max * jnp.abs(q)) / (1 + slope), 0.0)
    is_inside = jnp.abs(q) <= friction_max * p
    on_side = jnp.stack([along, jnp.sign(q) * friction_max * along], axis=-2)
    return jnp.where(is_inside[..., None, :], traction, on_side)


def shrunk(values: Float[Array, "..."], by: Any) -> Float[Array, "..."]:
    """Values moved towards zero by so much, and those that are nearer to zero put there."""
    return jnp.sign(values) * jnp.maximum(jnp.abs(values) - by, 0.0)
