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
from jaxtyping import Array, Float

from ..compiled import compiled
from ..errors import number
from ..grid import Line, as_real
from .film import Film, LineEffect
from .scan import ConstantSpeed, Motion
from .sensor import Sensor
from .simulation import response
from .turned_skin import TurnedSkin, cosine, is_of_strip, with_length

Scan = TypeVar("Scan", ConstantSpeed, Motion)

QUARTER_RAD = math.pi / 2 + 1e-6  # a quarter turn, as single precision too rounds it
MOST_BESIDE_ZONE = math.pi / 3 + 1e-6  # beyond, a contact zone is over twice as long along xi


def turned(sensor: Sensor, angle_rad) -> Sensor:
    """The sensor over features whose normal makes the angle phi with its x axis, its line along xi.

    Lengths along x shrink to their cos(phi), and every strip gets its [`StripLength`][]. Those of a
    strip that is turned itself follow its own angle. What the finger touches of a feature's line is
    symmetric about the film, so that along xi an envelope is 1/cos(phi) times as long, to second
    order in the depth times tan(phi) over its length. Raises `BadInput` for an angle beyond a
    quarter turn, with envelopes beyond 60 degrees, a skin that is no half space, and an effect
    along the line that is not known to turn.
    """
    if sensor.envelopes:
        wanted = "an angle of at most pi/3, or a sensor without finite_patch and fingerprint"
        number("angle_rad", angle_rad, wanted, least=-MOST_BESIDE_ZONE, most=MOST_BESIDE_ZONE)
    return _turned(sensor, _within_quarter(angle_rad))


@compiled
def _turned(sensor: Sensor, angle_rad: Float[Array, ""]) -> Sensor:
    def one(film: Film) -> Film:
        along = turned_film(film, angle_rad)
        return along if film.turn_rad is not None else with_length(along, angle_rad)

    longer = tuple(each.scaled(1 / cosine(angle_rad)) for each in sensor.envelopes)
    parts = TurnedSkin(sensor.skin, angle_rad), tuple(one(film) for film in sensor.elements), longer
    return eqx.tree_at(lambda s: (s.skin, s.elements, s.envelopes), sensor, parts)


def turned_film(film: Film, angle_rad: Float[Array, ""]) -> Film:
    """The film along xi: its place there, and each length along x of its effects times cos(phi).

    Width and length of a strip that is turned itself are left to [`along_x`][].
    """
    c, s = cosine(angle_rad), jnp.sin(angle_rad)

    def scaled(effect: LineEffect) -> LineEffect:
        is_own = film.turn_rad is not None and is_of_strip(effect)
        return effect if is_own else effect.scaled(c)

    place = c * film.offset_m + s * film.offset_y_m, jnp.zeros_like(film.offset_y_m)
    parts = tuple(map(scaled, film.effects)), *place
    return eqx.tree_at(lambda f: (f.effects, f.offset_m, f.offset_y_m), film, parts)


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
