"""Matched filters: events of known shapes in a stream, at a stated rate of false alarms.

Each whitened template of norm 1 is correlated with the whitened samples up to each instant. In
noise alone this statistic is normal with variance 1, and over an event of that shape its mean is
d', the event's strength. An alarm is where the greatest statistic of all templates rises above
the limit (bank.py).

Events are taken one by one. Since an alarm, the event is the template and instant of the greatest
statistic, once none has exceeded it for the length of that template. Its fit by the templates of
its kind near it is then subtracted, and what is left is searched anew. No fit is exact, so that a
part of a strong event is left: a second one that overlaps it counts only above a stated part of
its strength.

Full slip must follow incipient slip, as this ends. Its time is then known to a small part of the
slip's duration. The false alarms that are stated for the whole slip are all allowed there, so that
the limit for full slip is lower.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import ArrayLike, Bool, Float

from ...forward.episode import KINDS_OF_EVENT
from .bank import TemplateBank
from .templates import EventTemplate
from .threshold import stated_rates
from .whitening import StreamWhitener, as_samples

PATIENCE = 1.0  # template lengths that an event waits for a better one
BLOCK_LENGTHS = 4  # longest templates that are searched at once
ECHO = 0.25  # of a strong event's d', that what overlaps it has to have
FOLLOWER = {KINDS_OF_EVENT[1]: KINDS_OF_EVENT[2]}  # of a kind: the kind that begins as it ends
DUE = 0.05  # of an event's length, within which its follower begins: 98 % do
MISMATCH = 0.05  # relative error of a template, in the likelihoods of kinds
SURE_OF = 0.95  # posterior probability of a kind that is reported as it


class DetectedEvent(NamedTuple):
    """An event that was found.

    - `onset_s` [s]: when it began, by its template. `alarm_s` [s]: when its statistic passed the
      limit. `reported_s` [s]: when its kind was decided.
    - `kind`: the likeliest; `probability`: of each kind, all alike before the data but for a full
      slip where one is due. `strength`: d'.
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


class _Taken(NamedTuple):
    """An event that was subtracted: its last sample, length, kind and d', and when that was."""

    last: int
    length: int
    kind: str
    strength: float
    reported: int

    @property
    def end(self) -> int:
        """The last sample that it may have spoilt."""
        return self.last + self.length

    def overlaps(self, start, end):
        """Whether it may have spoilt samples from `start` to `end`, for numbers and arrays."""
        return (start <= self.end) & (end > self.last - 2 * self.length)

    def is_followed(self, start):
        """Whether what begins at `start` begins as it ends, for numbers and arrays."""
        return abs(start - self.last) <= max(DUE * self.length, 1)


class _Search(NamedTuple):
    """Statistics and limits (template, sample), from the stream's sample `first` on."""

    statistics: Float[np.ndarray, "template m"]
    limits: Float[np.ndarray, "template m"]
    first: int

    @property
    def passes(self) -> Bool[np.ndarray, "template m"]:
        return self.statistics >= self.limits


class EventDetector:
    """Contact events in a stream of samples, with kinds, times and strengths.

    - `templates`: of the events, as `event_templates` makes them. `whitener`: of the noise, a
      `StreamWhitener`; `rate_hz` [Hz]: samples a second.
    - `false_alarms_per_s` [1/s]: how often noise alone raises an alarm. `limit`: of d', for this
      rate; `limits_when_due`: by kind, where an event of it is due.

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
        per_sample = self.false_alarms_per_s / self.rate_hz
        self.limit = self.bank.limit(per_sample)
        self.limits_when_due = {
            kind: min(self.limit, self.bank.limit_of_kind(kind, per_sample / (2 * DUE)))
            for kind in FOLLOWER.values()
            if kind in self.bank.kinds
        }
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

    def push(self, signal: Float[ArrayLike, "e n"]) -> list[DetectedEvent]:
        """The events that the next samples decide. Raises `BadInput` for another number of
        elements, and samples that are not finite; none of them are taken then."""
        signal = as_samples(signal, len(self.whitener.root))
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
            found = self._search()
            above = np.where(found.passes, found.statistics, -np.inf)[:, : until - found.first]
            alarms = np.flatnonzero((above[:, self._searched - found.first :] > 0).any(0))
            if not alarms.size:
                self._searched = max(self._searched, until)
                return
            alarm = self._searched + int(alarms[0])
            event = self._settled(above[:, alarm - found.first :], alarm)
            if event is None:
                return
            template, end, decided = event
            reported = max(reported, decided)
            yield self._subtract(template, end, found, reported)
            self._searched = alarm

    def _search(self) -> _Search:
        """The limits are higher where a template overlaps a strong event, and lower where one is
        due."""
        statistics, first = self.bank(self._rest), self._start + self.bank.longest - 1
        ends = first + np.arange(statistics.shape[-1])
        starts = ends[None] - self.bank.lengths[:, None] + 1
        tail = self.whitener.order  # by which whitening lengthens a template
        limits = np.full(statistics.shape, self.limit)
        for each in self._taken:
            overlaps = each.overlaps(starts, ends[None])
            limits = np.where(overlaps, np.maximum(limits, ECHO * each.strength), limits)
        for each in self._taken:
            kind = FOLLOWER.get(each.kind)
            if kind in self.limits_when_due:
                own = np.array([other == kind for other in self.bank.kinds])[:, None]
                limits[own & each.is_followed(starts + tail)] = self.limits_when_due[kind]
        return _Search(statistics, limits, first)

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

    def _subtract(self, template: int, end: int, found: _Search, reported: int) -> DetectedEvent:
        """The event, subtracted from the rest."""
        strength = float(found.statistics[template, end - found.first])
        length = int(self.bank.lengths[template])
        start = end - length + 1
        probability = self._probabilities(found, start, end, strength)
        kind = max(probability, key=lambda name: probability[name])
        alarm = self._passed(found, start, end)
        is_followed = FOLLOWER.get(kind) in self.limits_when_due
        last = end - self._start
        begin, fit = self.bank.fit(self._rest, template, last, strength, is_followed)
        self._rest[:, begin : begin + fit.shape[-1]] -= fit
        self._taken.append(_Taken(end, length, kind, strength, reported))
        return DetectedEvent(
            onset_s=start / self.rate_hz,
            alarm_s=alarm / self.rate_hz,
            reported_s=reported / self.rate_hz,
            kind=kind,
            probability=probability,
            strength=strength,
            duration_s=self.bank.durations_s[template],
            amplitude=strength / float(self.bank.norms[template]),
            false_alarm=float(-np.expm1(-self.bank.alarms_per_sample(strength) * reported)),
        )

    def _passed(self, found: _Search, start: int, end: int) -> int:
        """The sample at which an event's statistics passed the limit: not before the report of an
        event that had to be subtracted first."""
        begin = max(start - found.first, 0)
        passes = found.passes[:, begin : end + 1 - found.first].any(0)
        passed = found.first + begin + int(np.argmax(passes))
        return max([passed, *(each.reported for each in self._taken if each.overlaps(start, end))])

    def _probabilities(
        self, found: _Search, start: int, end: int, strength: float
    ) -> dict[str, float]:
        """Posterior probability of each kind, from the mean likelihood of its templates that end
        within the event's own; they are uncertain by `MISMATCH` of the strength. A lower limit
        stands for higher odds before the data, as exp(-limit^2/2)."""
        half = max((end - start + 1) // 2, 1)
        near = slice(max(end - half - found.first, 0), end + half + 1 - found.first)
        positive = np.maximum(found.statistics[:, near], 0)
        log_likelihood = positive**2 / (2 * (1 + (MISMATCH * strength) ** 2))
        log_prior = (self.limit**2 - np.minimum(found.limits[:, near], self.limit) ** 2) / 2
        each = scipy.special.logsumexp(log_likelihood + log_prior, axis=1)
        kinds = list(dict.fromkeys(self.bank.kinds))
        rows = [[i for i, name in enumerate(self.bank.kinds) if name == kind] for kind in kinds]
        total = np.array([scipy.special.logsumexp(each[own]) - np.log(len(own)) for own in rows])
        return dict(zip(kinds, scipy.special.softmax(total).tolist(), strict=True))
