"""Indentation of a skin on a rigid core by a knife edge.

On a half space in plane strain the displacement under a line load is logarithmic and not defined
without a far boundary; on layers bonded to a rigid core it is. Under a load F with the spectrum
F e(k) the surface at the middle goes down by

    delta = F/pi integral over k > 0 of C(k) e(k) dk,   C(k) the skin's compliance,

with e = 2 J_1(ka)/(ka) of Hertz's ellipse for the load, and e = J_0(ka) of a flat punch for a small
change of it, d delta/dF. The part 2/(E* k) (1 - exp(-kh)) of C has closed forms; the rest, which
decays as exp(-kh), is the trapezoidal rule in ln k.
"""

from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ..errors import refuse
from .knife_edge import KnifeEdge, contact_modulus_Pa
from .skin import Skin

_LN_STEP = 0.005
_LONGEST, _SHORTEST = 1e-11, 1e4  # times 1/h
_POINTS = 241  # of the table of loads
_LEAST_LOAD = 1e-8  # of the table, over its largest
_STILL_GROWS = 0.5  # k C(k) over ten times longer waves, where C is as 1/k it is 1


class Indentation:
    """The relation of load and indentation of an edge on one skin, at rest.

    Hertz's distribution of load is kept on layers: that holds for contacts narrow beside the first
    layer's thickness. Raises `BadInput` for an edge of no radius, and for a skin without a rigid
    core below.
    """

    def __init__(self, edge: KnifeEdge, skin: Skin, depth_m: float):
        refuse(
            float(edge.radius_m) == 0,
            "edge radius_m is 0, and a line load indents without limit: prescribe the "
            "load, or give a radius above 0.",
        )
        self.edge, self.skin, self.height_m = edge, skin.sliding_at(0.0), depth_m
        refuse(
            not has_indentation(edge, skin, depth_m),
            f"A prescribed displacement needs a skin on a rigid core, not {skin.words}: "
            "prescribe the load, or give layers on a rigid core, as skin=layered.",
        )
        self.modulus_Pa = contact_modulus_Pa(self.skin)
        log_k = np.arange(np.log(_LONGEST), np.log(_SHORTEST), _LN_STEP)
        self._k = np.exp(log_k) / depth_m
        near = -2 * np.expm1(-self._k * depth_m) / (self.modulus_Pa * self._k)
        rest = np.real(self.skin.compliance_once(self._k)) - near
        self._weights = _LN_STEP / np.pi * self._k * rest

    def indentation_m(self, load_N_per_m: Float[np.ndarray, " load"]) -> np.ndarray:
        """Indentation delta [m] (load,) under each positive load [N/m]."""
        load = np.asarray(load_N_per_m, float)
        half, h = self._half(load), self.height_m
        z = np.outer(half, self._k)
        near = (h * np.hypot(h, half) - h * h) / half**2 + np.arcsinh(h / half)
        rest = (2 * scipy.special.j1(z) / z) @ self._weights
        return load * self._normal * (2 / (np.pi * self.modulus_Pa) * near + rest)

    def per_load(self, load_N_per_m: Float[np.ndarray, " load"]) -> np.ndarray:
        """d delta/dF [m^2/N] (load,) at each positive load [N/m]."""
        half = self._half(np.asarray(load_N_per_m, float))
        near = np.arcsinh(self.height_m / half)
        rest = scipy.special.j0(np.outer(half, self._k)) @ self._weights
        return self._normal * (2 / (np.pi * self.modulus_Pa) * near + rest)

    def load_N_per_m(self, indentation_m: Any, most_N_per_m: float) -> np.ndarray:
        """The load [N/m] at each indentation [m], 0 where the edge is off the skin, from a table up
        to `most_N_per_m` and four times as much."""
        table = 4 * most_N_per_m * np.geomspace(_LEAST_LOAD, 1, _POINTS)
        along = np.log(self.indentation_m(table))
        spline = scipy.interpolate.make_interp_spline(along, np.log(table), 5)
        wanted = np.asarray(indentation_m, float)
        refuse(
            bool(np.max(wanted) > np.exp(along[-1])),
            f"An indentation of {np.max(wanted):.3g} m needs more than "
            f"{4 * most_N_per_m:.3g} N/m: give a smaller amplitude.",
        )
        touches = wanted > np.exp(along[0])
        return np.where(touches, np.exp(spline(np.log(np.where(touches, wanted, 1.0)))), 0.0)

    @property
    def _normal(self) -> float:
        return float(np.cos(self.edge.direction_rad))

    def _half(self, load: np.ndarray) -> np.ndarray:
        return self.edge.half_width_m(self.skin, load)


def has_indentation(edge: KnifeEdge, skin: Skin, depth_m: float) -> bool:
    """Whether the indentation of the edge is defined: it has a radius, and the skin's compliance
    does not grow as 1/k to the longest waves, as it does without a rigid core."""
    k = np.array([1.0, 0.1]) * 1e-9 / depth_m
    short, long = k * np.abs(skin.sliding_at(0.0).compliance_once(k))
    return float(edge.radius_m) > 0 and bool(long < _STILL_GROWS * short)


def relative_modulus(skin: Skin, frequency_hz: Float[np.ndarray, " f"], depth_m: float):
    """m(i w) (f,): the complex modulus of a skin all of whose layers relax alike over that at rest,
    from its compliance in steady sliding, where w = k u; 1 for an elastic skin."""
    k = np.array([1 / depth_m])
    at_rest = skin.sliding_at(0.0).compliance_once(k)[0]
    speeds = 2 * np.pi * np.asarray(frequency_hz, float) / k[0]
    return np.array([at_rest / skin.sliding_at(each).compliance_once(k)[0] for each in speeds])
