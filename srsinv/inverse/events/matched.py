"""Matched filters: events of known shapes in a stream, at a stated rate of false alarms.

Each whitened template of norm 1 is correlated with the whitened samples up to each instant. In
noise alone this statistic is normal with variance 1, and over an event of that shape its mean is
d', the event's strength. An alarm is where the greatest statistic of all templates rises above
the limit. Noise has so many alarms for each sample as

    P(max_k c_k(j - 1) < h <= max_k c_k(j)),

the discrete form of Rice's rate (1944), of statistics whose covariance the templates give. It is
computed by importance sampling (Adler, Blanchet and Liu 2012): one statistic, drawn at random, is
above the limit, and the others follow it.

Events are taken one by one. Since an alarm, the event is the template and instant of the greatest
statistic, once none has exceeded it for the length of that template. It is then subtracted, and
what is left is searched anew.
No template is exact, so that a part of a strong event is left: a second one that overlaps it counts
only above a stated part of its strength.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float
from scipy.signal import fftconvolve

from ...errors import refuse
from .templates import EventTemplate
from .threshold import stated_rates
from .whitening import StreamWhitener

DRAWS = 20_000  # for the rate of false alarms: to some 3 %
SINGULAR = 1e-6  # variance that is added, as similar templates have dependent statistics
HIGHEST = 30.0  # limit on d': noise exceeds it in no time that anybody waits
PATIENCE = 1.0  # template lengths that an event waits for a better one
BLOCK_LENGTHS = 4  # longest templates that are searched at once
ECHO = 0.25  # of a strong event's d', that what overlaps it has to have
MISMATCH = 0.05  # relative error of a template, in the likelihoods of kinds
SURE_OF = 0.95  # posterior probability of a kind that is reported as it


class DetectedEvent(NamedTuple):
    """An event that was found.

    - `onset_s` [s]: when it began, by its template. `alarm_s` [s]: when its statistic passed the
      limit. `reported_s` [s]: when its kind was decided.
    - `kind`: the likeliest; `probability`: of each kind, all alike before the data. `strength`: d'.
    - `duration_s` [s]: of its template. `amplitude`: in units of that template.
    - `false_alarm`: probability that noise alone reached this d' at least once until then.
    """

    onset_s: float
    alarm_s: float
    reported_s: float
    kind: str
    probability: dict[str, float]
    strength: float
    duration_s: float
    amplitude: float
    false_alarm: float

    @property
    def is_unsure(self) -> bool:
        """Whether another kind is nearly as likely."""
        return self.probability[self.kind] < SURE_OF

    @property
    def answer(self) -> str:
        """The kind, or "unsure"."""
        return "unsure" if self.is_unsure else self.kind


class TemplateBank:
    """Whitened templates of norm 1, and the statistics that they give.

    Raises `BadInput` for no template, and for one without a signal.
    """

    def __init__(self, templates: Sequence[EventTemplate], whitener: StreamWhitener):
        refuse(not templates, "There are no templates: give at least one.")
        # Whitened, a template is longer by the samples that its last one enters.
        rows = [whitener(np.pad(each.signal, ((0, 0), (0, whitener.order)))) for each in templates]
        self.norms = np.array([np.linalg.norm(each) for each in rows])
        self.kinds = [each.kind for each in templates]
        refuse(
            not np.all((self.norms > 0) & np.isfinite(self.norms)),
            f"A template of {self.kinds[int(np.argmin(self.norms))]} has no signal: give a contact "
            "beside the film, or leave the template out.",
        )
        self.durations_s = [each.duration_s for each in templates]
        self.lengths = np.array([each.shape[-1] for each in rows])
        self.longest = int(self.lengths.max())
        # All end at the same instant.
        self.shapes = np.stack([
            np.pad(each / norm, ((0, 0), (self.longest - each.shape[-1], 0)))
            for each, norm in zip(rows, self.norms, strict=True)
        ])  # fmt: skip

    def __call__(self, whitened: Float[np.ndarray, "e n"]) -> Float[np.ndarray, "template m"]:
        """The statistics at every sample from that on at which the longest template is complete."""
        reversed_shapes = self.shapes[:, :, ::-1]
        return np.sum(fftconvolve(whitened[None], reversed_shapes, mode="valid", axes=-1), axis=1)

    @cached_property
    def alarms_per_sample(self) -> "_AlarmRate":
        """The probability in noise that the greatest statistic is above a limit at a sample and
        below it at the one before, as a function of the limit."""
        return _AlarmRate(self.shapes)

    def limit(self, alarms_per_sample: float) -> float:
        """The limit on the statistics at which noise has so many alarms for each sample."""

        def excess(h: float) -> float:
            return np.log(max(self.alarms_per_sample(h), 1e-300) / alarms_per_sample)

        return float(scipy.optimize.brentq(excess, 1.0, HIGHEST, xtol=1e-3))


class _AlarmRate:
    """Alarms for each sample as a function of the limit, by the same draws for all limits."""

    def __init__(self, shapes: Float[np.ndarray, "template e n"]):
        k = len(shapes)
        here = np.pad(shapes, ((0, 0), (0, 0), (1, 0)))
        before = np.pad(shapes, ((0, 0), (0, 0), (0, 1)))
        both = np.concatenate([here, before]).reshape(2 * k, -1)
        self.covariance = both @ both.T
        rng = np.random.default_rng(0)
        # Not by eigenvectors, which similar templates leave undetermined.
        root = np.linalg.cholesky(self.covariance + SINGULAR * np.eye(2 * k))
        self.free = rng.standard_normal((DRAWS, 2 * k)) @ root.T
        self.which, self.level, self.count = rng.integers(k, size=DRAWS), rng.random(DRAWS), k

    def __call__(self, limit: float) -> float:
        each = np.arange(self.which.size)
        log_tail = scipy.special.log_ndtr(-limit)
        high = -scipy.special.ndtri_exp(log_tail + np.log(self.level))
        change = (high - self.free[each, self.which])[:, None] * self.covariance[self.which]
        here, before = np.split(self.free + change, 2, axis=1)
        above = np.maximum(np.sum(here >= limit, axis=1), 1)
        rises = before.max(1) < limit
        return float(self.count * np.exp(log_tail) * np.mean(rises / above))


class _Taken(NamedTuple):
    """The samples of the stream that an event may have spoilt, from `start` to `end`, its d', and
    when it was reported and subtracted."""

    start: int
    end: int
    strength: float
    reported: int

    def overlaps(self, start, end):
        """Whether samples from `start` to `end` are among them, for numbers and arrays."""
        return (start <= self.end) & (end >= self.start)


class EventDetector:
    """Contact events in a stream of samples, with kinds, times and strengths.

    - `templates`: of the events, as `event_templates` makes them. `whitener`: of the noise, a
      `StreamWhitener`; `rate_hz` [Hz]: samples a second.
    - `false_alarms_per_s` [1/s]: how often noise alone raises an alarm.

    `push` takes samples (element, n) in blocks of any length and gives the events decided by them;
    `finish` those that are not decided yet. Raises `BadInput` for rates that are not positive, and
    templates without a signal.
    """

    def __init__(
        self,
        templates: Sequence[EventTemplate],
        whitener: StreamWhitener,
        rate_hz: float,
        false_alarms_per_s: float,
    ):
        self.rate_hz, self.false_alarms_per_s = stated_rates(rate_hz, false_alarms_per_s)
        self.whitener = whitener
        self.bank = TemplateBank(templates, whitener)
        self.limit = self.bank.limit(self.false_alarms_per_s / self.rate_hz)
        self.restart()

    def restart(self) -> None:
        """Forget the stream: the next samples are the first of another one."""
        elements = len(self.whitener.root)
        self._before = np.zeros((elements, self.whitener.order))
        # Whitened samples with the events so far subtracted, from the stream's sample `_start` on.
        self._rest = np.zeros((elements, 3 * self.bank.longest))
        self._start, self._searched = -3 * self.bank.longest, 0
        self._taken: list[_Taken] = []

    @property
    def _end(self) -> int:
        return self._start + self._rest.shape[-1]

    def push(self, signal: Float[np.ndarray, "e n"]) -> list[DetectedEvent]:
        """The events that the next samples decide."""
        starts = range(0, signal.shape[-1], BLOCK_LENGTHS * self.bank.longest)
        blocks = [signal[:, at : at + starts.step] for at in starts]
        return [event for block in blocks for event in self._push(block)]

    def _push(self, signal: Float[np.ndarray, "e n"]) -> list[DetectedEvent]:
        joined = np.concatenate([self._before, signal], axis=-1)
        whitened = self.whitener(signal, self._before)
        self._before = joined[:, joined.shape[-1] - self.whitener.order :]
        self._rest = np.concatenate([self._rest, whitened], axis=-1)
        events = list(self._decided(self._end))
        # Statistics reach back by a template, and an event's start by another one.
        surplus = self._searched - 2 * self.bank.longest - self._start
        if surplus > 0:
            self._rest, self._start = self._rest[:, surplus:], self._start + surplus
        self._taken = [each for each in self._taken if each.end > self._start]
        return events

    def finish(self) -> list[DetectedEvent]:
        """The events that the last samples hold; the stream is over."""
        last = self._end
        silent = np.zeros((self._rest.shape[0], 2 * self.bank.longest))
        self._rest = np.concatenate([self._rest, silent], axis=-1)
        events = list(self._decided(self._end))
        now = last / self.rate_hz
        return [
            each._replace(reported_s=min(each.reported_s, now), alarm_s=min(each.alarm_s, now))
            for each in events
        ]

    def _decided(self, until: int) -> Iterator[DetectedEvent]:
        """Events that statistics before the sample `until` decide."""
        reported = 0
        while True:
            statistics, first = self._statistics()
            excess = statistics - self._limits(statistics.shape[-1], first)
            excess = np.where(excess >= 0, statistics, -np.inf)[:, : until - first]
            alarms = np.flatnonzero((excess[:, self._searched - first :] > 0).any(0))
            if not alarms.size:
                self._searched = max(self._searched, until)
                return
            alarm = self._searched + int(alarms[0])
            event = self._settled(excess[:, alarm - first :], alarm)
            if event is None:
                return
            template, end, decided = event
            reported = max(reported, decided)
            yield self._subtract((template, end), statistics, first, reported)
            self._searched = alarm

    def _statistics(self) -> tuple[np.ndarray, int]:
        """Statistics (template, m), and the stream's sample of the first."""
        return self.bank(self._rest), self._start + self.bank.longest - 1

    def _limits(self, count: int, first: int) -> np.ndarray:
        """The limit (template, sample), raised where a template overlaps a strong event."""
        limits = np.full((len(self.bank.lengths), count), self.limit)
        ends = first + np.arange(count)
        starts = ends[None] - self.bank.lengths[:, None] + 1
        for each in self._taken:
            overlaps = each.overlaps(starts, ends[None])
            limits = np.where(overlaps, np.maximum(limits, ECHO * each.strength), limits)
        return limits

    def _settled(self, above: np.ndarray, alarm: int) -> tuple[int, int, int] | None:
        """Template and sample of the greatest statistic since an alarm, and the sample at which
        none has exceeded it for the length of its template; None where that is still to come."""
        greatest = above.max(0)
        running = np.maximum.accumulate(greatest)
        last = np.maximum.accumulate(np.where(greatest == running, np.arange(running.size), 0))
        patience = PATIENCE * self.bank.lengths[above.argmax(0)][last]
        waited = np.flatnonzero(np.arange(running.size) - last >= patience)
        if not waited.size:
            return None
        end = int(last[waited[0]])
        return int(above[:, end].argmax()), alarm + end, alarm + int(waited[0])

    def _subtract(
        self, event: tuple[int, int], statistics: np.ndarray, first: int, reported: int
    ) -> DetectedEvent:
        """The event, subtracted from the rest."""
        template, end = event
        strength = float(statistics[template, end - first])
        length = int(self.bank.lengths[template])
        start = end - length + 1
        probability = self._probabilities(statistics, first, start, end, strength)
        alarm = self._passed(statistics, first, start, end)
        shape = self.bank.shapes[template][:, self.bank.longest - length :]
        self._rest[:, start - self._start : end + 1 - self._start] -= strength * shape
        self._taken.append(_Taken(start - length, end + length, strength, reported))
        return DetectedEvent(
            onset_s=start / self.rate_hz,
            alarm_s=alarm / self.rate_hz,
            reported_s=reported / self.rate_hz,
            kind=max(probability, key=lambda name: probability[name]),
            probability=probability,
            strength=strength,
            duration_s=self.bank.durations_s[template],
            amplitude=strength / float(self.bank.norms[template]),
            false_alarm=float(-np.expm1(-self.bank.alarms_per_sample(strength) * reported)),
        )

    def _passed(self, statistics: np.ndarray, first: int, start: int, end: int) -> int:
        """The sample at which an event's statistics passed the limit: not before the report of an
        event that had to be subtracted first."""
        begin = max(start - first, 0)
        above = (statistics[:, begin : end + 1 - first] >= self.limit).any(0)
        passed = first + begin + int(np.argmax(above))
        return max([passed, *(each.reported for each in self._taken if each.overlaps(start, end))])

    def _probabilities(
        self, statistics: np.ndarray, first: int, start: int, end: int, strength: float
    ) -> dict[str, float]:
        """Posterior probability of each kind, from the mean likelihood of its templates that end
        within the event's own; they are uncertain by `MISMATCH` of the strength."""
        half = max((end - start + 1) // 2, 1)
        near = np.maximum(statistics[:, max(end - half - first, 0) : end + half + 1 - first], 0)
        log_likelihood = near**2 / (2 * (1 + (MISMATCH * strength) ** 2))
        each = scipy.special.logsumexp(log_likelihood, axis=1)
        kinds = list(dict.fromkeys(self.bank.kinds))
        rows = [[i for i, name in enumerate(self.bank.kinds) if name == kind] for kind in kinds]
        total = np.array([scipy.special.logsumexp(each[own]) - np.log(len(own)) for own in rows])
        return dict(zip(kinds, scipy.special.softmax(total).tolist(), strict=True))
