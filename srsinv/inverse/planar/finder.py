"""Direction of a ridge or a grating, from the signals of all elements on circles and passes.

A ridge that crosses a circle is met twice, at a = phi +- arccos(d/r): the times determine its angle
and distance, the amplitudes its load and friction. Both of these enter linearly. A search over
angle and distance, or over angle and pitch, gives the starts of a nonlinear fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import check_name, number, refuse
from ...forward.planar import PathScan
from ...grid import as_real
from ..features.search import separated
from ..nonlinear import Fit, fit, fit_many
from .signal import LINEAR, PlanarSignal, Range, StraightFeature, for_each_scan

AT_ONCE = 64  # trials


@dataclass(frozen=True)
class Direction:
    """The fitted feature.

    - `parameters`: (value, standard error) of `angle_deg` (from x to the feature's normal, from 0
      to 180), `distance_m`, `load_N_per_m`, `friction`, and `width_m` of a ridge or `pitch_m` of a
      grating, whose distance is from 0 to its pitch.
    - `fit`: the fit below, and `signal` (e, sample) its signal.
    """

    parameters: Mapping[str, tuple[float, float]]
    fit: Fit
    signal: Float[np.ndarray, "e sample"]

    def posterior(
        self, names: Sequence[str]
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"]]:
        """Values and covariance of the fitted parameters, in the order of `names`. Raises
        `BadInput` for one that was not fitted."""
        for name in names:
            check_name("posterior", name, self.fit.names)
        at = [self.fit.names.index(name) for name in names]
        values = np.array([float(self.fit.value[name]) for name in names])
        return values, self.fit.covariance[np.ix_(at, at)]


class DirectionFinder:
    """Finds the direction of a straight feature in signals of one sensor on given paths.

    - `scans`: the sensor on each path, or on one of them.
    - `feature`: a [`RidgeShape`][] or a [`GratingShape`][].
    - `ranges`: `{name: (low, high)}` of `distance_m`, `width_m` or `pitch_m`, in place of those
      that follow from the paths and the films' depth.
    - `priors`: `{name: (mean, standard deviation)}`, Gaussian, as [`srsinv.fit`][] takes them. The
      fit starts at the equivalent angle, by half turns, that is nearest to the prior's mean.

    The feature has to be there: from noise alone a direction is found, too. A grating's width over
    its pitch is taken as known, and a wrong one is not in the standard errors: see
    [`GratingShape`][]. Computations that do not depend on the signal are done once. Raises
    `BadInput` for an invalid range, a readout whose offset is not known, and scans of different
    numbers of elements.
    """

    def __init__(
        self,
        scans: PathScan | Sequence[PathScan],
        feature: StraightFeature,
        ranges: Mapping[str, Range] | None = None,
        priors: Mapping[str, tuple[float, float]] | None = None,
    ):
        scans = _checked((scans,) if isinstance(scans, PathScan) else tuple(scans))
        depth, self._priors = float(scans[0].sensor.depth_m), priors
        self._reach = max(scan.path.reach_m for scan in scans)
        for name in ranges or {}:
            check_name("ranges", name, feature.names[1 : -len(LINEAR)])  # the lengths
        given = {name: _range(name, each) for name, each in (ranges or {}).items()}
        self._ranges = feature.ranges(self._reach, depth) | given
        self.signal = PlanarSignal(feature, scans)
        cell = feature.cell_m(self._ranges, depth)
        self._sizes = [scan.path.group_size(cell) for scan in scans]
        self._trials = feature.trials(self._reach, cell, self._ranges)
        coarse = tuple(
            PathScan(scan.sensor, scan.path.coarser(size))
            for scan, size in zip(scans, self._sizes, strict=True)
        )
        count = len(self._trials["angle_deg"])
        # Whole batches: an incomplete one would be a second program.
        rows = np.minimum(np.arange(-(-count // AT_ONCE) * AT_ONCE), count - 1)
        trials = {name: as_real(values[rows]) for name, values in self._trials.items()}
        within = {name: tuple(map(as_real, each)) for name, each in self._ranges.items()}
        self._bank = np.asarray(_columns(PlanarSignal(feature, coarse), trials, within))[:count]

    def __call__(
        self,
        y: Float[np.ndarray, "e sample"],
        noise_rms: float | Float[np.ndarray, "..."] | None = None,
    ) -> Direction:
        """Fit the feature to `y`, the samples of one path after those of the other.

        `noise_rms`: of all elements, of each (e, 1), or of each sample, infinite where one is left
        out; None: the same in all, its level from the residual. Raises `BadInput` for other shapes
        and for noise that is not above 0.
        """
        y, scans = np.asarray(y, float), self.signal.scans
        shape = len(scans[0].sensor.elements), sum(scan.path.samples for scan in scans)
        refuse(
            y.shape != shape,
            f"The signal has the shape {y.shape}: give (element, sample) as the sensor and the "
            f"circle have them, {shape}.",
        )
        rms = _noise(1.0 if noise_rms is None else noise_rms, shape)
        fitted = self._fitted(y, None if noise_rms is None else rms, self._starts(y, rms))
        signal = self.signal(jax.tree.map(as_real, fitted.value))
        return Direction(_canonical(fitted), fitted, np.asarray(signal))

    def _fitted(
        self, y: np.ndarray, rms: np.ndarray | None, starts: Sequence[dict[str, float]]
    ) -> Fit:
        """The fit from these starts, the best first."""
        first, *others = starts
        initial = first | dict.fromkeys(LINEAR, 0.0)
        settings: dict[str, Any] = {
            "noise": rms,
            "bounds": self._ranges,
            "priors": self._priors,
            "starts": {name: [each[name] for each in others] for name in first} if others else None,
            "linear": LINEAR,
            "max_searches": len(starts) if self._priors else 1,
        }
        if rms is None and self._priors:  # whose weight follows from the level that is found
            return fit(self.signal, initial, y, **settings)
        # Its program is the linearised model alone, which compiles in a fifth of a search's time.
        return fit_many(self.signal, initial, y[None], **settings)[0]

    def _starts(self, y: np.ndarray, rms: np.ndarray) -> list[dict[str, float]]:
        """Parameters to start from, the best first: those whose best amplitudes explain most."""
        weight = 1 / self._means(rms)
        bank = (self._bank * weight).reshape(*self._bank.shape[:2], -1)
        weighted = self._means(np.nan_to_num(y)) * weight
        gram = bank @ bank.swapaxes(1, 2)
        # Slightly damped, for features that the paths hardly meet.
        count = gram.shape[-1]
        gram = gram + 1e-9 * np.trace(gram.mean(axis=0)) * np.eye(count) + 1e-300
        projections = bank @ weighted.ravel()
        amplitudes = np.linalg.solve(gram, projections[..., None])[..., 0]
        explained = np.sum(projections * amplitudes, axis=-1)
        feature, tried = self.signal.feature, list(self._trials.values())
        starts = [
            feature.start(
                {name: float(each[at]) for name, each in self._trials.items()},
                amplitudes[at],
                self._ranges,
            )
            for at in separated(tried, explained)
        ]
        return [self._beside_prior(start) for start in starts]

    def _beside_prior(self, start: dict[str, float]) -> dict[str, float]:
        """The same feature at the equivalent angle that is nearest to the prior's mean."""
        mean, _ = (self._priors or {}).get("angle_deg", (90.0, None))
        half_turns = np.round((float(mean) - start["angle_deg"]) / 180)
        distance = start["distance_m"] * (-1.0 if half_turns % 2 else 1.0)
        low, high = self._ranges.get("distance_m", (-np.inf, np.inf))
        if not low <= distance <= high:
            return start
        return start | {
            "angle_deg": start["angle_deg"] + 180.0 * float(half_turns), "distance_m": distance
        }  # fmt: skip

    def _means(self, y: np.ndarray) -> np.ndarray:
        """The means over the groups of samples that the search takes."""
        means, at = [], 0
        for scan, size in zip(self.signal.scans, self._sizes, strict=True):
            own = y[:, at : at + scan.path.samples // size * size]
            means.append(own.reshape(len(y), -1, size).mean(axis=-1))
            at += scan.path.samples
        return np.concatenate(means, axis=-1)


def _checked(scans: tuple[PathScan, ...]) -> tuple[PathScan, ...]:
    refuse(not scans, "There is no scan: give the sensor on one path at least.")
    counts = {len(scan.sensor.elements) for scan in scans}
    refuse(
        len(counts) > 1,
        f"The scans' sensors have {sorted(counts)} elements: give one sensor on each path.",
    )
    refuse(
        any(scan.sensor.amplifier.offset is None for scan in scans),
        "The readout's offset is not known: give amplifier.offset, or amplifier=current.",
    )
    return scans


def _noise(given: Any, shape: tuple[int, int]) -> np.ndarray:
    """The noise's rms of every sample; numbers of a row are those of samples, not of elements."""
    rms = np.asarray(given, float)
    fits = all(n in (1, wanted) for n, wanted in zip(rms.shape, shape, strict=False))
    refuse(
        rms.ndim not in (0, 2) or not fits,
        f"The noise has the shape {rms.shape}: give one number, or one of each element, "
        f"{(shape[0], 1)}, or of each sample, {shape}.",
    )
    refuse(not np.all(rms > 0), "The noise's rms is not above 0: give positive numbers.")
    return np.broadcast_to(rms, shape)


def _range(name: str, given: Range) -> Range:
    wanted = "two lengths in metres"
    refuse(np.shape(given) != (2,), f"{name} has the range {given!r}: give {wanted}.")
    low, high = (number(name, each, wanted) for each in given)
    refuse(
        not low < high or (name != "distance_m" and low <= 0),
        f"{name} has the range [{low}, {high}]: give the lesser length first, and leave room "
        "between; widths and pitches are positive.",
    )
    return float(low), float(high)


def _canonical(fitted: Fit) -> dict[str, tuple[float, float]]:
    """Reported parameters: of the two equivalent angles the one from 0 to 180 degrees."""
    half_turns, angle = divmod(float(fitted.value["angle_deg"]), 180.0)
    distance = (-1.0 if half_turns % 2 else 1.0) * float(fitted.value["distance_m"])
    value = {name: float(each) for name, each in fitted.value.items()}
    if "pitch_m" in value:
        distance %= value["pitch_m"]
    value |= {"angle_deg": angle, "distance_m": distance}
    read = {name: (value[name], float(fitted.stderr[name])) for name in value if name != LINEAR[1]}
    return read | {"friction": fitted.ratio(*reversed(LINEAR))}


@compiled
def _columns(
    signal: PlanarSignal, trials: Mapping[str, Any], ranges: Mapping[str, Any]
) -> Float[Array, "start column e sample"]:
    def at(trial):
        return for_each_scan(lambda scan: signal.feature.columns(scan, trial, ranges), signal.scans)

    return jax.lax.map(at, trials, batch_size=AT_ONCE)
