"""Scenes: pressure and friction along the line."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ..compiled import compiled
from ..errors import all_of_kind, number, of_kind, refuse, whole
from ..grid import Line, Scalar, as_real
from .contact import Contact, press
from .contact_wake import press_with_wake
from .shape import Shape
from .skin import HalfSpace, Skin
from .surface import Surface
from .traction import FrictionStep, Pressure


class Scene(eqx.Module):
    """Base of scenes: pressure p(x) [Pa] and Coulomb friction q = sign(u) mu(x) p.

    `friction`, `background` and `pressure` are to be defined.
    """

    @abc.abstractmethod
    def friction(self, line: Line, direction: Scalar = 1.0) -> Float[Array, " n"]:
        """mu at the cell centres, for sliding along `direction` = sign(u)."""

    @abc.abstractmethod
    def background(self, direction: Scalar = 1.0) -> Float[Array, "2"]:
        """(p, q) [Pa] far from every feature."""

    @abc.abstractmethod
    def pressure(self, line: Line) -> Float[Array, " n"]:
        """Cell averages of p [Pa]."""

    @property
    def pressed(self) -> "SurfaceScene | None":
        """The surface that the skin is pressed on, whatever its friction; None where the pressure
        is given."""
        return self.contact_scene

    @property
    def follows_speed(self) -> bool:
        """Whether its friction depends on the sliding speed."""
        return False

    @property
    def contact_scene(self) -> "SurfaceScene | None":
        """The surface that the skin is pressed on; None where the pressure is given."""
        return None

    def with_skin(self, skin: Skin) -> "Scene":
        """The scene with another skin in contact with it."""
        del skin
        return self

    def solved(
        self, line: Line, p: Float[ArrayLike, " n"] | None
    ) -> tuple["Scene", Float[ArrayLike, " n"] | None]:
        """The scene without its surface and skin, and its pressure. `p`: the pressure, if it is
        known already."""
        del line
        return self, p

    def warnings(self, line: Line) -> tuple[str, ...]:
        """Warnings about the traction on `line`."""
        del line
        return ()

    def traction(
        self, line: Line, direction: Scalar = 1.0, p: Float[Array, " n"] | None = None
    ) -> Float[Array, "2 n"]:
        """Cell averages of (p, q) [Pa], for sliding along `direction` = sign(u); `p` where the
        pressure is known already.

        q is mu at the cell's centre times the cell average of p: second order in the cell where
        mu is smooth, and exact where it is constant.
        """
        p = self.pressure(line) if p is None else p
        return jnp.stack([p, direction * self.friction(line, direction) * p])


def deviation(
    scene: Scene,
    line: Line,
    direction: Scalar,
    periodic: bool,
    p: Float[ArrayLike, " n"] | None = None,
) -> Float[Array, "2 n"]:
    """The traction that a line holds: all of it on a periodic one, where it repeats; on an open one
    its deviation from the background, which has no end. `p` where the pressure of a contact is
    known already.

    Programs of their own, as many ask for the same traction; that of the contact, which is long to
    compile, serves every elastic skin.
    """
    return _deviation(*scene.solved(line, p), line, direction, periodic)


@compiled
def _deviation(scene: Scene, p, line: Line, direction: Scalar, periodic: bool):
    whole = scene.traction(line, direction, p)
    return whole if periodic else whole - scene.background(direction)[:, None]


class TractionScene(Scene):
    """A scene of given traction: pressure profiles and steps of friction over a background.

    - `background_pressure_Pa` [Pa] and `base_friction`: values without any feature.
    - `pressures`: added to the background; `frictions`: added to the base, of either sign.

    Raises `BadInput` for a background or a base that is not a finite number, and for parts of
    another kind.
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
        key = "scene.background_pressure_Pa"
        self.background_pressure_Pa = as_real(
            number(key, background_pressure_Pa, "a pressure in Pa")
        )
        self.base_friction = as_real(
            number("scene.base_friction", base_friction, "a number, of either sign")
        )
        kinds = "pressures, as [UniformStrip(1e4, 2e-3, 0.0)]"
        self.pressures = all_of_kind("pressures", pressures, Pressure, kinds)
        kinds = "friction steps, as [FrictionStep(0.1, 0.0)]"
        self.frictions = all_of_kind("frictions", frictions, FrictionStep, kinds)

    def friction(self, line: Line, direction: Scalar = 1.0) -> Float[Array, " n"]:
        del direction
        return self.base_friction + sum((f(line.x) for f in self.frictions), jnp.zeros(line.n))

    def background(self, direction: Scalar = 1.0) -> Float[Array, "2"]:
        p = self.background_pressure_Pa
        return jnp.stack([p, direction * self.base_friction * p])

    def pressure(self, line: Line) -> Float[Array, " n"]:
        p = sum((f.cell_average(line) for f in self.pressures), jnp.zeros(line.n))
        return p + self.background_pressure_Pa


class SurfaceScene(Scene):
    """A scene of a surface: shapes on a plate, which a skin is pressed onto and slides over.

    - `surfaces`: the shapes; their heights add up. `base_friction`: mu of the plate.
    - `skin`: in contact with it; None: a homogeneous half space.
    - `nominal_pressure_Pa` [Pa]: the mean over the line's window, with which the surface repeats.
    - `contact_windows`: how many such windows the contact repeats with, the skin free in all but
      the line's. None: one; as many as its wake asks where the skin lags and
      touches in the window's midst alone.

    Raises `BadInput` for a pressure that is not positive, parts of another kind, a number of
    windows below 1, and several windows about a shape that goes on beyond the first.
    """

    nominal_pressure_Pa: Float[Array, ""]
    surface: Surface
    skin: Skin
    contact_windows: int | None = eqx.field(static=True)

    def __init__(
        self,
        nominal_pressure_Pa,
        surfaces: Sequence[Shape] = (),
        base_friction: Scalar = 0.0,
        skin: Skin | None = None,
        contact_windows: Any = None,
    ):
        wanted = "a positive pressure in Pa, the mean over the window"
        self.nominal_pressure_Pa = as_real(
            number("scene.nominal_pressure_Pa", nominal_pressure_Pa, wanted, above=0)
        )
        self.surface = Surface(surfaces, base_friction)
        skin = HalfSpace() if skin is None else skin
        self.skin = of_kind("skin", skin, Skin, "a skin, such as HalfSpace()")
        key, wanted = (
            "scene.contact_windows",
            "a whole number from 1, or null to choose it automatically",
        )
        if contact_windows is not None:
            contact_windows = whole(key, contact_windows, wanted, least=1)
        refuse(
            contact_windows not in (None, 1) and self._goes_on,
            f"{key} is {contact_windows}, but the surface continues beyond its window: "
            "leave it null.",
        )
        self.contact_windows = contact_windows

    @property
    def _goes_on(self) -> bool:
        return any(shape.is_periodic for shape in self.surface.shapes)

    @property
    def contact_scene(self) -> "SurfaceScene":
        return self

    def with_skin(self, skin: Skin) -> "SurfaceScene":
        return eqx.tree_at(lambda scene: scene.skin, self, skin)

    def solved(
        self, line: Line, p: Float[ArrayLike, " n"] | None
    ) -> tuple["SurfaceScene", Float[Array, " n"]]:
        p = self.pressure(line) if p is None else jnp.asarray(p)
        # The skin is not used once p is solved: one program serves all skins.
        return eqx.tree_at(lambda scene: scene.skin, self, None), p

    def contact(self, line: Line) -> Contact:
        """Contact of the skin with the surface."""
        given = (line, self.skin, self.height(line), self.nominal_pressure_Pa)
        # A wake that meets the next period of a surface that has one is right as it is.
        return press(*given) if self._goes_on else press_with_wake(*given, self.contact_windows)

    def warnings(self, line: Line) -> tuple[str, ...]:
        return self.contact(line).warnings

    def height(self, line: Line) -> Float[Array, " n"]:
        """Surface height [m] at the cell centres. It has a compiled program of its own, the same
        for all skins."""
        return _height(self.surface, line)

    def friction(self, line: Line, direction: Scalar = 1.0) -> Float[Array, " n"]:
        forward, backward = (self.surface.friction(line, direction) for direction in (True, False))
        return jnp.where(direction < 0, backward, forward)

    def background(self, direction: Scalar = 1.0) -> Float[Array, "2"]:
        p = self.nominal_pressure_Pa
        return jnp.stack([p, direction * self.surface.base_friction * p])

    def pressure(self, line: Line) -> Float[Array, " n"]:
        return self.contact(line).pressure_Pa


@compiled
def _height(surface: Surface, line: Line) -> Float[Array, " n"]:
    return surface.height(line)
