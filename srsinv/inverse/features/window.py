"""The stretch of a long recording that a fit of local features goes by.

A rate signal decays within some depths of the load that makes it: further off there is noise
alone, which says nothing of the load but its own level. The stretch is where the signal is above
the noise, with a margin. Which one that is the data choose, so that the evidence is that of a
feature anywhere in the recording.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ... import false_alarm
from ...errors import refuse
from ...forward.feature import ScanExtent
from ...forward.scan import Motion
from ...grid import as_real
from ...modules import with_fields
from ...resolution import cell_m, margin_m
from ..gridding.cells import Window, check_cells
from ..problem import Problem
from .loading import Features
from .model import scan_extent

LONG = 96  # depths: shorter recordings are fitted whole, and no stretch is longer but for margins


class FittedStretch(NamedTuple):
    """The `problem` of the samples that a fit goes by, the `whole` extent of the recording, and
    where else its signal is above the noise: x [m], or None."""

    problem: Problem
    whole: ScanExtent
    elsewhere_m: float | None = None

    @property
    def window(self) -> Window:
        """Where the samples are."""
        own = self._extent
        return Window(own.start_m, own.end_m)

    @property
    def _extent(self) -> ScanExtent:
        return scan_extent(self.problem.sensor, self.problem.motion)

    @property
    def is_part(self) -> bool:
        """Whether some of the recording is left out."""
        return self._extent != self.whole

    def log_prior_ratio(self, features: Features) -> float:
        """The logarithm of the priors of shapes anywhere in the recording over those of shapes in
        the stretch: of the lengths of what is searched."""
        total = 0.0
        for feature in features.values():
            near, far = (feature.ranges(each) for each in (self._extent, self.whole))
            total += sum(np.log(np.ptp(near[name]) / np.ptp(far[name])) for name in feature.axes)
        return float(total)

    @property
    def warnings(self) -> tuple[str, ...]:
        """That there is more in the recording."""
        if self.elsewhere_m is None:
            return ()
        start, end = self.window
        return (
            f"The fit uses the stretch from {start:.6g} m to {end:.6g} m, where the signal is "
            "strongest. The signal exceeds the noise elsewhere, too, first at "
            f"{self.elsewhere_m:.6g} m: give the feature's position_range_m for another stretch.",
        )


def stretch_of(problem: Problem, features: Features) -> FittedStretch:
    """The stretch that features of traction are fitted to: all of a recording of up to `LONG`
    depths, of features that are no local load, of a signal that is not a rate, of coloured noise,
    which is known as a fraction of the whole signal's rms, and of lines of mains. Raises `BadInput`
    where no sample is in the features' range, and for a scan so long that a unit is wrong."""
    depth = float(problem.sensor.depth_m)
    whole = scan_extent(problem.sensor, problem.motion)
    is_local = not any(each.is_of_surface or each.is_periodic for each in features.values())
    is_rate = problem.sensor.amplifier.order == 1 and not problem.has_free_offset
    is_white = not problem.noise.causes and not problem.noise.has_drift and not problem.mains
    if not is_local or not is_rate or not is_white or whole.length_m <= LONG * depth:
        return FittedStretch(problem, whole)
    check_cells(problem.name, whole.length_m, cell_m("load", depth))
    x, power, is_above = _blocks(problem)
    ranges = [each.ranges(whole).get("position_m", (-np.inf, np.inf)) for each in features.values()]
    inside = np.any([(low <= x) & (x <= high) for low, high in ranges], axis=0)
    refuse(
        not inside.any(),
        f"{problem.name}: no sample lies in the feature's position_range_m: give a range within "
        f"[{whole.start_m:.6g}, {whole.end_m:.6g}] m.",
    )
    margin = margin_m("fade", depth)
    near = _around(x, power, is_above & inside, inside, LONG * depth - 2 * margin, margin)
    window = Window(near.start_m - margin, near.end_m + margin)
    left = is_above & inside & ((x < window.start_m) | (x > window.end_m))
    return FittedStretch(_cut(problem, window), whole, float(x[left][0]) if left.any() else None)


def _blocks(
    problem: Problem,
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"], Bool[np.ndarray, " b"]]:
    """Position, power in units of the noise, and whether that is above it, of means of samples."""
    motion, observed = problem.motion, problem.observed
    depth, x = float(problem.sensor.depth_m), np.asarray(motion.position_m)
    moved = float(np.sum(np.abs(np.diff(x)))) / x.size
    size = max(1, int(cell_m("contact_search_samples", depth) / moved))
    used = x.size // size * size

    def sums(values: np.ndarray) -> np.ndarray:
        return values[..., :used].reshape(*values.shape[:-1], -1, size).sum(axis=-1)

    total = sums(np.where(observed, np.asarray(problem.data), 0.0))
    count = np.maximum(sums(observed.astype(float)), 1)
    level = np.asarray(problem.noise.white, float)[:, None]
    power = np.sum((total / level) ** 2 / count, axis=0)
    above = float(scipy.special.chdtri(len(total), false_alarm.BLOCK / power.size))
    return sums(x) / size, power, power > above


def _around(
    x: Float[np.ndarray, " b"],
    power: Float[np.ndarray, " b"],
    is_above: Bool[np.ndarray, " b"],
    inside: Bool[np.ndarray, " b"],
    most_m: float,
    apart_m: float,
) -> Window:
    """Where the signal is: all of it that is above the noise, where it is no longer than `most_m`,
    else what is no further apart than `apart_m` around the strongest."""
    strongest = float(x[np.argmax(np.where(inside, power, -np.inf))])
    above = np.sort(np.append(x[is_above], strongest))
    if np.ptp(above) <= most_m:
        return Window(float(above[0]), float(above[-1]))
    cuts = np.flatnonzero(np.diff(above) > apart_m) + 1
    runs = np.split(above, cuts)
    own = next(run for run in runs if run[0] <= strongest <= run[-1])
    half = most_m / 2
    return Window(max(float(own[0]), strongest - half), min(float(own[-1]), strongest + half))


def _cut(problem: Problem, window: Window) -> Problem:
    """The problem of the samples from the first to the last one in the window."""
    motion, x = problem.motion, np.asarray(problem.motion.position_m)
    at = np.flatnonzero((window.start_m <= x) & (x <= window.end_m))
    own = slice(int(at[0]), int(at[-1]) + 1)
    columns = (motion.time_s, motion.position_m, motion.speed_m_per_s)
    return with_fields(
        problem,
        motion=Motion(*(np.asarray(each)[own] for each in columns)),
        data=as_real(np.asarray(problem.data)[:, own]),
        observed=problem.observed[:, own],
    )
