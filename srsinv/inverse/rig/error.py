"""How well a rig is known: the covariance of a calibration and the tolerances of facts that are
stated, as signals that an estimate allows for.

A calibration determines gains, depth, angles and offsets c to within a covariance S = L L^T, and
facts that somebody stated are right to within their tolerances (rig/tolerance.py). To first order
the signal is then m + sum_j s_j (dm/dc L)_j with s_j normal of variance one: columns that enter
linearly, under priors of their own. Fitted beside the parameters they carry the rig's error into
all that a fit gives; inversions carry it as line/rig_bands.py says.

Estimated jointly, facts and parameters have the covariance of generalised least squares,
(J^T (N + D D^T)^-1 J)^-1 with D the columns: no unbiased estimate has smaller errors (Aitken 1935).
Parameters fitted as if the facts were exact, and then widened by |d theta / d c| sigma_c, are as
honest, but wider where the signals show more than the tolerance says, and their residual has the
error of the facts in it.
"""

import abc
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Shaped

from ... import false_alarm
from ...errors import refuse
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...grid import as_real
from .setup import OF_CONTACT, Setup, number_of_films

_OF_ELEMENT = re.compile(
    r"gain_([1-9][0-9]{0,3})|angle_([1-9][0-9]{0,3})_deg|offset_([1-9][0-9]{0,3})_m"
)
_UNIT = re.compile(r"_(m|deg|Pa)$")
_ROUNDING = 1e-6  # of a correlation, as numbers written by hand have it
_DEPTH = "depth_m"
CALIBRATED, STATED, ASSUMED = "calibrated", "stated", "assumed"
CALIBRATION = "calibration"  # the source of all errors that a calibration left
FOUND = "found"  # that of facts that were found with the traction, tolerances of others among them
NOISE = "noise"  # that of the signals' own errors
# Those of a fit alone: the width of its cells, what it leaves, and a second minimum.
CELLS, MISFIT, OTHER_MINIMUM = "cells", "misfit", "other_minimum"
LEAST_TOLD = 1e-4  # of the variance of a fact, by the data: less is rounding
# Steps of differences, in standard deviations. A whole one of the speed moves the ends of a long
# scan beyond the line.
STEPS = {"speed": 0.1}
MOST_OFF = 8.0  # standard deviations that a fact may be off
LEAST_LEFT = 0.9  # of what has to be above 0, that it may be off


class SensorError(eqx.Module):
    """How well a sensor is known: signals of what is not, in independent directions."""

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """What is not known exactly."""

    @abc.abstractmethod
    def columns(
        self,
        sensor: Sensor,
        fitted: Shaped[np.ndarray, "e *sample"],
        signal_of: Callable[[Setup], Any],
    ) -> Shaped[np.ndarray, "k e *sample"]:
        """What one standard deviation in each direction adds to the `fitted` signals; `signal_of`
        gives those of another setup. Transfer functions may stand for signals; of a motion that
        turns each film is there for the way back, too."""

    def sources(self, directions: int) -> tuple[str, ...]:
        """The source of the error in each of so many directions."""
        return (CALIBRATION,) * directions

    def uncertain(self, sensor: Sensor, motion: Motion) -> "UncertainSetup | None":
        """What the signals follow from, where the errors may be so large that signals are not
        linear in them; else None."""
        del sensor, motion
        return None

    def moves(self, name: str, directions: int) -> Float[np.ndarray, " k"]:
        """What one standard deviation in each of so many directions changes of one parameter."""
        del name
        return np.zeros(directions)

    def without(self, names: frozenset[str]) -> "SensorError | None":
        """The error without that of parameters of these names, which a fit has free; None where
        nothing is left."""
        del names
        return self

    @property
    def of_calibration(self) -> "SensorError | None":
        """The error that a calibration left, without that of what is stated or assumed."""
        return self

    @property
    def of_signals(self) -> "SensorError | None":
        """The error of the sensor and its motion, without that of what acts in contact alone."""
        return self.without(frozenset(OF_CONTACT))


class RigError(SensorError):
    """The covariance (k, k) of parameters of a rig, and their values (k,): `gain_N`, `depth_m`,
    `angle_N_deg`, `offset_N_m`, `strip_width_N_m`, N from 1, `poisson_ratio`, `youngs_modulus_Pa`,
    `nominal_pressure_Pa`, `edge_length_m`, and `speed`, a factor on that of the motion.

    `origins` (k,): how each is known, `calibrated`, `stated` or `assumed`; none: all calibrated.
    Those that are not calibrated are independent of all others.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    origins: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def words(self) -> str:
        grouped = {
            origin: ", ".join(name for name, own in self.origin_of.items() if own == origin)
            for origin in (CALIBRATED, STATED, ASSUMED)
        }
        return "; ".join(f"{names} ({origin})" for origin, names in grouped.items() if names)

    @property
    def origin_of(self) -> dict[str, str]:
        """How each parameter is known, by its name."""
        origins = self.origins or (CALIBRATED,) * len(self.names)
        return dict(zip(self.names, origins, strict=True))

    @property
    def stderr(self) -> Float[np.ndarray, " k"]:
        """Standard errors of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    @classmethod
    def of_facts(
        cls, name: str, facts: Mapping[str, Any] | None, elements: int
    ) -> "RigError | None":
        """That of a sidecar's key `rig_error`; None where it has none. Raises `BadInput`, calling
        the recording `name`, for one that is damaged or of another number of elements."""
        given: Mapping[str, Any] = {} if facts is None else facts
        names: tuple[str, ...] = tuple(given.get("parameters") or ())
        if not names:
            return None
        values = np.asarray(given.get("values") or [], float)
        rows: list[Any] = given.get("covariance") or []
        size = len(names)
        is_square = len(rows) == size and all(len(row) == size for row in rows)
        covariance = np.array(rows, float) if is_square else np.zeros((0, 0))
        valid = bool(is_square and values.shape == (size,) and _is_covariance(covariance))
        refuse(
            not valid or len({*names}) < size,
            f"{name}: the sidecar's rig_error is damaged, as its values and covariance do "
            f"not match its {size} parameters: run experiment=calibrate again.",
        )
        stderr = np.sqrt(np.diag(covariance))
        for each, value, error in zip(names, values, stderr, strict=True):
            of_element = _OF_ELEMENT.fullmatch(each)
            number = int(of_element[of_element.lastindex or 1]) if of_element else 0
            refuse(
                each != _DEPTH and not 1 <= number <= elements,
                f"{name}: the sidecar's rig_error has {each!a}, but the recording has "
                f"{elements} channels: give the sidecar of this rig.",
            )
            # A gain is divided by, and a depth changed by its error.
            wrong = value == 0 if each.startswith("gain_") else each == _DEPTH and value <= error
            refuse(
                bool(wrong),
                f"{name}: the sidecar's rig_error has {each} = {value:g} +- {error:g}, which "
                "is not a calibration's result: run experiment=calibrate again.",
            )
        return cls(names, values, covariance)

    def beside(
        self, stderr: Mapping[str, float], values: Mapping[str, float], origins: Mapping[str, str]
    ) -> "RigError":
        """The same with further, independent parameters that it does not have itself."""
        more = [name for name in stderr if name not in self.names]
        size = len(self.names)
        covariance = np.zeros((size + len(more),) * 2)
        covariance[:size, :size] = self.covariance
        covariance[range(size, len(covariance)), range(size, len(covariance))] = [
            stderr[name] ** 2 for name in more
        ]
        return RigError(
            (*self.names, *more),
            np.array([*self.values, *(values[name] for name in more)], float),
            covariance,
            (*self.origin_of.values(), *(origins[name] for name in more)),
        )

    def without(self, names: frozenset[str]) -> "RigError | None":
        own = [i for i, name in enumerate(self.names) if name not in names]
        if not own:
            return None
        if len(own) == len(self.names):
            return self
        origins = tuple(list(self.origin_of.values())[i] for i in own)
        pick = tuple(self.names[i] for i in own)
        return RigError(pick, self.values[own], self.covariance[np.ix_(own, own)], origins)

    @property
    def of_calibration(self) -> "RigError | None":
        others = (name for name, origin in self.origin_of.items() if origin != CALIBRATED)
        return self.without(frozenset(others))

    def sources(self, directions: int) -> tuple[str, ...]:
        """Of those that are calibrated, the calibration; else the parameter, as each is a direction
        of its own."""
        del directions
        own = self.origin_of.items()
        return (
            *(CALIBRATION for _, origin in own if origin == CALIBRATED),
            *(name for name, origin in own if origin != CALIBRATED),
        )

    def moves(self, name: str, directions: int) -> Float[np.ndarray, " k"]:
        return self.root[self.names.index(name)] if name in self.names else np.zeros(directions)

    def uncertain(self, sensor: Sensor, motion: Motion) -> "UncertainSetup | None":
        if all(origin == CALIBRATED for origin in self.origin_of.values()):
            return None
        keeps_area = tuple(self.keeps_area(name) for name in self.names)
        root, values = as_real(self.root), as_real(self.values)
        return UncertainSetup(sensor, motion, self.names, keeps_area, values, root)

    @property
    def root(self) -> Float[np.ndarray, "k j"]:
        """What one standard deviation in each direction changes of the parameters."""
        stderr, origins = self.stderr, np.array([*self.origin_of.values()])
        calibrated = np.flatnonzero(origins == CALIBRATED)
        own = self.covariance[np.ix_(calibrated, calibrated)]
        sizes = stderr[calibrated]
        strength, axes = np.linalg.eigh(own / sizes[:, None] / sizes)
        root = np.zeros((len(stderr), len(stderr)))
        directions = np.arange(len(calibrated))
        root[np.ix_(calibrated, directions)] = (
            sizes[:, None] * axes * np.sqrt(np.maximum(strength, 0.0))
        )
        rest = np.flatnonzero(origins != CALIBRATED)
        root[rest, len(calibrated) + np.arange(len(rest))] = stderr[rest]
        return root

    def columns(
        self,
        sensor: Sensor,
        fitted: Shaped[np.ndarray, "e *sample"],
        signal_of: Callable[[Setup], Any],
    ) -> Shaped[np.ndarray, "k e *sample"]:
        columns = np.zeros((len(self.names), *fitted.shape), np.asarray(fitted).dtype)
        for row, name in zip(self.root, self.names, strict=True):
            slope = self._slope(name, sensor, np.asarray(fitted), signal_of)
            for direction in np.flatnonzero(row):
                columns[direction] += row[direction] * slope
        return columns

    def keeps_area(self, name: str) -> bool:
        """Whether a strip's area is in what a calibration found of its gain."""
        if not name.startswith("strip_width_"):
            return False
        return self.origin_of.get(f"gain_{name.split('_')[2]}") == CALIBRATED

    def _slope(self, name: str, sensor: Sensor, fitted, signal_of):
        """The derivative of the signal (e, *sample) by one parameter."""
        i = self.names.index(name)
        value = float(self.values[i])
        if name.startswith("gain_"):
            own = np.zeros_like(fitted)
            first, count = int(name.removeprefix("gain_")) - 1, number_of_films(sensor)
            own[first::count] = fitted[first::count] / value
            return own
        step = STEPS.get(name, 1.0) * float(self.stderr[i])
        above, below = (
            signal_of(Setup(sensor).changed(name, value, sign * step, self.keeps_area(name)))
            for sign in (1, -1)
        )
        return (np.asarray(above) - np.asarray(below)) / (2 * step)


class UncertainSetup(eqx.Module):
    """What signals follow from, as a function of numbers (j,) of variance one and mean 0, by which
    the facts may be off: `root` (k, j) times these are the changes of parameters of these names
    and stated values (k,)."""

    sensor: Sensor
    motion: Motion
    names: tuple[str, ...] = eqx.field(static=True)
    keeps_area: tuple[bool, ...] = eqx.field(static=True)
    values: Float[Array, " k"]
    root: Float[Array, "k j"]

    @property
    def reach(self) -> float:
        """How far all these numbers may go, so that nothing falls to 0 that has to be above."""
        shares = [
            float(np.sum(np.abs(row)) / abs(value))
            for name, value, row in zip(
                self.names, np.asarray(self.values), np.asarray(self.root), strict=True
            )
            if value and not name.startswith(("angle_", "offset_"))
        ]
        return min(MOST_OFF, LEAST_LEFT / max(shares, default=1.0))

    def directions_of(self, without: frozenset[str]) -> tuple[int, ...]:
        """Those of the numbers that move a parameter other than gains and those named."""
        moves = [not (name in without or name.startswith("gain_")) for name in self.names]
        return tuple(np.flatnonzero(np.any(np.asarray(self.root)[moves] != 0, axis=0)).tolist())

    def __call__(self, off: Float[Any, " j"]) -> Setup:
        """The setup that is so far from what is stated."""
        setup, changes = Setup(self.sensor), self.root @ as_real(off)
        for i, (name, keeps) in enumerate(zip(self.names, self.keeps_area, strict=True)):
            setup = setup.changed(name, self.values[i], changes[i], keeps)
        return setup

    def without_gains(self) -> "UncertainSetup":
        """The same with gains that are exact."""
        of_gain = np.array([name.startswith("gain_") for name in self.names])
        root = jnp.where(jnp.asarray(of_gain)[:, None], 0.0, self.root)
        return eqx.tree_at(lambda s: s.root, self, root)

    def gains(self, off: Float[Any, " j"]) -> Float[Array, " e"]:
        """The factors on the elements' signals."""
        changes, films = self.root @ as_real(off), number_of_films(self.sensor)
        factors = [as_real(1.0)] * films
        for i, name in enumerate(self.names):
            if name.startswith("gain_"):
                own = int(name.removeprefix("gain_")) - 1
                factors[own] = 1 + changes[i] / self.values[i]
        return jnp.stack([factors[n % films] for n in range(len(self.sensor.elements))])


def contradiction(
    off: Float[np.ndarray, " j"], left: Float[np.ndarray, " j"], sources: Sequence[str]
) -> tuple[str, ...]:
    """A warning on the fact that the data put furthest `off` what is stated, in tolerances, among
    those that are off by more than chance makes; `left`: the variances that the data leave of
    numbers of variance one."""
    # The estimate of a number of variance one has the variance that the data take off it.
    told = 1 - left
    is_told = told > LEAST_TOLD
    apart = np.where(is_told, np.abs(off) / np.sqrt(np.where(is_told, told, 1.0)), 0.0)
    is_beyond = apart > -float(scipy.special.ndtri(false_alarm.CHECK / 2 / len(apart)))
    if not is_beyond.any():
        return ()
    worst = int(np.argmax(np.where(is_beyond, np.abs(off), 0.0)))
    named = _UNIT.sub("", sources[worst]).replace("_", " ")
    return (
        f"The signals contradict the stated {named}: the fit finds it {abs(off[worst]):.2g} times "
        "its tolerance away. This fact or the model is wrong. Measure it, or state its tolerance "
        "(recording.tolerance).",
    )


def _is_covariance(matrix: Float[np.ndarray, "k k"]) -> bool:
    """Whether a matrix is finite, symmetric and positive semidefinite, up to rounding."""
    variances = np.diag(matrix)
    if not np.all(np.isfinite(matrix)) or not np.all(variances >= np.finfo(float).tiny):
        return False
    stderr = np.sqrt(variances)
    with np.errstate(over="ignore"):
        correlation = matrix / stderr[:, None] / stderr
    if np.abs(correlation).max() > 1 + _ROUNDING:
        return False
    is_symmetric = np.abs(correlation - correlation.T).max() <= _ROUNDING
    return bool(is_symmetric and np.linalg.eigvalsh(correlation).min() > -_ROUNDING)
