"""Features fitted to a signal: which, where, how wide, how strong, with what friction.

The shape is searched from many starts; amplitudes of p and of q enter linearly and are solved out.
Friction is their ratio. Candidates are ranked by their evidence, the probability of the data under
each with all its parameters integrated out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import softmax

from ..forward.feature import Feature, Stretch
from ..forward.scan import Motion
from ..forward.scanned import Scanned
from ..forward.sensor import Sensor
from ..grid import Line, Open, as_real
from .nonlinear import Fit, Solver, fit, fit_many, whitener

CELLS_PER_DEPTH = 32  # the signal of an edge is then right to 1e-6 of its peak, of a line to 1e-5
MARGIN_DEPTHS = 16  # beyond the scan, in which what repeats fades out
COARSE_PER_DEPTH = 8  # cells and samples of the search for a start
STARTS = 3  # the best of the search that are fitted from
ENOUGH = 2.0  # standard deviations of chi squared up to which data count as explained
LEAST_SHARE = 1e-6  # of the strongest signal: what is felt less is not felt
FAR_M = 1e3  # how far a step goes on
# Prior standard deviation of an amplitude: the one whose signal is so many times the largest datum.
# Wide enough not to pull. The same rule for every candidate and every shape: one for the pressure
# itself would favour shapes that the film hardly feels, as these take any pressure.
BEYOND_DATA = 30.0

Features = Mapping[str, Feature]


class Felt(eqx.Module):
    """A sensor along a motion, on the open line that features' traction lies on.

    `scanned` maps traction on `line` to the signal; `tail` (e, c, sample) is the signal of unit
    traction on everything beyond the line's end, for what continues; `fade` (n,) takes out what
    repeats towards the line's ends. With `free_offset` each element has an unknown constant.
    """

    scanned: Scanned
    tail: Float[Array, "e c sample"]
    fade: Float[Array, " n"]
    line: Line
    direction: Float[Array, " sample"]
    reverses: bool = eqx.field(static=True)
    free_offset: bool = eqx.field(static=True)

    def __init__(self, sensor: Sensor, motion: Motion, cells_per_depth: int = CELLS_PER_DEPTH):
        self.line = line_under(sensor, motion, cells_per_depth)
        self.scanned, self.tail, self.fade = _responding(sensor, motion, self.line)
        self.direction = motion.direction
        self.reverses = bool(motion.reverses)
        self.free_offset = sensor.amplifier.offset is None


@eqx.filter_jit
def _responding(sensor: Sensor, motion: Motion, line: Line):
    return sensor.scanned(line, motion), sensor.beyond(line, motion, FAR_M), _fade(line, motion)


class FeatureModel(eqx.Module):
    """The signal of features as `felt`: parameters by feature to (element, sample)."""

    felt: Felt
    features: dict[str, Feature]

    def __init__(self, felt: Felt, features: Features):
        self.felt, self.features = felt, dict(features)

    @property
    def line(self) -> Line:
        """Where the traction lies."""
        return self.felt.line

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        named = [f"{n}.{part}" for n, f in self.features.items() for part in f.linear]
        return (*named, "offset") if self.felt.free_offset else tuple(named)

    def traction(self, params: Any) -> Float[Array, "2 n"]:
        """p and q [Pa] on the line while sliding towards +x."""
        total = jnp.zeros((2, self.line.n))
        for name, feature in self.features.items():
            shape = feature.profile(params[name]).shares(self.line)
            shape = shape * self.felt.fade if feature.repeats else shape
            total = total + jnp.stack(amplitudes(feature, params[name]))[:, None] * shape[None]
        return total

    @eqx.filter_jit
    def __call__(self, params: Any) -> Float[Array, "e sample"]:
        felt, forward = self.felt, self.traction(params)
        turn = jnp.array([[1.0], [-1.0]])
        if felt.reverses:
            signal = felt.scanned(forward, turn * forward)
        else:
            signal = felt.scanned(jnp.where(felt.direction[0] < 0, turn, 1.0) * forward)
        for name, feature in self.features.items():
            if feature.continues:
                p, q = amplitudes(feature, params[name])
                signal = signal + p * felt.tail[:, 0] + q * felt.direction[None] * felt.tail[:, 1]
        return signal + params["offset"][:, None] if felt.free_offset else signal


def amplitudes(feature: Feature, own: Mapping[str, Any]) -> tuple[Array, Array]:
    """Of p and of q."""
    p = jnp.asarray(own[feature.amplitude])
    q = own[feature.shear] if feature.friction is None else feature.friction * p
    return p, jnp.asarray(q)


def line_under(sensor: Sensor, motion: Motion, cells_per_depth: int) -> Open:
    """The open line that the features' traction lies on: fine cells, and a margin at both ends."""
    depth = float(sensor.depth_m)
    x = np.asarray(motion.position_m)
    cell = depth / cells_per_depth
    start = float(x.min()) - MARGIN_DEPTHS * depth
    n = int(np.ceil((float(x.max()) + MARGIN_DEPTHS * depth - start) / cell)) + 1
    return Open(n, cell, start)


def _fade(line: Line, motion: Motion) -> Float[Array, " n"]:
    """One over the scan and half its margins, falling to zero at the line's ends as a cosine."""
    x, low, high = line.x, jnp.min(motion.position_m), jnp.max(motion.position_m)
    beyond = jnp.maximum(low - x, x - high) / jnp.maximum(low - line.x[0], line.cell_m)
    return 0.5 * (1 + jnp.cos(jnp.pi * jnp.clip(2 * beyond - 1, 0.0, 1.0)))


@dataclass(frozen=True)
class FeatureFit:
    """A candidate fitted.

    - `features`: by name; none for "nothing there". `fit`: the fit below, None where there was
      nothing to fit. `model`: parameters to signal and traction.
    - `parameters`: what a user reads, (value, standard error) by name: the shape, the amplitude and
      the friction of each feature; names begin with the feature's where there are several.
    - `log_evidence`: log probability density of the data under the candidate.
    """

    features: dict[str, Feature]
    fit: Fit | None
    model: FeatureModel
    parameters: dict[str, tuple[float, float]]
    log_evidence: float

    @property
    def name(self) -> str:
        """The features' names, joined."""
        return " + ".join(self.features) or "nothing"

    @property
    def result(self) -> str:
        """Whether the fit is an answer: "converged", or what went wrong."""
        return "converged" if self.fit is None else self.fit.result

    @property
    def explains(self) -> bool:
        """Whether features leave no more of the data than the noise."""
        return self.fit is not None and explains(self.fit)

    def signal(self) -> Float[np.ndarray, "e sample"]:
        """The fitted signal."""
        value = {} if self.fit is None else self.fit.value
        return np.asarray(self.model(jax.tree.map(as_real, value)))


class FeatureFitter:
    """Fits features to signals of one sensor along one motion.

    What does not depend on the signal is computed once, and the programs compiled for the first
    signal serve all.
    """

    def __init__(self, sensor: Sensor, motion: Motion, solver: Solver | None = None):
        self._felt, self._coarse = Felt(sensor, motion), _Coarse(sensor, motion)
        self._solver = solver

    def rank(
        self, candidates: Sequence[Features], y: Float[np.ndarray, "e sample"], noise: Any
    ) -> list[FeatureFit]:
        """Every candidate fitted, for its evidence.

        All are fitted from their best start, and only where none explains the data to the noise
        from the others too.
        """
        fits = [self(features, y, noise, starts=1) for features in candidates]
        if any(found.explains for found in fits):
            return fits
        return [self(features, y, noise) for features in candidates]

    def __call__(
        self,
        features: Features,
        y: Float[np.ndarray, "e sample"],
        noise: Any,
        starts: int = STARTS,
    ) -> FeatureFit:
        """As [`fit_features`][], from so many of the best starts of each feature."""
        y = np.asarray(y, float)
        parts: dict[str, Feature] = {}
        found, priors = self._offset(y)
        result, model = None, FeatureModel(self._felt, parts)
        if found and not features:
            result = fit(model, found, y, noise=noise, linear=model.linear, priors=priors)
        for name, feature in features.items():
            shapes, more = self._starts(y, parts, found, name, feature)
            parts, priors = parts | {name: feature}, priors | more
            model = FeatureModel(self._felt, parts)
            settings = self._settings(model, noise, priors)
            first = [found | {name: shape} for shape in shapes[:starts]]
            result = _best(model, first, y, settings)
            found = dict(result.value)
        read = {} if result is None else readable(model, result)
        evidence = self._evidence(y, noise, parts, result)
        return FeatureFit(parts, result, model, read, evidence)

    def _evidence(self, y: np.ndarray, noise: Any, features: Features, result: Fit | None) -> float:
        """Log evidence, each amplitude's prior that of the shape found.

        The fit had the one of the shape felt most; both are too wide to move it.
        """
        if result is None:
            return log_density(y, noise)
        if result.log_evidence is None:
            return -np.inf
        shares = (self._coarse.share(f, result.value[name]) for name, f in features.items())
        return float(result.log_evidence + sum(np.log(share).sum() for share in shares))

    def many(
        self, name: str, feature: Feature, ys: Float[np.ndarray, "draw e sample"], noise: Any
    ) -> tuple[FeatureModel, list[Fit]]:
        """One feature fitted to many signals of the same scene.

        All start from where the search finds it in the first signal.
        """
        found, priors = self._offset(ys[0])
        shapes, more = self._starts(ys[0], {}, {}, name, feature)
        model = FeatureModel(self._felt, {name: feature})
        settings = self._settings(model, noise, priors | more)
        return model, fit_many(model, found | {name: shapes[0]}, ys, **settings)

    def _offset(self, y: np.ndarray) -> tuple[dict[str, Any], dict[str, tuple[float, float]]]:
        """First value and prior of each element's constant, where it is not known."""
        if not self._felt.free_offset:
            return {}, {}
        return {"offset": np.zeros(len(y))}, {"offset": (0.0, _reach(y))}

    def _starts(self, y, parts: Features, found, name: str, feature: Feature):
        """Parameters of one more feature to start from, and the priors of its amplitudes."""
        shapes, strongest = self._coarse.search(y, parts, found, feature)
        priors = {
            f"{name}.{part}": (0.0, _reach(y) / top if top > 0 else 1.0)
            for part, top in zip(feature.linear, strongest, strict=True)
        }
        return [shape | dict.fromkeys(feature.linear, 0.0) for shape in shapes], priors

    def _settings(self, model: FeatureModel, noise: Any, priors) -> dict[str, Any]:
        return {
            "noise": noise,
            "bounds": _bounds(model.features, self._coarse.stretch),
            "linear": model.linear,
            "priors": priors,
            "solver": self._solver,
        }


def _best(model: FeatureModel, starts: list[dict[str, Any]], y, settings: dict[str, Any]) -> Fit:
    """From the starts in order, until one explains the data to the noise."""
    ends: list[Fit] = []
    for start in starts:
        ends.append(fit(model, start, y, **settings))
        if explains(ends[-1]):
            break
    return min(ends, key=lambda end: end.stats["cost"])


def explains(end: Fit) -> bool:
    """Whether a fit leaves no more of the data than the noise."""
    freedom = end.stats["degrees_of_freedom"]
    small = 2 * end.stats["cost"] <= freedom + ENOUGH * np.sqrt(2 * freedom)
    return bool(end.converged and small)


def fit_features(
    sensor: Sensor,
    motion: Motion,
    features: Features,
    y: Float[np.ndarray, "e sample"],
    noise: Any,
    solver: Solver | None = None,
) -> FeatureFit:
    """The features' parameters under which they explain `y` (element, sample) best.

    - `noise`: as [`nonlinear.fit`][] takes it, and known.
    - Features of a sum are found one after the other, each beside those found before, and then
      fitted together. No feature at all is a candidate too.

    For several candidates or signals a [`FeatureFitter`][] is faster. Raises `BadInput` where the
    data and the motion disagree.
    """
    return FeatureFitter(sensor, motion, solver)(features, y, noise)


def _bounds(parts: Features, stretch: Stretch) -> dict[str, tuple[float, float]]:
    return {
        f"{name}.{part}": within
        for name, feature in parts.items()
        for part, within in feature.ranges(stretch).items()
    }


def _reach(y) -> float:
    """What a prior amplitude's signal reaches: see `BEYOND_DATA`."""
    largest = float(np.max(np.abs(y[np.isfinite(y)]), initial=0.0))
    return BEYOND_DATA * largest if largest > 0 else 1.0


def stretch_of(sensor: Sensor, motion: Motion) -> Stretch:
    """Where the motion has been."""
    x = np.asarray(motion.position_m)
    return Stretch(float(x.min()), float(x.max()), float(sensor.depth_m))


@dataclass(frozen=True)
class _Bank:
    """Signals of unit amplitudes (start, a, datum) for every shape tried, less each element's mean
    where the offset is free; their Gram matrices (start, a, a), and the largest signal (a,)."""

    tried: dict[str, np.ndarray]
    signals: np.ndarray
    gram: np.ndarray
    strongest: list[float]


class _Coarse:
    """The same signal on coarser samples and cells, for the search of a start."""

    def __init__(self, sensor: Sensor, motion: Motion):
        x = np.asarray(motion.position_m)
        moved = np.abs(np.diff(x))
        typical = float(np.median(moved[moved > 0])) if np.any(moved > 0) else 0.0
        wanted = float(sensor.depth_m) / COARSE_PER_DEPTH
        self.block = int(np.clip(wanted / typical if typical else 1, 1, x.size // 8 or 1))
        columns = (motion.time_s, motion.position_m, motion.speed_m_per_s)
        coarse = Motion(*(self._means(np.asarray(column)) for column in columns))
        self.felt = Felt(sensor, coarse, COARSE_PER_DEPTH)
        self.stretch = stretch_of(sensor, motion)
        self._banks: dict[Feature, _Bank] = {}

    def _means(self, values: np.ndarray) -> np.ndarray:
        kept = values.shape[-1] // self.block * self.block
        return values[..., :kept].reshape(*values.shape[:-1], -1, self.block).mean(axis=-1)

    def search(
        self, y: np.ndarray, parts: Features, found, feature: Feature
    ) -> tuple[list[dict[str, float]], list[float]]:
        """The shapes of one more feature to start from, the best first, and the strongest signal of
        each of its unit amplitudes over all shapes tried.

        A bank of matched filters: for each shape tried, how much of what the features found so far
        leave (their shape and amplitudes kept) its best amplitudes explain.
        """
        rest = self._means(np.nan_to_num(y))
        if parts:
            rest = rest - np.asarray(FeatureModel(self.felt, parts)(found))
        bank = self._known(feature)
        told = bank.signals @ self._centred(rest).ravel()
        explained = np.sum(told * np.linalg.solve(bank.gram, told[..., None])[..., 0], axis=-1)
        return _apart(bank.tried, explained), bank.strongest

    def share(self, feature: Feature, own: Mapping[str, Any]) -> Float[np.ndarray, " a"]:
        """How strong the signal of each unit amplitude is, beside that of the shape felt most."""
        signals = self._responses(feature, {part: [own[part]] for part in feature.axes})
        felt = np.abs(signals).max(axis=(0, 2, 3))
        top = np.asarray(self._known(feature).strongest)
        return np.maximum(felt / np.where(top > 0, top, 1.0), LEAST_SHARE)

    def _known(self, feature: Feature) -> _Bank:
        if feature not in self._banks:
            self._banks[feature] = self._bank(feature)
        return self._banks[feature]

    def _responses(self, feature: Feature, shapes: Mapping[str, Any]) -> np.ndarray:
        model = FeatureModel(self.felt, {"one": feature})
        return np.asarray(_responses(model, {k: as_real(v) for k, v in shapes.items()}))

    def _bank(self, feature: Feature) -> _Bank:
        tried = feature.starts(self.stretch)
        signals = self._responses(feature, tried)
        strongest = np.abs(signals).max(axis=(0, 2, 3)).tolist()
        signals = self._centred(signals).reshape(*signals.shape[:2], -1)
        gram = signals @ signals.swapaxes(1, 2)
        # Faintly damped, for shapes that the film hardly feels.
        gram = gram + 1e-9 * np.trace(gram.mean(axis=0)) * np.eye(gram.shape[-1]) + 1e-300
        return _Bank(tried, signals, gram, strongest)

    def _centred(self, signals: np.ndarray) -> np.ndarray:
        """Less each element's mean, where its offset is free."""
        return signals - self.felt.free_offset * signals.mean(axis=-1, keepdims=True)


@eqx.filter_jit
def _responses(model: FeatureModel, shapes) -> Float[Array, "start a e sample"]:
    """Signals of every unit amplitude of the model's only feature, for each shape."""
    ((name, feature),) = model.features.items()
    elements = model.felt.tail.shape[0]
    rest = {"offset": jnp.zeros(elements)} if model.felt.free_offset else {}

    def of(shape, one: str):
        own = {part: as_real(float(part == one)) for part in feature.linear}
        return model({name: shape | own} | rest)

    def at(shape):
        return jnp.stack([of(shape, one) for one in feature.linear])

    return jax.lax.map(at, shapes, batch_size=64)


def _apart(tried: dict[str, np.ndarray], explained: np.ndarray) -> list[dict[str, float]]:
    """The best shapes tried that are not neighbours on the grid."""
    places = np.stack([np.unique(v, return_inverse=True)[1] for v in tried.values()], axis=1)
    chosen: list[int] = []
    for at in np.argsort(-explained):
        near = [np.abs(places[at] - places[other]).max() <= 1 for other in chosen]
        if not any(near):
            chosen.append(int(at))
        if len(chosen) == STARTS:
            break
    return [{part: float(values[at]) for part, values in tried.items()} for at in chosen]


def readable(model: FeatureModel, result: Fit) -> dict[str, tuple[float, float]]:
    """Each parameter as a user reads it."""
    read: dict[str, tuple[float, float]] = {}
    for name, feature in model.features.items():
        prefix = f"{name}_" if len(model.features) > 1 else ""
        own, spread = result.value[name], result.stderr[name]
        listed = {part: float(own[part]) for part in (*feature.axes, feature.amplitude)}
        for part, value in feature.plain(listed).items():
            read[prefix + part] = value, float(spread[part])
        if feature.friction is None and own[feature.amplitude] != 0:
            read[f"{prefix}friction"] = friction_of(result, name, feature)
    return read


def friction_of(result: Fit, name: str, feature: Feature) -> tuple[float, float]:
    """mu, the ratio of the two amplitudes, and its standard error to first order."""
    value, stderr = result.derive(
        lambda params: params[name][feature.shear] / params[name][feature.amplitude]
    )
    return float(value), float(stderr)


def traction_band(found: FeatureFit) -> tuple[np.ndarray, np.ndarray]:
    """p and q (2, n) [Pa] on the model's line while sliding towards +x, and their standard error
    to first order."""
    n = found.model.line.n
    if found.fit is None:
        return np.zeros((2, n)), np.zeros((2, n))
    value, stderr = found.fit.derive(lambda params: jnp.ravel(found.model.traction(params)))
    return value.reshape(2, n), stderr.reshape(2, n)


def log_density(y, noise: Any) -> float:
    """The log probability density of data that are noise alone."""
    data = np.asarray(y, float)
    white, seen = whitener(noise, data.shape)
    rest = np.asarray(white(as_real(np.where(seen, data, 0.0))))
    volume = white.log_volume(data.shape) + white.count(data.shape) / 2 * np.log(2 * np.pi)
    return float(-0.5 * rest @ rest - volume)


def probabilities(candidates: Sequence[FeatureFit]) -> np.ndarray:
    """Of each candidate (c,), all taken as equally probable beforehand."""
    return np.asarray(softmax([candidate.log_evidence for candidate in candidates]))
