"""Direction of a straight ridge, from the signal of one circle over it.

A ridge that crosses the circle is met twice, at a = phi +- arccos(d/r): the times determine its
angle and distance, the amplitudes its load and friction. Both of these enter linearly.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from srsinv.compiled import compiled
from srsinv.errors import number, refuse
from srsinv.forward.sensor import Sensor
from srsinv.grid import as_real
from srsinv.inverse.features.search import separated
from srsinv.inverse.nonlinear import Fit, fit
from srsinv.resolution import cell_m

from .circular import Circle, Circling, ObliqueRidge

MOST_TRIED = 1e6  # angles times distances
COARSE_NODES = 2  # of the widths' quadrature
FIT_NODES = 6  # right to 1e-7 for widths up to a depth, to 3e-5 for two
LINEAR = ("load_N_per_m", "shear_N_per_m")
Range = tuple[float, float]


@dataclass(frozen=True)
class Direction:
    """The fitted ridge.

    - `parameters`: (value, standard error) of `angle_deg` (from x to the ridge's normal, from 0 to
      180), `distance_m`, `load_N_per_m`, `width_m` and `friction`.
    - `fit`: the fit below, and `signal` (e, sample) its signal.
    """

    parameters: Mapping[str, tuple[float, float]]
    fit: Fit
    signal: Float[np.ndarray, "e sample"]


class RidgeModel(eqx.Module):
    """Parameters of a ridge to its signal on a circle (element, sample)."""

    circling: Circling

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        return LINEAR

    @compiled
    def __call__(self, params: Any) -> Float[Array, "e sample"]:
        place = jnp.deg2rad(params["angle_deg"]), params["distance_m"], params["width_m"]
        by_load, by_shear = self.circling.unit(*place, nodes=FIT_NODES)
        return params["load_N_per_m"] * by_load + params["shear_N_per_m"] * by_shear


class DirectionFinder:
    """Finds the direction of a ridge in signals of one sensor on one circle.

    `width_range_m`: range of the ridge's width, by default from a tenth of the film's depth to two
    depths: it is weakly identifiable. Computations that do not depend on the signal are done once.
    Raises `BadInput` for an invalid range, and a readout whose offset is not known.
    """

    def __init__(self, sensor: Sensor, circle: Circle, width_range_m: Range | None = None):
        refuse(
            sensor.amplifier.offset is None,
            "The readout's offset is not known: give amplifier.offset, or amplifier=current.",
        )
        depth = float(sensor.depth_m)
        widths = width_range_m or (0.1 * depth, 2 * depth)
        wanted = "two widths in metres"
        low, high = (number("width_range_m", each, wanted, above=0) for each in widths)
        refuse(
            not low < high,
            f"width_range_m is [{low}, {high}]: give the lesser width first, and leave room "
            "between.",
        )
        self._widths = low, high
        self._model = RidgeModel(Circling(sensor, circle))
        self._bank = _RidgeBank(self._model.circling, float(np.mean(self._widths)))

    def __call__(self, y: Float[np.ndarray, "e sample"], noise: Any = None) -> Direction:
        """Fit the ridge to `y`.

        `noise`: as [`nonlinear.fit`][] takes it; None: white, its level from the residual.
        """
        y = np.asarray(y, float)
        circling = self._model.circling
        shape = len(circling.sensor.elements), circling.circle.samples
        refuse(
            y.shape != shape,
            f"The signal has the shape {y.shape}: give (element, sample) as the sensor and the "
            f"circle have them, {shape}.",
        )
        places = self._bank.search(y)
        width = float(np.mean(self._widths))
        first = {"angle_deg": places[0][0], "distance_m": places[0][1], "width_m": width}
        rest = np.asarray(places[1:])
        starts = {"angle_deg": rest[:, 0], "distance_m": rest[:, 1]} if len(rest) else None
        reach = 1.2 * float(circling.circle.radius_m)
        fitted = fit(
            self._model,
            first | dict.fromkeys(LINEAR, 0.0),
            y,
            noise=noise,
            bounds={"distance_m": (-reach, reach), "width_m": self._widths},
            starts=starts,
            linear=LINEAR,
            max_searches=1,
        )
        signal = self._model(jax.tree.map(as_real, fitted.value))
        return Direction(_canonical_angle(fitted), fitted, np.asarray(signal))


def _canonical_angle(fitted: Fit) -> dict[str, tuple[float, float]]:
    """Reported parameters: of the two equivalent angles of the ridge the one from 0 to 180
    degrees."""
    half_turns, angle = divmod(fitted.value["angle_deg"], 180.0)
    side = -1.0 if half_turns % 2 else 1.0
    value = fitted.value | {"angle_deg": angle, "distance_m": side * fitted.value["distance_m"]}
    names = ("angle_deg", "distance_m", "load_N_per_m", "width_m")
    read = {name: (float(value[name]), float(fitted.stderr[name])) for name in names}
    return read | {"friction": fitted.ratio("shear_N_per_m", "load_N_per_m")}


class _RidgeBank:
    """Signals of a ridge of one width at every angle and distance tried, on coarser samples."""

    def __init__(self, circling: Circling, width_m: float):
        circle, depth = circling.circle, float(circling.sensor.depth_m)
        radius = float(circle.radius_m)
        step = radius * float(circle.sweep_rad) / circle.samples
        self._size = int(np.clip(cell_m("ridge_search", depth) / step, 1, circle.samples // 8))
        self._trials = _trial_lines(radius, cell_m("ridge_search", depth))
        coarse = Circling(circling.sensor, circle.coarser(self._size))
        angles, distances = (as_real(column) for column in self._trials.T)
        signals = np.asarray(_signals(coarse, angles, distances, as_real(width_m)))
        self._signals = signals.reshape(*signals.shape[:2], -1)
        gram = self._signals @ self._signals.swapaxes(1, 2)
        # Slightly damped, for ridges outside the circle.
        size = np.trace(gram.mean(axis=0))
        self._gram = gram + 1e-9 * size * np.eye(len(LINEAR)) + 1e-300

    def search(self, y: Float[np.ndarray, "e sample"]) -> Float[np.ndarray, "start 2"]:
        """Angles [deg] and distances [m] to start from, the best first: those whose best amplitudes
        explain most."""
        used = y.shape[1] // self._size * self._size
        means = np.nan_to_num(y)[:, :used].reshape(len(y), -1, self._size).mean(axis=-1)
        projections = self._signals @ means.ravel()
        explained = np.sum(
            projections * np.linalg.solve(self._gram, projections[..., None])[..., 0], axis=-1
        )
        chosen = self._trials[separated(list(self._trials.T), explained)]
        return np.stack([np.rad2deg(chosen[:, 0]), chosen[:, 1]], axis=1)


def _trial_lines(radius_m: float, step_m: float) -> Float[np.ndarray, "start 2"]:
    """Angles [rad] over half a turn and distances [m] over the circle, `step_m` apart on it."""
    count = np.pi * radius_m / step_m * 2 * radius_m / step_m
    refuse(
        count > MOST_TRIED,
        f"A circle of radius {radius_m:g} m has {count:.0e} positions to search for a "
        "ridge: give a smaller radius, or a deeper film.",
    )
    angles = np.arange(0, np.pi, step_m / radius_m)
    distances = np.linspace(-radius_m, radius_m, 2 * int(np.ceil(radius_m / step_m)) + 1)
    return np.stack(np.meshgrid(angles, distances, indexing="ij"), axis=-1).reshape(-1, 2)


@compiled
def _signals(circling: Circling, angles, distances, width) -> Float[Array, "start 2 e sample"]:
    def at(place):
        angle, distance = place
        return circling.unit(angle, distance, width, nodes=COARSE_NODES)

    return jax.lax.map(at, (angles, distances), batch_size=64)


@compiled
def angle_bounds_deg(
    circling: Circling, ridge: ObliqueRidge, angles_rad: Float[Array, " angle"], snr_dB: float
) -> Float[Array, " angle"]:
    """The Cramer-Rao bound [deg] on the standard error of a ridge's angle, at each of
    `angles_rad`: all five parameters unknown, white noise `snr_dB` below the rms signal."""
    others = (ridge.load_N_per_m, ridge.friction * ridge.load_N_per_m, ridge.width_m)

    def signal(values):
        load, shear, width, distance, angle = values
        by_load, by_shear = circling.unit(angle, distance, width)
        return jnp.ravel(load * by_load + shear * by_shear)

    def bound(angle):
        truth = jnp.stack([*others, ridge.distance_m, angle])
        slopes = jax.jacfwd(signal)(truth)
        # Scaled: loads are in N/m, widths in metres.
        size = jnp.linalg.norm(slopes, axis=0)
        triangle = jnp.linalg.qr(slopes / size, mode="r")
        rms = jnp.sqrt(jnp.mean(signal(truth) ** 2)) * 10 ** (-snr_dB / 20)
        return jnp.rad2deg(rms / (jnp.abs(triangle[-1, -1]) * size[-1]))

    return jax.lax.map(bound, jnp.asarray(angles_rad))
