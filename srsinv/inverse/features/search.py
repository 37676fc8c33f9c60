"""Start values of a fit of features: banks of matched filters on coarser samples."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...errors import number, refuse
from ...forward.feature import ScanExtent, range_name
from ...forward.scan import Motion
from ...known import Numbers, array_module, is_traced, outside_traces
from .direct import responses
from .loading import AnyFeature, Features, TrialShapes
from .model import FeatureModel

# Prior standard deviation of an amplitude: the one whose signal is this multiple of the largest
# datum. Wide enough not to pull. The same rule for every candidate and every shape: one for the
# pressure itself would favour shapes with hardly any signal, as these take any pressure.
AMPLITUDE_PRIOR_REACH = 30.0
STARTS = 3  # the best of the search that are fitted from
MOST_HELD = 2**26  # numbers of filters in a traced program: half a gigabyte
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

    def means(self, values: Any) -> Any:
        """The means along the last axis."""
        used = values.shape[-1] // self.size * self.size
        return values[..., :used].reshape(*values.shape[:-1], -1, self.size).mean(axis=-1)


def separated(tried: Sequence[np.ndarray], explained: np.ndarray) -> list[int]:
    """Indices of the best starts that are not neighbours on their grid, by `tried`'s columns
    (start,)."""
    places = _places(tried)
    chosen: list[int] = []
    for at in np.argsort(-explained):
        near = [np.abs(places[at] - places[other]).max() <= 1 for other in chosen]
        if not any(near):
            chosen.append(int(at))
        if len(chosen) == STARTS:
            break
    return chosen


def _places(tried: Sequence[np.ndarray]) -> np.ndarray:
    """Where each start is on their grid (start, column)."""
    return np.stack([np.unique(v, return_inverse=True)[1] for v in tried], axis=1)


@dataclass(frozen=True)
class FilterBank:
    """Matched filters of some shapes (start,).

    `basis` (start, a, row): an orthonormal basis of each one's signals, slightly damped where there
    is hardly any; its `fixed` signal (start, row), None for none.
    """

    shapes: Mapping[str, Float[np.ndarray, " start"]]
    basis: Float[np.ndarray, "start a row"]
    fixed: Float[np.ndarray, "start row"] | None

    @classmethod
    def of(
        cls,
        tried: TrialShapes,
        weigh: Callable[[Float[np.ndarray, "..."]], Float[np.ndarray, "..."]],
    ) -> "FilterBank":
        """Those of the shapes tried; `weigh` gives signals in units of the noise."""
        signals = weigh(tried.signals)
        signals = signals.reshape(*signals.shape[:2], -1)
        gram = signals @ signals.swapaxes(1, 2)
        damping = 1e-9 * np.trace(gram.mean(axis=0)) + 1e-300
        root = np.linalg.cholesky(gram + damping * np.eye(gram.shape[-1]))
        fixed = weigh(tried.fixed).reshape(len(gram), -1) if np.any(tried.fixed) else None
        # With the inverse of so small a root, many rows take a fifth of the time of solving.
        return cls(tried.shapes, np.linalg.inv(root) @ signals, fixed)

    def explained(self, rest: Float[Numbers, "b row"]) -> Float[Numbers, "b start"]:
        """Reduction of the squares of each residual by a shape with its best linear parameters,
        less the squares that its fixed signal leaves."""
        (starts, a, rows), xp = self.basis.shape, array_module(rest)
        along = (rest @ self.basis.reshape(-1, rows).T).reshape(-1, starts, a)
        squares = xp.sum(rest**2, axis=1)[:, None]
        if self.fixed is not None:
            along = along - (self.basis @ self.fixed[:, :, None])[..., 0]
            squares = squares - 2 * rest @ self.fixed.T + np.sum(self.fixed**2, axis=1)
        return xp.sum(along**2, axis=2) - squares


class FeatureSearch:
    """The best shapes of a feature to start from, by a coarse model along the means of `blocks`."""

    def __init__(self, coarse: FeatureModel, blocks: Blocks, stretch: ScanExtent):
        self._model, self._blocks, self._stretch = coarse, blocks, stretch
        self._banks: dict[Any, list[FilterBank]] = {}
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
        known = self._blocks.means(np.isfinite(y).astype(float))
        rest = self._blocks.means(np.nan_to_num(y))
        if before[0]:
            rest = rest - known * np.asarray(self._model.with_features(before[0])(before[1]))
        banks = self._filter_banks(feature, white, known, given)
        columns, explained = self._explained(rest[None], white, known, feature, banks)
        chosen = separated(list(columns.values()), explained[0])
        return [{name: float(column[at]) for name, column in columns.items()} for at in chosen]

    def traced(
        self,
        y: Float[Array, "e sample"],
        observed: Bool[np.ndarray, "e sample"],
        before: tuple[Mapping[str, AnyFeature], Any],
        feature: AnyFeature,
        given: Mapping[str, float],
    ) -> dict[str, Float[Array, " start"]]:
        """As `starts`, of signals that jax traces, 0 where they are not `observed`. Raises
        `BadInput` for filters of more than `MOST_HELD` numbers."""
        known = self._blocks.means(observed.astype(float))
        rest = self._blocks.means(y)
        if before[0]:
            rest = rest - known * self._model.with_features(before[0])(before[1])
        white = np.ones(len(y))
        banks, held = [], 0
        with outside_traces():
            for bank in self._filter_banks(feature, white, known, given):
                banks.append(bank)
                held += bank.basis.size + (0 if bank.fixed is None else bank.fixed.size)
                refuse(
                    held > MOST_HELD,
                    f"The search for {type(feature).__name__} tries too many shapes for a program "
                    "that JAX traces: give narrower ranges "
                    f"({', '.join(map(range_name, feature.axes))}).",
                )
        columns, explained = self._explained(rest[None], white, known, feature, banks)
        places, left = jnp.asarray(_places(list(columns.values()))), explained[0]
        chosen = []
        for _ in range(STARTS):
            at = jnp.argmax(left)
            chosen.append(at)
            left = jnp.where(jnp.abs(places - places[at]).max(axis=1) <= 1, -jnp.inf, left)
        return {name: jnp.asarray(each)[jnp.array(chosen)] for name, each in columns.items()}

    def best(
        self, ys: Float[np.ndarray, "b e sample"], feature: AnyFeature
    ) -> dict[str, Float[np.ndarray, " b"]]:
        """The best shape of the only feature to start from, for each of many signals."""
        observed = np.isfinite(ys).all(axis=0)
        known = self._blocks.means(observed.astype(float))
        rest, white = self._blocks.means(np.where(observed, ys, 0.0)), np.ones(ys.shape[1])
        banks = self._filter_banks(feature, white, known, {})
        columns, explained = self._explained(rest, white, known, feature, banks)
        return {name: column[explained.argmax(axis=1)] for name, column in columns.items()}

    def _explained(
        self,
        rest: Float[Numbers, "b e block"],
        white: Float[np.ndarray, " e"],
        known: Float[np.ndarray, "e block"],
        feature: AnyFeature,
        banks: Iterable[FilterBank],
    ) -> tuple[dict[str, np.ndarray], Any]:
        """The shapes of the banks, and how much of each residual they explain; `known`: the
        fraction of each block's samples that are there, the rest being zero."""
        left = self._weighed(rest, white, known).reshape(len(rest), -1)
        shapes, explained = [], []
        for bank in banks:
            shapes.append(bank.shapes)
            explained.append(bank.explained(left))
        columns = {name: np.concatenate([each[name] for each in shapes]) for name in feature.axes}
        return columns, array_module(explained).concatenate(explained, axis=1)

    def strongest(self, feature: AnyFeature) -> list[float]:
        """The strongest signal of each of its unit linear parameters over all shapes tried."""
        if feature not in self._strongest:
            tried = self._model.loading.trial_shapes(self._model, feature, self._stretch, {})
            self._note(feature, peaks=[_peaks(part) for part in tried])
        return self._strongest[feature]

    def relative_signal(
        self, feature: AnyFeature, own: Mapping[str, Any]
    ) -> Float[np.ndarray, "b a"]:
        """Signal of each unit amplitude, relative to the shape with the strongest signal, for
        shapes whose parameters are (b,) each."""
        shape = {part: np.atleast_1d(own[part]) for part in feature.axes}
        signals = responses(self._model.with_features({"one": feature}), shape)
        peak = np.abs(signals).max(axis=(2, 3))
        top = np.asarray(self.strongest(feature))
        return np.maximum(peak / np.where(top > 0, top, 1.0), LEAST_RELATIVE_SIGNAL)

    def _filter_banks(
        self,
        feature: AnyFeature,
        white: Float[np.ndarray, " e"],
        known: Float[np.ndarray, "e block"],
        given: Mapping[str, float],
    ) -> Iterable[FilterBank]:
        loading = self._model.loading
        key = feature, white.tobytes(), known.tobytes()
        if key in self._banks:
            return self._banks[key]
        tried = loading.trial_shapes(self._model, feature, self._stretch, given)

        def weigh(signals):
            return self._weighed(known * signals, white, known)

        if not loading.ARE_FEW:
            return (FilterBank.of(part, weigh) for part in tried)
        tried = list(tried)
        self._note(feature, peaks=[_peaks(part) for part in tried])
        self._banks[key] = [FilterBank.of(part, weigh) for part in tried]
        return self._banks[key]

    def _note(self, feature: AnyFeature, peaks: list[np.ndarray]) -> None:
        self._strongest[feature] = np.max(peaks, axis=0).tolist()

    def _weighed(self, signals: Any, white: np.ndarray, known: np.ndarray) -> Any:
        """Signals in units of the noise, less each element's offset where it is free: what is
        `known` of one."""
        weighed = signals / white[:, None]
        if self._model.free_offset:
            along = array_module(weighed).sum(known * weighed, axis=-1, keepdims=True)
            squares = np.sum(known**2, axis=-1, keepdims=True)
            weighed = weighed - known * (along / np.where(squares > 0, squares, 1.0))
        return weighed


def _peaks(tried: TrialShapes) -> Float[np.ndarray, " a"]:
    return np.abs(tried.signals).max(axis=(0, 2, 3))


def given_start(start: Mapping[str, float], name: str, features: Features) -> dict[str, float]:
    """The start values of this feature."""
    prefix, wanted = f"{name}_" if len(features) > 1 else "", "a number, in SI units"
    given = {
        part: float(number(f"fit.start.{prefix}{part}", start[prefix + part], wanted))
        for part in features[name].reported
        if prefix + part in start
    }
    return features[name].from_reported(given)


def prior_reach(y: Any) -> Any:
    """Signal at one prior standard deviation of an amplitude: see `AMPLITUDE_PRIOR_REACH`."""
    if is_traced(y):
        largest = jnp.max(jnp.abs(y))
        return jnp.where(largest > 0, AMPLITUDE_PRIOR_REACH * largest, 1.0)
    largest = float(np.max(np.abs(y[np.isfinite(y)]), initial=0.0))
    return AMPLITUDE_PRIOR_REACH * largest if largest > 0 else 1.0
