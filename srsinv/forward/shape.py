"""What a surface is made of: the base of its shapes, and their edges.

[`real`][] and the like convert the numbers that a shape is given, by the name of its field; those
that are out of range are refused.
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import echo, number, refuse
from ..grid import Line, as_real


class EdgeFriction(eqx.Module):
    """The friction of an edge at `position_m`, instead of the base's, over about `length_m`."""

    position_m: Float[Array, ""]
    friction: Float[Array, ""]
    length_m: Float[Array, ""]

    def weight(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """Weight of the edge's friction against the base's: exp(-((x - x_edge)/l)^2)."""
        return jnp.exp(-(((x - self.position_m) / self.length_m) ** 2))


class Shape(eqx.Module):
    """Base of shapes on a surface: a height [m] along x, positive into the finger.

    `height` is to be defined. `is_periodic`: whether the shape goes on beyond the window for ever.
    """

    is_periodic: ClassVar[bool] = False

    @abc.abstractmethod
    def height(self, line: Line) -> Float[Array, " n"]:
        """Height [m] at the cell centres."""

    def edges(self, forward: bool) -> tuple[EdgeFriction, ...]:
        """Edges with a friction of their own, `forward` for sliding towards +x."""
        del forward
        return ()


def rise(x: Float[Array, " n"], edge_length_m: Float[Array, ""]) -> Float[Array, " n"]:
    """A smooth step from 0 to 1 at x = 0, tanh over `edge_length_m`; vertical where that is 0."""
    sharp = edge_length_m <= 0
    smooth = jnp.tanh(x / jnp.where(sharp, 1.0, edge_length_m))
    return 0.5 * (1 + jnp.where(sharp, jnp.sign(x), smooth))


Conversion = Callable[[Any], Any]


FOLLOWS = "motion", "edge"  # what an edge's friction goes by where the motion turns


def follows(value: Any) -> str:
    """One of `FOLLOWS`."""
    refuse(
        value not in FOLLOWS,
        f"friction_follows is {echo(value)}: give motion (the edge met first is "
        "leading) or edge (edges keep their friction).",
    )
    return value


def real(name: str) -> Conversion:
    """Of a number of either sign."""
    return lambda value: as_real(number(f"surface {name}", value, "a number, in SI units"))


def positive(name: str) -> Conversion:
    """Of a number above 0."""
    wanted = "a positive number, in SI units"
    return lambda value: as_real(number(f"surface {name}", value, wanted, above=0))


def not_negative(name: str) -> Conversion:
    """Of a length that may be 0."""
    wanted = "a length in metres, 0 or more"
    return lambda value: as_real(number(f"surface {name}", value, wanted, least=0))


def friction(name: str) -> Conversion:
    """Of a friction, or None for that of the plate."""
    wanted = "a number, of either sign, or null for that of the plate"
    return lambda value: (
        None if value is None else as_real(number(f"surface {name}", value, wanted))
    )
