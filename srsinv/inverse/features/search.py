"""Start values of a fit of features: banks of matched filters on coarser samples."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ...forward.feature import ScanExtent
from ...forward.scan import Motion
from ...grid import as_real
from .direct import responses
from .loading import AnyFeature, Tried
from .model import FeatureModel

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


class FeatureSearch:
    """The best shapes of a feature to start from, by a coarse model along the means of `blocks`."""

    def __init__(self, coarse: FeatureModel, blocks: Blocks, stretch: ScanExtent):
        self._model, self._blocks, self._stretch = coarse, blocks, stretch
        self._known: dict[AnyFeature, list[Tried]] = {}
        self._strongest: dict[AnyFeature, list[float]] = {}

    def starts(
        self,
        y: Float[np.ndarray, "e sample"],
        white: Float[np.ndarray, " e"],
        before: tuple[Mapping[str, AnyFeature], Any],
        feature: AnyFeature,
        given: Mapping[str, float],
    ) -> list[dict[str, float]]:
        """The shapes of one more feature to start from, the best first.

        - `white`: the level of white noise in each element, by which they are weighed.
        - `before`: features found before, and all of their parameters.
        - `given`: the user's values of some of the feature's parameters, or of all of them.

        For each shape tried, the part of the residual of the features found so far (their shape and
        amplitudes fixed) that its best linear parameters explain.
        """
        rest = self._blocks.means(np.nan_to_num(y))
        if before[0]:
            rest = rest - np.asarray(self._model.with_features(before[0])(before[1]))
        rest = self._without_mean(rest / white[:, None])
        shapes, explained = [], []
        for tried in self._tried(feature, given):
            shapes.append(tried.shapes)
            explained.append(self._explained(rest, white, tried))
        columns = {name: np.concatenate([each[name] for each in shapes]) for name in feature.axes}
        chosen = apart(list(columns.values()), np.concatenate(explained))
        return [{name: float(column[at]) for name, column in columns.items()} for at in chosen]

    def strongest(self, feature: AnyFeature) -> list[float]:
        """The strongest signal of each of its unit linear parameters over all shapes tried."""
        if feature not in self._strongest:
            peaks = [np.abs(part.signals).max(axis=(0, 2, 3)) for part in self._tried(feature, {})]
            self._strongest[feature] = np.max(peaks, axis=0).tolist()
        return self._strongest[feature]

    def relative_signal(
        self, feature: AnyFeature, own: Mapping[str, Any]
    ) -> Float[np.ndarray, " a"]:
        """Signal of each unit amplitude, relative to the shape with the strongest signal."""
        shape = {part: as_real([own[part]]) for part in feature.axes}
        signals = np.asarray(responses(self._model.with_features({"one": feature}), shape))
        peak = np.abs(signals).max(axis=(0, 2, 3))
        top = np.asarray(self.strongest(feature))
        return np.maximum(peak / np.where(top > 0, top, 1.0), LEAST_RELATIVE_SIGNAL)

    def _tried(self, feature: AnyFeature, given: Mapping[str, float]) -> Iterable[Tried]:
        loading = self._model.loading
        if not loading.ARE_FEW:
            return loading.tried(self._model, feature, self._stretch, given)
        if feature not in self._known:
            tried = loading.tried(self._model, feature, self._stretch, given)
            self._known[feature] = list(tried)
        return self._known[feature]

    def _explained(
        self, rest: Float[np.ndarray, "e sample"], white: Float[np.ndarray, " e"], tried: Tried
    ) -> Float[np.ndarray, " start"]:
        """Reduction of the squares of the residual `rest` by the best linear parameters."""
        basis = self._without_mean(tried.signals / white[:, None])
        basis = basis.reshape(*basis.shape[:2], -1)
        left = (rest - self._without_mean(tried.fixed / white[:, None])).reshape(-1, rest.size)
        projections = (basis @ left[:, :, None])[..., 0]
        gram = basis @ basis.swapaxes(1, 2)
        # Slightly damped, for shapes with hardly any signal.
        damping = 1e-9 * np.trace(gram.mean(axis=0)) + 1e-300
        gram = gram + damping * np.eye(gram.shape[-1])
        solved = np.linalg.solve(gram, projections[..., None])[..., 0]
        return np.sum(projections * solved, axis=1) - np.sum(left**2, axis=1)

    def _without_mean(self, signals: np.ndarray) -> np.ndarray:
        """Signals less each element's mean, where its offset is free."""
        return signals - self._model.free_offset * signals.mean(axis=-1, keepdims=True)
