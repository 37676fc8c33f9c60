"""Partial slip: a contact under a growing shear force sticks in its middle and slips at its edges.

A finger that is pressed on with the load P and pulled along with the force Q < mu P does not slide:
a part of its contact slips, and the rest sticks (Cattaneo 1938, Mindlin 1949). The shear is

    q(x) = mu [p(x; P) - p(x; P - Q/mu)],

p(x; F) the pressure under the load F, and the contact under the load P - Q/mu is the part that
sticks. This holds for every profile (Jaeger 1998, Ciavarella 1998) where the surface moves along
under shear as it moves inwards under pressure, and neither moves it the other way: a half space in
plane strain with nu = 1/2. P stays constant while Q grows from zero. Under a cylinder of radius R,
Hertz's contact has the half-width a = sqrt(4 P R/(pi E*)), and the part that sticks

    c = a sqrt(1 - Q/(mu P)).
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float

from ..errors import number, refuse
from ..grid import Line, as_real
from .contact import Contact, press
from .knife_edge import KnifeEdge, load_polynomial
from .sensor import Sensor
from .skin import HalfSpace, Skin

SKIPPED, FITTED = 2, 8  # cells at an edge: those that it crosses, and those that show it
ROUNDING = 1e-9  # of a load, by which it may exceed the greatest
ChargeOfForces = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class PartialSlip(eqx.Module):
    """The solution, over cells (n,).

    - `contact`: under the whole load. `sticking`: under the load P - Q/mu; None where all slips.
    - `shear_Pa` [Pa]: cell averages of q, of the sign of the shear force.
    """

    contact: Contact
    sticking: Contact | None
    shear_Pa: Float[Array, " n"]

    @property
    def pressure_Pa(self) -> Float[Array, " n"]:
        """Cell averages of the pressure [Pa]."""
        return self.contact.pressure_Pa

    @property
    def sticks(self) -> Bool[Array | np.ndarray, " n"]:
        """Mask of the cells that stick."""
        if self.sticking is None:
            return jnp.zeros(self.shear_Pa.shape, bool)
        return self.sticking.touching

    def zone_edges_m(self, line: Line) -> tuple[np.ndarray, np.ndarray]:
        """Edges [m] (zone, 2) of the contacts, and of the parts that stick (`zone_edges_m`)."""
        none = np.zeros((0, 2))
        stuck = none if self.sticking is None else zone_edges_m(line, self.sticking.pressure_Pa)
        return zone_edges_m(line, self.pressure_Pa), stuck


def press_and_shear(
    line: Line,
    skin: Skin,
    height_m: Float[ArrayLike, " n"],
    nominal_pressure_Pa,
    nominal_shear_Pa,
    friction,
) -> PartialSlip:
    """The profile `height_m` (n,) pressed into `skin` by a mean pressure, then pulled along x.

    - `nominal_pressure_Pa`, `nominal_shear_Pa` [Pa]: means over the window, which repeats.
    - `friction`: mu, above 0.

    Differentiable as `press` is, below full slip. Raises `BadInput` for a skin other than an
    incompressible half space, a shear above mu times the pressure, and as `press` does.
    """
    check_similar(skin)
    mu = number("friction", friction, "a friction coefficient above 0", above=0)
    shear = number("nominal_shear_Pa", nominal_shear_Pa, "a shear in Pa, of either sign")
    height = as_real(height_m)
    contact = press(line, skin, height, nominal_pressure_Pa)
    rest = nominal_pressure_Pa - abs(shear) / mu
    if not isinstance(rest, Tracer):
        refuse(
            bool(rest < 0),
            f"nominal_shear_Pa is {float(shear):.6g}, above friction times the pressure: give at "
            f"most {float(mu * nominal_pressure_Pa):.6g} to either side.",
        )
        if rest == 0:
            return PartialSlip(contact, None, jnp.sign(shear) * mu * contact.pressure_Pa)
    sticking = press(line, skin, height, rest)
    slip = contact.pressure_Pa - sticking.pressure_Pa
    return PartialSlip(contact, sticking, jnp.sign(shear) * mu * slip)


def check_similar(skin: Skin) -> None:
    """Raise `BadInput` for a skin to which the law of partial slip does not apply."""
    own = skin.half_space
    is_own = own is not None and type(own).compliance is HalfSpace.compliance
    refuse(
        not is_own,
        f"The skin ({skin.words}) yields differently to pressure and to shear, or lags behind "
        "them, so partial slip is not solved: give a HalfSpace of poisson_ratio=0.5.",
    )
    ratio = float(own.poisson_ratio) if own is not None else 0.5
    refuse(
        ratio != 0.5,
        f"skin.poisson_ratio is {ratio:g}, where shear moves the surface inwards too: give 0.5 for "
        "partial slip.",
    )


def zone_edges_m(line: Line, pressure_Pa: Float[ArrayLike, " n"]) -> Float[np.ndarray, "zone 2"]:
    """Left and right edge [m] of every stretch with pressure, to a small part of a cell.

    The square of the pressure is a polynomial near a smooth edge, where the pressure is a square
    root: its zero is the edge. A stretch of few cells has the edges of its cells. None where all
    cells touch. A stretch across the end of a periodic window has its right edge beyond it.
    """
    p, cell = np.asarray(pressure_Pa, float), float(line.cell_m)
    touches, start = p > 0, float(line.x[0])
    firsts = np.flatnonzero(touches & ~np.roll(touches, 1))
    zones = []
    for first in firsts:
        ahead = np.roll(touches, -first)
        count = int(np.argmin(ahead))
        own = np.roll(p, -first)[:count]
        ends = -_outside(own), count - 1 + _outside(own[::-1])
        zones.append([start + cell * (first + end) for end in ends])
    return np.array(zones).reshape(-1, 2)


def _outside(p: Float[np.ndarray, " n"]) -> float:
    """How far [cells] the edge lies before the centre of the first cell."""
    if p.size < 2 * (SKIPPED + FITTED):
        return 0.5
    at = np.arange(SKIPPED, SKIPPED + FITTED)
    roots = np.roots(np.polyfit(at, p[at] ** 2, 2))
    real = roots[np.isreal(roots)].real
    near = real[np.abs(real) < SKIPPED]
    return -float(near[np.argmin(np.abs(near))]) if near.size else 0.5


class CylinderContact(eqx.Module):
    """A cylinder across the sliding direction, pressed on a skin and pulled along it.

    - `radius_m` [m]: of the cylinder, above 0. `place_m` [m]: of its middle from the sensor.

    Loads and shear forces are per length [N/m]. Numbers are concrete, not traced. Raises `BadInput`
    for a radius that is not positive.
    """

    radius_m: float = eqx.field(static=True)
    place_m: float = eqx.field(static=True)

    def __init__(self, radius_m, place_m=0.0):
        wanted = "a positive length in metres"
        self.radius_m = float(number("contact radius_m", radius_m, wanted, above=0))
        self.place_m = float(number("contact place_m", place_m, "a position in metres"))

    def half_width_m(self, skin: Skin, load_N_per_m) -> Float[np.ndarray, "*load"]:
        """Half-width a [m] of the contact (*load,)."""
        return KnifeEdge(self.radius_m).half_width_m(skin, load_N_per_m)

    def stick_half_width_m(
        self, skin: Skin, load_N_per_m, shear_N_per_m, friction
    ) -> Float[np.ndarray, "*load"]:
        """Half-width c [m] of the part that sticks (*load,); 0 where all slips.

        Raises `BadInput` for a skin to which the law does not apply, and a friction that is not
        positive.
        """
        check_similar(skin)
        mu = np.asarray(friction, float)
        refuse(not np.all(mu > 0), f"friction is {mu.min():g}: give friction coefficients above 0.")
        rest = np.asarray(load_N_per_m) - np.abs(shear_N_per_m) / mu
        return self.half_width_m(skin, np.maximum(rest, 0))

    def traction(
        self, skin: Skin, x_m, load_N_per_m: float, shear_N_per_m: float, friction: float
    ) -> Float[np.ndarray, "2 x"]:
        """p and q [Pa] at x [m] from the cylinder's middle.

        Raises `BadInput` as `stick_half_width_m` does, and for a shear force above mu P.
        """
        check_similar(skin)
        friction = number("friction", friction, "a friction coefficient above 0", above=0)
        refuse(
            abs(shear_N_per_m) > friction * load_N_per_m,
            f"shear_N_per_m is {shear_N_per_m:g}: give at most {friction * load_N_per_m:g}, "
            "friction times the load.",
        )
        p = self._pressure(skin, x_m, load_N_per_m)
        stuck = self._pressure(skin, x_m, load_N_per_m - abs(shear_N_per_m) / friction)
        return np.stack([p, np.sign(shear_N_per_m) * friction * (p - stuck)])

    def charge(self, sensor: Sensor, most_N_per_m: float) -> ChargeOfForces:
        """The charge [C] (element, time) as a function of load, shear force and friction (time,),
        for loads up to `most_N_per_m` [N/m].

        It is H_p(P) + mu sign(Q) [H_q(P) - H_q(P - |Q|/mu)], H the charge under Hertz's pressure
        and under the same shear. It holds while Q grows at constant P, or where all slips. Raises
        `BadInput` for a skin to which the law does not apply, a contact wider than 40 depths, and,
        when called, greater loads.
        """
        check_similar(sensor.skin)
        edge = KnifeEdge(self.radius_m)

        def by_component(load):
            return edge.charge_by_component(sensor, self.place_m, load)[:, :, 0]

        hertz = load_polynomial(by_component, edge, sensor, most_N_per_m)

        def charge(load, shear, friction):
            load, shear = np.maximum(load, 0), np.asarray(shear)
            refuse(
                bool(np.any(load > most_N_per_m * (1 + ROUNDING))),
                f"The load is {np.max(load):g} N/m, where the charge is made for up to "
                f"{most_N_per_m:g}: give a greater most_N_per_m.",
            )
            whole, stuck = hertz(load), hertz(np.maximum(load - np.abs(shear) / friction, 0))
            return whole[:, 0] + np.sign(shear) * friction * (whole[:, 1] - stuck[:, 1])

        return charge

    def _pressure(self, skin: Skin, x_m, load_N_per_m: float) -> np.ndarray:
        half = float(self.half_width_m(skin, load_N_per_m))
        if half == 0:
            return np.zeros(np.shape(x_m))
        root = np.sqrt(np.maximum(1 - (np.asarray(x_m) / half) ** 2, 0))
        return 2 * load_N_per_m / (np.pi * half) * root
