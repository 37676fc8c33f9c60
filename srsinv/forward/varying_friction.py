"""Friction that varies with pressure and speed: rubber rubs less where it is pressed harder.

Coulomb's friction has one coefficient. The area that rubber really touches grows more slowly than
the load, as its two-thirds power between single spheres, so that the coefficient falls as
(p/p0)^(-a), a from 0 to 1/3 (Schallamach 1952). It also varies with the speed, over a few decades
about as (|u|/u0)^b (Persson 2001, who derives the whole curve).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ..errors import number, of_kind, refuse
from ..grid import Line, Scalar, as_real
from .scene import Scene, SurfaceScene
from .skin import Skin

MOST_EXPONENT = 1.0  # of the pressure, where shear no longer grows with it


class RubberFriction(Scene):
    """A `scene` whose friction is its own mu times (p/p0)^(-a) (|u|/u0)^b, one direction of motion
    as the other: q = mu p.

    - `pressure_exponent`: a, from 0 to 1. `reference_pressure_Pa` [Pa]: p0, where the scene's mu
      holds; None: its background pressure.
    - `speed_exponent`: b. `relative_speed`: |u|/u0.

    Pressures that are not positive rub as they do without the law. Raises `BadInput` for numbers
    out of range, and without a reference where the background has no pressure.
    """

    scene: Scene
    pressure_exponent: Float[Array, ""]
    reference_pressure_Pa: Float[Array, ""]
    speed_factor: Float[Array, ""]
    is_of_speed: bool = eqx.field(static=True)

    def __init__(
        self,
        scene: Scene,
        pressure_exponent: Any,
        reference_pressure_Pa: Any = None,
        speed_exponent: Any = 0.0,
        relative_speed: Any = 1.0,
    ):
        self.scene = of_kind("scene", scene, Scene, "a TractionScene or a SurfaceScene")
        key, wanted = "varying_friction", f"a number from 0 to {MOST_EXPONENT:g}"
        exponent = number(
            f"{key}.pressure_exponent", pressure_exponent, wanted, least=0, most=MOST_EXPONENT
        )
        self.pressure_exponent = as_real(exponent)
        if reference_pressure_Pa is None:
            reference_pressure_Pa = scene.background()[0]
        wanted = "a positive pressure in Pa, where the scene's friction holds"
        name = f"{key}.reference_pressure_Pa"
        self.reference_pressure_Pa = as_real(number(name, reference_pressure_Pa, wanted, above=0))
        exponent = number(f"{key}.speed_exponent", speed_exponent, "a number")
        self.is_of_speed = not (isinstance(exponent, int | float) and exponent == 0)
        wanted = "a positive ratio of speeds"
        ratio = as_real(number(f"{key}.relative_speed", relative_speed, wanted, above=0))
        self.speed_factor = ratio**exponent

    def factor(self, p: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The friction over the scene's, under pressures of any shape [Pa]."""
        touches = p > 0
        relative = jnp.where(touches, p, 1.0) / jnp.where(touches, self.reference_pressure_Pa, 1.0)
        return self.speed_factor * relative**-self.pressure_exponent

    @property
    def follows_speed(self) -> bool:
        return self.is_of_speed

    @property
    def pressed(self) -> SurfaceScene | None:
        return self.scene.pressed

    def with_skin(self, skin: Skin) -> "RubberFriction":
        return self._with(self.scene.with_skin(skin))

    def solved(
        self, line: Line, p: Float[ArrayLike, " n"] | None
    ) -> tuple["RubberFriction", Float[ArrayLike, " n"] | None]:
        scene, p = self.scene.solved(line, p)
        return self._with(scene), p

    def warnings(self, line: Line) -> tuple[str, ...]:
        return self.scene.warnings(line)

    def friction(self, line: Line, direction: Scalar = 1.0) -> Float[Array, " n"]:
        return self.scene.friction(line, direction) * self.factor(self.pressure(line))

    def background(self, direction: Scalar = 1.0) -> Float[Array, "2"]:
        p, q = self.scene.background(direction)
        return jnp.stack([p, q * self.factor(p)])

    def pressure(self, line: Line) -> Float[Array, " n"]:
        return self.scene.pressure(line)

    def traction(
        self, line: Line, direction: Scalar = 1.0, p: Float[Array, " n"] | None = None
    ) -> Float[Array, "2 n"]:
        p = self.pressure(line) if p is None else p
        friction = self.scene.friction(line, direction) * self.factor(p)
        return jnp.stack([p, direction * friction * p])

    def _with(self, scene: Scene) -> "RubberFriction":
        return eqx.tree_at(lambda own: own.scene, self, scene)


def refuse_uneven(scene: Scene, is_uneven: bool) -> None:
    """Refuse friction that follows the speed along a motion whose speed varies."""
    refuse(
        is_uneven and scene.follows_speed,
        "The friction follows the speed, which varies along this motion: give "
        "effects.varying_friction.speed_exponent=0, or leave speed_ripple, standstill and reversal "
        "out of effects.",
    )
