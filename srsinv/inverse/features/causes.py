"""Which cause that is no fact of the rig would explain what a fit of features leaves.

A low-pass, a saturation, a constant, a drift, a jump, hum and a further load are each a model of
one number, beside parameters of features and facts of the rig. Let v be by how much these are off a
fit by the facts as stated, and s(v) the signal there, of slopes J. A cause that makes F(s) of a
signal leaves, of white noise,

    min_d |y - F(s) - F'(s) J d|^2,

the priors in it. Its number is searched for, then v moves along d as far as less is left, in rounds
(Gauss-Newton). What that is less than what the fit leaves is what the cause explains. Facts and
noise that a fit has estimated have taken a misfit up, so that its end may be far from where the
cause would have it: all start before.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
import scipy
from jaxtyping import Float, Int

from ... import false_alarm
from ...compiled import compiled
from ...forward.filter import FirstOrder
from ...forward.operator import MotionOperator
from ...forward.scan import Motion
from ...grid import as_real
from ...numerics import orthonormal_basis
from ..noise.causes import AS_GOOD, ENOUGH, LikelyCause, in_words
from ..noise.trend import SMOOTH
from ..nonlinear import Fit, Independent, WithNuisance, whitener
from .model import FeatureModel

GRID = 12  # values of a cause's number, before the best of them is searched around
CLOSE = 1e-2  # of its range: where its search ends
PROMISING = 0.5  # of what the best cause explains to first order: others that are followed
ROUNDS, SETTLED = 10, 0.2  # of moves, until half the squares hardly change
PARTS = np.array([[1.0], [0.5], [0.2], [0.05]])  # of a move, until less is left
SLOWEST = 0.1  # of the scan's time: a low-pass beyond it would leave no signal
LEAST_WAVES = 5  # of hum in a scan: fewer are a drift
FINER = 4  # frequencies of hum that are tried, over those of the scan's length
TRENDS = {"constant": 0, "drift": SMOOTH}  # degrees of polynomials on each signal
PART = {"jump_s": 0.2}  # of a misfit, in place of `ENOUGH`: there may be several of these
SPANS, LEAST_SPAN = (1, 8, 64, 512), 8  # samples before and after a jump, and from the ends
WIDTHS, APART = (0.5, 1.0, 2.0, 4.0), 0.5  # of further loads, and between them, in depths
MOST_PLACES = 64  # of a further load
ALIKE = 1e-10  # of a column's square, added to it: columns may be alike

Signal = Float[np.ndarray, "e sample"]
Rows = Float[np.ndarray, "_ e sample"]


class FittedModel(NamedTuple):
    """A fit with its noise, as [`nonlinear.fit`][] takes it, and a model of the same parameters;
    `facts`: of how many numbers of variance one the model is a function besides, `calibration`."""

    fit: Fit
    noise: Any
    model: FeatureModel
    facts: int = 0

    def signal(self, by: Float[np.ndarray, " m"]) -> Signal:
        """The signal where parameters and facts are so far off the fit."""
        free = len(self.fit.names)
        params = dict(self.fit.moved(by[:free]).value)
        params |= {"calibration": by[free:]} if self.facts else {}
        return np.asarray(self.model(params))

    @property
    def steps(self) -> Float[np.ndarray, " m"]:
        """Steps for differences: standard errors, of facts beforehand."""
        coarse = [self.model.steps.get(name, 0.0) for name in self.fit.names]
        own = np.maximum(np.sqrt(np.diag(self.fit.covariance)), coarse)
        return np.append(own, np.ones(self.facts))


class ChangedSignals(NamedTuple):
    """What a cause makes of the signal and its slopes (row, e, sample), the signal first, and
    columns `more` of its own."""

    rows: Rows
    more: Rows


@dataclasses.dataclass(frozen=True)
class Misfit:
    """What is left of `y` (e, sample), NaN where a sample is missing, about numbers `at` (m,).

    - `signal_of` these numbers; `steps` (m,): over which its slopes are differences.
    - `white` (e, #sample): rms of the white noise.
    - `weight`, `pull` (m,): one over the standard deviations of the numbers' priors, and how many
      of these the number 0 is off their means.
    - `beside` (row, e, sample): signals beside the noise, of unknown sizes of variance one.
    """

    y: Signal
    white: Float[np.ndarray, "e #sample"]
    signal_of: Callable[[Float[np.ndarray, " m"]], Signal]
    steps: Float[np.ndarray, " m"]
    weight: Float[np.ndarray, " m"]
    pull: Float[np.ndarray, " m"]
    beside: Rows
    at: Float[np.ndarray, " m"]
    rows: Rows

    @classmethod
    def of(
        cls,
        y: Signal,
        white: Float[np.ndarray, "e #sample"],
        fitted: FittedModel,
        beside: Rows,
    ) -> "Misfit":
        """That about a fit."""
        fit, facts, none = fitted.fit, np.zeros(fitted.facts), np.zeros(len(fitted.steps))
        weight = np.append(1 / np.array([*fit.prior_stderr.values()]), facts + 1)
        pull = np.append(fit.prior_pull, facts)
        made = cls(y, white, fitted.signal, fitted.steps, weight, pull, beside, none, y[None])
        return made.moved(none).with_slopes()

    def moved(self, by: Float[np.ndarray, " m"]) -> "Misfit":
        """That about other numbers, without slopes there."""
        at = self.at + by
        return dataclasses.replace(self, at=at, rows=self.signal_of(at)[None])

    def with_slopes(self) -> "Misfit":
        """The same with its slopes."""
        slopes = [
            (self.signal_of(self.at + own) - self.signal_of(self.at - own)) / (2 * step)
            for own, step in zip(np.diag(self.steps), self.steps, strict=True)
        ]
        return dataclasses.replace(self, rows=np.stack([self.rows[0], *slopes]))

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return int(np.isfinite(self.y).sum()) - self.steps.size

    @property
    def rest(self) -> Signal:
        """What is left in units of the noise, zero where a sample is missing, at any numbers and
        any sizes of what is beside, to first order."""
        per_noise = np.where(np.isfinite(self.y), 1 / self.white, 0.0)
        left = np.nan_to_num(self.y - self.rows[0]) * per_noise
        columns = np.concatenate([self.rows[1:], self.beside]) * per_noise
        basis = orthonormal_basis(columns.reshape(len(columns), -1).T)
        return left - (basis @ (basis.T @ left.ravel())).reshape(left.shape)

    def solved(self, trial: ChangedSignals) -> tuple[float, Float[np.ndarray, " m"]]:
        """Half the squares that a trial leaves at best, and how far the numbers move for it, as far
        as there are slopes."""
        per_noise = np.where(np.isfinite(self.y), 1 / self.white, 0.0)
        signal, slopes = trial.rows[0], trial.rows[1:]
        columns = np.concatenate([slopes, self.beside, trial.more]) * per_noise
        columns = columns.reshape(len(columns), self.y.size)
        rest = (np.where(np.isfinite(self.y), self.y - signal, 0.0) * per_noise).ravel()
        pull, free = self.pull + self.weight * self.at, len(slopes)
        own = self.weight[:free], np.ones(len(self.beside)), np.zeros(len(trial.more))
        weight = np.concatenate(own)
        squares = columns @ columns.T + np.diag(weight**2)
        along = columns @ rest
        along[:free] -= weight[:free] * pull[:free]
        unit = np.sqrt(np.maximum(np.diag(squares), np.finfo(float).tiny))
        scaled = squares / unit[:, None] / unit + ALIKE * np.eye(unit.size)
        moves = np.linalg.solve(scaled, along / unit)
        left = rest @ rest + pull @ pull - (along / unit) @ moves
        return float(left) / 2, (moves / unit)[:free]


class MisfitCause(NamedTuple):
    """A cause by the numbers that it may have, between the least and the greatest of which it is
    searched on where `is_smooth`; what value a number is, and the trial of a misfit with it."""

    name: str
    numbers: Float[np.ndarray, " number"]
    is_smooth: bool
    value: Callable[[float], float]
    trial: Callable[[Misfit, float], ChangedSignals]

    def best(self, misfit: Misfit) -> tuple[float, float]:
        """Half the squares that are left at least, and the number that leaves them."""

        def left(at: float) -> float:
            return misfit.solved(self.trial(misfit, float(at)))[0]

        tried = [(left(at), at) for at in self.numbers.tolist()]
        least = min(tried)
        if not self.is_smooth:
            return least
        place = tried.index(least)
        around = self.numbers[[max(place - 1, 0), min(place + 1, len(tried) - 1)]]
        width = CLOSE * float(np.ptp(self.numbers))
        end: Any = scipy.optimize.minimize_scalar(
            left, bounds=tuple(around.tolist()), method="bounded", options={"xatol": width}
        )
        return min(least, (float(end.fun), float(end.x)))

    def followed(self, misfit: Misfit) -> tuple[float, float]:
        """What is left, and the number, as parameters and facts move with the cause."""
        here, sloped = dataclasses.replace(misfit, rows=misfit.rows[:1]), misfit
        least = self.best(here)
        for _ in range(ROUNDS):
            _, at = self.best(sloped)
            _, moves = sloped.solved(self.trial(sloped, at))
            ends = ((self.best(tried), tried) for tried in map(here.moved, PARTS * moves))
            better = next((end for end in ends if end[0][0] < least[0] - SETTLED), None)
            if better is None:
                break
            least, here = better
            sloped = here.with_slopes()
        return least

    def gain(self, misfit: Misfit, least: float, is_followed: bool) -> tuple[float, LikelyCause]:
        """By how much less than `least` the cause leaves, to first order or followed, beyond what
        its numbers explain by chance (Schwarz 1978)."""
        left, at = self.followed(misfit) if is_followed else self.best(misfit)
        numbers = 1 + len(self.trial(misfit, at).more)
        chance = numbers / 2 * float(np.log(misfit.freedom))
        return least - left - chance, LikelyCause(self.name, self.value(at))


class Explained(NamedTuple):
    """The `share` of a misfit that some causes explain, each alone, the likeliest first."""

    share: float = 0.0
    causes: tuple[LikelyCause, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is said of it."""
        if not self.causes:
            return ()
        return (f"{self.share:.0%} of the misfit is explained by {in_words(self.causes)}.",)


def explained(
    y: Signal,
    begun: FittedModel,
    ended: FittedModel,
    white: Float[np.ndarray, " e"] | None,
    motion: Motion,
    depth_m: float,
) -> Explained:
    """What explains most of the misfit that a fit to `y` `ended` with; nothing where no cause
    explains half of it and no jump a fifth, where the data do not determine all parameters, and
    beside noise that is stated and not white.

    `begun`: the fit by the facts as stated; `white`: levels of the white noise, where they were
    estimated.
    """
    known, _ = whitener(ended.noise, y.shape)
    alone, beside = known, y[None, :0, :0].reshape(0, *y.shape)
    if isinstance(known, WithNuisance):
        alone, beside = known.alone, of_each(np.asarray(known.waves))
    if white is not None:
        level = white[:, None]
    elif isinstance(alone, Independent):
        level = np.asarray(alone.stderr)
    else:
        return Explained()
    variances = np.concatenate([np.diag(each.fit.covariance) for each in (begun, ended)])
    if not (np.isfinite(variances) & (variances > 0)).all():
        return Explained()
    end, misfit = (Misfit.of(y, level, each, beside) for each in (ended, begun))
    least, _ = end.solved(ChangedSignals(end.rows, end.rows[:0]))
    excess = least - misfit.freedom / 2
    beyond_chance = -float(np.log(false_alarm.NOISE_PART))
    if excess < beyond_chance:
        return Explained()
    causes = list(_causes(misfit, motion, Loads.along(begun, motion, depth_m)))
    first = [each.gain(misfit, least, is_followed=False)[0] for each in causes]
    found = [
        each.gain(misfit, least, is_followed=True)
        for each, gain in zip(causes, first, strict=True)
        if gain > PROMISING * max(*first, 0.0)
    ]
    found = [
        (gain, cause)
        for gain, cause in sorted(found, reverse=True)
        if gain > max(PART.get(cause.name, ENOUGH) * excess, beyond_chance)
    ]
    if not found:
        return Explained()
    best = found[0][0]
    named = tuple(cause for gain, cause in found if gain > AS_GOOD * best)
    return Explained(min(best / excess, 1.0), named)


def _causes(misfit: Misfit, motion: Motion, loads: "Loads | None") -> Iterator[MisfitCause]:
    """All causes that a motion tells."""
    time_s, elements = np.asarray(motion.time_s), len(misfit.y)
    interval_s = float(np.mean(np.diff(time_s)))
    none = misfit.rows[:0]

    def slowed(rows: Rows, element: int | None, tau_s: float) -> ChangedSignals:
        flat = as_real(rows.reshape(-1, time_s.size))
        slow = np.asarray(FirstOrder(tau_s).in_time(flat, as_real(interval_s))).reshape(rows.shape)
        is_own = np.arange(elements)[:, None] == element
        return ChangedSignals(slow if element is None else np.where(is_own, slow, rows), none)

    def frequency(log_s: float) -> float:
        return float(np.exp(-log_s) / (2 * np.pi))

    times = np.log(np.geomspace(interval_s / 2, SLOWEST * np.ptp(time_s), GRID))
    for element in [None, *range(elements if elements > 1 else 0)]:
        name = "low_pass_Hz" if element is None else f"low_pass_{element + 1}_Hz"
        yield MisfitCause(
            name, times, True, frequency,
            lambda of, at, own=element: slowed(of.rows, own, float(np.exp(at))),
        )  # fmt: skip

    def saturated(of: Misfit, share: float) -> ChangedSignals:
        # s / (1 + a (s / s_max)^2): the same amplifier in all channels.
        signal, slopes = of.rows[0], of.rows[1:]
        size = share * (signal / np.max(np.abs(signal))) ** 2
        changed = slopes * (1 - size) / (1 + size) ** 2
        return ChangedSignals(np.concatenate([(signal / (1 + size))[None], changed]), none)

    yield MisfitCause(
        "saturation", np.linspace(0, 1, GRID), True, lambda at: at / (1 + at), saturated
    )

    def with_shapes(of: Misfit, shapes: Float[np.ndarray, "m sample"]) -> ChangedSignals:
        return ChangedSignals(of.rows, of_each(np.broadcast_to(shapes, (elements, *shapes.shape))))

    def waves(of: Misfit, frequency_Hz: float) -> ChangedSignals:
        turn = 2 * np.pi * frequency_Hz * time_s
        return with_shapes(of, np.stack([np.cos(turn), np.sin(turn)]))

    def smooth(of: Misfit, degree: float) -> ChangedSignals:
        along = np.linspace(-1, 1, time_s.size)
        return with_shapes(of, np.polynomial.legendre.legvander(along, int(degree)).T)

    for name, degree in TRENDS.items():
        yield MisfitCause(name, np.array([degree], float), False, float, smooth)

    def jumped(of: Misfit, at_s: float) -> ChangedSignals:
        return with_shapes(of, np.stack([np.ones(time_s.size), time_s - time_s[0] > at_s]))

    rest = misfit.rest
    after = _jumps(rest)
    if after.size:
        halfway_s = (time_s[after] + time_s[after + 1]) / 2 - time_s[0]
        yield MisfitCause("jump_s", halfway_s, False, float, jumped)

    tried = _frequencies(rest, interval_s)
    yield MisfitCause("hum_Hz", tried, False, float, waves)
    if loads is not None:
        places = np.arange(len(loads.at_m), dtype=float)
        yield MisfitCause(
            "load_m", places, False, lambda at: float(loads.at_m[int(at)]),
            lambda of, at: ChangedSignals(of.rows, loads.signals[int(at)]),
        )  # fmt: skip


def _jumps(rest: Signal) -> Int[np.ndarray, " jump"]:
    """The samples after which the means over some spans differ most in what is left."""
    found, count = set(), rest.shape[1]
    sums = np.pad(np.cumsum(rest, axis=1), ((0, 0), (1, 0)))
    for span in SPANS:
        least = max(span, LEAST_SPAN)
        at = np.arange(least, count - least)
        if at.size:
            apart = sums[:, at + span] + sums[:, at - span] - 2 * sums[:, at]
            found.add(int(at[np.argmax(np.sum(apart**2, axis=0))]) - 1)
    return np.array(sorted(found), int)


def _frequencies(rest: Signal, interval_s: float) -> Float[np.ndarray, " f"]:
    """Frequencies about that of the strongest line in what is left, of a few waves at least."""
    n = FINER * rest.shape[1]
    power = np.sum(np.abs(np.fft.rfft(rest, n)) ** 2, axis=0)
    power[: FINER * LEAST_WAVES] = 0.0
    top = int(np.argmax(power))
    return np.fft.rfftfreq(n, interval_s)[max(top - FINER, 1) : top + FINER + 1]


class Loads(NamedTuple):
    """Further loads at places [m], and the signals of their pressure and shear."""

    at_m: Float[np.ndarray, " place"]
    signals: Float[np.ndarray, "place 2 e sample"]

    @classmethod
    def along(cls, fitted: FittedModel, motion: Motion, depth_m: float) -> "Loads | None":
        """Loads all along a motion; None of one that turns."""
        if len(motion.directions) > 1:
            return None
        model, params = fitted.model, {**fitted.fit.value, "calibration": np.zeros(fitted.facts)}
        model, params = model.at_facts(jax.tree.map(as_real, params))
        operator = model.loading.operator(model.operator, params)
        x, line = np.asarray(motion.position_m), np.asarray(model.line.x)
        count = min(int(np.ptp(x) / (APART * depth_m)) + 1, MOST_PLACES)
        places, widths_m = np.linspace(x.min(), x.max(), count), depth_m * np.array(WIDTHS)
        places, widths_m = (each.ravel() for each in np.meshgrid(places, widths_m))
        bumps = np.exp(-(((line - places[:, None]) / widths_m[:, None]) ** 2) / 2)
        each = as_real(np.einsum("pn,cd->pcdn", bumps, np.eye(2)).reshape(-1, 2, line.size))
        signals = np.asarray(model.first(_signals(operator, each)))
        return cls(places, signals.reshape(len(places), 2, *signals.shape[1:]))


@compiled
def _signals(operator: MotionOperator, tractions: Any) -> Any:
    return jax.lax.map(operator, tractions)


def of_each(columns: Float[np.ndarray, "e m sample"]) -> Rows:
    """Columns of each element alone, as rows of all elements."""
    elements = len(columns)
    apart = np.einsum("ems,ef->mefs", columns, np.eye(elements))
    return apart.reshape(-1, elements, columns.shape[-1])
