"""Scenes: pressure and friction along the line."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ..errors import number, refuse, whole
from ..grid import Line, Scalar, as_real
from .contact import Contact, press
from .contact_wake import press_with_wake
from .skin import HalfSpace, Skin
from .surface import Shape, Surface
from .traction import FrictionStep, Pressure


class Scene(eqx.Module):
    """A scene for the finger to slide over, with Coulomb friction q = sign(u) mu(x) p."""

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
    def as_surface(self) -> "SurfaceScene | None":
        """The scene where it is one of a surface in contact with the skin, else None."""
        return None

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
    if isinstance(scene, SurfaceScene):
        p = scene.pressure(line) if p is None else jnp.asarray(p)
        scene = eqx.tree_at(
            lambda surface_scene: surface_scene.skin, scene, None
        )  # not used once p is solved: one program serves all skins
    return _deviation(scene, line, direction, periodic, p)


@eqx.filter_jit
def _deviation(scene: Scene, line: Line, direction: Scalar, periodic: bool, p):
    whole = scene.traction(line, direction, p)
    return whole if periodic else whole - scene.background(direction)[:, None]


class TractionScene(Scene):
    """Features of pressure over a background.

    - `background_pressure_Pa` and `base_friction`: values without any feature.
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
    """Shapes on a plate of friction `base_friction`, pressed on by a skin.

    - `nominal_pressure_Pa`: the mean over the line's window, with which the surface repeats.
    - `contact_windows`: how many such windows the contact repeats with, the skin free in all but
      the line's. None: one; as many as its wake asks (contact_wake.py) where the skin lags and
      touches in the window's midst alone.

    Raises `BadInput` for a pressure that is not positive, a number of windows below 1, and several
    windows about a shape that goes on beyond the first.
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
        number("scene.nominal_pressure_Pa", nominal_pressure_Pa, wanted, above=0)
        self.nominal_pressure_Pa = as_real(nominal_pressure_Pa)
        self.surface = Surface(surfaces, base_friction)
        self.skin = HalfSpace() if skin is None else skin
        self.contact_windows = self._windows(contact_windows)

    def _windows(self, given: Any) -> int | None:
        key, wanted = "scene.contact_windows", "a whole number from 1, or null to let the skin tell"
        windows = None if given is None else whole(key, given, wanted, least=1)
        refuse(
            windows not in (None, 1) and self._goes_on,
            f"{key} is {windows}, but the surface goes on beyond its window, where the skin would "
            "be free: leave it at null, or give a longer grid.length_m.",
        )
        return windows

    @property
    def as_surface(self) -> "SurfaceScene":
        return self

    @property
    def _goes_on(self) -> bool:
        return any(shape.is_periodic for shape in self.surface.shapes)

    def contact(self, line: Line) -> Contact:
        """Contact of the skin with the surface."""
        given = (line, self.skin, self.height(line), self.nominal_pressure_Pa)
        # A wake that meets the next period of a surface that has one is right as it is.
        return press(*given) if self._goes_on else press_with_wake(*given, self.contact_windows)

    def warnings(self, line: Line) -> tuple[str, ...]:
        return self.contact(line).warnings

    def height(self, line: Line) -> Float[Array, " n"]:
        """Surface height [m] at the cell centres: a program of its own, whatever the skin."""
        return _height(self.surface, line)

    def friction(self, line: Line, direction: Scalar = 1.0) -> Float[Array, " n"]:
        forward, backward = (self.surface.friction(line, way) for way in (True, False))
        return jnp.where(direction < 0, backward, forward)

    def background(self, direction: Scalar = 1.0) -> Float[Array, "2"]:
        p = self.nominal_pressure_Pa
        return jnp.stack([p, direction * self.surface.base_friction * p])

    def pressure(self, line: Line) -> Float[Array, " n"]:
        return self.contact(line).pressure_Pa


@eqx.filter_jit
def _height(surface: Surface, line: Line) -> Float[Array, " n"]:
    return surface.height(line)
