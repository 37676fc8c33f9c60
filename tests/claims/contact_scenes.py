"""Random contact episodes and the detector that is to find their events.

The detector's templates are of one nominal finger, load and friction, with edges solved on 24 cells
over half the contact. Episodes have other fingers, loads, frictions, heights and shapes in time,
and 60 such cells.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from srsinv import Sensor
from srsinv.forward.episode import Episode, PassingEdge, Ramp, RecordedEpisode
from srsinv.forward.partial_slip import CylinderContact
from srsinv.forward.surface import Ridge, StepDown, StepUp
from srsinv.inverse.events.matched import EventDetector
from srsinv.inverse.events.templates import EventTemplate, event_templates
from srsinv.inverse.events.whitening import StreamWhitener

RATE_HZ = 5000.0
JOHNSON_V = 6.4e-6  # of 1 Mohm at 300 K in each sample
PLACE_M = 0.6e-3
NOMINAL = Episode(CylinderContact(0.01, PLACE_M), 20.0, Ramp(0.0, 0.05))
DURATIONS_S = (0.02, 0.035, 0.06, 0.1, 0.15)
DROPS_S = (2e-3, 4e-3, 8e-3)
EDGES = (
    *(step(height, 0.0) for height in (5e-6, 1e-5, 2e-5, 4e-5) for step in (StepUp, StepDown)),
    *(Ridge(1e-5, width) for width in (2e-4, 5e-4)),
)
SPEEDS_M_PER_S = (0.025, 0.04, 0.065, 0.1)
SAMPLES = 7500


class DrawnEpisode(NamedTuple):
    """An episode, its noise-free signal (2, sample) [V], and when its events begin and end [s]."""

    episode: Episode
    signal: np.ndarray
    onsets_s: dict[str, float]
    ends_s: dict[str, float]


def sensor(elements: int = 2) -> Sensor:
    """The paper's two elements, or the flat one alone."""
    return Sensor(Sensor().elements[:elements])


@cache
def templates(elements: int = 2) -> tuple[EventTemplate, ...]:
    """The templates of the nominal finger."""
    return event_templates(
        NOMINAL, sensor(elements), RATE_HZ, DURATIONS_S, DROPS_S, EDGES, SPEEDS_M_PER_S
    )


@cache
def detector(false_alarms_per_s: float, elements: int = 2, noise_V: float = JOHNSON_V):
    """A detector in white noise, to be restarted for each stream."""
    whitener = StreamWhitener.white([noise_V] * elements)
    return EventDetector(templates(elements), whitener, RATE_HZ, false_alarms_per_s)


def drawn(seed: int, falls: bool = True) -> DrawnEpisode:
    """An episode of five events, all of whose numbers are random. Friction falls in full slip, or
    else this gives no signal."""
    rng = np.random.default_rng([7, seed])

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    touch, pull, release = (Ramp(0.0, between(0.02, 0.15), rng.uniform(1.7, 3)) for _ in range(3))
    height = between(5e-6, 4e-5)
    shape = [StepUp(height, 0.0), StepDown(height, 0.0), Ridge(height, between(2e-4, 5e-4))][
        int(rng.integers(3))
    ]
    friction = rng.uniform(0.4, 0.9)
    starts = np.array([0.1, 0.45, 0.95, 1.25]) + rng.uniform(0, 0.05, 4)
    episode = Episode(
        CylinderContact(between(0.007, 0.014), PLACE_M),
        between(10, 40),
        touch=_at(touch, starts[0]),
        pull=_at(pull, starts[1]),
        edge=PassingEdge(shape, starts[2], between(0.025, 0.1)),
        release=_at(release, starts[3]),
        friction=friction,
        sliding_friction=friction * max(rng.uniform(0.7, 0.9), float(not falls)),
        drop_s=between(2e-3, 8e-3),
    )
    recorded = RecordedEpisode(episode, sensor())
    onsets_s = recorded.onsets_s
    _, _, full, edge, _ = onsets_s
    ends = [starts[0] + touch.duration_s, onsets_s[full], onsets_s[full] + 4 * episode.drop_s,
            2 * starts[2] - onsets_s[edge], starts[3] + release.duration_s]  # fmt: skip
    ends_s = {kind: float(end) for kind, end in zip(onsets_s, ends, strict=True)}
    return DrawnEpisode(episode, recorded.signal(RATE_HZ, SAMPLES), onsets_s, ends_s)


def _at(ramp: Ramp, start_s: float) -> Ramp:
    return Ramp(start_s, ramp.duration_s, ramp.exponent)
