"""Search for bursts in the signals of a pass, one set of levels given.

A burst is claimed where the likelihood of the signals, averaged over the prior of its sample,
place, decay and size, is at least 1/`FALSE_CLAIMS` times that without it. The mean of such a ratio
over signals without bursts is 1, so that at most the fraction `FALSE_CLAIMS` of them exceeds the
bound (Markov's inequality). This holds where the covariance of everything else is right. A ridge
is louder in places than a stationary traction, so that a claim must hold as well where the
traction's power is `LOUDER` times as high: it is then left out of what bursts are found by.
"""

from functools import cached_property

import numpy as np
from jaxtyping import Complex

from .everything import Everything
from .model import BurstModel
from .posterior import BESIDE, Burst, Grid, OneBurst, Others, SizePrior, signals_of

FALSE_CLAIMS = 0.02  # of passes without bursts, at most
LOUDER = 1e3
NEAR = 40  # samples within which bursts are fitted together
AWAY = 20  # samples between bursts that are claimed in one round
CROWD = (
    4  # bursts near each other, at most: more are no bursts, but what the traction's model misses
)
MISSED = 2.0  # chi-square per sample that a crowd leaves where the model is wrong; 1.2 of real ones
ROUNDS, SWEEPS = 20, 2
DECAYS, PLACES = 6, 41  # of the scan
FAINT = 1e-9  # of the largest square: a place that no element responds to gives nothing


class BurstSearch:
    """Bursts in signals of a spectrum `data` (e, k), in the order of time.

    `rests`: everything else at the traction's level, and at one that is `LOUDER`.
    """

    def __init__(
        self,
        model: BurstModel,
        rests: tuple[Everything, Everything],
        prior: SizePrior,
        data: Complex[np.ndarray, "e k"],
    ):
        self.model, self.rests, self.prior, self.data = model, rests, prior, data

    def run(self, bursts: list[Burst]) -> list[Burst]:
        """All bursts that are claimed, from some that are known already; ended at once where they
        are errors of the model."""
        bursts = self.refined(bursts, range(len(bursts)))
        for _ in range(ROUNDS):
            if self.are_model_errors(bursts):
                return bursts
            added = self._claimed(bursts)
            if not added:
                break
            known = len(bursts)
            bursts = [*bursts, *added]
            changed = {j for j in range(len(bursts)) if _has_near(self.model.n, bursts, j, known)}
            bursts = self.refined(bursts, sorted(changed))
        return self._confirmed(bursts)

    def refined(self, bursts: list[Burst], which: "range | list[int]") -> list[Burst]:
        """The bursts with each of `which` at its likeliest, given the others; as they were where
        that leaves more of the signals unexplained, as bursts do that drive each other away."""
        given, bursts = bursts, list(bursts)
        for _ in range(SWEEPS):
            for j in which:
                one = self.one(bursts, j)
                bursts[j] = one.likeliest(one.around(bursts[j].sample))
            which = [j for j in which if len(_near(self.model.n, bursts, j)) > 1]
        return bursts if self._left(bursts) <= self._left(given) else given

    def are_model_errors(self, bursts: list[Burst]) -> bool:
        """Whether bursts crowd at one place and leave far more than the noise, as they do where the
        model of the traction is wrong."""
        elements, n = self.data.shape[0], self.model.seconds / self.model.interval_s
        return crowded(self.model.n, bursts) and self._left(bursts) > MISSED * elements * n

    def _left(self, bursts: list[Burst]) -> float:
        """Chi-square of the signals less these bursts."""
        left = self.without(bursts)[None]
        return float(self.rests[0].dot(left, self.rests[0].weigh(left))[0, 0])

    def one(self, bursts: list[Burst], j: int, level: int = 0) -> OneBurst:
        """The posterior of one of the bursts beside the others."""
        near = [i for i in _near(self.model.n, bursts, j) if i != j]
        data = self.without([each for i, each in enumerate(bursts) if i != j])
        rest = self.rests[level]
        others = Others.of(self.model, rest, self.prior, [bursts[i] for i in near])
        return OneBurst(self.model, rest, self.prior, data, others)

    def surest_grids(self, bursts: list[Burst]) -> list[Grid]:
        """The posterior of each burst under the louder traction."""
        each = enumerate(bursts)
        return [self.one(bursts, j, level=1).around(burst.sample) for j, burst in each]

    def without(self, bursts: list[Burst]) -> Complex[np.ndarray, "e k"]:
        """The signals' spectrum less these bursts."""
        return self.data - signals_of(self.model, bursts)

    def _claimed(self, bursts: list[Burst]) -> list[Burst]:
        """Further bursts, far enough from each other."""
        data, n = self.without(bursts), self.model.n
        least = np.log(n / FALSE_CLAIMS / (2 * BESIDE + 1)) - 0.5
        heights = np.minimum(*(self._heights(level, data) for level in (0, 1)))
        added: list[Burst] = []
        for sample in np.argsort(heights)[::-1].tolist():
            if heights[sample] < least:  # or looked at with a neighbour
                continue
            if any(_samples_between(n, sample, each.sample) < AWAY for each in added):
                continue
            if sum(_samples_between(n, sample, each.sample) <= NEAR for each in bursts) >= CROWD:
                continue
            ones = [OneBurst(self.model, rest, self.prior, data) for rest in self.rests]
            grids = [one.around(sample) for one in ones]
            if min(self.log_odds(grid) for grid in grids) > -np.log(FALSE_CLAIMS):
                added.append(ones[0].likeliest(grids[0]))
            else:
                heights[np.arange(sample - BESIDE, sample + BESIDE + 1) % n] = -np.inf
        return added

    def _confirmed(self, bursts: list[Burst]) -> list[Burst]:
        """The bursts that are still claimed beside the others, the weakest left out first."""
        for j in sorted(range(len(bursts)), key=lambda j: bursts[j].d_prime):
            near = _near(self.model.n, bursts, j)
            grids = (
                one.around(bursts[j].sample) for one in (self.one(bursts, j, i) for i in (0, 1))
            )
            if min(self.log_odds(grid) for grid in grids) <= -np.log(FALSE_CLAIMS):
                rest = [each for i, each in enumerate(bursts) if i != j]
                moved = [i - (i > j) for i in near if i != j]
                return self._confirmed(self.refined(rest, moved))
        return bursts

    def log_odds(self, grid: Grid) -> float:
        """Log of the averaged likelihood ratio, samples of equal odds."""
        return grid.log_evidence - float(np.log(self.model.n))

    def _heights(self, level: int, data: np.ndarray) -> np.ndarray:
        """d'^2/2 of a burst in every sample, the greatest over places and decays."""
        model, rest = self.model, self.rests[level]
        waves, responses, squares = self._scan[level]
        weighed, highest = rest.weigh(data), np.zeros(model.n)
        for wave, square in zip(waves, squares, strict=True):
            along = responses.T @ np.fft.irfft(wave.conj() * weighed, model.n)
            highest = np.maximum(highest, np.max(along**2 / square, axis=0) / 2)
        return highest

    @cached_property
    def _scan(self) -> list[tuple[np.ndarray, np.ndarray, list[np.ndarray]]]:
        """At each level the decays and the responses that a scan tries, and Q of each decay,
        (place, n) or (place, 1)."""
        model = self.model
        waves = model.decaying(model.decays(DECAYS))
        responses = model.responses(np.linspace(-0.5, 0.5, PLACES) * model.contact_m)
        found = []
        for rest in self.rests:
            squares = []
            for wave, square in zip(waves, rest.squares(waves, responses), strict=True):
                own = square[:, None]
                if rest.taken is not None:
                    own = own - rest.taken.every_square(wave, responses)
                squares.append(np.maximum(own, FAINT * square.max()))
            found.append((waves, responses, squares))
        return found


def crowded(n: int, bursts: list[Burst]) -> bool:
    """Whether as many bursts as may be are near each other."""
    return any(len(_near(n, bursts, j)) >= CROWD for j in range(len(bursts)))


def _samples_between(n: int, one: int, other: int) -> int:
    """Samples between two, around the circle."""
    return min((one - other) % n, (other - one) % n)


def _near(n: int, bursts: list[Burst], j: int) -> list[int]:
    """The bursts near one of them, itself among them."""
    return [
        i
        for i, each in enumerate(bursts)
        if _samples_between(n, each.sample, bursts[j].sample) <= NEAR
    ]


def _has_near(n: int, bursts: list[Burst], j: int, known: int) -> bool:
    """Whether a burst is new, or near one that is."""
    return any(i >= known for i in _near(n, bursts, j))
