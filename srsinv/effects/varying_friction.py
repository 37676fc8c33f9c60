"""Friction that falls with pressure, as rubber's does, and varies with speed."""

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Array, Float

from ..errors import number
from ..forward.scenario import Scenario
from ..forward.varying_friction import MOST_EXPONENT, RubberFriction
from ..grid import Periodic, as_real
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class VaryingFriction(Effect):
    """The scene's friction times (p/p0)^(-a) (|u|/u0)^b, p the local pressure.

    - `pressure_exponent`: a, from 0 to 1. `reference_pressure_Pa` [Pa]: p0; None: the scene's
      background pressure. `speed_exponent`: b; `reference_speed_m_per_s` [m/s]: u0.

    Raises `BadInput` for numbers out of range, and without p0 where the scene's background has no
    pressure.
    """

    order: ClassVar[Order] = Order.CONTACT
    of_sensor: ClassVar[bool] = False
    pressure_exponent: Float[Array, ""]
    reference_pressure_Pa: Float[Array, ""] | None
    speed_exponent: float
    reference_speed_m_per_s: Float[Array, ""]

    def __init__(
        self,
        pressure_exponent: Any,
        reference_pressure_Pa: Any = None,
        speed_exponent: Any = 0.0,
        reference_speed_m_per_s: Any = 0.05,
    ):
        key, wanted = "effects.varying_friction", f"a number from 0 to {MOST_EXPONENT:g}"
        exponent = number(
            f"{key}.pressure_exponent", pressure_exponent, wanted, least=0, most=MOST_EXPONENT
        )
        self.pressure_exponent, self.reference_pressure_Pa = as_real(exponent), None
        if reference_pressure_Pa is not None:
            name, wanted = f"{key}.reference_pressure_Pa", "a positive pressure in Pa"
            p0 = number(name, reference_pressure_Pa, wanted, above=0)
            self.reference_pressure_Pa = as_real(p0)
        self.speed_exponent = float(number(f"{key}.speed_exponent", speed_exponent, "a number"))
        name, wanted = f"{key}.reference_speed_m_per_s", "a positive speed in m/s"
        speed = number(name, reference_speed_m_per_s, wanted, above=0)
        self.reference_speed_m_per_s = as_real(speed)

    def apply(self, scenario: Scenario) -> Scenario:
        if scenario.scene is None:
            return scenario
        relative = np.abs(scenario.scan.speed_m_per_s) / self.reference_speed_m_per_s
        return scenario.replace(
            scene=RubberFriction(
                scenario.scene, self.pressure_exponent, self.reference_pressure_Pa,
                self.speed_exponent, relative,
            )
        )  # fmt: skip

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        scene = self.apply(reference.scenario).scene
        if not isinstance(scene, RubberFriction):  # bursts, which are no friction of a surface
            return 0.0
        # The shear follows from the reference's own pressure.
        background, n = reference.background_Pa, reference.line.n
        p, q = np.fft.irfft(reference.traction, n) + background[:, None]
        more = q * (np.asarray(scene.factor(as_real(p))) - 1)
        if not isinstance(reference.line, Periodic):
            more = more - background[1] * (float(scene.factor(as_real(background[0]))) - 1)
        per_shear = np.einsum("es,esk->ek", reference.weights, reference.stress[:, :, 1])
        change = reference.transfer_of_others * reference.read(per_shear * np.fft.rfft(more))
        signal = reference.transfer_of_others * reference.signal
        return reference.relative_difference(signal + change, signal)
