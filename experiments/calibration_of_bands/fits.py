"""Fits whose intervals are calibrated: of features, of a pitch, of any model, and posterior
samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import srsinv
from srsinv.errors import check_name, mapping, number_range
from srsinv.grid import as_real
from srsinv.inverse.board.pitch import drift, scan_pitch, waves
from srsinv.inverse.features.synthetic import KnownLoad, KnownShape, known_noise

from .ranks import RankedMethod, Ranks, by_quantity, drawn, normal_rank

Parameters = Mapping[str, tuple[float, float]]


def parameter_ranks(truth: Mapping[str, float], found: Parameters) -> dict[str, float]:
    """The ranks of parameters, by (value, standard error)."""
    return {name: float(normal_rank(each, *found[name])) for name, each in truth.items()}


@dataclass(frozen=True)
class Ranges:
    """Ranges [least, greatest] of parameters, by name, in which truths are uniform."""

    of: Mapping[str, tuple[float, float]]

    @classmethod
    def checked(cls, key: str, given: Any, names: Sequence[str]) -> "Ranges":
        """Raises `BadInput` for what are no ranges, and for other parameters than these."""
        wanted = "two numbers"
        for name in mapping(key, given):
            check_name(key, name, names)
        return cls({
            name: number_range(f"{key}.{name}", each, wanted) for name, each in given.items()
        })  # fmt: skip

    @property
    def middle(self) -> dict[str, float]:
        """The middle of each."""
        return {name: sum(each) / 2 for name, each in self.of.items()}

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """One of each."""
        return {name: float(rng.uniform(*each)) for name, each in self.of.items()}


@dataclass(frozen=True)
class RankedLoad(RankedMethod):
    """The fit of a feature of traction."""

    label: str
    known: KnownLoad
    ranges: Ranges

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        known = self.known
        truths = [self.ranges.draw(rng) for _ in range(draws)]
        level = np.sqrt(known.power[0])
        signals = np.array([known.signal(truth) for truth in truths])
        ys = signals + level * rng.standard_normal(signals.shape)
        fits = known.fitter.estimates(known.name, known.feature, ys, known_noise(known.power))
        each = zip(truths, fits, strict=True)
        return by_quantity([parameter_ranks(truth, fit.parameters) for truth, fit in each])


@dataclass(frozen=True)
class RankedSurface(RankedMethod):
    """The fit of a feature of a surface, through contact; its noise is estimated from the
    residual."""

    label: str
    known: KnownShape
    ranges: Ranges
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        known = self.known
        level, shape = np.sqrt(known.power[0]), known.on.shape

        def one() -> dict[str, float]:
            drawn_part = self.ranges.draw(rng)
            fitted = known.fit({**known.truth, **drawn_part}, level * rng.standard_normal(shape))
            return parameter_ranks(drawn_part, fitted.parameters)

        return drawn(one, draws)


def real(values: Mapping[str, float]) -> dict[str, Array]:
    """The values as arrays of jax."""
    return {name: as_real(value) for name, value in values.items()}


PITCH_M, BOARD_LENGTH_M, BOARD_SAMPLES, BOARD_NOISE = (2.0e-3, 3.0e-3), 0.08, 1600, 0.3


@dataclass(frozen=True)
class RankedPitch(RankedMethod):
    """The pitch of a board of ridges, from two channels of noise and drift."""

    label: str = "Pitch of a board"

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        x = np.arange(BOARD_SAMPLES) * BOARD_LENGTH_M / BOARD_SAMPLES
        slow = drift(x, 0.02)

        def one() -> dict[str, float]:
            pitch = float(rng.uniform(*PITCH_M))
            pattern = rng.standard_normal((2, 4)) @ waves(x, pitch, 2).T
            y = pattern + rng.standard_normal((2, slow.shape[1])) @ slow.T
            y = y + BOARD_NOISE * rng.standard_normal(y.shape)
            found = scan_pitch(x, y, slow, (0.98 * pitch, 1.02 * pitch), 2)
            return {"pitch": float(normal_rank(pitch, found.pitch_m, found.stderr_m))}

        return drawn(one, draws)


class Decay(eqx.Module):
    """A decay to a constant: a exp(-k t) + c at times `t`."""

    t: Float[Array, " n"]

    def __call__(self, params: Any) -> Float[Array, " n"]:
        return params["a"] * jnp.exp(-params["k"] * self.t) + params["c"]


DECAY_SAMPLES, DECAY_NOISE = 60, 0.03
DECAY_RANGES = Ranges({"a": (1.0, 3.0), "k": (2.0, 4.0), "c": (-1.0, 1.0)})
FLAT = {"a": (-20.0, 20.0), "k": (0.1, 20.0), "c": (-20.0, 20.0)}  # priors, far beyond


@dataclass(frozen=True)
class RankedFit(RankedMethod):
    """`srsinv.fit` of a decay, and `srsinv.sample` of the same fits where `is_sampled`."""

    label: str
    is_sampled: bool
    is_quick: bool

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        model = Decay(jnp.linspace(0.0, 1.0, DECAY_SAMPLES))
        noise = DECAY_NOISE * (10.0 if self.is_sampled else 1.0)
        ranges = FLAT if self.is_sampled else DECAY_RANGES.of

        def one() -> dict[str, float]:
            truth = DECAY_RANGES.draw(rng)
            y = np.asarray(model(real(truth))) + noise * rng.standard_normal(DECAY_SAMPLES)
            fit = srsinv.fit(model, {"a": 1.0, "k": 3.0, "c": 0.0}, y, noise=noise, bounds=ranges)
            if not self.is_sampled:
                each = {name: (fit.value[name], fit.stderr[name]) for name in truth}
                return parameter_ranks(truth, each)
            samples = srsinv.sample(
                fit, draws=250, chains=2, warmup=200, seed=int(rng.integers(2**31))
            )
            return {
                name: float(np.mean(samples.draws[..., i] < truth[name]))
                for i, name in enumerate(samples.names)
            }

        return drawn(one, draws)
