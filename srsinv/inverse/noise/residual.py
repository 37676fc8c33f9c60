"""Noise that a fit estimates from what it leaves: fit and noise in turn.

White noise of a level of its own in each channel, and either a part that is correlated along the
motion, of levels estimated too, or a random walk in time of a stated one. The waves of mains are
beside them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from ... import false_alarm
from ...forward.scan import Motion
from ..diagnostics import sliding_noise
from ..nonlinear import Fit, WhitePlusOU, WithNuisance
from ..problem import Problem
from .model import SampleNoise, Samples
from .sliding import Levels, estimate, evidence_of_sliding, first_levels

ROUNDS = 4  # of fitting, and estimating the noise from the residual


@dataclass(frozen=True)
class ResidualNoise:
    """How the noise of signals along a motion is estimated.

    - `depth_m` of the film, which gives the scale of what is correlated.
    - `known`: a first level of the white noise, where there are waves; and what drifts. Where
      nothing does, what is correlated is estimated.
    - `waves` (e, m, sample): see [`WithNuisance`][]; None: there are none.
    """

    motion: Motion
    depth_m: float
    known: SampleNoise = field(default_factory=lambda: SampleNoise(1.0))
    waves: Float[np.ndarray, "e m sample"] | None = None

    def first(self, y: Float[np.ndarray, "e sample"]) -> Levels:
        """First levels, from the samples' differences."""
        levels = first_levels(self.without_waves(y), self.depth_m)
        if not self.known.has_drift:
            return levels
        rms, slow_s = self.known.drift_as_correlated(np.asarray(self.motion.time_s))
        return Levels(levels.white, rms, slow_s * self._mean_speed, is_stated=True)

    def without_waves(self, y: Float[np.ndarray, "e sample"]) -> Float[np.ndarray, "e sample"]:
        """The signals less the waves that they say of themselves."""
        if self.waves is None:
            return y
        white = np.where(np.isfinite(y), np.asarray(self.known.white)[:, None], np.inf)
        return WithNuisance.of(white, self.waves).without(y)

    def whitener(
        self, levels: Levels, y: Float[np.ndarray, "e sample"]
    ) -> WhitePlusOU | WithNuisance:
        """Whitener of the noise of these levels, at the samples of `y` that are there."""
        alone = levels.whitener(self._path_m, np.isfinite(y))
        return alone if self.waves is None else WithNuisance.of(alone, self.waves)

    def alone(self, y: Float[np.ndarray, "e sample"]) -> Levels:
        """The levels where there is nothing but noise."""
        levels = self.first(y)
        left = _without_waves(self.whitener(levels, y), y)
        return estimate(left, self._path_m, self.depth_m, start=levels)

    def settled(
        self,
        fitted: Callable[[Mapping[str, Any], Any], Fit],
        result: Fit,
        levels: Levels,
        y: Float[np.ndarray, "e sample"],
    ) -> tuple[Fit, Levels]:
        """Fit and noise in turn, until the noise no longer changes; `fitted` fits from a start with
        a noise."""
        step = float(np.median(np.abs(np.diff(self.motion.position_m))))
        white = self.whitener(levels, y)
        for _ in range(ROUNDS):
            last, taken = levels, white.coloured(result.jacobian)
            left = _without_waves(white, result.residual)
            levels = estimate(left, self._path_m, self.depth_m, taken, last)
            white = self.whitener(levels, y)
            result = fitted(dict(result.value), white)
            if not levels.differs_from(last, max(step, 1e-9 * self.depth_m)):
                break
        return result, levels

    def warnings(
        self, levels: Levels, y: Float[np.ndarray, "e sample"], result: Fit
    ) -> tuple[str, ...]:
        """Warnings on noise that was estimated from a fit's residual; a correlated part that is
        known, or that chance makes as well, says nothing."""
        if levels.is_stated:
            return ()
        white = self.whitener(levels, y)
        left = _without_waves(white, result.residual)
        clean = y - (result.residual - left)
        warnings = tuple(sliding_noise(levels.sliding_rms / float(np.sqrt(np.nanmean(clean**2)))))
        if not warnings:
            return ()
        taken = white.coloured(result.jacobian)
        odds = evidence_of_sliding(left, self._path_m, taken, levels)
        return warnings if odds >= -np.log(false_alarm.CHECK) else ()

    @property
    def _path_m(self) -> Float[np.ndarray, " sample"]:
        """What noise is correlated along: where the finger is, or, of a walk, the time."""
        if not self.known.has_drift:
            return np.asarray(self.motion.position_m)
        return self._mean_speed * np.asarray(self.motion.time_s)

    @property
    def _mean_speed(self) -> float:
        return float(np.mean(np.abs(np.asarray(self.motion.speed_m_per_s))))


def _without_waves(
    white: WhitePlusOU | WithNuisance, residual: Float[np.ndarray, "e sample"]
) -> Float[np.ndarray, "e sample"]:
    """A residual without the waves that stand beside the noise, if any."""
    return white.without(residual) if isinstance(white, WithNuisance) else residual


def residual_noise(problem: Problem, samples: Samples) -> ResidualNoise:
    """That of a problem's samples, with the waves and the drift that are named."""
    depth = float(problem.sensor.depth_m)
    return ResidualNoise(samples.motion, depth, problem.noise, samples.waves)
