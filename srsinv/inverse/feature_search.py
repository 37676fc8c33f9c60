"""Start values of a fit of features: banks of matched filters on coarser samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..forward.feature import Feature
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..grid import as_real
from .feature_model import FeatureModel, Features, scan_extent

COARSE_PER_DEPTH = 8  # cells and samples of the search for a start
STARTS = 3  # the best of the search that are fitted from
LEAST_RELATIVE_SIGNAL = 1e-6  # of the strongest signal: a floor


class Blocks:
    """Means over blocks of samples, about `wanted_m` of the motion each."""

    def __init__(self, motion: Motion, wanted_m: float):
        x = np.asarray(motion.position_m)
        moved = np.abs(np.diff(x))
        typical = float(np.median(moved[moved > 0])) if np.any(moved > 0) else 0.0
        self.size = int(np.clip(wanted_m / typical if typical else 1, 1, x.size // 8 or 1))
        columns = (motion.time_s, motion.position_m, motion.speed_m_per_s)
        self.motion = Motion(*(self.means(np.asarray(column)) for column in columns))

    def means(self, values: np.ndarray) -> np.ndarray:
        """The means along the last axis."""
        used = values.shape[-1] // self.size * self.size
        return values[..., :used].reshape(*values.shape[:-1], -1, self.size).mean(axis=-1)


def apart(tried: Sequence[np.ndarray], explained: np.ndarray) -> list[int]:
    """Indices of the best starts that are not neighbours on their grid, by `tried`'s columns
    (start,)."""
    places = np.stack([np.unique(v, return_inverse=True)[1] for v in tried], axis=1)
    chosen: list[int] = []
    for at in np.argsort(-explained):
        near = [np.abs(places[at] - places[other]).max() <= 1 for other in chosen]
        if not any(near):
            chosen.append(int(at))
        if len(chosen) == STARTS:
            break
    return chosen


@dataclass(frozen=True)
class _MatchedFilterBank:
    """Signals of unit amplitudes (start, a, datum) for every shape tried, less each element's mean
    where the offset is free; their Gram matrices (start, a, a), and the largest signal (a,)."""

    tried: dict[str, np.ndarray]
    signals: np.ndarray
    gram: np.ndarray
    strongest: list[float]


class Coarse:
    """Coarse model: fewer samples and cells, for the search of a start."""

    def __init__(self, sensor: Sensor, motion: Motion):
        self._blocks = Blocks(motion, float(sensor.depth_m) / COARSE_PER_DEPTH)
        self._model = FeatureModel.along(sensor, self._blocks.motion, COARSE_PER_DEPTH)
        self.stretch = scan_extent(sensor, motion)
        self._banks: dict[Feature, _MatchedFilterBank] = {}

    def search(
        self, y: np.ndarray, parts: Features, params, feature: Feature
    ) -> tuple[list[dict[str, float]], list[float]]:
        """The shapes of one more feature to start from, the best first, and the strongest signal of
        each of its unit amplitudes over all shapes tried.

        A bank of matched filters: for each shape tried, the part of the residual of the features
        found so far (their shape and amplitudes fixed) that its best amplitudes explain.
        """
        rest = self._blocks.means(np.nan_to_num(y))
        if parts:
            rest = rest - np.asarray(self._model.with_features(parts)(params))
        bank = self._known(feature)
        projections = bank.signals @ self._without_mean(rest).ravel()
        explained = np.sum(
            projections * np.linalg.solve(bank.gram, projections[..., None])[..., 0], axis=-1
        )
        chosen = apart(list(bank.tried.values()), explained)
        shapes = [{n: float(v[at]) for n, v in bank.tried.items()} for at in chosen]
        return shapes, bank.strongest

    def relative_signal(self, feature: Feature, own: Mapping[str, Any]) -> Float[np.ndarray, " a"]:
        """Signal of each unit amplitude, relative to the shape with the strongest signal."""
        signals = self._responses(feature, {part: [own[part]] for part in feature.axes})
        peak = np.abs(signals).max(axis=(0, 2, 3))
        top = np.asarray(self._known(feature).strongest)
        return np.maximum(peak / np.where(top > 0, top, 1.0), LEAST_RELATIVE_SIGNAL)

    def _known(self, feature: Feature) -> _MatchedFilterBank:
        if feature not in self._banks:
            self._banks[feature] = self._bank(feature)
        return self._banks[feature]

    def _responses(self, feature: Feature, shapes: Mapping[str, Any]) -> np.ndarray:
        model = self._model.with_features({"one": feature})
        return np.asarray(_responses(model, {k: as_real(v) for k, v in shapes.items()}))

    def _bank(self, feature: Feature) -> _MatchedFilterBank:
        tried = feature.starts(self.stretch)
        signals = self._responses(feature, tried)
        strongest = np.abs(signals).max(axis=(0, 2, 3)).tolist()
        signals = self._without_mean(signals).reshape(*signals.shape[:2], -1)
        gram = signals @ signals.swapaxes(1, 2)
        # Slightly damped, for shapes with hardly any signal.
        gram = gram + 1e-9 * np.trace(gram.mean(axis=0)) * np.eye(gram.shape[-1]) + 1e-300
        return _MatchedFilterBank(tried, signals, gram, strongest)

    def _without_mean(self, signals: np.ndarray) -> np.ndarray:
        """Signals less each element's mean, where its offset is free."""
        return signals - self._model.free_offset * signals.mean(axis=-1, keepdims=True)


@eqx.filter_jit
def _responses(model: FeatureModel, shapes) -> Float[Array, "start a e sample"]:
    """Signals of every unit amplitude of the model's only feature, for each shape."""
    ((name, feature),) = model.features.items()
    elements = model.operator.field.transfer.shape[0]
    rest = {"offset": jnp.zeros(elements)} if model.free_offset else {}

    def of(shape, one: str):
        own = {part: as_real(float(part == one)) for part in feature.linear}
        return model({name: shape | own} | rest)

    def at(shape):
        return jnp.stack([of(shape, one) for one in feature.linear])

    return jax.lax.map(at, shapes, batch_size=64)
