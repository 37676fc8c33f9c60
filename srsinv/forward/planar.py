"""A finger that keeps its orientation and moves in the plane of the skin over straight features.

On a circle the finger stands at r (cos a, sin a), on a straight pass at c + s (cos h, sin h). A
feature with the normal (cos phi, sin phi) lies at xi = x cos phi + y sin phi - d from it. Friction
acts along the velocity, so that its parts across and along the feature follow the direction of
motion (docs/explanation/physics/oblique.md).
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..compiled import compiled
from ..errors import BadInput, number, refuse, whole
from ..grid import Scalar, as_real, sinc
from .film import Film, StripAverage
from .filter import filtered
from .oblique import turned_film
from .sensor import Sensor
from .skin import Skin
from .turned_skin import TurnedSkin, in_own_axes, with_length

MOST_SAMPLES = 100_000
NODES = 10  # of Gauss's rule: enough for widths up to 2 depths, to 1e-7
LEAST_DEPTHS = 1e-6  # least projected length of a strip, for one of zero: right to its square
HARMONICS = 8  # of a grating: at a pitch of 6 depths e^(-k z) is 2e-4 at the last
FAR_PITCHES = 1e4  # of the stretch that stands for the ridges beyond a row, in its half length
Charges = Float[Array, "3 sample"]


class Crossing(NamedTuple):
    """A path as features cross it: the place along their normal [m], and the parts of the motion's
    direction across and along them, (sample,)."""

    place_m: Float[Array, " sample"]
    across: Float[Array, " sample"]
    along: Float[Array, " sample"]


class PlanarPath(eqx.Module):
    """Base of paths in the plane: even samples at a constant speed."""

    speed_m_per_s: eqx.AbstractVar[Float[Array, ""]]
    samples: eqx.AbstractVar[int]

    @abc.abstractmethod
    def crossing(self, angle_rad: Float[Array, ""]) -> Crossing:
        """The path over features whose normal makes this angle with x."""

    @property
    @abc.abstractmethod
    def curvature_per_m(self) -> Scalar | None:
        """Curvature, positive to the left; None for a straight path."""

    @property
    @abc.abstractmethod
    def interval_s(self) -> Float[Array, ""]:
        """Time between samples."""

    @property
    @abc.abstractmethod
    def reach_m(self) -> float:
        """How far it reaches from the origin."""

    @abc.abstractmethod
    def coarser(self, size: int) -> "PlanarPath":
        """The path at the means of `size` samples each; an incomplete group at the end is
        dropped."""

    def group_size(self, cell_m: float) -> int:
        """How many samples make one of about `cell_m`; at least 8 groups are left."""
        step = float(self.interval_s) * float(self.speed_m_per_s)
        return int(np.clip(cell_m / step, 1, self.samples // 8))


class Circle(PlanarPath):
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

    @property
    def interval_s(self) -> Float[Array, ""]:
        return self.sweep_rad / self.samples * self.radius_m / self.speed_m_per_s

    @property
    def curvature_per_m(self) -> Scalar:
        return 1 / self.radius_m

    def crossing(self, angle_rad: Float[Array, ""]) -> Crossing:
        turn = self.angle_rad - angle_rad
        return Crossing(self.radius_m * jnp.cos(turn), -jnp.sin(turn), jnp.cos(turn))

    @property
    def reach_m(self) -> float:
        return float(self.radius_m)

    def coarser(self, size: int) -> "Circle":
        count, step = self.samples // size, self.sweep_rad / self.samples
        start = self.start_rad + (size - 1) / 2 * step
        return Circle(self.radius_m, self.speed_m_per_s, count, start, count * size * step)


class StraightPass(PlanarPath):
    """A straight pass in the direction `heading_rad` from +x towards +y, at a constant speed.

    It takes `duration_s` in `samples` even steps, and its middle is at (`middle_x_m`,
    `middle_y_m`). Raises `BadInput` for a speed or a duration that is not positive, and for fewer
    than 8 samples or more than a hundred thousand.
    """

    heading_rad: Float[Array, ""]
    speed_m_per_s: Float[Array, ""]
    duration_s: Float[Array, ""]
    samples: int = eqx.field(static=True)
    middle_x_m: Float[Array, ""]
    middle_y_m: Float[Array, ""]

    def __init__(
        self,
        heading_rad: Scalar,
        speed_m_per_s: Scalar = 0.05,
        duration_s: Scalar = 0.2,
        samples: Any = 200,
        middle_x_m: Scalar = 0.0,
        middle_y_m: Scalar = 0.0,
    ):
        self.heading_rad = as_real(number("pass.heading_rad", heading_rad, "an angle in radians"))
        wanted = "a positive speed in m/s"
        self.speed_m_per_s = as_real(number("pass.speed_m_per_s", speed_m_per_s, wanted, above=0))
        wanted = "a positive time in seconds"
        self.duration_s = as_real(number("pass.duration_s", duration_s, wanted, above=0))
        wanted = f"a whole number from 8 to {MOST_SAMPLES}"
        self.samples = whole("pass.samples", samples, wanted, least=8, most=MOST_SAMPLES)
        wanted = "a place in metres"
        self.middle_x_m = as_real(number("pass.middle_x_m", middle_x_m, wanted))
        self.middle_y_m = as_real(number("pass.middle_y_m", middle_y_m, wanted))

    @property
    def interval_s(self) -> Float[Array, ""]:
        return self.duration_s / self.samples

    @property
    def curvature_per_m(self) -> None:
        return None

    @property
    def way_m(self) -> Float[Array, " sample"]:
        """Place along the pass, from its middle."""
        steps = np.arange(self.samples) / self.samples - 0.5
        return self.speed_m_per_s * self.duration_s * steps

    def crossing(self, angle_rad: Float[Array, ""]) -> Crossing:
        turn = self.heading_rad - angle_rad
        middle = self.middle_x_m * jnp.cos(angle_rad) + self.middle_y_m * jnp.sin(angle_rad)
        across, along = (jnp.broadcast_to(f(turn), self.samples) for f in (jnp.cos, jnp.sin))
        return Crossing(middle + across * self.way_m, across, along)

    @property
    def reach_m(self) -> float:
        half = float(self.speed_m_per_s) * float(self.duration_s) / 2
        return half + float(np.hypot(float(self.middle_x_m), float(self.middle_y_m)))

    def coarser(self, size: int) -> "StraightPass":
        count, interval = self.samples // size, self.interval_s
        # Its middle, from the first step to one beyond the last, moves by what groups leave out.
        moved = (count * size - self.samples + size - 1) / 2 * interval * self.speed_m_per_s
        x = self.middle_x_m + moved * jnp.cos(self.heading_rad)
        y = self.middle_y_m + moved * jnp.sin(self.heading_rad)
        duration = count * size * interval
        return StraightPass(self.heading_rad, self.speed_m_per_s, duration, count, x, y)

    def finer(self, times: int) -> "StraightPass":
        """The same pass with so many times the samples, the given ones among them."""
        return StraightPass(
            self.heading_rad, self.speed_m_per_s, self.duration_s, times * self.samples,
            self.middle_x_m, self.middle_y_m,
        )  # fmt: skip


class PlanarLoad(eqx.Module):
    """Base of loads that are the same all along a direction in the plane."""

    @abc.abstractmethod
    def charges(
        self,
        skin: Skin,
        film: Film,
        own_rad: Float[Array, ""],
        place_m: Float[Array, " sample"],
        order: int,
    ) -> Charges:
        """Charge [C] at these places along the feature's normal under 1 N/m of p, of shear across
        and of shear along the feature; where `order` is 1 its slope [C/m] along the normal.

        The normal makes `own_rad` with the width of the film's strip, whose effects are those along
        the normal but for that of its length.
        """


class RidgeLoad(PlanarLoad):
    """A ridge that presses uniformly over `width_m`, at `distance_m` along its normal.

    The widths of film and ridge are integrated by Gauss's rule of `nodes`. The mean of a line
    load's stress over the strip's length is the stress of a strip of load that long.
    """

    distance_m: Float[Array, ""]
    width_m: Float[Array, ""]
    nodes: int = eqx.field(static=True, default=NODES)

    def charges(self, skin, film, own_rad, place_m, order) -> Charges:
        shifts, fractions = _spots(film, self.width_m, self.nodes)
        least, xi = LEAST_DEPTHS * film.depth_m, place_m - self.distance_m
        reach = jnp.sqrt((film.length_m * jnp.sin(own_rad)) ** 2 + least**2)
        at = jnp.ravel(shifts[:, None] + xi[None]), film.depth_m, reach
        weights = film.charge_per_stress() / reach
        charge = TurnedSkin(skin, own_rad).strip_to_each(weights, *at, order)
        return jnp.tensordot(fractions, charge.reshape(3, shifts.size, xi.size), ((0,), (1,)))


class GratingLoad(PlanarLoad):
    """Ridges at a pitch without end, each pressing uniformly over `width_m`: a Fourier series of
    `harmonics` harmonics. One of the ridges is at `distance_m` along the normal."""

    distance_m: Float[Array, ""]
    pitch_m: Float[Array, ""]
    width_m: Float[Array, ""]
    harmonics: int = eqx.field(static=True, default=HARMONICS)

    def charges(self, skin, film, own_rad, place_m, order) -> Charges:
        k = 2 * jnp.pi / self.pitch_m * np.arange(self.harmonics + 1)
        load = sinc(k * self.width_m / 2) * np.append(1.0, 2 * np.ones(self.harmonics))
        turned, weights = TurnedSkin(skin, own_rad), film.charge_per_stress() / self.pitch_m
        charge = turned.transfer_to_each(weights, k, film.depth_m) * load[None]
        charge = with_length(film, own_rad).along_line(charge, k) * (1j * k[None]) ** order
        phase = k[:, None] * (place_m - self.distance_m)[None]
        return charge.real @ jnp.cos(phase) - charge.imag @ jnp.sin(phase)


class RidgeRow(PlanarLoad):
    """A row of `ridges` ridges at a pitch, the middle one at `distance_m`, and a uniform load in
    place of those beyond its ends: a grating by its ridges, one by one."""

    distance_m: Float[Array, ""]
    pitch_m: Float[Array, ""]
    width_m: Float[Array, ""]
    ridges: int = eqx.field(static=True)

    def charges(self, skin, film, own_rad, place_m, order) -> Charges:
        def one(shift_m: Float[Array, ""]) -> Charges:
            ridge = RidgeLoad(self.distance_m + shift_m, self.width_m)
            return ridge.charges(skin, film, own_rad, place_m, order)

        shifts = self.pitch_m * (np.arange(self.ridges) - self.ridges // 2)
        near = jnp.sum(jax.lax.map(one, shifts), axis=0)
        return near + self._far(TurnedSkin(skin, own_rad), film, place_m, order)

    def _far(self, turned: TurnedSkin, film: Film, place_m, order: int) -> Charges:
        """The charge under the mean load beyond the row's ends, at the film's middle."""
        half = self.pitch_m * (self.ridges / 2)
        width = FAR_PITCHES * half
        centre = self.pitch_m * ((self.ridges - 1) / 2 - self.ridges // 2)
        weights, xi = film.charge_per_stress() / self.pitch_m, place_m - self.distance_m - centre
        xi = xi if film.is_at_origin else xi + film.offset_m

        def one(side: float) -> Charges:
            at = xi - side * (half + width / 2), film.depth_m, width
            return turned.strip_to_each(weights, *at, order)

        return one(1.0) + one(-1.0)


class ObliqueRidge(eqx.Module):
    """A straight ridge that presses uniformly on |xi - d| < W/2 with a load per length.

    - `angle_rad`: from +x to its normal; turned by pi with -d it is the same ridge.
    - `distance_m`: d, from the origin along the normal; `width_m`: W.
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

    @property
    def shape(self) -> PlanarLoad:
        """Where it presses."""
        return RidgeLoad(self.distance_m, self.width_m)


class ObliqueGrating(ObliqueRidge):
    """Parallel ridges at a pitch, each as an [`ObliqueRidge`][], one of them at the distance d.

    Its signal is that of `ridges` ridges one by one, and of a uniform load beyond them: give enough
    to reach well beyond the path. Raises `BadInput` for a pitch that is not positive, and a number
    of ridges that is not odd.
    """

    pitch_m: Float[Array, ""]
    ridges: int = eqx.field(static=True)

    def __init__(self, angle_rad, distance_m, pitch_m, ridges: Any = 41, **ridge):
        super().__init__(angle_rad, distance_m, **ridge)
        wanted = "a positive length in metres"
        self.pitch_m = as_real(number("grating.pitch_m", pitch_m, wanted, above=0))
        self.ridges = whole("grating.ridges", ridges, "an odd whole number from 1", least=1)
        refuse(self.ridges % 2 == 0, f"grating.ridges is {ridges}: give an odd whole number.")

    @property
    def shape(self) -> PlanarLoad:
        return RidgeRow(self.distance_m, self.pitch_m, self.width_m, self.ridges)


class PathScan(eqx.Module):
    """A sensor on a path: a straight feature to its signal (element, sample), less its offset.

    Raises `BadInput` for averaged samples, which are known along a line alone, and for filters in
    time on a circle, as its past is not known.
    """

    sensor: Sensor
    path: PlanarPath

    def __init__(self, sensor: Sensor, path: PlanarPath):
        refuse(
            bool(sensor.filters) and not isinstance(path, StraightPass),
            f"The sensor has {len(sensor.filters)} filters, which cannot be simulated on "
            "a circle: leave them out of effects.",
        )
        refuse(
            bool(sensor.envelopes),
            "The finger touches everywhere in a plane scan: leave finite_patch and fingerprint out "
            "of effects.",
        )
        for film in sensor.elements:
            if any(effect.averages_samples for effect in film.effects):
                raise BadInput(
                    "SampleAverage cannot be simulated on a circle: leave it out of effects."
                )
        self.sensor, self.path = sensor, path

    @compiled
    def __call__(self, feature: ObliqueRidge) -> Float[Array, "e sample"]:
        """The signal."""
        by_load, by_shear = self.unit(feature.angle_rad, feature.shape)
        return feature.load_N_per_m * (by_load + feature.friction * by_shear)

    def unit(self, angle_rad: Float[Array, ""], feature: PlanarLoad) -> Float[Array, "2 e sample"]:
        """The signals of 1 N/m of load, and of 1 N/m of shear along the velocity."""
        place, across, along = self.path.crossing(angle_rad)
        amplifier, curvature = self.sensor.amplifier, self.path.curvature_per_m
        gain = amplifier.at_speed(jnp.broadcast_to(self.path.speed_m_per_s, place.shape))

        def one(film: Film, own_rad: Float[Array, ""]) -> Float[Array, "2 sample"]:
            at = self.sensor.skin, film, own_rad, place
            p, shear, lag = feature.charges(*at, amplifier.order)
            each = jnp.stack([p, across * shear + along * lag])
            if amplifier.order:
                each = across[None] * each  # d xi/ds
                if curvature is not None:  # with the path the direction of friction turns
                    _, shear, lag = feature.charges(*at, 0)
                    each = each.at[1].add(curvature * (across * lag - along * shear))
            return gain[None] * each

        signal = _for_each(one, [_across(film, angle_rad) for film in self.sensor.elements])
        rows = signal.reshape(-1, place.size)
        filters, interval = self.sensor.filters, self.path.interval_s
        return filtered(filters, rows, interval).reshape(signal.shape).swapaxes(0, 1)


def _for_each(one: Callable[[Film, Array], Array], films: list[tuple[Film, Array]]) -> Array:
    """`one` of every film, stacked; of films of one form by one program for all."""
    first, *others = (jax.tree.flatten(pair) for pair in films)
    if any(form != first[1] for _, form in others):
        return jnp.stack([one(*pair) for pair in films])
    leaves = zip(first[0], *(each for each, _ in others), strict=True)
    stacked = [jnp.stack(each) for each in leaves]
    return jax.vmap(one)(*jax.tree.unflatten(first[1], stacked))


def _across(film: Film, angle_rad: Float[Array, ""]) -> tuple[Film, Float[Array, ""]]:
    """The film along the normal of features at this angle, and the normal's angle from the strip's
    own width."""
    along = turned_film(film, angle_rad)
    if film.turn_rad is None:
        return along, angle_rad
    own_rad = angle_rad - film.turn_rad
    return in_own_axes(along, own_rad), own_rad


def _spots(film: Film, width_m: Float[Array, ""], nodes: int) -> tuple[Array, Array]:
    """Shifts along xi, and the weight of each: quadrature over the widths of film and ridge."""
    shifts, fractions = jnp.zeros(1), jnp.ones(1)
    for effect in (*film.all_effects, StripAverage(width_m)):
        spread, weights = effect.quadrature(nodes)
        shifts = jnp.ravel(shifts[:, None] + spread[None])
        fractions = jnp.ravel(fractions[:, None] * weights[None])
    return shifts, fractions
