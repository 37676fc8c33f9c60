"""Whether pressure is the same in passes there and back, as a joint inversion takes it to be, and
whether a stage whose positions are off on the way back is why it is not."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ... import false_alarm
from ...forward.scan import Motion
from ...modules import with_fields
from ...recording.passes import go_both_ways, passes_of, with_backlash
from ..estimate import COMPONENTS, Estimate
from ..line.model import CHI2, FREEDOM
from ..problem import Problem
from ..quality import Quality

STEP_DEPTHS = 0.02  # between offsets that are tried
EXPLAINED = 0.1  # of what both ways leave more together: less is left beside backlash


def pressure_by_direction(
    method: Callable[[Any], Estimate], problem: Problem, joint: Estimate
) -> tuple[str, ...]:
    """Warning on a pressure that changes with the direction of sliding.

    Each way is inverted by itself; `joint` is what the method gives for both together. Of one
    pressure in both, the joint fit leaves so much more of the signals than the others do as its
    degrees of freedom are fewer, but for the scatter of a chi-square; what the priors pull is less
    where both are together. Empty where the joint fit leaves no more than noise, where the motion
    does not turn, and where one way alone does not tell p from q.
    """
    cannot_part = problem.friction is None and len(problem.sensor.elements) < 2
    turns = go_both_ways(passes_of(np.asarray(problem.motion.position_m)))
    if not turns or problem.direction is not None or cannot_part:
        return ()
    if not _leaves_more_than_noise(joint):
        return ()
    both = [method(problem.of_direction(direction)) for direction in (True, False)]
    if any(each.quality is Quality.FAILED for each in both):
        return ()
    freedom = max(sum(map(_resolved, both)) - _resolved(joint), 1.0)
    separate = sum(map(_squares, both))
    more = _squares(joint) - separate
    if scipy.special.chdtrc(freedom, more) > false_alarm.DIRECTIONS:
        return ()
    line, position = both[0].line, np.asarray(problem.motion.position_m)
    x = np.asarray(line.x)
    cells = (x > position.min()) & (x < position.max())
    p = [np.asarray(each.on(line).value)[0, cells] for each in both]
    backlash = _backlash(method, problem, _offset(x[cells], p))
    if backlash.left < separate + EXPLAINED * more:
        return (backlash.warning,)
    share = float(np.std(p[0] - p[1]) / max(map(np.std, p)))
    return (
        "The passes towards +x and those towards -x do not show the same pressure: inverted by "
        f"themselves they give pressures that differ by {100 * share:.0f} %, and together they "
        f"leave {more:.3g} more in chi-square, of {freedom:.3g} degrees of freedom. The skin is "
        "viscoelastic, the load or the stage's position changes with the direction, or drift or "
        "hum is on the signals (recording.drift, recording.mains_Hz): invert each way by "
        "recording.ways=onwards and recording.ways=back.",
    )


class _Backlash(NamedTuple):
    """By how much further on positions are on the way back [m], its standard error, and the
    chi-square that the joint inversion then leaves."""

    value_m: float
    stderr_m: float
    left: float

    @property
    def warning(self) -> str:
        """By how much both ways disagree, and what takes it out."""
        return (
            "The passes towards -x show the pressure of those towards +x "
            f"{self.value_m:.4g} ± {self.stderr_m:.2g} m further on, as of a stage with "
            f"backlash: give recording.backlash_m={-self.value_m:.4g}, which is added to "
            "positions on the way back."
        )


def _offset(x: Float[np.ndarray, " x"], p: Sequence[Float[np.ndarray, " x"]]) -> float:
    """By how much the second pressure is further on than the first, by least squares."""
    onwards, back = (each - np.mean(each) for each in p)
    offset = 0.0
    for _ in range(5):
        shifted = np.interp(x + offset, x, back)
        slope = np.gradient(onwards, x)
        offset += float(slope @ (onwards - shifted) / (slope @ slope))
    return offset


def _backlash(method: Callable[[Any], Estimate], problem: Problem, near_m: float) -> _Backlash:
    """The offset of the way back under which the joint inversion leaves least, near this one: of
    the parabola through three of them."""
    step = STEP_DEPTHS * float(problem.sensor.depth_m)
    tried = near_m + step * np.array([-1.0, 0.0, 1.0])
    left = []
    for offset_m in tried:
        position = with_backlash(np.asarray(problem.motion.position_m), -offset_m)
        motion = Motion(problem.motion.time_s, position, problem.motion.speed_m_per_s)
        left.append(_squares(method(with_fields(problem, motion=motion))))
    curvature = max(left[0] - 2 * left[1] + left[2], np.finfo(float).tiny)
    change = float(np.clip((left[0] - left[2]) / (2 * curvature), -1.0, 1.0))
    least = left[1] - (left[0] - left[2]) ** 2 / (8 * curvature)
    return _Backlash(near_m + step * change, step * float(np.sqrt(2 / curvature)), float(least))


def _leaves_more_than_noise(estimate: Estimate) -> bool:
    """Whether chance leaves as much of the signals once in 1 / `false_alarm.DIRECTIONS`."""
    ratio, freedom = estimate.stats[CHI2], estimate.stats[FREEDOM]
    return ratio is not None and bool(
        scipy.special.chdtrc(freedom, ratio * freedom) < false_alarm.DIRECTIONS
    )


def _resolved(estimate: Estimate) -> float:
    """Degrees of freedom that the signals resolve."""
    return sum(float(estimate.stats.get(f"resolved_dof_{c}", 0.0)) for c in COMPONENTS)


def _squares(estimate: Estimate) -> float:
    """Chi-square of the residual."""
    return float(np.nansum(np.asarray(estimate.whitened) ** 2))
