"""A finger that slides back on its way, and on again."""

from typing import ClassVar

from ..forward.scenario import Scenario
from ..forward.speed_profile import ReversalProfile as Back
from ._effect import Effect, Order
from ._paced import displaced_bound, with_speed_profile
from ._reference import ReferenceSpectra


class Reversal(Effect):
    """Sliding backwards for `duration_s` from `at_s` on, turning over `ramp_s`; friction turns with
    it. A duration of 0 is none. Raises `BadInput` as the speed profile does."""

    order: ClassVar[Order] = Order.MOTION
    of_sensor: ClassVar[bool] = False
    speed_profile: Back

    def __init__(self, at_s, duration_s, ramp_s=0.01):
        self.speed_profile = Back(at_s, duration_s, ramp_s)

    def apply(self, scenario: Scenario) -> Scenario:
        return (
            with_speed_profile(scenario, self.speed_profile)
            if self.speed_profile.window.duration_s
            else scenario
        )

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        if not self.speed_profile.window.duration_s:
            return 0.0
        delay_s = 2 * float(self.speed_profile.window.duration_s + self.speed_profile.window.ramp_s)
        return 2.0 + displaced_bound(reference, abs(reference.speed_m_per_s) * delay_s)
