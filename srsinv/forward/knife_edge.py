"""A knife edge that presses on the skin over a resting sensor, as in the paper's Figs. 7 and 8.

The edge at x0 presses with the load F per length in a direction alpha from the normal,
p = F cos(alpha) e(x - x0) and q = F sin(alpha) e(x - x0), and the sensor at x = 0 has the charge

    Q(x0, F) = F [cos(alpha) K_p(-x0) + sin(alpha) K_q(-x0)],

K the response of its charge to a line load, averaged over the distribution e. An edge of radius R
touches over 2a, a = sqrt(4 F cos(alpha) R/(pi E*)), and e is Hertz's ellipse (Johnson 1985, 4.2).
As a grows with F, a small change of F is distributed as under a flat punch, 1/(pi sqrt(a^2 - x^2)):
dQ/dF is K averaged over that. Shear follows pressure, q = p tan(alpha), where nothing slips.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial.chebyshev import chebval, chebvander

from ..compiled import compiled
from ..errors import number, refuse
from ..grid import Stage, as_real
from ..numerics import shared_count
from .sensor import Sensor
from .skin import Skin

WIDEST_DEPTHS = 20.0  # half-width of contact: beyond, the load is no edge's, and nodes grow many
_LEAST_NODES = 8
_NARROW_DEPTHS = 0.01  # below, charge is proportional to the load but for rounding
_SHORT_WAVE = 1e9  # rad/m: to such waves a skin is the half space of its surface

ChargeOfLoad = Callable[[np.ndarray], np.ndarray]


class KnifeEdge(eqx.Module):
    """A rounded edge across the sliding direction.

    - `radius_m` [m]: of the edge; 0 is a line load.
    - `direction_rad` [rad]: of the load, from the normal into the finger toward +x.

    Its contact is that on a half space of the skin's surface: on layers it holds for contacts
    narrow beside the thickness of the first. Numbers are concrete, not traced. Raises `BadInput`
    for a negative radius and a direction beyond 90 degrees to either side.
    """

    radius_m: Float[Array, ""]
    direction_rad: Float[Array, ""]

    def __init__(self, radius_m: Any = 0.0, direction_rad: Any = 0.0):
        wanted = "a length in metres that is at least 0"
        self.radius_m = as_real(number("edge radius_m", radius_m, wanted, least=0))
        wanted, right = "an angle from -pi/2 to pi/2", float(np.pi / 2) * (1 + 1e-6)
        self.direction_rad = as_real(
            number("edge direction_rad", direction_rad, wanted, least=-right, most=right)
        )

    def half_width_m(self, skin: Skin, load_N_per_m: Any) -> Float[np.ndarray, "*load"]:
        """Half-width a [m] of the contact (*load,) under each load [N/m]; 0 where nothing presses.

        Raises `BadInput` for a skin whose surface has no modulus.
        """
        load = np.maximum(np.asarray(load_N_per_m, float), 0)
        if float(self.radius_m) == 0:
            return np.zeros(load.shape)
        normal = load * max(float(np.cos(self.direction_rad)), 0.0)
        modulus = contact_modulus_Pa(skin)
        return np.asarray(np.sqrt(4 * normal * float(self.radius_m) / (np.pi * modulus)))

    def charge(
        self, sensor: Sensor, place_m: Any, load_N_per_m: Any
    ) -> Float[np.ndarray, "e place load"]:
        """Charge [C] of every element for the edge at each place [m] under each load [N/m].

        The edge does not adhere: a negative load is none. Raises `BadInput` for a contact wider
        than 20 depths of the film to either side.
        """
        return self._along(self.charge_by_component(sensor, place_m, load_N_per_m))

    def charge_of_load(self, sensor: Sensor, place_m: Any, most_N_per_m: float) -> ChargeOfLoad:
        """The charge [C] (e, place, *load) as a function of loads (*load,) from 0 to `most_N_per_m`
        [N/m], for many of them: a polynomial, to rounding.

        Charge over load is analytic in the load but where a is i times a depth. Raises `BadInput`
        as `charge` does.
        """
        return load_polynomial(
            lambda load: self.charge(sensor, place_m, load), self, sensor, most_N_per_m
        )

    def charge_by_component(
        self, sensor: Sensor, place_m: Any, load_N_per_m: Any
    ) -> Float[np.ndarray, "e c place load"]:
        """Charge [C] by p and by q of every element under the pressure of each normal load [N/m],
        and under a shear of the same distribution and size; as `charge` otherwise."""
        load = np.maximum(np.asarray(load_N_per_m, float), 0)
        half = self.half_width_m(sensor.skin, load)
        angle = np.pi * np.arange(1, (n := _nodes(sensor, half)) + 1) / (n + 1)
        weights = 2 / (n + 1) * np.sin(angle) ** 2
        return load * _average(sensor, place_m, half, np.cos(angle), weights)

    def charge_per_load(
        self, sensor: Sensor, place_m: Any, preload_N_per_m: Any
    ) -> Float[np.ndarray, "e place"]:
        """dQ/dF [C m/N] of every element for the edge at each place [m] under the preload [N/m].

        Raises `BadInput` for a preload that is not positive, and as `charge` does.
        """
        wanted = "a positive load in N/m"
        load = np.array([number("preload_N_per_m", preload_N_per_m, wanted, above=0)], float)
        half = self.half_width_m(sensor.skin, load)
        n = _nodes(sensor, half)
        at = np.cos(np.pi * (np.arange(n) + 0.5) / n)
        return self._along(_average(sensor, place_m, half, at, np.full(n, 1 / n)))[..., 0]

    def _along(self, values: Float[np.ndarray, "e c place load"]) -> np.ndarray:
        """Components of p and q combined in the load's direction."""
        angle = float(self.direction_rad)
        return np.cos(angle) * values[:, 0] + np.sin(angle) * values[:, 1]


class VibratingEdge(eqx.Module):
    """An edge whose load vibrates about a preload, F = F0 + F1 sin(2 pi f t).

    - `edge`; `preload_N_per_m` [N/m]: F0; `amplitude_N_per_m` [N/m]: F1, of a load that leaves the
      skin where it is above the preload.

    Raises `BadInput` for loads that are not positive.
    """

    edge: KnifeEdge
    preload_N_per_m: float = eqx.field(static=True)
    amplitude_N_per_m: float = eqx.field(static=True)

    def __init__(self, edge: KnifeEdge, preload_N_per_m: Any, amplitude_N_per_m: Any):
        self.edge, wanted = edge, "a positive load in N/m"
        self.preload_N_per_m = float(number("preload_N_per_m", preload_N_per_m, wanted, above=0))
        self.amplitude_N_per_m = float(
            number("amplitude_N_per_m", amplitude_N_per_m, wanted, above=0)
        )

    def small_charge(self, sensor: Sensor, place_m: Any) -> Float[np.ndarray, "e place"]:
        """F1 dQ/dF: amplitude [C] of every element's charge, in phase with the load, with the edge
        at each place [m], where the amplitude is far below the preload."""
        return self.amplitude_N_per_m * self.edge.charge_per_load(
            sensor, place_m, self.preload_N_per_m
        )

    def charge_over_period(
        self, sensor: Sensor, place_m: Any, samples: int
    ) -> Float[np.ndarray, "e place sample"]:
        """Charge [C] of every element over one even period from t = 0, for any amplitude."""
        turn = 2 * np.pi * np.arange(samples) / samples
        load = self.preload_N_per_m + self.amplitude_N_per_m * np.sin(turn)
        most = self.preload_N_per_m + self.amplitude_N_per_m
        return self.edge.charge_of_load(sensor, place_m, most)(load)


def load_polynomial(
    charge: ChargeOfLoad, edge: KnifeEdge, sensor: Sensor, most_N_per_m: float
) -> ChargeOfLoad:
    """The `charge` (*row, load) under an edge as a function (*row, *load) of loads from 0 to
    `most_N_per_m` [N/m]: its ratio to the load is a polynomial, to rounding.

    This ratio is analytic in the load but where the half-width of contact is i times a depth.
    """
    widest = float(edge.half_width_m(sensor.skin, most_N_per_m)) / float(sensor.depth_m)
    end = 1 + 2 / max(widest, _NARROW_DEPTHS) ** 2
    ellipse = end + np.sqrt(end**2 - 1)
    count = int(np.log(1 / np.finfo(float).eps) / np.log(ellipse)) + 3
    at = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    load = most_N_per_m * (1 + at) / 2
    ratio = charge(load) / load
    values = np.linalg.solve(chebvander(at, count - 1), ratio.reshape(-1, count).T)

    def polynomial(wanted: np.ndarray) -> np.ndarray:
        inside = np.clip(wanted, 0, most_N_per_m)
        per_load = chebval(2 * inside / most_N_per_m - 1, values)
        return (inside * per_load).reshape(*ratio.shape[:-1], *inside.shape)

    return polynomial


def _average(sensor: Sensor, place_m, half_m, nodes, weights) -> np.ndarray:
    """The charge per load by p and by q (e, c, place, load), K averaged over nodes times the
    half-widths."""
    place = np.atleast_1d(np.asarray(place_m, float))
    if not np.any(half_m):  # all nodes are one
        nodes, weights = np.zeros(1), np.ones(1)
    x = half_m[None, :, None] * nodes[None, None] - place[:, None, None]
    response = line_response(sensor, x.ravel())
    return response.reshape(*response.shape[:2], *x.shape) @ weights


def line_response(sensor: Sensor, x_m: Any) -> Float[np.ndarray, "e c x"]:
    """K_p and K_q: the charge [C m/N] of every element, x [m] beyond a line load of 1 N/m, by p and
    by q. Filters do not act on it, nor do envelopes, as the load is known."""
    # A cell so narrow that its own average is off by as little as rounding is.
    cell = sensor.depth_m * np.cbrt(np.finfo(sensor.depth_m.dtype).eps)
    x = np.asarray(x_m)
    # So many places that contacts of many widths share a program.
    padded = as_real(np.pad(x, (0, shared_count(x.size) - x.size)))
    charge = sensor.touching_everywhere().charge()
    return np.asarray(_per_load(charge, padded, cell))[..., : x.size]


@compiled
def _per_load(stage: Stage, x: Float[Array, " x"], cell_m: Float[Array, ""]) -> Array:
    return stage.cell_response(x, cell_m) / cell_m


def contact_modulus_Pa(skin: Skin) -> float:
    """E* = E/(1 - nu^2) [Pa] of the skin's surface at rest, from its compliance 2/(E* k) to waves
    far shorter than it is thick. Raises `BadInput` for a skin without one."""
    at_rest = np.real(skin.sliding_at(0.0).compliance_once(np.array([_SHORT_WAVE])))[0]
    modulus = 2 / (_SHORT_WAVE * float(at_rest)) if at_rest else np.nan
    refuse(
        not np.isfinite(modulus) or modulus <= 0,
        f"The skin ({skin.words}) has no compliance to short waves, which an edge of "
        "finite radius needs: give radius_m 0, or a skin with compliance(k) > 0.",
    )
    return modulus


def _nodes(sensor: Sensor, half_m: np.ndarray) -> int:
    """Nodes of Gauss and Chebyshev's rule over the widest contact.

    K is analytic within a depth of the real axis: the error falls as r^(-2 nodes), r the sum of the
    half axes of the ellipse up to there.
    """
    depth, widest = float(sensor.depth_m), float(np.max(half_m, initial=0.0))
    refuse(
        widest > WIDEST_DEPTHS * depth,
        f"The edge touches over {2 * widest:.3g} m, more than {2 * WIDEST_DEPTHS:g} depths of the "
        "film: give a smaller radius_m or load.",
    )
    if widest == 0:
        return _LEAST_NODES
    needed = np.log(1 / np.finfo(float).eps) / (2 * np.arcsinh(depth / widest)) + 2
    return int(2 ** np.ceil(np.log2(max(needed, _LEAST_NODES))))
