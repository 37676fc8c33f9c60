"""Functions shared by the effects that depart from constant speed."""

import numpy as np

from ..forward.scenario import Scenario
from ..forward.speed_profile import SpeedProfile
from ._reference import ReferenceSpectra


def with_speed_profile(scenario: Scenario, by: SpeedProfile) -> Scenario:
    """The scenario with one more departure from constant speed."""
    return scenario.with_recorder(speed_profiles=(*scenario.recorder.speed_profiles, by))


def displaced_bound(reference: ReferenceSpectra, moved_m: float) -> float:
    """A bound on the relative change of a signal that comes from up to `moved_m` away:
    |exp(ika) - 1| is ka at most, and 2."""
    factor = np.minimum(reference.k * moved_m, 2.0)
    return reference.relative_rms_of_modulus(factor * np.abs(reference.signal))
