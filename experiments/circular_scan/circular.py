"""A finger that keeps its orientation and moves on a circle over a straight ridge.

The finger stands at r (cos a, sin a) from the circle's centre, a growing at the rate u/r, and a
ridge with the normal (cos phi, sin phi) at the distance d from the centre lies at xi = r cos(a -
phi) - d from it. Friction acts along the velocity, so that its parts across and along the ridge,
-sin(a - phi) and cos(a - phi), change on the way, and the rate signal with them.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from srsinv.compiled import compiled
from srsinv.errors import BadInput, number, refuse, whole
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.oblique import turned_film
from srsinv.forward.sensor import Sensor
from srsinv.forward.turned_skin import TurnedSkin
from srsinv.grid import Scalar, as_real

MOST_SAMPLES = 100_000
NODES = 10  # of Gauss's rule: enough for widths up to 2 depths, to 1e-7
LEAST_DEPTHS = 1e-6  # least projected length of a strip, for one of zero: right to its square


class Circle(eqx.Module):
    """Counter-clockwise motion on a circle at a constant speed, in `samples` even steps from
    `start_rad` over `sweep_rad`, one turn by default.

    Raises `BadInput` for a radius, a speed or a sweep that is not positive, and for fewer than 8
    samples or more than a hundred thousand.
    """

    radius_m: Float[Array, ""]
    speed_m_per_s: Float[Array, ""]
    start_rad: Float[Array, ""]
    sweep_rad: Float[Array, ""]
    samples: int = eqx.field(static=True)

    def __init__(
        self,
        radius_m: Scalar = 10e-3,
        speed_m_per_s: Scalar = 0.05,
        samples: Any = 512,
        start_rad: Scalar = 0.0,
        sweep_rad: Scalar = 2 * np.pi,
    ):
        wanted = "a positive length in metres"
        self.radius_m = as_real(number("circle.radius_m", radius_m, wanted, above=0))
        wanted = "a positive speed in m/s, counter-clockwise"
        self.speed_m_per_s = as_real(number("circle.speed_m_per_s", speed_m_per_s, wanted, above=0))
        self.start_rad = as_real(number("circle.start_rad", start_rad, "an angle in radians"))
        wanted = "a positive angle in radians"
        self.sweep_rad = as_real(number("circle.sweep_rad", sweep_rad, wanted, above=0))
        wanted = f"a whole number from 8 to {MOST_SAMPLES}"
        self.samples = whole("circle.samples", samples, wanted, least=8, most=MOST_SAMPLES)

    @property
    def angle_rad(self) -> Float[Array, " sample"]:
        """Angular position of the finger, from +x towards +y."""
        return self.start_rad + self.sweep_rad / self.samples * np.arange(self.samples)

    @property
    def time_s(self) -> Float[Array, " sample"]:
        """Sample times, from the first sample on."""
        return (self.angle_rad - self.start_rad) * self.radius_m / self.speed_m_per_s

    def coarser(self, size: int) -> "Circle":
        """The circle at the means of `size` samples each; an incomplete group at the end is
        dropped."""
        count, step = self.samples // size, self.sweep_rad / self.samples
        start = self.start_rad + (size - 1) / 2 * step
        return Circle(self.radius_m, self.speed_m_per_s, count, start, count * size * step)


class ObliqueRidge(eqx.Module):
    """A straight ridge that presses uniformly on |xi - d| < W/2 with a load per length.

    - `angle_rad`: from +x to its normal; turned by pi with -d it is the same ridge.
    - `distance_m`: d, from the circle's centre along the normal; `width_m`: W.
    - `friction`: mu, along the velocity and of either sign (negative on a real finger).
    """

    angle_rad: Float[Array, ""]
    distance_m: Float[Array, ""]
    load_N_per_m: Float[Array, ""]
    width_m: Float[Array, ""]
    friction: Float[Array, ""]

    def __init__(self, angle_rad, distance_m, load_N_per_m=1.0, width_m=0.5e-3, friction=0.0):
        self.angle_rad = as_real(number("ridge.angle_rad", angle_rad, "an angle in radians"))
        self.distance_m = as_real(number("ridge.distance_m", distance_m, "a distance in metres"))
        self.load_N_per_m = as_real(number("ridge.load_N_per_m", load_N_per_m, "a load in N/m"))
        wanted = "a positive width in metres"
        self.width_m = as_real(number("ridge.width_m", width_m, wanted, above=0))
        self.friction = as_real(number("ridge.friction", friction, "a number, of either sign"))


class Circling(eqx.Module):
    """A sensor on a circle: a ridge to its signal (element, sample), less its offset.

    The sensor's skin is a half space. Offsets are along x, which the finger keeps. Raises
    `BadInput` for averaged samples, which lie on an arc here, and for filters in time.
    """

    sensor: Sensor
    circle: Circle

    def __init__(self, sensor: Sensor, circle: Circle):
        refuse(
            bool(sensor.filters),
            f"The sensor has {len(sensor.filters)} filters, which cannot be simulated on "
            "a circle: leave them out of effects.",
        )
        refuse(
            bool(sensor.envelopes),
            "The finger touches everywhere on a circle: leave finite_patch and fingerprint out of "
            "effects.",
        )
        for film in sensor.elements:
            if any(effect.averages_samples for effect in film.effects):
                raise BadInput(
                    "SampleAverage cannot be simulated on a circle: leave it out of effects."
                )
        self.sensor, self.circle = sensor, circle

    @compiled
    def __call__(self, ridge: ObliqueRidge) -> Float[Array, "e sample"]:
        """The signal."""
        by_load, by_shear = self.unit(ridge.angle_rad, ridge.distance_m, ridge.width_m)
        return ridge.load_N_per_m * (by_load + ridge.friction * by_shear)

    def unit(
        self,
        angle_rad: Float[Array, ""],
        distance_m: Float[Array, ""],
        width_m: Float[Array, ""],
        nodes: int = NODES,
    ) -> Float[Array, "2 e sample"]:
        """The signals of 1 N/m of load, and of 1 N/m of shear along the velocity."""
        circle = self.circle
        turn = circle.angle_rad - angle_rad
        xi = circle.radius_m * jnp.cos(turn) - distance_m
        across, along = -jnp.sin(turn), jnp.cos(turn)
        speed = jnp.broadcast_to(circle.speed_m_per_s, turn.shape)
        gain = self.sensor.amplifier.at_speed(speed)

        def one(film: Film):
            p, shear, lag, p_slope, shear_slope, lag_slope = self._charges(
                film, angle_rad, xi, *_spots(film, angle_rad, width_m, nodes)
            )
            charge = jnp.stack([p, across * shear + along * lag])
            if not self.sensor.amplifier.order:
                return gain[None] * charge
            # Along the arc: d xi/ds = across, d across/ds = -along/r, d along/ds = across/r.
            slope = jnp.stack([p_slope, across * shear_slope + along * lag_slope])
            veer = (across * lag - along * shear) / circle.radius_m
            rate = across[None] * slope + jnp.stack([jnp.zeros_like(veer), veer])
            return gain[None] * rate

        return jnp.stack([one(film) for film in self.sensor.elements], axis=1)

    def _charges(self, film: Film, angle_rad, xi, shifts, fractions) -> Float[Array, "6 sample"]:
        """Charge [C] at xi from 1 N/m of p, shear across and shear along the ridge, and the slopes
        of the three along xi.

        The mean of a line load's stress over the strip's length is the stress of a strip of load
        that long.
        """
        skin = TurnedSkin(self.sensor.skin, angle_rad)
        least = LEAST_DEPTHS * film.depth_m
        reach = jnp.sqrt((film.length_m * jnp.sin(angle_rad)) ** 2 + least**2)
        place = jnp.ravel(shifts[:, None] + xi[None]), film.depth_m, reach
        stress = jnp.concatenate([skin.response_to_each(*place), skin.slope_to_each(*place)], 1)
        charge = jnp.tensordot(film.charge_per_stress() / reach, stress, 1)
        return jnp.tensordot(fractions, charge.reshape(6, shifts.size, xi.size), ((0,), (1,)))


def _spots(film: Film, angle_rad, width_m, nodes: int) -> tuple[Array, Array]:
    """Shifts along xi, and the weight of each: quadrature over the widths of film and ridge."""
    shifts, fractions = jnp.zeros(1), jnp.ones(1)
    along = turned_film(film, angle_rad)
    for effect in (*along.all_effects, StripAverage(width_m)):
        spread, weights = effect.quadrature(nodes)
        shifts = jnp.ravel(shifts[:, None] + spread[None])
        fractions = jnp.ravel(fractions[:, None] * weights[None])
    return shifts, fractions
