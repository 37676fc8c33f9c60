"""A pass whose signals are taken apart: the likeliest levels of the traction and of small bursts,
and the estimate with the bursts that were found."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from ...errors import BadInput
from ...modules import with_fields
from ...status import Status
from ..estimate import TractionEstimate
from ..line.prior import Prior
from ..line.problem import LineProblem
from ..line.rig_bands import with_rig_errors
from ..line.shared import shared_noise, usable
from ..method import Method
from .estimate import LOCATED, BurstEstimate, Found, FoundBursts
from .everything import Columns, Everything
from .model import BurstModel, are_usual, samples_in_a_cell
from .posterior import Burst, OneBurst, Others, signals_of
from .rate import burst_rate, first_sizes
from .search import CROWD, LOUDER, BurstSearch, crowded

STRONG = 4.5  # gain in log likelihood, of three standard errors
LEVELS, STEPS = (-3.0, 3.0), 13  # decades of the small bursts' power about the noise's, and steps


class BurstPass:
    """The signals of a pass, and the levels of everything in them."""

    def __init__(self, problem: LineProblem, model: BurstModel, method: Method):
        assert problem.scan is not None
        self.problem, self.model, self.method = problem, model, method
        self.is_backward = float(problem.scan.direction) < 0
        self._stated = Columns(
            self._in_time(problem.is_observed & are_usual(problem)), self._in_time(self._nuisance())
        )
        self._stated.check()
        self.columns = self._stated
        self.data = np.fft.rfft(self._in_time(np.asarray(problem.data, float)))
        shared, elements = problem.shared_noise, len(problem.data)
        own = np.asarray(problem.noise if shared is None else shared.own, float)
        own = np.broadcast_to(own, (elements, own.shape[-1])).copy()
        own[:, 0] = np.where(np.isfinite(own[:, 0]), own[:, 0], own[:, 1])
        self.own = own
        products, power = model.small_bursts()
        self._small = products[..., None] * power
        self.small_power = 0.0  # of the small bursts, in units of `_small`
        self.search: BurstSearch

    def _in_time(self, rows: np.ndarray) -> np.ndarray:
        """Rows along x in the order of time, and back."""
        return rows[..., ::-1] if self.is_backward else rows

    def _nuisance(self) -> Float[np.ndarray, "j e n"]:
        """The columns of each element's nuisance, as signals of all elements along x."""
        own = self.problem.nuisance
        if own is None:
            return np.zeros((0, *self.problem.data.shape))
        own = np.asarray(own, float)
        alone = np.eye(len(own))[:, None, :, None] * own[:, :, None]
        return alone.reshape(-1, *self.problem.data.shape)

    def _with_rig(self, prior: Prior, left: Complex[np.ndarray, "e k"]) -> Columns:
        """The columns, with what errors of the rig make of the traction's signals."""
        noise, stated = self._noise(self.small_power), self._stated
        rest = Everything.of(self.problem, prior, noise, 1.0).over(stated)
        traction = self._traction(rest, rest.weigh(left)[None])[0]
        own = self._in_time(np.asarray(self.problem.rig_signals(traction), float))
        columns = stated._replace(signals=np.concatenate([stated.signals, own]))
        columns.check()
        return columns

    def _traction(
        self, rest: Everything, weighed: Complex[np.ndarray, "j e k"]
    ) -> Float[np.ndarray, "j c n"]:
        """S G^H times weighed signals: the traction that is expected along x."""
        along = np.fft.rfft(self._in_time(np.fft.irfft(weighed, self.model.n)))
        transfer = np.asarray(self.problem.forward.circulant().transfer)
        expected = np.einsum("ck,eck,jek->jck", rest.power, transfer.conj(), along)
        return np.fft.irfft(expected, self.model.n)

    def set_levels(self, bursts: list[Burst]) -> None:
        """The levels of the traction and of small bursts under which what is left beside the bursts
        is most likely; and the search under them."""
        known = len(bursts) > 0
        prior = self.method.prior_fixed_on(self._without(bursts))(self.problem)
        left = self.data - signals_of(self.model, bursts)
        if self.problem.rig_changes is not None:
            self.columns = self._with_rig(prior, left)
        if known:
            self.small_power = self._likeliest_power(prior, left)
        rests = (
            self._rest(prior, self.small_power, 1.0),
            self._rest(prior, self.small_power, LOUDER),
        )
        self.search = BurstSearch(self.model, rests, first_sizes(self.model, rests[0]), self.data)
        if known:
            grids = self.search.surest_grids(bursts)
            sizes = burst_rate(self.model, *rests, grids).sizes
            self.search = BurstSearch(self.model, rests, sizes, self.data)

    def _noise(self, small_power: float) -> Float[np.ndarray, "k e e"]:
        """The matrix of the elements' noise and of small bursts."""
        each = np.eye(len(self.own))[..., None] * self.own + small_power * self._small
        return np.moveaxis(each, -1, 0)

    def _rest(self, prior: Prior, small_power: float, factor: float) -> Everything:
        noise = self._noise(small_power)
        return Everything.of(self.problem, prior, noise, factor).over(self.columns)

    def _likeliest_power(self, prior: Prior, left: Complex[np.ndarray, "e k"]) -> float:
        """The power of small bursts of the greatest evidence, 0 where there are none."""
        unit = np.mean(self.own) / np.mean(np.einsum("eek->k", self._small) / len(self.own))
        best, highest = 0.0, self._rest(prior, 0.0, 1.0).log_likelihood(left)
        grid = unit * np.logspace(*LEVELS, STEPS)
        for _ in range(2):
            for power in grid:
                value = self._rest(prior, power, 1.0).log_likelihood(left)
                if value > highest:
                    best, highest = float(power), value
            if not best:
                break
            grid = best * np.logspace(-0.4, 0.4, 5)
        return best

    def _without(self, bursts: list[Burst]) -> LineProblem:
        """The problem without these bursts, under the noise that is left."""
        shared, noise = None, self.own
        if self.small_power and np.allclose(self.own, self.own[:1], rtol=1e-9, atol=0):
            cross = jnp.asarray(self.small_power * self._small)
            shared, _ = shared_noise(cross, jnp.asarray(self.own[0]))
            others = self.problem.noise_scale, self.problem.nuisance
            shared, _ = usable(shared, self.problem.observed, others)
        if self.small_power:
            noise = noise + self.small_power * np.einsum("eek->ek", self._small)
        noise = noise.copy()
        if self.problem.has_free_offset:
            noise[:, 0] = np.inf
        data = np.asarray(self.problem.data, float) - self._signal(bursts)
        data = np.where(self.problem.is_observed, data, 0.0)
        return with_fields(
            self.problem, data=jnp.asarray(data), noise=jnp.asarray(noise), shared_noise=shared,
            by_rig=None,
        )  # fmt: skip

    def _signal(self, bursts: list[Burst]) -> Float[np.ndarray, "e n"]:
        """The signals of bursts along x."""
        return self._in_time(np.fft.irfft(signals_of(self.model, bursts), self.model.n))

    def without_claims(self) -> BurstEstimate:
        """The estimate where the model of the traction is wrong: no burst, and an unknown rate."""
        self.small_power = 0.0
        none = dataclasses.replace(self._found([], []), rate_hz=(np.nan,) * 4)
        return self._estimate([], none, _MISLED)

    def estimate(self, bursts: list[Burst]) -> BurstEstimate:
        """The estimate with these bursts."""
        bursts = sorted(bursts, key=lambda each: each.sample)
        ones = [self.search.one(bursts, j) for j in range(len(bursts))]
        return self._estimate(bursts, self._found(bursts, ones), _out_of_range(bursts, ones))

    def _estimate(
        self, bursts: list[Burst], found: FoundBursts, warnings: tuple[str, ...]
    ) -> BurstEstimate:
        """The estimate with these bursts, in the order of time, of which this was found."""
        problem = self._without(bursts)
        made = self.method(problem)
        if not isinstance(made, TractionEstimate):
            raise BadInput(
                f"{type(self.method).__name__} gives no traction with a covariance: give "
                "method.bursts.method=srsinv.Wiener() or Tikhonov()."
            )
        moved = self._errors_by(bursts)
        own, sources = made.rig_errors, made.rig_sources
        stderr = made.stderr
        if moved is not None:
            stderr = jnp.asarray(with_rig_errors(problem, np.asarray(stderr), moved))
            own = moved if own is None else np.concatenate([np.asarray(own), moved])
            sources = (*sources, *("bursts",) * len(moved))
        lost = () if found.is_located.all() else _not_located(found)
        lost = (*lost, *warnings, *(_CROWDED if crowded(self.model.n, bursts) else ()))
        fields = {f.name: getattr(made, f.name) for f in dataclasses.fields(TractionEstimate)}
        rate, stderr_hz, low, high = found.rate_hz
        return BurstEstimate(
            **fields
            | {
                "stderr": stderr,
                "rig_errors": None if own is None else jnp.asarray(own),
                "rig_sources": sources,
                "fitted": made.fitted + jnp.asarray(self._signal(bursts)),
                "warnings": (*made.warnings, *lost),
                "parameters": {
                    **made.parameters,
                    "burst_rate_hz": (rate, stderr_hz),
                    **found.named(lambda each, j: (each.value[j], each.stderr[j])),
                },
                "stats": {
                    **made.stats,
                    "method": "bursts",
                    "bursts": len(found),
                    "burst_rate_low_hz": low,
                    "burst_rate_high_hz": high,
                },
                "status": Status(made.status),
            },
            bursts=found,
        )

    def _found(self, bursts: list[Burst], ones: list[OneBurst]) -> FoundBursts:
        """The bursts with their uncertainty, from the posterior of each."""
        draws, odds = [], []
        for j, (each, one) in enumerate(zip(bursts, ones, strict=True)):
            grid = one.around(each.sample)
            made = one.draws(grid, j)
            draws.append(made._replace(time_s=self._time_s(made.time_s)))
            odds.append(self.search.log_odds(grid))
        named = zip(*draws, strict=True) if draws else ([],) * 4
        time, place, size, decay = (Found.of(list(each)) for each in named)
        rate = burst_rate(self.model, *self.search.rests, self.search.surest_grids(bursts))
        return FoundBursts(
            time, place, size, decay,
            np.array([each.d_prime for each in bursts]),
            place.stderr < LOCATED * self.model.contact_m,
            np.array(odds),
            (rate.value_hz, rate.stderr_hz, rate.low_hz, rate.high_hz),
        )  # fmt: skip

    def _time_s(self, time_s: np.ndarray) -> np.ndarray:
        """Draws of a time, from the recording's first sample."""
        model, whole_s = self.model, self.model.n * self.model.interval_s
        if self.problem.forward.is_circular and time_s.mean() < 0:
            time_s = time_s + whole_s  # the line repeats with its window
        if not self.problem.forward.is_circular:  # the line is wider than the scan
            first = np.argmax(self._in_time(self.problem.observed_cells))
            time_s = time_s - first * model.interval_s
        assert self.problem.sensor is not None
        # A cell's time is that of its last sample.
        return time_s + (1 - 1 / samples_in_a_cell(self.problem.sensor)) * model.interval_s

    def _errors_by(self, bursts: list[Burst]) -> Float[np.ndarray, "j c n"] | None:
        """Changes of the traction by errors of the bursts, in independent directions of these."""
        rest = self.search.rests[0]
        others = Others.of(self.model, rest, self.search.prior, bursts)
        if others is None:
            return None
        return self._traction(rest, np.einsum("cek,cj->jek", others.weighed, others.root))


_CROWDED = (
    f"{CROWD} bursts are near each other, and no further ones are sought there. The model of the "
    "traction may be wrong there: check what is stated, such as friction.",
)
_MISLED = (
    "The model of the traction leaves more than the noise where bursts crowd at one place, so none "
    "is claimed, and their rate is unknown. Check what is stated, such as friction and the angles.",
)


def _out_of_range(bursts: list[Burst], ones: list[OneBurst]) -> tuple[str, ...]:
    """Warning on bursts whose decay is out of the range."""
    gains = [one.gain_out_of_range(each) for one, each in zip(ones, bursts, strict=True)]
    count = sum(gain > STRONG for gain in gains)
    if not count:
        return ()
    return (
        f"{count} of {len(bursts)} bursts are likelier with a decay out of the range of "
        "method.bursts.decay_s, so their sizes and decays are wrong. Give a wider range. Two "
        "opposite bursts within three samples appear so, too.",
    )


def _not_located(found: FoundBursts) -> tuple[str, ...]:
    """Warning on bursts whose place is not known."""
    lost, total = int(np.sum(~found.is_located)), len(found)
    return (
        f"{lost} of {total} bursts are not located: their places have errors above a tenth of the "
        "contact. Give more elements along the travel, or take their times alone.",
    )
