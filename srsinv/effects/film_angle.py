"""Films mounted askew: every one turned by a further angle, so that it responds to tau_xz too."""

import dataclasses
from typing import ClassVar

import numpy as np
from jaxtyping import Array, Float

from ..errors import number
from ..forward.scenario import Scenario
from ..grid import as_real
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class FilmAngle(Effect):
    """All films turned by `tilt_deg`, from +x toward +z, beyond their own orientation.

    Raises `BadInput` for a tilt that is not a number.
    """

    order: ClassVar[Order] = Order.FILM
    of_sensor: ClassVar[bool] = True
    tilt_rad: Float[Array, ""]

    def __init__(self, tilt_deg):
        wanted = "an angle in degrees"
        tilt = number("effects.film_angle.tilt_deg", tilt_deg, wanted, least=-360, most=360)
        self.tilt_rad = as_real(tilt * np.pi / 180)

    def apply(self, scenario: Scenario) -> Scenario:
        return scenario.with_films(
            lambda each: dataclasses.replace(each, angle_rad=each.angle_rad + self.tilt_rad)
        )

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        # Half the difference of the weights of sigma_x and sigma_z, and half that of tau_xz, turn
        # by twice the angle (docs/explanation/physics/film.md).
        along, through, shear, across = reference.weights.T
        half, turn = (along - through) / 2, 2 * float(self.tilt_rad)
        less = half * (np.cos(turn) - 1) - shear / 2 * np.sin(turn)
        more = half * np.sin(turn) + shear / 2 * (np.cos(turn) - 1)
        change = np.stack([less, -less, 2 * more, 0 * across], axis=1)
        charge = np.einsum("es,esk->ek", change, reference.film_stress)
        return reference.relative_rms(reference.read(charge))
