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

import abc
import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
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
BATCH = 32  # numbers of an addition that are solved for together
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
    columns `more` of its own: (m, e, sample), or (number, m, e, sample) of several numbers under
    which the rows are the same."""

    rows: Rows
    more: Float[np.ndarray, "*number m e sample"]


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

    def solved(
        self, trial: ChangedSignals
    ) -> tuple[Float[np.ndarray, "*number"], Float[np.ndarray, "*number m"]]:
        """Half the squares that a trial leaves at best, and how far the numbers move for it, as far
        as there are slopes."""
        per_noise = np.where(np.isfinite(self.y), 1 / self.white, 0.0)
        signal, slopes = trial.rows[0], trial.rows[1:]
        rest = (np.where(np.isfinite(self.y), self.y - signal, 0.0) * per_noise).ravel()
        shared = np.concatenate([slopes, self.beside]) * per_noise
        shared, more = (
            rows.reshape(*rows.shape[:-2], rest.size) for rows in (shared, trial.more * per_noise)
        )
        pull, free = self.pull + self.weight * self.at, len(slopes)
        own = self.weight[:free], np.ones(len(self.beside)), np.zeros(more.shape[-2])
        weight = np.concatenate(own)
        along = _joined(shared @ rest, more @ rest)
        along[..., :free] -= weight[:free] * pull[:free]
        squares = _gram(shared, more) + np.diag(weight**2)
        diagonal = np.diagonal(squares, axis1=-2, axis2=-1)
        unit = np.sqrt(np.maximum(diagonal, np.finfo(float).tiny))
        scaled = squares / unit[..., None] / unit[..., None, :] + ALIKE * np.eye(weight.size)
        moves = np.linalg.solve(scaled, (along / unit)[..., None])[..., 0]
        left = rest @ rest + pull @ pull - np.sum(along / unit * moves, axis=-1)
        return np.asarray(left / 2), (moves / unit)[..., :free]


def _joined(
    shared: Float[np.ndarray, " b"], more: Float[np.ndarray, "*number m"]
) -> Float[np.ndarray, "*number c"]:
    return np.concatenate([np.broadcast_to(shared, (*more.shape[:-1], len(shared))), more], -1)


def _gram(
    shared: Float[np.ndarray, "b n"], more: Float[np.ndarray, "*number m n"]
) -> Float[np.ndarray, "*number c c"]:
    """The inner products of the rows of both."""
    across = more @ shared.T
    corner = np.broadcast_to(shared @ shared.T, (*more.shape[:-2], len(shared), len(shared)))
    return np.block([[corner, across.mT], [across, more @ more.mT]])


class MisfitCause(abc.ABC):
    """A cause of a misfit, by a number that it may have."""

    name: str

    @abc.abstractmethod
    def value(self, at: float) -> float:
        """What value a number is."""

    @abc.abstractmethod
    def trial(self, misfit: Misfit, at: float) -> ChangedSignals:
        """A misfit's signals with the cause."""

    @abc.abstractmethod
    def best(self, misfit: Misfit) -> tuple[float, float]:
        """Half the squares that are left at least, and the number that leaves them."""

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


@dataclasses.dataclass(frozen=True)
class Distortion(MisfitCause):
    """A change of the signal by a number, which is searched for between the least and the greatest
    of `numbers`: the `value` of one, and the `changed` rows."""

    name: str
    numbers: Float[np.ndarray, " number"]
    to_value: Callable[[float], float]
    changed: Callable[[Rows, float], Rows]

    def value(self, at: float) -> float:
        return self.to_value(at)

    def trial(self, misfit: Misfit, at: float) -> ChangedSignals:
        return ChangedSignals(self.changed(misfit.rows, at), misfit.rows[:0])

    def best(self, misfit: Misfit) -> tuple[float, float]:
        def left(at: float) -> float:
            return float(misfit.solved(self.trial(misfit, float(at)))[0])

        tried = [(left(at), at) for at in self.numbers.tolist()]
        least = min(tried)
        place = tried.index(least)
        around = self.numbers[[max(place - 1, 0), min(place + 1, len(tried) - 1)]]
        width = CLOSE * float(np.ptp(self.numbers))
        end: Any = scipy.optimize.minimize_scalar(
            left, bounds=tuple(around.tolist()), method="bounded", options={"xatol": width}
        )
        return min(least, (float(end.fun), float(end.x)))


@dataclasses.dataclass(frozen=True)
class Addition(MisfitCause):
    """Signals of unknown sizes (number, m, e, sample) beside the model's, for each of its `values`
    (number,); its number is the place among these."""

    name: str
    values: Float[np.ndarray, " number"]
    signals: Float[np.ndarray, "number m e sample"]

    def value(self, at: float) -> float:
        return float(self.values[int(at)])

    def trial(self, misfit: Misfit, at: float) -> ChangedSignals:
        return ChangedSignals(misfit.rows, self.signals[int(at)])

    def best(self, misfit: Misfit) -> tuple[float, float]:
        some = (self.signals[at : at + BATCH] for at in range(0, len(self.signals), BATCH))
        left = np.concatenate([misfit.solved(ChangedSignals(misfit.rows, s))[0] for s in some])
        at = int(np.argmin(left))
        return float(left[at]), float(at)


class Explained(NamedTuple):
    """The `share` of a misfit that some causes explain, each alone, the likeliest first."""

    share: float = 0.0
    causes: tuple[LikelyCause, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence that names the causes."""
        if not self.causes:
            return ()
        return (f"{100 * self.share:.0f} % of the misfit is explained by {in_words(self.causes)}.",)


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
    least = float(end.solved(ChangedSignals(end.rows, end.rows[:0]))[0])
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
    time_s = np.asarray(motion.time_s)
    yield from _distortions(time_s, len(misfit.y))
    yield from _additions(misfit.rest, time_s)
    if loads is not None:
        yield Addition("load_m", loads.at_m, loads.signals)


def _distortions(time_s: Float[np.ndarray, " sample"], elements: int) -> Iterator[Distortion]:
    """A low-pass of all elements or of one, and the same saturation of all."""
    interval_s = float(np.mean(np.diff(time_s)))

    def slowed(rows: Rows, log_s: float, element: int | None) -> Rows:
        flat, low_pass = as_real(rows.reshape(-1, time_s.size)), FirstOrder(float(np.exp(log_s)))
        slow = np.asarray(low_pass.in_time(flat, as_real(interval_s))).reshape(rows.shape)
        is_own = np.arange(elements)[:, None] == element
        return slow if element is None else np.where(is_own, slow, rows)

    def frequency(log_s: float) -> float:
        return float(np.exp(-log_s) / (2 * np.pi))

    times = np.log(np.geomspace(interval_s / 2, SLOWEST * np.ptp(time_s), GRID))
    for element in [None, *range(elements if elements > 1 else 0)]:
        name = "low_pass_Hz" if element is None else f"low_pass_{element + 1}_Hz"
        yield Distortion(name, times, frequency, partial(slowed, element=element))

    def saturated(rows: Rows, share: float) -> Rows:
        # s / (1 + a (s / s_max)^2): the same amplifier in all channels.
        signal, slopes = rows[0], rows[1:]
        size = share * (signal / np.max(np.abs(signal))) ** 2
        changed = slopes * (1 - size) / (1 + size) ** 2
        return np.concatenate([(signal / (1 + size))[None], changed])

    yield Distortion("saturation", np.linspace(0, 1, GRID), lambda at: at / (1 + at), saturated)


def _additions(rest: Signal, time_s: Float[np.ndarray, " sample"]) -> Iterator[Addition]:
    """A constant, a drift, a jump and hum, each of its own size on each element, as what is left
    (e, sample) suggests them."""

    def added(name: str, values: Any, shapes: list[np.ndarray]) -> Addition:
        """Of shapes (m, sample) for each value."""
        rows = (of_each(np.broadcast_to(each, (len(rest), *each.shape))) for each in shapes)
        return Addition(name, np.asarray(values, float), np.stack([*rows]))

    along = np.linspace(-1, 1, time_s.size)
    for name, degree in TRENDS.items():
        yield added(name, [degree], [np.polynomial.legendre.legvander(along, degree).T])
    after = _jumps(rest)
    if after.size:
        halfway_s = (time_s[after] + time_s[after + 1]) / 2 - time_s[0]
        steps = [np.stack([np.ones(time_s.size), time_s - time_s[0] > at]) for at in halfway_s]
        yield added("jump_s", halfway_s, steps)
    tried = _frequencies(rest, float(np.mean(np.diff(time_s))))
    turns = [2 * np.pi * frequency_Hz * time_s for frequency_Hz in tried]
    yield added("hum_Hz", tried, [np.stack([np.cos(turn), np.sin(turn)]) for turn in turns])


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
        operator = model.loading.operator(model.operator, model.features, params)
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
