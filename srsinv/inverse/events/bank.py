"""Whitened templates, the statistics that they give, and the limit for a rate of false alarms.

Noise has so many alarms for each sample as

    P(max_k c_k(j - 1) < h <= max_k c_k(j)),

the discrete form of Rice's rate (1944), of statistics whose covariance the templates give. It is
computed by importance sampling (Adler, Blanchet and Liu 2012): one statistic, drawn at random, is
above the limit, and the others follow it.

No template is exact. An event of strength s is described better by a random combination of the m
templates b_j near the one that was found,

    s/sqrt(m) sum_j w_j b_j,  w_j normal with variance 1,

whose estimate from samples in noise of variance 1 is that of ridge regression.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Float
from scipy.signal import fftconvolve

from ...errors import refuse
from .templates import EventTemplate
from .whitening import StreamWhitener

DRAWS = 20_000  # for the rate of false alarms: to some 3 %
SINGULAR = 1e-6  # variance that is added, as similar templates have dependent statistics
LEVELS = np.arange(1.0, 6.0, 0.25)  # from which on a limit is sought
HIGHEST = 30.0  # limit on d': noise exceeds it in no time that anybody waits
NEAR = 0.5  # correlation with a template from which on another one is near it
STEPS = 20  # to a template's length, in which those near it are moved


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
        """The limit on the statistics at which noise has so many alarms for each sample.

        Raises `BadInput` where no limit has so many, or so few.
        """
        return _limit(self.alarms_per_sample, alarms_per_sample)

    def limit_of_kind(self, kind: str, alarms_per_sample: float) -> float:
        """That of the templates of one kind alone; the lowest where they never have so many."""
        own = _AlarmRate(self.shapes[[each == kind for each in self.kinds]])
        return _limit(own, min(alarms_per_sample, max(own(h) for h in LEVELS)))

    def near(self, template: int, is_followed: bool = False) -> list[tuple[int, int]]:
        """Templates of the same kind, each with the samples by which it is moved, at most half the
        length of this one, that correlate with it by `NEAR` or more. None ends later where the
        event is followed at once by another."""
        half = max(int(self.lengths[template]) // 2, 1)
        correlation = self(np.pad(self.shapes[template], ((0, 0), (half, half))))
        found = []
        for other, kind in enumerate(self.kinds):
            step = max(int(self.lengths[other]) // STEPS, 1)
            latest = 0 if is_followed else half // step
            moved = step * np.arange(-(half // step), latest + 1)
            is_near = correlation[other, half + moved] >= NEAR
            if kind == self.kinds[template]:
                found += [(other, int(by)) for by in moved[is_near]]
        return found

    def fit(
        self,
        signal: Float[np.ndarray, "e n"],
        template: int,
        end: int,
        strength: float,
        is_followed: bool = False,
    ) -> tuple[int, Float[np.ndarray, "e m"]]:
        """The event that a template and its last sample stand for, as a combination of the
        templates near it, and the sample at which it begins."""
        near = self.near(template, is_followed)
        start = min(end + by - int(self.lengths[other]) + 1 for other, by in near)
        part = signal[:, start : max(end + by for _, by in near) + 1]
        shapes = np.zeros((len(near), *part.shape))
        for row, (other, by) in enumerate(near):
            last, length = end + by + 1 - start, int(self.lengths[other])
            shapes[row, :, last - length : last] = self.shapes[other][:, self.longest - length :]
        rows = shapes.reshape(len(near), -1)
        ridge = len(near) / strength**2 * np.eye(len(near))
        weights = np.linalg.solve(rows @ rows.T + ridge, rows @ part.ravel())
        return start, (weights @ rows).reshape(part.shape)


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


def _limit(rate: _AlarmRate, alarms_per_sample: float) -> float:
    def excess(h: float) -> float:
        return np.log(max(rate(h), 1e-300) / alarms_per_sample)

    # Below some level noise is nearly always above it, and alarms are few again.
    level = next((h for h in LEVELS if excess(h) >= 0), None)
    few = "fewer" if level is None else "more"
    refuse(
        level is None or excess(HIGHEST) > 0,
        f"No limit on these templates has {alarms_per_sample:.3g} false alarms for each sample: "
        f"ask for {few} false_alarms_per_s.",
    )
    return float(scipy.optimize.brentq(excess, level, HIGHEST, xtol=1e-3))
