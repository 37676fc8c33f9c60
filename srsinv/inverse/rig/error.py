"""How well a rig is known: the covariance of a calibration, as signals that an estimate allows for.

A calibration determines gains, depth, angles and offsets c to within a covariance S = L L^T. To
first order the signal is then m + sum_j s_j (dm/dc L)_j with s_j normal of variance one: columns
that enter linearly, under priors of their own. Fitted beside the parameters they carry the
calibration's error into all that a fit gives; inversions carry it as line/rig_bands.py says.
"""

import abc
import re
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Shaped

from ...errors import refuse
from ...forward.film import Film, Offset
from ...forward.sensor import Sensor

_OF_ELEMENT = re.compile(
    r"gain_([1-9][0-9]{0,3})|angle_([1-9][0-9]{0,3})_deg|offset_([1-9][0-9]{0,3})_m"
)
_ROUNDING = 1e-6  # of a correlation, as numbers written by hand have it
_DEPTH = "depth_m"


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
        signal_of: Callable[[Sensor], Any],
    ) -> Shaped[np.ndarray, "k e *sample"]:
        """What one standard deviation in each direction adds to the `fitted` signals; `signal_of`
        gives those of another sensor. Transfer functions may stand for signals; of a motion that
        turns each film is there for the way back, too."""


class RigError(SensorError):
    """The covariance (k, k) of parameters of a rig, and their values (k,): `gain_N`, `depth_m`,
    `angle_N_deg`, `offset_N_m`, N from 1."""

    names: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]

    @property
    def words(self) -> str:
        return ", ".join(self.names)

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
            f"{name}: the sidecar's rig_error is damaged, as its values and covariance are not "
            f"those of {size} parameters: run experiment=calibrate again.",
        )
        stderr = np.sqrt(np.diag(covariance))
        for each, value, error in zip(names, values, stderr, strict=True):
            of_element = _OF_ELEMENT.fullmatch(each)
            number = int(of_element[of_element.lastindex or 1]) if of_element else 0
            refuse(
                each != _DEPTH and not 1 <= number <= elements,
                f"{name}: the sidecar's rig_error has {each!a}, and the recording {elements} "
                "channels: give the sidecar of this rig.",
            )
            # A gain is divided by, and a depth changed by its error.
            wrong = value == 0 if each.startswith("gain_") else each == _DEPTH and value <= error
            refuse(
                bool(wrong),
                f"{name}: the sidecar's rig_error has {each} = {value:g} +- {error:g}, which no "
                "calibration determines: run experiment=calibrate again.",
            )
        return cls(names, values, covariance)

    def columns(
        self,
        sensor: Sensor,
        fitted: Shaped[np.ndarray, "e *sample"],
        signal_of: Callable[[Sensor], Any],
    ) -> Shaped[np.ndarray, "k e *sample"]:
        slopes = np.stack([
            self._slope(i, sensor, np.asarray(fitted), signal_of) for i in range(len(self.names))
        ])  # fmt: skip
        stderr = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / stderr[:, None] / stderr
        strength, axes = np.linalg.eigh(correlation)
        root = stderr[:, None] * axes * np.sqrt(np.maximum(strength, 0.0))
        return np.einsum("ij,i...->j...", root, slopes)

    def _slope(self, i: int, sensor: Sensor, fitted, signal_of) -> Shaped[np.ndarray, "e *sample"]:
        """The derivative of the signal by one parameter."""
        name, step = self.names[i], float(np.sqrt(self.covariance[i, i]))
        if name.startswith("gain_"):
            own = np.zeros_like(fitted)
            channels = slice(int(name.removeprefix("gain_")) - 1, None, _films(sensor))
            own[channels] = fitted[channels] / self.values[i]
            return own
        above, below = (
            signal_of(_with_parameter_changed(sensor, name, sign * step)) for sign in (1, -1)
        )
        return (np.asarray(above) - np.asarray(below)) / (2 * step)


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


def _films(sensor: Sensor) -> int:
    """How many films there are, each counted once where it is there for both ways."""
    return sum(not film.is_backward for film in sensor.elements)


def _with_parameter_changed(sensor: Sensor, name: str, by: float) -> Sensor:
    """The sensor with one parameter changed by so much."""

    def depth(film: Film) -> Film:
        return eqx.tree_at(lambda f: f.depth_m, film, film.depth_m + by)

    def angle(film: Film) -> Film:
        return eqx.tree_at(lambda f: f.angle_rad, film, film.angle_rad + np.deg2rad(by))

    def offset(film: Film) -> Film:
        return film.with_effect(Offset(by))

    if name == _DEPTH:
        films = [depth(film) for film in sensor.elements]
    else:
        kind, number = name.split("_")[:2]
        change = {"angle": angle, "offset": offset}[kind]
        count, own = _films(sensor), int(number) - 1
        films = [
            change(film) if n % count == own else film for n, film in enumerate(sensor.elements)
        ]
    return eqx.tree_at(lambda s: s.elements, sensor, tuple(films))
