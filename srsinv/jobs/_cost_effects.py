"""Effects: what leaving one out changes of the signal, and the time that it costs."""

from collections.abc import Callable, Collection, Iterator
from functools import cache, partial

import jax

from ..forward.simulation import Simulation
from ..forward.trace import Trace, difference, pair, trace
from ..timing import timed
from ._cost_settings import CostSettings
from ._cost_trials import MOST_S, CostScore, CostTrial, Work

PART = "effects"

# A simulation on a line of so many cells, with these of the effects.
WithEffects = Callable[[int, Collection[str]], Simulation]


def trials(
    simulated: WithEffects,
    settings: CostSettings,
    named: Collection[str],
    line: str,
    key: jax.Array,
) -> Iterator[CostTrial]:
    """Each effect that the scene names or that there is besides: all named ones and it, and the
    same without it."""
    for cells in sorted(settings.effects_cells):
        for name in dict.fromkeys((*named, *settings.effects)):
            bench = WithAndWithout(partial(simulated, cells), name, named, key)
            yield CostTrial(
                group=PART, part=PART, line=line, family=name, size=cells,
                prepare=bench.work, score=bench.score, rests_on={"named": sorted(named)},
            )  # fmt: skip


class WithAndWithout:
    """The scene with an effect and without it, the other named ones in both."""

    def __init__(
        self,
        simulated: Callable[[Collection[str]], Simulation],
        name: str,
        named: Collection[str],
        key: jax.Array,
    ):
        others = [each for each in named if each != name]
        self._key = key
        self.full = cache(partial(simulated, [*others, name]))
        self.less = cache(partial(simulated, others))

    def work(self) -> Work:
        """From the scene to the signal, with the effect."""
        return partial(trace, self.full(), self._key)

    def score(self, given: Trace) -> CostScore:
        """The change over the signal with all of them, and the time without the effect."""
        del given
        full, less = pair(self.full(), self.less(), self._key)
        without = timed(partial(trace, self.less(), self._key), 5, MOST_S)
        measures = {"error": difference(less, full), "without_call_s": without.median_s}
        return CostScore(measures)
