"""Straight features that cross the sliding direction at an angle.

The features' normal xi makes the angle phi with the sliding direction x; eta runs along them. All
fields depend on xi alone, so that xi is the coordinate of the line. The stress is plane strain in
(xi, z) and antiplane shear along eta, turned back into the sensor's frame
(docs/explanation/physics/oblique.md).
"""

import math
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Inexact

from ..compiled import compiled
from ..errors import number
from ..grid import Line, as_real
from .antiplane import Antiplane
from .film import Film, Kernel, LineEffect, StripAverage
from .scan import ConstantSpeed, Motion
from .sensor import Sensor
from .simulation import response
from .skin import HalfSpace, Skin

Scan = TypeVar("Scan", ConstantSpeed, Motion)

# Enough for a strip of 15 depths: Gauss's rule converges as in `StripAverage.at_depth`.
LENGTH_NODES = 128
MOST_BESIDE_ZONE = math.pi / 3 + 1e-6  # beyond, a contact zone is over twice as long along xi
QUARTER_RAD = math.pi / 2 + 1e-6  # a quarter turn, as single precision too rounds it


def cosine(angle_rad: Float[Array, ""]) -> Float[Array, ""]:
    """cos(phi), exactly 0 at a right angle."""
    away = jnp.where(angle_rad < 0, -angle_rad, angle_rad)
    return jnp.sin(jnp.pi / 2 - away)


class TurnedSkin(Skin):
    """A skin under features whose normal makes the angle `angle_rad` with x.

    x of its methods is xi, across the features. Rows are stress in the sensor's frame (sigma_x,
    sigma_z, tau_xz, sigma_y), columns (p, q) with q along x, the sliding direction. Contact is in
    the (xi, z) plane, as under the skin itself.
    """

    skin: Skin
    angle_rad: Float[Array, ""]

    def __init__(self, skin: Skin, angle_rad):
        self.skin = skin
        self.angle_rad = as_real(number("angle_rad", angle_rad, "an angle in radians"))

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
        return np.asarray(TurnedSkin(HalfSpace(), self.angle_rad).turned_back(plane, across))

    @compiled
    def turned_back(self, plane: Complex[Array, "4 2 k"], antiplane: Complex[Array, "2 k"]):
        """Stress in the sensor's frame (4, 2, k), of that in plane strain and of that in antiplane
        shear, under (p, q)."""
        return self._sliding(self._in_frame(plane, antiplane))

    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        return self._sliding(self.response_to_each(x, depth_m, width_m))

    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        return self._sliding(self.slope_to_each(x, depth_m, width_m))

    def response_to_each(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 3 x"]:
        """As [`strip_response`][], for p, shear along xi and shear along eta separately."""
        plane = self.skin.strip_response(x, depth_m, width_m)
        return self._in_frame(plane, self.antiplane.strip_response(x, depth_m, width_m))

    def slope_to_each(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 3 x"]:
        """d/dx of [`response_to_each`][], in 1/m."""
        plane = self.skin.strip_slope(x, depth_m, width_m)
        return self._in_frame(plane, self.antiplane.strip_slope(x, depth_m, width_m))

    def _in_frame(self, plane, antiplane) -> Array:
        """Stress in the sensor's frame (4, 3, ...) under p, q_xi and q_eta."""
        c, s = cosine(self.angle_rad), jnp.sin(self.angle_rad)
        xi, z, xi_z, eta = plane
        along = jnp.stack(
            [c**2 * xi + s**2 * eta, z, c * xi_z, s**2 * xi + c**2 * eta]
        )  # fmt: skip
        twist = 2 * s * c * antiplane[0]
        across = jnp.stack([-twist, jnp.zeros_like(twist), -s * antiplane[1], twist])
        return jnp.concatenate([along, across[:, None]], axis=1)

    def _sliding(self, each) -> Array:
        """Response to p, and to shear along x = cos(phi) xi - sin(phi) eta."""
        c, s = cosine(self.angle_rad), jnp.sin(self.angle_rad)
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


def turned(sensor: Sensor, angle_rad) -> Sensor:
    """The sensor over features whose normal makes the angle phi with its x axis, its line along xi.

    Lengths along x shrink to their cos(phi), and every strip gets its [`StripLength`][]. What the
    finger touches of a feature's line is symmetric about the film, so that along xi an envelope is
    1/cos(phi) times as long, to second order in the depth times tan(phi) over its length. Raises
    `BadInput` for an angle beyond a quarter turn, with envelopes beyond 60 degrees, a skin that is
    no half space, and an effect along the line that is not known to turn.
    """
    if sensor.envelopes:
        wanted = "an angle of at most pi/3, or a sensor without finite_patch and fingerprint"
        number("angle_rad", angle_rad, wanted, least=-MOST_BESIDE_ZONE, most=MOST_BESIDE_ZONE)
    return _turned(sensor, _within_quarter(angle_rad))


@compiled
def _turned(sensor: Sensor, angle_rad: Float[Array, ""]) -> Sensor:
    def one(film: Film) -> Film:
        return turned_film(film, angle_rad).with_effect(
            StripLength(film.length_m * jnp.sin(angle_rad))
        )

    longer = tuple(each.scaled(1 / cosine(angle_rad)) for each in sensor.envelopes)
    parts = TurnedSkin(sensor.skin, angle_rad), tuple(one(film) for film in sensor.elements), longer
    return eqx.tree_at(lambda s: (s.skin, s.elements, s.envelopes), sensor, parts)


def turned_film(film: Film, angle_rad: Float[Array, ""]) -> Film:
    """The film along xi: its offset, and each length along x of its effects, times cos(phi)."""
    c = cosine(angle_rad)
    parts = tuple(effect.scaled(c) for effect in film.effects), c * film.offset_m
    return eqx.tree_at(lambda f: (f.effects, f.offset_m), film, parts)


def turned_scan(scan: Scan, angle_rad) -> Scan:
    """The scan along xi, the features' normal: speeds and positions times cos(phi).

    Up to a quarter turn, where it stands still, its direction is that along x, so that friction
    keeps its sign. Raises `BadInput` for an angle beyond.
    """
    return scan.scaled(cosine(_within_quarter(angle_rad)))


def gain_of_angle(
    sensor: Sensor,
    scan: ConstantSpeed,
    line: Line,
    traction: Float[Array, "2 n"],
    angles_rad: Float[np.ndarray, " angle"],
) -> Float[np.ndarray, "element angle"]:
    """Rms signal in time of straight scans over a feature at each angle, over that at angle 0;
    `traction` [Pa] is that of the feature along its normal."""

    def rms(angle_rad: float) -> np.ndarray:
        stage = turned(sensor, angle_rad).output(turned_scan(scan, angle_rad))
        signal = response(stage, line, traction, refinement=1)
        return np.sqrt(np.mean(np.asarray(signal) ** 2, axis=-1))

    straight = rms(0.0)
    return np.stack([rms(angle) / straight for angle in angles_rad], axis=-1)


def _within_quarter(angle_rad) -> Float[Array, ""]:
    wanted = "an angle in radians between -pi/2 and pi/2, from x to the features' normal"
    return as_real(number("angle_rad", angle_rad, wanted, least=-QUARTER_RAD, most=QUARTER_RAD))
