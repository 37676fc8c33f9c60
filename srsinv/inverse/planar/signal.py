"""Straight features in the plane, fitted to signals of a sensor on circles and straight passes.

A ridge, or a grating of ridges at a pitch, has a direction, a place, a load and friction. Load and
shear enter linearly. Each element counts by its own noise: one that a feature hardly reaches adds
no information, and nothing has to choose between elements.
"""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import refuse
from ...forward.planar import HARMONICS, GratingLoad, PathScan, PlanarLoad, RidgeLoad
from ...grid import as_real
from ...resolution import cell_m

MOST_TRIED = 1e6  # combinations in a search
COARSE_NODES = 2  # of the widths' quadrature in a search
CELLS_A_PITCH = 6  # samples in a pitch, in a search
LINEAR = ("load_N_per_m", "shear_N_per_m")
FIT_NODES = 6  # right to 1e-7 for widths up to a depth, to 3e-5 for two
Range = tuple[float, float]
Trials = dict[str, Float[np.ndarray, " start"]]


class StraightFeature(eqx.Module):
    """Base of straight features: names of the parameters, `angle_deg` first and those that enter
    linearly last, the load that they stand for, and where a search starts."""

    names: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def load(self, params: Mapping[str, Any]) -> PlanarLoad:
        """Where it presses."""

    @abc.abstractmethod
    def ranges(self, reach_m: float, depth_m: float) -> dict[str, Range]:
        """Ranges of its parameters, for paths that reach so far from the origin."""

    @abc.abstractmethod
    def cell_m(self, ranges: Mapping[str, Range], depth_m: float) -> float:
        """The distance of samples that a search takes."""

    @abc.abstractmethod
    def trials(self, reach_m: float, cell_m: float, ranges: Mapping[str, Range]) -> Trials:
        """Angles [deg] and values of one other parameter that a search tries."""

    @abc.abstractmethod
    def columns(
        self, scan: PathScan, trial: Mapping[str, Any], ranges: Mapping[str, Range]
    ) -> Float[Array, "column e sample"]:
        """Signals whose sum explains those of the feature at a trial, whatever its load, shear and
        other parameters."""

    @abc.abstractmethod
    def start(
        self, trial: Mapping[str, Any], amplitudes: np.ndarray, ranges: Mapping[str, Range]
    ) -> dict[str, float]:
        """The parameters of a trial whose columns have these amplitudes, less the linear ones."""


class RidgeShape(StraightFeature):
    """One ridge: `angle_deg` of its normal from x, `distance_m` from the origin, `width_m`,
    `load_N_per_m` and `shear_N_per_m`, the shear along the velocity."""

    names = ("angle_deg", "distance_m", "width_m", *LINEAR)
    nodes: int = eqx.field(static=True, default=FIT_NODES)

    def load(self, params: Mapping[str, Any]) -> PlanarLoad:
        return RidgeLoad(params["distance_m"], params["width_m"], self.nodes)

    def ranges(self, reach_m: float, depth_m: float) -> dict[str, Range]:
        reach = 1.2 * reach_m
        return {"distance_m": (-reach, reach), "width_m": (0.1 * depth_m, 2 * depth_m)}

    def cell_m(self, ranges: Mapping[str, Range], depth_m: float) -> float:
        return cell_m("ridge_search", depth_m)

    def trials(self, reach_m: float, cell_m: float, ranges: Mapping[str, Range]) -> Trials:
        low, high = np.clip(ranges["distance_m"], -reach_m, reach_m)
        halves = int(np.ceil((high - low) / (2 * cell_m)))
        return _grid(
            "distance_m", cell_m / reach_m, 2 * halves + 1, lambda n: np.linspace(low, high, n)
        )

    def columns(self, scan, trial, ranges) -> Float[Array, "column e sample"]:
        low, high = ranges["width_m"]
        load = RidgeLoad(trial["distance_m"], as_real((low + high) / 2), COARSE_NODES)
        return scan.unit(jnp.deg2rad(trial["angle_deg"]), load)

    def start(self, trial, amplitudes, ranges) -> dict[str, float]:
        return {**trial, "width_m": sum(ranges["width_m"]) / 2}


class GratingShape(StraightFeature):
    """Ridges at a pitch without end: `angle_deg`, `distance_m` of one of them, `pitch_m`, and load
    and shear of each ridge.

    `width_share`: width of a ridge over the pitch, which is taken as known. It scales the harmonics
    that reach the film: one of them does not distinguish it from the load, with more a wrong one
    biases the fit. The standard errors do not include that error, and the residual seldom shows it:
    0.2 of a pitch in place of 0.3 leaves 54 of 100 directions within their 90 % intervals, where
    the right one leaves 81 (docs/explanation/physics/oblique.md).
    """

    names = ("angle_deg", "distance_m", "pitch_m", *LINEAR)
    width_share: Float[Array, ""] = eqx.field(converter=as_real, default=0.3)
    harmonics: int = eqx.field(static=True, default=HARMONICS)

    def load(self, params: Mapping[str, Any]) -> PlanarLoad:
        return self._load(params["distance_m"], params["pitch_m"], self.harmonics)

    def _load(self, distance_m, pitch_m, harmonics: int) -> GratingLoad:
        return GratingLoad(distance_m, pitch_m, self.width_share * pitch_m, harmonics)

    def ranges(self, reach_m: float, depth_m: float) -> dict[str, Range]:
        del reach_m
        return {"pitch_m": (2 * depth_m, 7 * depth_m)}

    def cell_m(self, ranges: Mapping[str, Range], depth_m: float) -> float:
        return min(cell_m("ridge_search", depth_m), ranges["pitch_m"][0] / CELLS_A_PITCH)

    def trials(self, reach_m: float, cell_m: float, ranges: Mapping[str, Range]) -> Trials:
        # From trial to trial the phase at the ends of the reach changes by a quarter turn.
        low, high = ranges["pitch_m"]
        step = min(low / (4 * reach_m), 0.5)
        count = 1 + int(np.ceil(np.log(high / low) / step))
        return _grid("pitch_m", step, count, lambda n: np.geomspace(low, high, n))

    def columns(self, scan, trial, ranges) -> Float[Array, "column e sample"]:
        # The first harmonic at both of its phases stands for a grating at any distance.
        angle, pitch = jnp.deg2rad(trial["angle_deg"]), trial["pitch_m"]
        both = [self._load(phase * pitch, pitch, 1) for phase in (0.0, 0.25)]
        return jnp.concatenate([scan.unit(angle, load) for load in both])

    def start(self, trial, amplitudes, ranges) -> dict[str, float]:
        phase = np.arctan2(amplitudes[2], amplitudes[0]) / (2 * np.pi)  # of the load
        return {**trial, "distance_m": float(phase * trial["pitch_m"])}


def _grid(name: str, step_rad: float, count: int, spread: Callable[[int], np.ndarray]) -> Trials:
    """Angles of half a turn, `step_rad` apart, with so many values of another parameter each."""
    total = np.pi / step_rad * count
    refuse(
        total > MOST_TRIED,
        f"The paths have {total:.0e} combinations of angle and {name} to search: give shorter "
        f"paths, or a narrower range of {name}.",
    )
    angles_deg = np.rad2deg(np.arange(0, np.pi, step_rad))
    both = np.meshgrid(angles_deg, spread(count), indexing="ij")
    return {"angle_deg": both[0].ravel(), name: both[1].ravel()}


class PlanarSignal(eqx.Module):
    """Parameters of a straight feature to its signals (element, sample), one path after another: a
    model for [`srsinv.fit`][]."""

    feature: StraightFeature
    scans: tuple[PathScan, ...]

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        return LINEAR

    @compiled
    def __call__(self, params: Mapping[str, Any]) -> Float[Array, "e sample"]:
        by_load, by_shear = self.unit(params)
        return params["load_N_per_m"] * by_load + params["shear_N_per_m"] * by_shear

    def unit(self, params: Mapping[str, Any]) -> Float[Array, "2 e sample"]:
        """The signals of 1 N/m of load, and of 1 N/m of shear along the velocity."""
        angle, load = jnp.deg2rad(params["angle_deg"]), self.feature.load(params)
        return for_each_scan(lambda scan: scan.unit(angle, load), self.scans)

    def whitened_slopes(
        self, row: Float[Array, " m"], noise_rms: Float[Array, " e"]
    ) -> Float[Array, "e sample m"]:
        """The derivative of the signals over each element's noise by the parameters in the order of
        `feature.names`."""

        *others, load, shear = row

        def units(others: Float[Array, " searched"]):
            own = dict(zip(self.feature.names, others, strict=False))
            both = self.unit(own)
            return load * both[0] + shear * both[1], both

        slopes, both = jax.jacfwd(units, has_aux=True)(jnp.stack(others))
        each = jnp.concatenate([slopes, jnp.moveaxis(both, 0, -1)], axis=-1)
        return each / noise_rms[:, None, None]


def for_each_scan(one: Callable[[PathScan], Array], scans: Sequence[PathScan]) -> Array:
    """`one` of every scan, joined along the samples; of scans of one form by one program."""
    (first, form), *others = (jax.tree.flatten(scan) for scan in scans)
    if not others or any(own != form for _, own in others):
        return jnp.concatenate([one(scan) for scan in scans], axis=-1)
    leaves = zip(first, *(each for each, _ in others), strict=True)
    stacked = jax.tree.unflatten(form, [jnp.stack(each) for each in leaves])
    joined = jnp.moveaxis(jax.vmap(one)(stacked), 0, -2)
    return joined.reshape(*joined.shape[:-2], -1)


@compiled
def information(
    signal: PlanarSignal, row: Float[Array, " m"], noise_rms: Float[Array, " e"]
) -> Float[Array, "e m m"]:
    """Fisher information of each element, on the parameters in the order of `feature.names`, under
    white noise of `noise_rms` in each element; the elements' sum is that of all."""
    slopes = signal.whitened_slopes(row, noise_rms)
    return jnp.einsum("esi,esj->eij", slopes, slopes)


def standard_errors(information: Float[np.ndarray, "m m"]) -> Float[np.ndarray, " m"]:
    """The Cramer-Rao bound of each parameter, all of them unknown; infinite where the information
    is singular."""
    size = np.sqrt(np.diag(information))
    if not np.all(size > 0):
        return np.full(len(information), np.inf)
    scaled = information / np.outer(size, size)
    values, vectors = np.linalg.eigh(scaled)
    floor = len(size) * np.finfo(float).eps * values[-1]
    with np.errstate(divide="ignore"):
        variance = (vectors**2) @ (1 / np.where(values > floor, values, 0.0))
    return np.sqrt(variance) / size


def weights(information: Float[np.ndarray, "e m m"], at: int = 0) -> Float[np.ndarray, " e"]:
    """Share of each element in the information on one parameter, all of them unknown; the shares
    sum to 1, and are nan where the data do not determine it.

    With F the sum over elements F_e and v the column `at` of its inverse, the share is v F_e v over
    v F v.
    """
    total = information.sum(axis=0)
    if not np.isfinite(standard_errors(total)[at]):
        return np.full(len(information), np.nan)
    size = np.sqrt(np.diag(total))
    scaled = total / np.outer(size, size)
    column = np.linalg.solve(scaled, np.eye(len(size))[at]) / size
    parts = np.einsum("i,eij,j->e", column, information, column)
    return parts / parts.sum()
