"""What lies on the line: pressure and friction, and the window they are seen in."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import number
from ..grid import Line, as_real
from .traction import FrictionStep, Pressure, Scalar


class Scene(eqx.Module):
    """Pressure features over a background, with Coulomb friction q = sign(u) mu(x) p.

    - `background_pressure_Pa` and `base_friction`: what is there without any feature.
    - `pressures`: added to the background; `frictions`: added to the base, of either sign.

    Raises `BadInput` for a background or a base that is not a finite number.
    """

    background_pressure_Pa: Float[Array, ""]
    base_friction: Float[Array, ""]
    pressures: tuple[Pressure, ...]
    frictions: tuple[FrictionStep, ...]

    def __init__(
        self,
        background_pressure_Pa=0.0,
        base_friction=0.0,
        pressures: Sequence[Pressure] = (),
        frictions: Sequence[FrictionStep] = (),
    ):
        number("scene.background_pressure_Pa", background_pressure_Pa, "a pressure in Pa")
        number("scene.base_friction", base_friction, "a number, of either sign")
        self.background_pressure_Pa = as_real(background_pressure_Pa)
        self.base_friction = as_real(base_friction)
        self.pressures, self.frictions = tuple(pressures), tuple(frictions)

    def friction(self, line: Line) -> Float[Array, " n"]:
        """mu at the cell centres."""
        return self.base_friction + sum((f(line.x) for f in self.frictions), jnp.zeros(line.n))

    def background(self, direction: Scalar = 1.0) -> Float[Array, "2"]:
        """(p, q) [Pa] far from every feature."""
        p = self.background_pressure_Pa
        return jnp.stack([p, direction * self.base_friction * p])

    def traction(self, line: Line, direction: Scalar = 1.0) -> Float[Array, "2 n"]:
        """Cell averages of (p, q) [Pa], for sliding along `direction` = sign(u).

        q is mu at the cell's centre times the cell average of p: second order in the cell where
        mu is smooth, and exact where it is constant.
        """
        p = sum((f.cell_average(line) for f in self.pressures), jnp.zeros(line.n))
        p = p + self.background_pressure_Pa
        return jnp.stack([p, direction * self.friction(line) * p])
