"""A finger that stops on its way, and goes on."""

from typing import ClassVar

from ..forward.scenario import Scenario
from ..forward.speed_profile import StandstillProfile as Rest
from ._effect import Effect, Order
from ._paced import displaced_bound, with_speed_profile
from ._reference import ReferenceSpectra


class Standstill(Effect):
    """A rest of `duration_s` from `at_s` on, slowing down and speeding up over `ramp_s`. A duration
    of 0 is none. Raises `BadInput` as the speed profile does."""

    order: ClassVar[Order] = Order.MOTION
    of_sensor: ClassVar[bool] = False
    speed_profile: Rest

    def __init__(self, at_s, duration_s, ramp_s=0.01):
        self.speed_profile = Rest(at_s, duration_s, ramp_s)

    def apply(self, scenario: Scenario) -> Scenario:
        return (
            with_speed_profile(scenario, self.speed_profile)
            if self.speed_profile.window.duration_s
            else scenario
        )

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        # All that comes after it comes later.
        delay_s = float(self.speed_profile.window.duration_s + self.speed_profile.window.ramp_s)
        if not self.speed_profile.window.duration_s:
            return 0.0
        return 1.0 + displaced_bound(reference, abs(reference.speed_m_per_s) * delay_s)
