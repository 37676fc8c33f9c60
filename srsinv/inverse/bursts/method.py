"""Inversion of a pass with bursts of catch and snap: the traction that all elements share, and the
bursts that the skin makes, by the evidence."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from ...errors import BadInput, echo, number, of_kind, refuse
from ...known import is_traced
from ...modules import with_fields
from ...status import Status
from ..estimate import Estimate, TractionEstimate
from ..line.prior import Prior
from ..line.problem import LineProblem
from ..line.rig_bands import with_rig_errors
from ..line.shared import shared_noise
from ..method import Method
from ..problem import Problem
from ..wiener import Wiener
from .estimate import LOCATED, BurstEstimate, Found, FoundBursts
from .model import BurstModel, Everything
from .posterior import Burst, Others
from .rate import burst_rate, first_sizes
from .search import CROWD, LOUDER, BurstSearch, crowded

ROUNDS = 4  # of levels and bursts in turn, at most
LEVELS, STEPS = (-3.0, 3.0), 13  # decades of the small bursts' power about the noise's, and steps


class BurstInversion(Method):
    """The traction and the bursts of catch and snap, found together from elements along the travel.

    All elements see the same surface, and record the same bursts, each through its own response.
    The evidence says which part of the signals is a burst: at most 2 % of passes without any have
    one claimed. The estimate is a [`BurstEstimate`][], whose `bursts` have time, place on the
    finger, size and decay, with standard errors and 90 % intervals, and the rate of bursts. Three
    elements locate a burst; with one, and often with two, its place is ambiguous.

    - `patch_m` [m]: length of the patch of skin that snaps back; `contact_m` [m]: of the contact
      about the sensor's origin, over which places are of equal odds.
    - `decay_s` [s]: shortest and longest decay of a burst, of equal odds over logarithms.
    - `method`: the inversion of what is left, which has a Gaussian prior; None: Wiener's filter,
      whose levels of p and q are those under which the data are most likely.

    Raises `BadInput` for lengths and decays that are not positive, for a problem without a sensor,
    on an open line, with samples missing or at rest, and under `jax.jit`.
    """

    patch_m: float = eqx.field(static=True)
    contact_m: float = eqx.field(static=True)
    decay_s: tuple[float, float] = eqx.field(static=True)
    method: Method

    def __init__(
        self, patch_m: Any = 0.5e-3, contact_m: Any = 10e-3, decay_s: Any = (1e-3, 20e-3),
        method: Any = None,
    ):  # fmt: skip
        key, wanted = "method.bursts.", "a positive length in metres"
        self.patch_m = float(number(f"{key}patch_m", patch_m, wanted, above=0))
        self.contact_m = float(number(f"{key}contact_m", contact_m, wanted, above=0))
        pair = list(decay_s) if isinstance(decay_s, list | tuple) else []
        what = "two positive times in seconds, the shorter one first"
        refuse(len(pair) != 2, f"{key}decay_s is {echo(decay_s)}: give {what}.")
        low, high = (float(number(f"{key}decay_s", each, what, above=0)) for each in pair)
        refuse(low >= high, f"{key}decay_s is {echo(decay_s)}: give {what}.")
        self.decay_s = low, high
        inner = Wiener(scale="evidence") if method is None else method
        wanted = "a method, such as srsinv.Wiener()"
        self.method = of_kind(f"{key}method", inner, Method, wanted)

    def __call__(self, problem: Problem | LineProblem) -> Estimate:
        """The estimate of p and q and of the bursts."""
        problem = checked(problem)
        model = BurstModel(problem, self.patch_m, self.contact_m, self.decay_s)
        parts = BurstPass(problem, model, self.method)
        bursts: list[Burst] = []
        for _ in range(ROUNDS):
            parts.set_levels(bursts)
            before, bursts = bursts, parts.search.run(bursts)
            if [each.sample for each in before] == [each.sample for each in bursts]:
                break
        return parts.estimate(bursts)

    @property
    def chooses_prior(self) -> bool:
        return self.method.chooses_prior


def checked(problem: Problem | LineProblem) -> LineProblem:
    """The problem on its cells, where bursts can be found."""
    on = problem if isinstance(problem, LineProblem) else problem.to_grid()
    if on.sensor is None or on.scan is None:
        raise BadInput(
            "The problem has an operator but no sensor, which bursts need: give sensor and scan."
        )
    refuse(
        is_traced(on),
        "BurstInversion searches known signals: call it outside jax.jit, jax.grad and jax.vmap.",
    )
    refuse(
        not on.separable,
        "BurstInversion needs grid.line=periodic without missing samples, at a constant speed: "
        "give such a problem, or another method.",
    )
    refuse(
        not float(on.scan.speed_m_per_s),
        "BurstInversion needs a sensor that slides, as nothing snaps back at rest: give "
        "scan.speed_m_per_s.",
    )
    return on


class BurstPass:
    """The signals of a pass, and the levels of everything in them."""

    def __init__(self, problem: LineProblem, model: BurstModel, method: Method):
        assert problem.scan is not None
        self.problem, self.model, self.method = problem, model, method
        self.is_backward = float(problem.scan.direction) < 0
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

    def set_levels(self, bursts: list[Burst]) -> None:
        """The levels of the traction and of small bursts under which what is left beside the bursts
        is most likely; and the search under them."""
        known = len(bursts) > 0
        prior = self.method.prior_fixed_on(self._without(bursts))(self.problem)
        left = self.data - sum((each.spectrum(self.model) for each in bursts), 0.0 * self.data)
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
        return Everything.of(self.problem, prior, self._noise(small_power), factor)

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
        if self.small_power:
            noise = noise + self.small_power * np.einsum("eek->ek", self._small)
        noise = noise.copy()
        if self.problem.has_free_offset:
            noise[:, 0] = np.inf
        data = np.asarray(self.problem.data, float) - self._signal(bursts)
        return with_fields(
            self.problem, data=jnp.asarray(data), noise=jnp.asarray(noise), shared_noise=shared,
            by_rig=None,
        )  # fmt: skip

    def _signal(self, bursts: list[Burst]) -> Float[np.ndarray, "e n"]:
        """The signals of bursts along x."""
        total = sum((each.spectrum(self.model) for each in bursts), 0.0 * self.data)
        return self._in_time(np.fft.irfft(total, self.model.n))

    def estimate(self, bursts: list[Burst]) -> BurstEstimate:
        """The estimate with these bursts."""
        bursts = sorted(bursts, key=lambda each: each.sample)
        found = self.found(bursts)
        problem = self._without(bursts)
        made = self.method(problem)
        if not isinstance(made, TractionEstimate):
            raise BadInput(
                f"{type(self.method).__name__} gives no traction with a covariance: give "
                "method.bursts.method=srsinv.Wiener() or Tikhonov()."
            )
        moved = self._moved(bursts, made, problem)
        own, sources = made.rig_errors, made.rig_sources
        stderr = made.stderr
        if moved is not None:
            stderr = jnp.asarray(with_rig_errors(problem, np.asarray(stderr), moved))
            own = moved if own is None else np.concatenate([np.asarray(own), moved])
            sources = (*sources, *("bursts",) * len(moved))
        lost = () if found.is_located.all() else _not_located(found)
        lost = (*lost, *(_CROWDED if crowded(self.model.n, bursts) else ()))
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
                "parameters": {**made.parameters, "burst_rate_hz": (rate, stderr_hz)},
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

    def found(self, bursts: list[Burst]) -> FoundBursts:
        """The bursts with their uncertainty."""
        draws, odds = [], []
        for j, each in enumerate(bursts):
            one = self.search.one(bursts, j)
            grid = one.around(each.sample)
            made = one.draws(grid, j)
            if made.time_s.mean() < 0:  # the line repeats with its window
                made = made._replace(time_s=made.time_s + self.model.n * self.model.interval_s)
            draws.append(made)
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

    def _moved(
        self, bursts: list[Burst], made: TractionEstimate, problem: LineProblem
    ) -> Float[np.ndarray, "j c n"] | None:
        """Changes of the traction by errors of the bursts, in independent directions of these."""
        others = Others.of(self.model, self.search.rests[0], self.search.prior, bursts)
        if others is None or made.covariance is None:
            return None
        columns = np.concatenate([each.tangents(self.model) for each in bursts])
        spectra = np.einsum("cek,cj->jek", columns, others.root)
        signals = self._in_time(np.fft.irfft(spectra, self.model.n))
        inverse = np.linalg.inv(self._noise(self.small_power))
        if self.problem.has_free_offset:
            inverse[0] = 0.0
        weighed = np.einsum("kef,jfk->jek", inverse, np.fft.rfft(signals))
        transfer = np.asarray(problem.forward.transfer)
        right = np.einsum("eck,jek->jck", transfer.conj(), weighed)
        moved = np.einsum("cdk,jdk->jck", np.asarray(made.covariance), right)
        return np.fft.irfft(moved, self.model.n)


_CROWDED = (
    f"{CROWD} bursts are at one place of the pass, where the model of the traction may be wrong: "
    "check what is stated, such as friction, or take none of them as a burst.",
)


def _not_located(found: FoundBursts) -> tuple[str, ...]:
    """Warning on bursts whose place is not known."""
    lost, total = int(np.sum(~found.is_located)), len(found)
    return (
        f"{lost} of {total} bursts are not located: their places have errors above a tenth of the "
        "contact. Give more elements along the travel, or take their times alone.",
    )
