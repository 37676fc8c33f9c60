"""Model selection: random features and noise alone, each fitted by every candidate.

Every draw has its own shape, sign, friction and noise, simulated on finer cells. All the named
features, and "nothing there", are fitted to it and ranked by their evidence.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray
from jaxtyping import Float, Int
from scipy.stats import binomtest

from .. import config
from ..errors import BadInput, is_number, refuse, shown, whole
from ..forward.feature import Feature
from ..inverse.features.fit import FeatureFitter
from ..progress import stage
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from .simulated_features import (
    SampledScan,
    SyntheticTractionScan,
    known_noise,
    named,
    parameters,
    sample_rate,
    synthetic_scan,
    unit_of,
)

NOTHING = "nothing"

Ranges = dict[str, tuple[float, float]]


class DrawnFeature(NamedTuple):
    """A feature, and the ranges from which each parameter is drawn."""

    feature: Feature
    ranges: Ranges

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Parameters of either sign."""
        own = {part: float(rng.uniform(*pair)) for part, pair in self.ranges.items()}
        size = self.feature.amplitude
        return own | {size: float(rng.choice([-1.0, 1.0])) * own[size]}


@dataclass(frozen=True)
class Ranked:
    """Log evidence of every candidate (c,) for the draws of every truth (t,), and the time taken.

    Truths are the candidates, "nothing" the last of both.
    """

    candidates: tuple[str, ...]
    log_evidence: Float[np.ndarray, "t draw c"]
    truths: dict[str, dict[str, np.ndarray]]
    time_s: Float[np.ndarray, "t draw"]

    @property
    def chosen(self) -> Int[np.ndarray, "t c"]:
        """Number of draws in which each candidate is the most probable."""
        best = self.log_evidence.argmax(axis=-1)
        return np.array([np.bincount(row, minlength=len(self.candidates)) for row in best])

    @property
    def margin(self) -> Float[np.ndarray, "t draw"]:
        """The log evidence of the true candidate, less that of the best other."""
        size = len(self.candidates)
        own = np.arange(size)
        true = self.log_evidence[own, :, own]
        others = np.where(np.eye(size, dtype=bool)[:, None], -np.inf, self.log_evidence)
        return true - others.max(axis=-1)

    @property
    def right(self) -> Int[np.ndarray, " t"]:
        """Number of draws of each truth in which it was chosen."""
        return np.diagonal(self.chosen)


def run(cfg: config.Config) -> Outcome:
    """The job: draw, fit every candidate, count."""
    with config.precision(cfg):
        given = cfg["ranking"]
        draws = whole("ranking.draws", given["draws"], "a whole number from 1", least=1)
        features = config.features(cfg)
        refuse(len(features) < 2, "A ranking needs candidates: name at least two in feature=[...].")
        parts = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
        sampled = SampledScan("ranking", sample_rate("ranking", given), *parts)
        on = synthetic_scan(config.line(cfg), sampled)
        drawn = {
            name: DrawnFeature(feature, _ranges(given["truth_ranges"], name, feature))
            for name, feature in features.items()
        }
        fitter = FeatureFitter.along(on.sensor, on.motion, config.solver(cfg))
        ranking = _ranked(on, fitter, drawn, draws, config.seed(cfg))
    assumed = (
        *_assumed(on, ", ".join(cfg["noise"])),
        ("precision, seed", f"{cfg['precision']}, {cfg['seed']}"),
    )
    right, total = int(ranking.right[:-1].sum()), draws * len(features)
    data, table = _dataset(ranking), _table(ranking)
    return Outcome(
        f"The right feature in {right} of {total} draws, nothing in {ranking.right[-1]} of {draws} "
        "of noise",
        _metrics(ranking),
        data,
        _sections(ranking, data, table, assumed),
        table,
    )


def wilson(right: int, total: int) -> tuple[float, float]:
    """Wilson's central 90 % interval of a proportion (1927)."""
    interval = binomtest(right, total).proportion_ci(0.9, "wilson")
    return float(interval.low), float(interval.high)


def _ranges(given: Any, name: str, feature: Feature) -> Ranges:
    """Ranges from which each parameter is drawn."""
    ranges: Ranges = {}
    for part, pair in named("ranking.truth_ranges", given, name, feature).items():
        is_pair = isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_number, pair))
        if not is_pair or pair[0] > pair[1]:
            raise BadInput(
                f"ranking.truth_ranges.{name}.{part} is {shown(pair)}: give [least, greatest] in "
                "SI units."
            )
        ranges[part] = float(pair[0]), float(pair[1])
    least = ranges[feature.amplitude][0]
    refuse(
        not least > 0,
        f"ranking.truth_ranges.{name}.{feature.amplitude} begins at {least}: give sizes above 0, "
        "either sign is drawn.",
    )
    refuse(
        feature.friction is not None,
        f"feature.{name}.friction is {feature.friction}, but ranking draws the friction: leave it "
        "null.",
    )
    return ranges


def _ranked(
    on: SyntheticTractionScan,
    fitter: FeatureFitter,
    drawn: Mapping[str, DrawnFeature],
    draws: int,
    seed: int,
) -> Ranked:
    candidates = {name: {name: each.feature} for name, each in drawn.items()} | {NOTHING: {}}
    rng = np.random.default_rng(seed)
    keys = jax.random.split(jax.random.key(seed), (len(candidates), draws))
    truths = {name: [each.draw(rng) for _ in range(draws)] for name, each in drawn.items()}
    first = next(iter(drawn))
    evidence = np.zeros((len(candidates), draws, len(candidates)))
    time_s = np.zeros((len(candidates), draws))
    for t, truth in enumerate(candidates):
        with stage(f"ranking {draws} draws of {truth}"):
            for i in range(draws):
                # Noise alone is as strong as beside the first feature; its level does not matter.
                source = first if truth == NOTHING else truth
                feature = drawn[source].feature
                clean = on.signal(source, feature, parameters(feature, truths[source][i]))
                power = on.power(float(np.sqrt(np.mean(clean**2))))
                y = on.noise(keys[t, i], power, 1)[0] + (truth != NOTHING) * clean
                begun = time.perf_counter()
                noise = known_noise(power)
                fits = fitter.rank(list(candidates.values()), y, noise)
                evidence[t, i] = [fit.log_evidence for fit in fits]
                time_s[t, i] = time.perf_counter() - begun
    columns = {
        name: {part: np.array([own[part] for own in rows]) for part in rows[0]}
        for name, rows in truths.items()
    }
    return Ranked(tuple(candidates), evidence, columns, time_s)


# --- the page --------------------------------------------------------------------------------


def _metrics(ranking: Ranked) -> dict[str, Any]:
    draws = ranking.margin.shape[1]
    features = int(ranking.right[:-1].sum()), draws * (len(ranking.candidates) - 1)
    metrics: dict[str, Any] = {"draws": draws, "fraction_right": features[0] / features[1]}
    metrics["fraction_right_low_90"], metrics["fraction_right_high_90"] = wilson(*features)
    for name, right, margin in zip(ranking.candidates, ranking.right, ranking.margin, strict=True):
        low, high = wilson(int(right), draws)
        metrics |= {
            f"{name}_fraction_right": float(right) / draws,
            f"{name}_fraction_right_low_90": low,
            f"{name}_fraction_right_high_90": high,
            f"{name}_margin_mean": float(margin.mean()),
            f"{name}_margin_least": float(margin.min()),
        }
    steady = ranking.time_s.ravel()[1:] if ranking.time_s.size > 1 else ranking.time_s.ravel()
    metrics["first_call_s"] = float(ranking.time_s[0, 0])
    metrics["steady_call_s"] = float(np.median(steady))
    return metrics


def _dataset(ranking: Ranked) -> xarray.Dataset:
    one, names = {"units": "1"}, list(ranking.candidates)
    variables: dict[str, Any] = {
        "log_evidence": (("truth", "draw", "candidate"), ranking.log_evidence, one),
        "chosen": (("truth", "candidate"), ranking.chosen, one),
        "margin": (("truth", "draw"), ranking.margin, one),
    }
    for name, columns in ranking.truths.items():
        for part, values in columns.items():
            variables[f"{name}_{part}"] = ("draw", values, {"units": unit_of(part)})
    return xarray.Dataset(
        variables,
        {"truth": ("truth", names, one), "candidate": ("candidate", names, one)},
        {"title": "Ranking of features by evidence"},
    )


def _table(ranking: Ranked) -> Table:
    draws = ranking.margin.shape[1]
    rows = []
    for name, right, margin in zip(ranking.candidates, ranking.right, ranking.margin, strict=True):
        low, high = (100 * end for end in wilson(int(right), draws))
        rows.append(
            (name.replace("_", " "), int(right), draws, round(100 * right / draws, 1),
             f"{low:.1f} to {high:.1f}", float(margin.mean()), float(margin.min()))
        )  # fmt: skip
    return Table(
        ("there", "chosen", "of draws", "share [%]", "90 % interval [%]",
         "mean log evidence margin", "least"),
        tuple(rows),
    )  # fmt: skip


def _assumed(on: SyntheticTractionScan, noises: str) -> tuple[tuple[str, str], ...]:
    elements, samples = on.shape
    return (
        ("scan", f"{samples} samples of {elements} elements at "
         f"{float(on.scan.speed_m_per_s):.4g} m/s"),
        ("noise", f"{noises}, its spectrum known to the fit"),
    )  # fmt: skip


def _sections(
    ranking: Ranked, data: xarray.Dataset, table: Table, assumed: tuple[tuple[str, str], ...]
) -> tuple[Section, ...]:
    drawn = tuple(
        (name.replace("_", " "), ", ".join(
            f"{part} {values.min():.3g} to {values.max():.3g}" for part, values in columns.items()))
        for name, columns in ranking.truths.items()
    )  # fmt: skip
    return (
        Section(
            "What was chosen",
            (
                "Every candidate is fitted to every draw, and the one of the greatest evidence is "
                "chosen: the probability of the data with all parameters integrated out, the same "
                "rule for the priors of all.",
            ),
            {
                "confusion": lambda: figures.confusion(data),
                "evidence_margins": lambda: figures.evidence_margins(data),
            },
            tables=(table,),
        ),
        Section("What was drawn", tables=(Table(("feature", "from and to"), drawn),)),
        Section("What was assumed", tables=(Table(("what", "value"), assumed),)),
    )  # fmt: skip
