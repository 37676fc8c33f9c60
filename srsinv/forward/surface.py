"""Surfaces: height h(x), positive into the finger, and local friction at edges.

A surface is a sum of shapes on a smooth plate with a base friction. Edges may have a friction of
their own over a short zone, mu(x) = base + (edge - base) exp(-((x - x_edge)/l)^2); the leading edge
is the one met first (docs/explanation/physics/contact.md).
"""

from collections.abc import Sequence
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, UInt32

from ..compiled import compiled
from ..errors import all_of_kind, number, refuse, whole
from ..grid import Line, Scalar, as_real, wavenumbers
from .shape import (
    FOLLOWS,
    EdgeFriction,
    Shape,
    follows,
    friction,
    not_negative,
    positive,
    real,
    rise,
)


def _raised(x, height, width, position, edge_length) -> Float[Array, " n"]:
    """H/2 [tanh((x - x0 + W/2)/e) - tanh((x - x0 - W/2)/e)]."""
    left, right = x - position + width / 2, x - position - width / 2
    return height * (rise(left, edge_length) - rise(right, edge_length))


class _Raised(Shape):
    """A raised strip."""

    height_m: Float[Array, ""] = eqx.field(converter=real("height_m"))
    width_m: Float[Array, ""] = eqx.field(converter=positive("width_m"))
    position_m: Float[Array, ""] = eqx.field(converter=real("position_m"), default=0.0)
    edge_length_m: Float[Array, ""] = eqx.field(
        converter=not_negative("edge_length_m"), default=1e-5
    )

    def height(self, line: Line) -> Float[Array, " n"]:
        return _raised(line.x, self.height_m, self.width_m, self.position_m, self.edge_length_m)


class Ridge(_Raised):
    """A raised strip (of negative height a groove), its friction that of the plate."""


class Tape(_Raised):
    """A raised strip whose leading and trailing edges have a friction of their own.

    - `friction_zone_length_m`: the length l of both; a friction of None is that of the plate.
    - `friction_follows`: "motion" where the leading edge is the one met first in each direction, so
      that the edges exchange their frictions where the motion turns; "edge" where each edge keeps
      its friction, and the leading one is that met first towards +x.

    Raises `BadInput` for another word.
    """

    edge_length_m: Float[Array, ""] = eqx.field(
        converter=not_negative("edge_length_m"), default=2e-5
    )
    leading_edge_friction: Float[Array, ""] | None = eqx.field(
        converter=friction("leading_edge_friction"), default=None
    )
    trailing_edge_friction: Float[Array, ""] | None = eqx.field(
        converter=friction("trailing_edge_friction"), default=None
    )
    friction_zone_length_m: Float[Array, ""] = eqx.field(
        converter=positive("friction_zone_length_m"), default=0.6e-3
    )
    friction_follows: str = eqx.field(converter=follows, static=True, default=FOLLOWS[0])

    def edges(self, forward: bool) -> tuple[EdgeFriction, ...]:
        left, right = self.position_m - self.width_m / 2, self.position_m + self.width_m / 2
        swaps = self.friction_follows == "motion" and not forward
        places = (right, left) if swaps else (left, right)
        frictions = (self.leading_edge_friction, self.trailing_edge_friction)
        return tuple(
            EdgeFriction(place, friction, self.friction_zone_length_m)
            for place, friction in zip(places, frictions, strict=True)
            if friction is not None
        )


class _Step(Shape):
    """A step, its other edge at the seam of the periodic window."""

    height_m: Float[Array, ""] = eqx.field(converter=real("height_m"))
    position_m: Float[Array, ""] = eqx.field(converter=real("position_m"), default=0.0)
    edge_length_m: Float[Array, ""] = eqx.field(
        converter=not_negative("edge_length_m"), default=2e-5
    )
    edge_friction: Float[Array, ""] | None = eqx.field(
        converter=friction("edge_friction"), default=None
    )
    friction_zone_length_m: Float[Array, ""] = eqx.field(
        converter=positive("friction_zone_length_m"), default=0.6e-3
    )

    def edges(self, forward: bool) -> tuple[EdgeFriction, ...]:
        del forward
        if self.edge_friction is None:
            return ()
        return (EdgeFriction(self.position_m, self.edge_friction, self.friction_zone_length_m),)


class StepUp(_Step):
    """Higher from `position_m` on, up to the end of the window."""

    def height(self, line: Line) -> Float[Array, " n"]:
        return self.height_m * _from(line, self.position_m, self.edge_length_m)


class StepDown(_Step):
    """Higher from the beginning of the window to `position_m`, and lower from there on."""

    def height(self, line: Line) -> Float[Array, " n"]:
        return self.height_m * (1 - _from(line, self.position_m, self.edge_length_m))


def _from(line: Line, position, edge_length) -> Float[Array, " n"]:
    """A plateau of one from `position` to the window's end, both edges alike."""
    start, end = line.x[0] - line.cell_m / 2, line.x[-1] + line.cell_m / 2
    seam = 1 - rise(line.x - start, edge_length) - rise(line.x - end, edge_length)
    return rise(line.x - position, edge_length) + seam


class Ridges(Shape):
    """Ridges on a pitch, as many as the window holds; one at `position_m`.

    With a window of whole pitches the surface is periodic.
    """

    is_periodic: ClassVar[bool] = True
    height_m: Float[Array, ""] = eqx.field(converter=real("height_m"))
    width_m: Float[Array, ""] = eqx.field(converter=positive("width_m"))
    pitch_m: Float[Array, ""] = eqx.field(converter=positive("pitch_m"))
    position_m: Float[Array, ""] = eqx.field(converter=real("position_m"), default=0.0)
    edge_length_m: Float[Array, ""] = eqx.field(
        converter=not_negative("edge_length_m"), default=1e-5
    )

    def height(self, line: Line) -> Float[Array, " n"]:
        from_ridge = (line.x - self.position_m) / self.pitch_m
        # From the nearest ridge; the neighbours' edges reach over where e is not small.
        x = (from_ridge - jnp.round(from_ridge)) * self.pitch_m
        return sum(
            (
                _raised(x, self.height_m, self.width_m, turn * self.pitch_m, self.edge_length_m)
                for turn in (-1, 0, 1)
            ),
            jnp.zeros(line.n),
        )


class Cylinder(Shape):
    """A cylinder across the sliding direction: h = sqrt(R^2 - (x - x0)^2) - R, and flat beyond."""

    radius_m: Float[Array, ""] = eqx.field(converter=positive("radius_m"))
    position_m: Float[Array, ""] = eqx.field(converter=real("position_m"), default=0.0)

    def height(self, line: Line) -> Float[Array, " n"]:
        square = (line.x - self.position_m) ** 2
        above = square < self.radius_m**2
        # R - sqrt(R^2 - x^2) = x^2/(R + sqrt(R^2 - x^2)) keeps its digits for a large radius.
        root = jnp.sqrt(jnp.where(above, self.radius_m**2 - square, 1.0))
        return -jnp.where(above, square / (self.radius_m + root), self.radius_m)


class Bump(Shape):
    """A smooth bump, H exp(-(x - x0)^2/(2 s^2))."""

    height_m: Float[Array, ""] = eqx.field(converter=real("height_m"))
    sigma_m: Float[Array, ""] = eqx.field(converter=positive("sigma_m"))
    position_m: Float[Array, ""] = eqx.field(converter=real("position_m"), default=0.0)

    def height(self, line: Line) -> Float[Array, " n"]:
        return self.height_m * jnp.exp(-(((line.x - self.position_m) / self.sigma_m) ** 2) / 2)


class SineWave(Shape):
    """h = H cos(2 pi (x - x0)/L)."""

    is_periodic: ClassVar[bool] = True
    height_m: Float[Array, ""] = eqx.field(converter=real("height_m"))
    wavelength_m: Float[Array, ""] = eqx.field(converter=positive("wavelength_m"))
    position_m: Float[Array, ""] = eqx.field(converter=real("position_m"), default=0.0)

    def height(self, line: Line) -> Float[Array, " n"]:
        k = 2 * jnp.pi / self.wavelength_m
        return self.height_m * jnp.cos(k * (line.x - self.position_m))


class Rough(Shape):
    """A random rough texture: Gaussian heights, periodic with the window.

    - `rms_m` [m]: rms of the height.
    - `longest_m`, `shortest_m` [m]: wavelengths between which the power spectrum falls as
      k^-(1 + 2 H); it is flat at longer ones. `hurst`: H, from 0 to 1, of a self-affine profile.
    - `seed`: the same one gives the same waves on every line of the same window, however fine.

    Raises `BadInput` for numbers out of these ranges.
    """

    is_periodic: ClassVar[bool] = True
    rms_m: Float[Array, ""]
    longest_m: Float[Array, ""]
    shortest_m: Float[Array, ""]
    hurst: Float[Array, ""]
    seed: UInt32[Array, ""]

    def __init__(self, rms_m, longest_m, shortest_m, hurst: Scalar = 0.8, seed: Any = 0):
        self.rms_m = not_negative("rms_m")(rms_m)
        self.longest_m = positive("longest_m")(longest_m)
        wanted = "a positive length in metres, not above longest_m"
        most = float("inf") if isinstance(longest_m, Tracer) else float(longest_m)
        self.shortest_m = as_real(
            number("surface shortest_m", shortest_m, wanted, above=0, most=most)
        )
        self.hurst = as_real(
            number("surface hurst", hurst, "a number from 0 to 1", least=0, most=1)
        )
        wanted = "a whole number, 0 or more"
        self.seed = jnp.asarray(whole("surface seed", seed, wanted, least=0), "uint32")

    def power(self, k: Float[Array, " k"]) -> Float[Array, " k"]:
        """The spectrum, up to a factor."""
        roll_off, cut_off = 2 * jnp.pi / self.longest_m, 2 * jnp.pi / self.shortest_m
        fall = (jnp.maximum(k, roll_off) / roll_off) ** -(1 + 2 * self.hurst)
        return jnp.where((k > 0) & (k <= cut_off), fall, 0.0 * cut_off)  # 0, or NaN as that is

    def height(self, line: Line) -> Float[Array, " n"]:
        k = wavenumbers(line.n, line.cell_m)
        # Wave by wave from its own key, so that a finer line adds waves and changes none; the last
        # one of an even line stands for two and is left out.
        keys = jax.vmap(jax.random.fold_in, (None, 0))(
            jax.random.key(self.seed), np.arange(k.size, dtype=np.uint32)
        )
        parts = jax.vmap(lambda key: jax.random.normal(key, (2,)))(keys)
        inside = np.arange(k.size) < (line.n + 1) // 2
        power = jnp.where(inside, self.power(k), 0.0)
        amplitude = jnp.sqrt(jnp.where(power > 0, power, 1.0)) * (power > 0)
        wave = amplitude * (parts[:, 0] + 1j * parts[:, 1])
        # Half a cell lies between the window's start and the first cell.
        wave = wave * jnp.exp(0.5j * k * line.cell_m)
        height = jnp.fft.irfft(wave, line.n) * line.n
        expected = jnp.sqrt(4 * jnp.sum(power))
        return self.rms_m * height / jnp.where(expected == 0, 1.0, expected)


class Profile(Shape):
    """A measured profile: heights (sample,) at increasing positions, straight lines between them,
    and level beyond its ends."""

    position_m: Float[Array, " sample"]
    profile_m: Float[Array, " sample"]

    def __init__(self, position_m, profile_m):
        x, h = np.asarray(position_m, float), np.asarray(profile_m, float)
        refuse(
            x.ndim != 1 or x.shape != h.shape or x.size < 2,
            f"surface profile has positions of shape {x.shape} and heights of shape {h.shape}: "
            "give two columns of the same length, at least 2 samples.",
        )
        refuse(
            not (np.isfinite(x).all() and np.isfinite(h).all()),
            "surface profile holds values that are not finite: correct or leave them out.",
        )
        refuse(
            bool((np.diff(x) <= 0).any()),
            "surface profile: the positions must increase strictly: sort them and leave out "
            "repetitions.",
        )
        self.position_m, self.profile_m = as_real(x), as_real(h)

    def height(self, line: Line) -> Float[Array, " n"]:
        return jnp.interp(line.x, self.position_m, self.profile_m)


OneShape = TypeVar("OneShape", bound=Shape)


class Surface(eqx.Module):
    """The sum of shapes on a plate of friction `base_friction`."""

    shapes: tuple[Shape, ...]
    base_friction: Float[Array, ""]

    def __init__(self, shapes: Sequence[Shape] = (), base_friction: Scalar = 0.0):
        self.shapes = all_of_kind("surfaces", shapes, Shape, "shapes, as [Ridge(4e-5, 6e-4, 0.0)]")
        self.base_friction = real("base_friction")(base_friction)

    def only(self, kind: type[OneShape]) -> OneShape | None:
        """Its only shape, where that is of this kind, else None."""
        shape = self.shapes[0] if len(self.shapes) == 1 else None
        return shape if isinstance(shape, kind) else None

    @compiled
    def height(self, line: Line) -> Float[Array, " n"]:
        """Height [m] at the cell centres."""
        return sum((shape.height(line) for shape in self.shapes), jnp.zeros(line.n))

    @compiled
    def friction(self, line: Line, forward: bool = True) -> Float[Array, " n"]:
        """mu at the cell centres, `forward` for sliding towards +x."""
        mu = jnp.full(line.n, self.base_friction)
        for edge in (edge for shape in self.shapes for edge in shape.edges(forward)):
            mu = mu + (edge.friction - self.base_friction) * edge.weight(line.x)
        return mu
