"""Probabilities of detection against false alarms, and delays, of each event alone."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from srsinv.forward.episode import KINDS_OF_EVENT
from srsinv.inverse.events.matched import EventDetector
from srsinv.inverse.events.templates import FADED
from srsinv.inverse.events.threshold import (
    ThresholdDetector,
    detection_by_threshold,
    threshold,
)

from .setting import EventSetting

FALSE_ALARMS_PER_S = (1e-3, 1e-2, 0.1, 1.0, 10.0)


class Characteristics:
    """Statistics of each event in many draws of noise: they are those of the event, in proportion
    to its strength, and of the noise."""

    def __init__(
        self,
        setting: EventSetting,
        detector: EventDetector,
        simple: ThresholdDetector,
        key: PRNGKeyArray,
    ):
        self.setting, self.detector, self.simple = setting, detector, simple
        self.rate_hz = detector.rate_hz
        self.events = self._events()
        longest = max(event.shape[-1] for event in self.events)
        shape = setting.given["draws"], len(setting.clean), detector.bank.longest - 1 + longest
        self.noise = np.asarray(jax.random.normal(key, shape), float)  # the same for all events
        self.of_noise = [detector.bank(one) for one in self.noise]
        per_sample = [each / self.rate_hz for each in FALSE_ALARMS_PER_S]
        self.limits = [detector.bank.limit(each) for each in per_sample]
        self.thresholds = [threshold(len(setting.clean), each) for each in per_sample]

    def curves(self) -> dict[str, np.ndarray]:
        """By name, for each kind of event (kind, ...)."""
        each = [self._of(event) for event in self.events]
        return {name: np.array([one[name] for one in each]) for name in each[0]}

    def _events(self) -> list[Float[np.ndarray, "e n"]]:
        """The whitened signal of each event alone, from its onset on."""
        episode, whitened = self.setting.episode, self.setting.whitener(self.setting.clean)
        onsets = self.setting.onsets_s
        assert episode.pull is not None
        assert episode.edge is not None
        assert episode.release is not None
        edge = onsets[KINDS_OF_EVENT[3]]
        ends = [
            episode.touch.end_s, episode.pull.end_s,
            episode.pull.end_s + FADED * episode.drop_s, 2 * episode.edge.at_s - edge,
            episode.release.end_s,
        ]  # fmt: skip
        spans = zip(onsets.values(), ends, strict=True)
        return [whitened[:, int(a * self.rate_hz) : int(b * self.rate_hz) + 1] for a, b in spans]

    def _of(self, event: Float[np.ndarray, "e n"]) -> dict[str, Any]:
        bank, given, n = self.detector.bank, self.setting.given, event.shape[-1]
        before = bank.longest - 1
        own = bank(np.pad(event, ((0, 0), (before, 0))))
        statistics = [each[:, :n] for each in self.of_noise]
        size = float(np.linalg.norm(event))
        scaled = [strength / size for strength in given["strengths"]]
        greatest = np.array([[(each + s * own).max() for each in statistics] for s in scaled])
        matched = np.array([np.mean(greatest >= limit, axis=1) for limit in self.limits]).T
        simple = [[detection_by_threshold(s * event, limit) for limit in self.thresholds]
                  for s in scaled]  # fmt: skip
        passed = np.stack([(each + own).max(0) for each in statistics]) >= self.detector.limit
        noisy = event + self.noise[:, :, before : before + n]
        sizes = np.linalg.norm(noisy, axis=1) > self.simple.limit
        return {
            "natural": size,
            "matched_operating": matched,
            "threshold_operating": np.array(simple),
            **self._delays("", passed),
            **self._delays("threshold_", sizes),
        }

    def _delays(self, name: str, passed: np.ndarray) -> dict[str, float]:
        """The part of the draws in which a detector passes its limit, and after what time."""
        hit = passed.any(axis=1)
        delay = np.where(hit, passed.argmax(axis=1) / self.rate_hz, np.inf)
        with np.errstate(invalid="ignore"):
            median, late = np.quantile(delay, [0.5, 0.9], method="higher")
        return {
            f"{name}detected": float(hit.mean()),
            f"{name}delay": float(median) if np.isfinite(median) else np.nan,
            f"{name}late_delay": float(late) if np.isfinite(late) else np.nan,
        }
