"""Templates of contact events: the signal of each kind, over some durations, from the model.

They are made for a nominal contact. An event that lasts another time, under another load, has a
template that is nearly like it, and the filter loses the part of its strength that is not.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ...errors import number, refuse
from ...forward.episode import (
    KINDS_OF_EVENT,
    Episode,
    PassingEdge,
    Ramp,
    RecordedEpisode,
    sampled,
    touching_s,
)
from ...forward.sensor import Sensor
from ...forward.shape import Shape

LONG_AGO_S = 1e3
FADED = 4.0  # decays after which a drop of friction is over
COARSE = 24  # cells over half the contact, for an edge's template


class EventTemplate(NamedTuple):
    """The signal (element, sample) [V] of an event of a `kind` that lasts `duration_s` [s]."""

    kind: str
    duration_s: float
    signal: Float[np.ndarray, "e m"]


def event_templates(
    episode: Episode,
    sensor: Sensor,
    rate_hz: float,
    durations_s: Sequence[float],
    drops_s: Sequence[float] = (),
    edges: Sequence[Shape] = (),
    speeds_m_per_s: Sequence[float] = (),
) -> tuple[EventTemplate, ...]:
    """Templates of first contact, incipient slip and loss of contact in each of `durations_s` [s],
    of full slip by each of `drops_s` [s], and of `edges` at each speed [m/s].

    `episode` gives the contact, its load and its frictions; when its events happen has no meaning
    here. Raises `BadInput` for a rate, durations, drops or speeds that are not positive, for
    durations shorter than a sampling interval, for drops where friction does not fall, and for
    edges without a speed.
    """
    rate = float(number("rate_hz", rate_hz, "a positive rate in Hz", above=0))
    refuse(
        len(drops_s) > 0 and episode.sliding_friction == episode.friction,
        f"Friction stays {episode.friction:g} in full slip, which then gives no signal: give the "
        "episode a lower sliding_friction, or no drops_s.",
    )
    wanted = "a positive speed in m/s"
    speeds = [number("speeds_m_per_s", each, wanted, above=0) for each in speeds_m_per_s]
    refuse(len(edges) > 0 and not speeds, "Edges pass at some speed: give speeds_m_per_s.")
    bank = _Bank(episode, sensor, rate)
    made = [each for duration in durations_s for each in bank.of_duration(duration)]
    made += [bank.of_drop(drop) for drop in drops_s]
    made += [each for edge in edges for each in bank.of_edge(edge, speeds)]
    return tuple(made)


class _Bank(NamedTuple):
    episode: Episode
    sensor: Sensor
    rate_hz: float

    def of_duration(self, duration_s: float) -> list[EventTemplate]:
        """Contact, incipient slip, and loss of contact from rest and from sliding."""
        rest, now = Ramp(-LONG_AGO_S, 1.0), Ramp(0.0, duration_s)
        slid = Ramp(-LONG_AGO_S / 2, 1.0)
        first, incipient, _, _, last = KINDS_OF_EVENT
        return [
            self._template(first, duration_s, self._with(now)),
            self._template(incipient, duration_s, self._with(rest, pull=now)),
            self._template(last, duration_s, self._with(rest, release=now)),
            self._template(last, duration_s, self._with(rest, pull=slid, release=now)),
        ]

    def of_drop(self, drop_s: float) -> EventTemplate:
        """Full slip."""
        pull = Ramp(-LONG_AGO_S / 2, LONG_AGO_S / 2)
        pulled = self._with(Ramp(-LONG_AGO_S, 1.0), pull=pull, drop_s=drop_s)
        return self._template(KINDS_OF_EVENT[2], FADED * drop_s, pulled)

    def of_edge(self, shape: Shape, speeds_m_per_s: Sequence[float]) -> list[EventTemplate]:
        """An edge that passes at each speed, from its first touch to its last."""
        own, edge = self.episode, PassingEdge(shape, 0.0, 1.0)
        given = own.contact, own.load_N_per_m, own.sliding_friction
        added = edge.charge(self.sensor, *given, half_cells=COARSE)  # over the way [m]
        first, last = touching_s(added)
        made = []
        for speed in speeds_m_per_s:
            count = int((last - first) / speed * self.rate_hz) + 2
            way = first + np.arange(-1, count) * speed / self.rate_hz
            signal = sampled(self.sensor, added(np.clip(way, *added.x[[0, -1]])), self.rate_hz)
            made.append(EventTemplate(KINDS_OF_EVENT[3], (last - first) / speed, signal))
        return made

    def _with(self, touch: Ramp, **others: Any) -> Episode:
        own = self.episode
        given: Any = {"friction": own.friction, "sliding_friction": own.sliding_friction} | others
        return Episode(own.contact, own.load_N_per_m, touch, **given)

    def _template(self, kind: str, duration_s: float, episode: Episode) -> EventTemplate:
        interval = 1 / self.rate_hz
        refuse(
            duration_s < interval,
            f"A {kind} of {duration_s:g} s is shorter than the sampling interval, {interval:g} s: "
            "give longer durations_s and drops_s.",
        )
        # The first sample is at the onset, still silent.
        count = int(np.ceil(duration_s * self.rate_hz)) + 1
        signal = RecordedEpisode(episode, self.sensor).signal(self.rate_hz, count)
        return EventTemplate(kind, duration_s, signal)
