"""Parts of a signal that are even and odd about a place.

A line of pressure makes a charge that is even about it, and a line of shear one that is odd; each
one's rate has the other symmetry.
"""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline


def even_and_odd(
    x_m: Float[np.ndarray, " n"],
    signals: Float[np.ndarray, "*rows n"],
    places_m: Float[np.ndarray, " place"],
    reach_m: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, "*rows place m"], Float[np.ndarray, "*rows place m"]]:
    """The even and the odd part of signals over x about each place, by cubic splines, at distances
    `reach_m` from it that are themselves even about zero."""
    near = CubicSpline(x_m, signals, axis=-1)(places_m[:, None] + reach_m)
    return (near + near[..., ::-1]) / 2, (near - near[..., ::-1]) / 2
