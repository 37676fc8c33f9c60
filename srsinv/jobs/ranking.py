"""Model selection: random features and noise alone, each fitted by every candidate.

Every draw has its own shape, sign, friction and noise, simulated on finer cells. All the named
features, and "nothing there", are fitted to it and ranked by their evidence.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray
from jaxtyping import Float, Int

from .. import config
from ..errors import BadInput, echo, is_number, refuse, whole
from ..forward.feature import Feature
from ..inverse.features.fit import FeatureFitter
from ..inverse.features.synthetic import SampledScan, SyntheticScan, known_noise
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import unit_of, without_unit
from . import _facts
from ._features import of_feature, sample_rate
from ._statistics import wilson
from .estimates import Variables
from .monte_carlo import simulate_and_fit

NOTHING = "nothing"

Ranges = Mapping[str, tuple[float, float]]


class DrawnFeature(NamedTuple):
    """A feature, and the ranges from which each parameter is drawn."""

    feature: Feature
    ranges: Ranges

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Parameters of either sign."""
        own = {part: float(rng.uniform(*pair)) for part, pair in self.ranges.items()}
        size = self.feature.amplitude
        return own | {size: float(rng.choice([-1.0, 1.0])) * own[size]}


class NoisySignal(NamedTuple):
    """One draw: the signal with noise, and the noise as the fit takes it."""

    y: Float[np.ndarray, "e sample"]
    noise: Any


def run(cfg: config.Config) -> Result:
    """The job: draw, fit every candidate, count."""
    with config.precision(cfg):
        given = cfg["ranking"]
        draws = whole("ranking.draws", given["draws"], "a whole number from 1", least=1)
        features = config.features(cfg)
        refuse(len(features) < 2, "A ranking needs candidates: name at least two in feature=[...].")
        parts = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
        sampled = SampledScan("ranking", sample_rate("ranking", given), *parts)
        on = SyntheticScan.along(config.line(cfg), sampled)
        drawn = {
            name: DrawnFeature(feature, _ranges(given["truth_ranges"], name, feature))
            for name, feature in features.items()
        }
        fitter, seed = FeatureFitter.along(on.sensor, on.motion, config.solver(cfg)), cfg["seed"]
        rng = np.random.default_rng(config.seed(cfg))
        truths = {name: [each.draw(rng) for _ in range(draws)] for name, each in drawn.items()}
        candidates = [*({name: feature} for name, feature in features.items()), {}]
        answers = simulate_and_fit(
            _problems(on, features, truths, config.random_key(cfg)),
            {f"Fits of {len(candidates)} candidates": lambda p: fitter.rank(candidates, *p)},
            shape=(len(candidates), draws),
        )
        evidence = answers.each(lambda fits: [fit.log_evidence for fit in fits])[0]
    times = {"first_call_s": answers.first_call_s[0], "steady_call_s": answers.steady_call_s[0]}
    facts = {
        **_facts.of_scan(on, cfg["noise"]),
        "precision_and_seed": f"{cfg['precision']}, {seed}",
        "fit_cells": fitter.model.line.n,
    }
    data = _dataset([*features, NOTHING], evidence, times, truths, facts)
    right = data["chosen"].values.diagonal()
    title = (
        f"The true feature is identified in {right[:-1].sum()} of {draws * len(features)} draws, "
        f"noise alone in {right[-1]} of {draws}"
    )
    return Result(title, data, sections("ranking", "assumed_scan"))


def _ranges(given: Any, name: str, feature: Feature) -> Ranges:
    """Ranges from which each parameter is drawn."""
    ranges: dict[str, tuple[float, float]] = {}
    for part, pair in of_feature("ranking.truth_ranges", given, name, feature).items():
        is_pair = isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_number, pair))
        if not is_pair or pair[0] > pair[1]:
            raise BadInput(
                f"ranking.truth_ranges.{name}.{part} is {echo(pair)}: give [least, greatest] in "
                "SI units."
            )
        ranges[part] = float(pair[0]), float(pair[1])
    least = ranges[feature.amplitude][0]
    refuse(
        not least > 0,
        f"ranking.truth_ranges.{name}.{feature.amplitude} begins at {least}: give "
        "sizes above 0, as draws have either sign.",
    )
    refuse(
        feature.friction is not None,
        f"feature.{name}.friction is {feature.friction}, but ranking draws the "
        f"friction: give feature.{name}.friction=null.",
    )
    return ranges


def _problems(
    on: SyntheticScan,
    features: Mapping[str, Feature],
    truths: Mapping[str, Sequence[Mapping[str, float]]],
    key: jax.Array,
) -> list[NoisySignal]:
    """The draws of every feature, and as many of noise alone: as strong as beside the first
    feature, as its level does not matter."""
    first, draws = next(iter(features)), len(next(iter(truths.values())))
    keys = jax.random.split(key, (len(features) + 1, draws))
    problems = []
    for name, own in zip((*features, NOTHING), keys, strict=True):
        source, amount = (first, 0.0) if name == NOTHING else (name, 1.0)
        for truth, each in zip(truths[source], own, strict=True):
            clean = on.signal(source, features[source], truth)
            power = on.power(clean)
            y = on.noise(each, power, 1)[0] + amount * clean
            problems.append(NoisySignal(y, known_noise(power)))
    return problems


# --- numbers ---------------------------------------------------------------------------------


def chosen(
    log_evidence: Float[np.ndarray, "truth draw candidate"],
) -> Int[np.ndarray, "truth candidate"]:
    """Number of draws in which each candidate is the most probable."""
    best, size = log_evidence.argmax(axis=-1), log_evidence.shape[-1]
    return np.array([np.bincount(row, minlength=size) for row in best])


def margins(
    log_evidence: Float[np.ndarray, "truth draw truth"],
) -> Float[np.ndarray, "truth draw"]:
    """The log evidence of the true candidate, less that of the best other."""
    size = log_evidence.shape[-1]
    own = np.arange(size)
    others = np.where(np.eye(size, dtype=bool)[:, None], -np.inf, log_evidence)
    return log_evidence[own, :, own] - others.max(axis=-1)


def _dataset(
    names: list[str],
    evidence: Float[np.ndarray, "truth draw candidate"],
    times: Mapping[str, float],
    truths: Mapping[str, Sequence[Mapping[str, float]]],
    facts: Mapping[str, Any],
) -> xarray.Dataset:
    draws, counts, margin = evidence.shape[1], chosen(evidence), margins(evidence)
    right, total = counts.diagonal(), draws * (len(names) - 1)
    ends = np.array([wilson(int(each), draws) for each in right])
    drawn = {
        f"{name}_{part}": np.array([own[part] for own in rows])
        for name, rows in truths.items()
        for part in rows[0]
    }
    (low, high), each = wilson(int(right[:-1].sum()), total), "truth"
    variables: Variables = {
        "log_evidence": ((each, "draw", "candidate"), evidence, "1"),
        "chosen": ((each, "candidate"), counts, "1"),
        "margin": ((each, "draw"), margin, "1"),
        "fraction": (each, right / draws, "1", "{truth!s}_fraction_right"),
        "fraction_low": (each, ends[:, 0], "1", "{truth!s}_fraction_right_low_90"),
        "fraction_high": (each, ends[:, 1], "1", "{truth!s}_fraction_right_high_90"),
        "margin_mean": (each, margin.mean(axis=1), "1", "{truth!s}_margin_mean"),
        "margin_least": (each, margin.min(axis=1), "1", "{truth!s}_margin_least"),
        **{name: ("draw", values, unit_of(name)) for name, values in drawn.items()},
        "drawn_least": ("drawn", [values.min() for values in drawn.values()], "SI"),
        "drawn_greatest": ("drawn", [values.max() for values in drawn.values()], "SI"),
        **scalars({
            "draws": draws, "fraction_right": right[:-1].sum() / total,
            "fraction_right_low_90": low, "fraction_right_high_90": high, **times,
        }),
    }  # fmt: skip
    coordinates = {
        "truth": (names, "1"),
        "candidate": (names, "1"),
        "drawn": ([without_unit(name) for name in drawn], "1"),
        "unit": ("drawn", [unit_of(name) for name in drawn], "1"),
    }
    return dataset(variables, coordinates, **facts)
