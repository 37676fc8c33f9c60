"""Bases of the effects that depart from constant speed."""

import numpy as np

from ..forward.scenario import Scenario
from ..forward.speed_profile import Interruption
from ._reference import ReferenceSpectra
from .general import SpeedProfileEffect


class InterruptionEffect(SpeedProfileEffect[Interruption]):
    """An interruption of the motion. A duration of 0 is none."""

    def apply(self, scenario: Scenario) -> Scenario:
        return super().apply(scenario) if self.speed_profile.duration_s else scenario

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        by = self.speed_profile
        if not by.duration_s:
            return 0.0
        # All that comes after it comes later.
        delay_s = by.slowdown * float(by.duration_s + by.ramp_s)
        delayed_m = abs(reference.speed_m_per_s) * delay_s
        return by.slowdown + displaced_bound(reference, delayed_m)


def displaced_bound(reference: ReferenceSpectra, moved_m: float) -> float:
    """A bound on the relative change of a signal that comes from up to `moved_m` away:
    |exp(ika) - 1| is ka at most, and 2."""
    factor = np.minimum(reference.k * moved_m, 2.0)
    return reference.relative_rms_of_modulus(factor * np.abs(reference.signal))
