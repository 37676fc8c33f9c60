"""Effects: what leaving one out changes of the signal, and the time that it costs."""

from collections.abc import Callable, Collection, Iterator
from functools import cache, partial

import jax
import numpy as np

from ..forward.simulation import Simulation
from ..forward.trace import Trace, difference, pair, trace
from ..timing import timed
from ._cost_settings import CostSettings
from ._cost_trials import cost_trial
from .trials import Row, Trial, Work

PART = "effects"

# A simulation on a line of so many cells, with these of the effects.
WithEffects = Callable[[int, Collection[str]], Simulation]


def trials(
    simulated: WithEffects,
    settings: CostSettings,
    named: Collection[str],
    line: str,
    key: jax.Array,
) -> Iterator[Trial]:
    """Each effect that the scene names or that there is besides: all named ones and it, and the
    same without it."""
    for cells in sorted(settings.effects_cells):
        for name in dict.fromkeys((*named, *settings.effects)):
            bench = WithAndWithout(partial(simulated, cells), name, named, key, settings.repeats)
            rests_on = {"named": sorted(named), "effect": settings.effects.get(name)}
            yield cost_trial(
                PART, PART, line, name, cells,
                prepare=bench.work, score=bench.score, rests_on=rests_on,
            )  # fmt: skip


class WithAndWithout:
    """The scene with an effect and without it, the other named ones in both."""

    def __init__(
        self,
        simulated: Callable[[Collection[str]], Simulation],
        name: str,
        named: Collection[str],
        key: jax.Array,
        repeats: int,
    ):
        others = [each for each in named if each != name]
        self._key, self._repeats = key, repeats
        self.full = cache(partial(simulated, [*others, name]))
        self.less = cache(partial(simulated, others))

    def work(self) -> Work:
        """From the scene to the signal, with the effect."""
        return partial(trace, self.full(), self._key)

    def score(self, given: Trace) -> Row:
        """The change over the signal with all of them, and the time that the effect costs: the
        median and the quartiles of differences between calls in turns."""
        del given
        full, less = pair(self.full(), self.less(), self._key)
        calls = [partial(trace, each(), self._key) for each in (self.full, self.less)]
        for call in calls:
            call()
        seconds = [[timed(call, 0).first_s for call in calls] for _ in range(self._repeats)]
        lower, cost, upper = np.quantile(-np.diff(seconds), (0.25, 0.5, 0.75)).tolist()
        measures = {"error": difference(less, full), "cost_s": cost}
        return measures | {"lower_cost_s": lower, "upper_cost_s": upper}
