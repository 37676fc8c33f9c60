"""The stress under straight features, in the axes of the sensor or of a strip turned in the plane.

The features' normal xi makes the angle phi with x; eta runs along them. A strip whose axes are
turned by psi about z responds as one along x to features whose normal is at phi - psi
(docs/explanation/physics/oblique.md).
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Inexact

from ..compiled import compiled
from ..errors import number
from ..grid import as_real
from .antiplane import Antiplane
from .film import Film, Kernel, LineEffect, StripAverage
from .skin import HalfSpace, Skin

# Enough for a strip of 15 depths: Gauss's rule converges as in `StripAverage.at_depth`.
LENGTH_NODES = 128


def cosine(angle_rad: Float[Array, ""]) -> Float[Array, ""]:
    """cos(phi), exactly 0 at a right angle."""
    away = jnp.where(angle_rad < 0, -angle_rad, angle_rad)
    return jnp.sin(jnp.pi / 2 - away)


class TurnedSkin(Skin):
    """A skin under features whose normal makes the angle `angle_rad` with x.

    x of its methods is xi, across the features. Rows are stress in the axes' frame (sigma_x,
    sigma_z, tau_xz, sigma_y), columns (p, q) with q along the sliding direction. That is x, unless
    `sliding_rad` gives the angle from it to the normal. Contact is in the (xi, z) plane, as under
    the skin itself.
    """

    skin: Skin
    angle_rad: Float[Array, ""]
    sliding_rad: Float[Array, ""]

    def __init__(self, skin: Skin, angle_rad, sliding_rad=None):
        self.skin = skin
        self.angle_rad = as_real(number("angle_rad", angle_rad, "an angle in radians"))
        given = angle_rad if sliding_rad is None else sliding_rad
        self.sliding_rad = as_real(number("sliding_rad", given, "an angle in radians"))

    @property
    def words(self) -> str:
        return f"{self.skin.words}, features turned by {math.degrees(self.angle_rad):.4g} degrees"

    @property
    def antiplane(self) -> Antiplane:
        return self.skin.antiplane

    def compliance(self, k: Float[Array, " k"]) -> Inexact[Array, " k"]:
        return self.skin.compliance(k)

    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "4 2 k"]:
        plane = self.skin.transfer(k, depth_m)
        return self.turned_back(plane, self.antiplane.transfer(k, depth_m))

    def transfer_once(self, k: np.ndarray, depth_m: float) -> Complex[np.ndarray, "4 2 k"]:
        plane = jnp.asarray(self.skin.transfer_once(k, depth_m))
        across = self.antiplane.transfer(as_real(k), as_real(depth_m))
        # The skin has done its part: one program serves all skins.
        turns = self.angle_rad, self.sliding_rad
        return np.asarray(TurnedSkin(HalfSpace(), *turns).turned_back(plane, across))

    @compiled
    def turned_back(self, plane: Complex[Array, "4 2 k"], antiplane: Complex[Array, "2 k"]):
        """Stress in the sensor's frame (4, 2, k), of that in plane strain and of that in antiplane
        shear, under (p, q)."""
        return self._sliding(self._in_frame(plane, antiplane))

    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        plane = self.skin.strip_response(x, depth_m, width_m)
        antiplane = self.antiplane.strip_response(x, depth_m, width_m)
        return self._sliding(self._in_frame(plane, antiplane))

    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        plane = self.skin.strip_slope(x, depth_m, width_m)
        antiplane = self.antiplane.strip_slope(x, depth_m, width_m)
        return self._sliding(self._in_frame(plane, antiplane))

    def transfer_to_each(
        self, weights: Float[Array, "4"], k: Float[Array, " k"], depth_m: Float[Array, ""]
    ) -> Complex[Array, "3 k"]:
        """The sum of stress in the axes' frame times `weights` under unit traction exp(ikx): p,
        shear along xi and shear along eta separately."""
        plane = self.skin.transfer(k, depth_m)
        return self._weighed(weights, plane, self.antiplane.transfer(k, depth_m))

    def strip_to_each(
        self,
        weights: Float[Array, "4"],
        x: Float[Array, " x"],
        depth_m: Float[Array, ""],
        width_m: Float[Array, ""],
        order: int,
    ) -> Float[Array, "3 x"]:
        """The same sum under a strip of unit traction; where `order` is 1 its slope, in 1/m."""
        at = x, depth_m, width_m
        if order:
            plane, antiplane = self.skin.strip_slope(*at), self.antiplane.strip_slope(*at)
        else:
            plane, antiplane = self.skin.strip_response(*at), self.antiplane.strip_response(*at)
        return self._weighed(weights, plane, antiplane)

    def _in_frame(self, plane, antiplane) -> Array:
        """Stress in the axes' frame (4, 3, ...) under p, q_xi and q_eta."""
        c, s = cosine(self.angle_rad), jnp.sin(self.angle_rad)
        xi, z, xi_z, eta = plane
        along = jnp.stack(
            [c**2 * xi + s**2 * eta, z, c * xi_z, s**2 * xi + c**2 * eta]
        )  # fmt: skip
        twist = 2 * s * c * antiplane[0]
        across = jnp.stack([-twist, jnp.zeros_like(twist), -s * antiplane[1], twist])
        return jnp.concatenate([along, across[:, None]], axis=1)

    def _weighed(self, weights, plane, antiplane) -> Array:
        """The stress in the axes' frame under p, q_xi and q_eta times `weights`, (3, ...): in one
        sum, as the frame's twelve rows would take most of a program's time and memory."""
        c, s = cosine(self.angle_rad), jnp.sin(self.angle_rad)
        x, z, x_z, y = weights
        rows = c**2 * x + s**2 * y, z, c * x_z, s**2 * x + c**2 * y
        along = sum(weight * row for weight, row in zip(rows, plane, strict=True))
        across = 2 * s * c * (y - x) * antiplane[0] - s * x_z * antiplane[1]
        return jnp.concatenate([along, across[None]])

    def _sliding(self, each) -> Array:
        """Response to p, and to shear along cos(phi) xi - sin(phi) eta, the sliding direction."""
        c, s = cosine(self.sliding_rad), jnp.sin(self.sliding_rad)
        return jnp.stack([each[:, 0], c * each[:, 1] - s * each[:, 2]], axis=1)


class StripLength(LineEffect):
    """The strip's charge is the mean over its length, which reaches over l sin(phi) along xi:
    sin(a)/a with a = k l sin(phi)/2. Each part of it has the contact zone about itself."""

    acts_on_signal = True
    reach_m: Float[Array, ""]
    nodes: int = eqx.field(static=True)

    def __init__(self, reach_m, nodes: int = LENGTH_NODES):
        self.reach_m, self.nodes = as_real(reach_m), nodes

    def transfer(self, k: Float[Array, " k"]) -> Float[Array, " k"]:
        return self._mean.transfer(k)

    def spread(self, kernel: Kernel) -> Kernel:
        return self._mean.spread(kernel)

    @property
    def _mean(self) -> StripAverage:
        return StripAverage(self.reach_m, self.nodes)


def along_x(film: Film, skin: Skin) -> tuple[Film, Skin]:
    """A film and the skin above it as one whose strip lies across x; as given where it does.

    The strip of a film turned by psi, under features whose normal is at phi from x, averages over
    w cos(phi - psi) and l sin(phi - psi) along that normal. The skin's stress is in its axes. For a
    [`TurnedSkin`][] phi is the skin's angle, else 0.
    """
    if film.turn_rad is None:
        return film, skin
    is_oblique = isinstance(skin, TurnedSkin)
    beneath, sliding = (skin.skin, skin.sliding_rad) if is_oblique else (skin, as_real(0.0))
    angle = (skin.angle_rad if is_oblique else sliding) - film.turn_rad
    # Its length lies along x, too, and acts within the finger as its width does.
    length = StripAverage(film.length_m * jnp.sin(angle), LENGTH_NODES)
    turned = TurnedSkin(beneath, angle, sliding)
    return in_own_axes(film, angle).with_effect(length), turned


def is_of_strip(effect: LineEffect) -> bool:
    """Whether it is the mean over the strip's own width, not over a cell of the line."""
    return isinstance(effect, StripAverage) and not effect.acts_on_signal


def with_length(film: Film, angle_rad: Float[Array, ""]) -> Film:
    """The film with the mean over its strip's length, under features whose normal makes the angle
    `angle_rad` with the strip's width."""
    return film.with_effect(StripLength(film.length_m * jnp.sin(angle_rad)))


def in_own_axes(film: Film, angle_rad: Float[Array, ""]) -> Film:
    """The film without its turn, under features whose normal makes the angle `angle_rad` with its
    strip's width: the width is that along the normal."""
    c = cosine(angle_rad)
    effects = tuple(effect.scaled(c) if is_of_strip(effect) else effect for effect in film.effects)
    film = eqx.tree_at(lambda f: f.turn_rad, film, None, is_leaf=lambda leaf: leaf is None)
    return eqx.tree_at(lambda f: f.effects, film, effects)
