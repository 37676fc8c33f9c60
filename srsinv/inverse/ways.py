"""Whether pressure is the same in passes there and back, as a joint inversion takes it to be."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from ..recording.passes import go_both_ways
from .estimate import COMPONENTS, Estimate
from .line_model import CHI2, FREEDOM
from .passes import passes_of
from .problem import Problem
from .quality import Quality

FALSE_ALARM = 1e-3  # of a pressure that is the same


def pressure_by_way(
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
    turns = go_both_ways(passes_of(problem.motion))
    if not turns or problem.way is not None or cannot_part:
        return ()
    if not _leaves_more_than_noise(joint):
        return ()
    both = [method(problem.of_way(way)) for way in (True, False)]
    if any(each.quality is Quality.FAILED for each in both):
        return ()
    freedom = max(sum(map(_resolved, both)) - _resolved(joint), 1.0)
    more = _squares(joint) - sum(map(_squares, both))
    if scipy.stats.chi2.sf(more, freedom) > FALSE_ALARM:
        return ()
    line, position = both[0].line, np.asarray(problem.motion.position_m)
    cells = (np.asarray(line.x) > position.min()) & (np.asarray(line.x) < position.max())
    p = [np.asarray(each.on(line).value)[0, cells] for each in both]
    share = float(np.std(p[0] - p[1]) / max(map(np.std, p)))
    return (
        "The passes towards +x and those towards -x do not show the same pressure: inverted by "
        f"themselves they give pressures that differ by {share:.0%}, and together they leave "
        f"{more:.3g} more in chi-square, of {freedom:.3g} degrees of freedom. The skin is "
        "viscoelastic, the load or the stage's position changes with the direction, or drift or "
        "hum is on the signals (recording.drift, recording.mains_Hz): invert each way by "
        "recording.ways=onwards and recording.ways=back.",
    )


def _leaves_more_than_noise(estimate: Estimate) -> bool:
    """Whether chance leaves as much of the signals once in 1 / `FALSE_ALARM`."""
    ratio, freedom = estimate.stats[CHI2], estimate.stats[FREEDOM]
    return ratio is not None and bool(scipy.stats.chi2.sf(ratio * freedom, freedom) < FALSE_ALARM)


def _resolved(estimate: Estimate) -> float:
    """Degrees of freedom that the signals resolve."""
    return sum(float(estimate.stats.get(f"resolved_dof_{c}", 0.0)) for c in COMPONENTS)


def _squares(estimate: Estimate) -> float:
    """Chi-square of the residual."""
    return float(np.nansum(np.asarray(estimate.whitened) ** 2))
