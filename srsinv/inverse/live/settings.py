"""Settings of a live inversion, as numbers that can be stored."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ... import resolution
from ...errors import echo, number, refuse
from ...forward.amplifier import Amplifier
from ...forward.sensor import Sensor
from ...known import in_numpy

MEMORY_DEPTHS = 64  # of what the model remembers, where nothing else is given
LEAST_MEMORY = 4  # depths, of less there is no model
MOST_MEMORY = 4096  # cells, of more making the model takes minutes


class LiveSettings(NamedTuple):
    """Numbers that a live inversion keeps, arrays (of one number, where nothing else stands).

    - `cell_m`, `depth_m` [m]; `lag`, `memory` in cells.
    - `gain` (2,): of the amplifier, g_0 + g_1 u; `offset` (e,): of the signals, 0 where unknown.
    - `noise` (e,): the rms that was given, NaN where it is estimated.
    - `friction`: mu, NaN where q is independent; `nominal_pressure_Pa` [Pa].
    - `drift` (e,): rms after a second, in the signal's unit; `mains_Hz` (m,) [Hz]; `has_offset`:
      whether the signals have offsets that are not known.
    """

    cell_m: np.ndarray
    depth_m: np.ndarray
    lag: np.ndarray
    memory: np.ndarray
    gain: Float[np.ndarray, "2"]
    offset: Float[np.ndarray, " e"]
    noise: Float[np.ndarray, " e"]
    friction: np.ndarray
    nominal_pressure_Pa: np.ndarray
    drift: Float[np.ndarray, " e"]
    mains_Hz: Float[np.ndarray, " m"]
    has_offset: np.ndarray

    @property
    def elements(self) -> int:
        """The number of signals."""
        return self.noise.size

    @property
    def depth_cells(self) -> int:
        """Cells in a depth."""
        return max(round(float(self.depth_m / self.cell_m)), 1)

    @property
    def has_level(self) -> bool:
        """Whether each signal has an offset or a drift beside the traction's signal."""
        return bool(self.has_offset or self.drift.any())

    @property
    def nuisances(self) -> int:
        """The nuisance parameters of each element."""
        return self.has_level + 2 * self.mains_Hz.size

    @property
    def parameters(self) -> int:
        """The nuisance parameters of all elements."""
        return self.elements * self.nuisances

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        *,
        noise: Any,
        lag_m: Any,
        cell_m: Any,
        memory_m: Any,
        friction: Any,
        nominal_pressure_Pa: Any,
        drift: Any,
        mains_Hz: Sequence[float],
    ) -> "LiveSettings":
        """The settings as [`Live`][] takes them; it has what they are and what is refused."""
        elements, depth_m = len(sensor.elements), float(sensor.depth_m)
        cell_m = resolution.cell_m("live", depth_m) if cell_m is None else cell_m
        wanted = f"a width in metres, above 0 and up to the film's depth, {depth_m:.4g}"
        cell_m = float(number("cell_m", cell_m, wanted, above=0, most=depth_m))
        memory_m = MEMORY_DEPTHS * depth_m if memory_m is None else memory_m
        least, most = LEAST_MEMORY * depth_m, MOST_MEMORY * cell_m
        wanted = (
            f"a length in metres from {least:.4g} ({LEAST_MEMORY} depths) to {most:.4g} "
            f"({MOST_MEMORY} cells)"
        )
        memory_m = float(number("memory_m", memory_m, wanted, least=least, most=most))
        refuse(
            friction is None and elements < 2,
            "One element cannot determine both p and q: give friction (q = mu p) or a second "
            "element.",
        )
        mu = number("friction", 0.0 if friction is None else friction, "a finite number, or none")
        nominal_Pa = number("nominal_pressure_Pa", nominal_pressure_Pa, "a pressure in Pa")
        frequencies = [number("mains_Hz", each, "a frequency in Hz", above=0) for each in mains_Hz]
        if isinstance(noise, str):
            refuse(noise != "adaptive", f"noise is {echo(noise)}: give adaptive, or a level.")
            noise = np.full(elements, np.nan)
        else:
            noise = _of_each("noise", noise, elements)
        offset = sensor.amplifier.offset
        return cls(
            np.array(cell_m),
            np.array(depth_m),
            np.array(0),
            np.array(round(memory_m / cell_m)),
            _linear_gain(sensor.amplifier),
            np.full(elements, 0.0 if offset is None else float(offset)),
            noise,
            np.array(np.nan if friction is None else float(mu)),
            np.array(float(nominal_Pa)),
            _of_each("drift", drift, elements, may_be_zero=True),
            np.array(frequencies, float),
            np.array(offset is None),
        ).with_lag(lag_m)

    def with_lag(self, lag_m: Any) -> "LiveSettings":
        """The same settings with another lag [m]. Raises `BadInput` for one beyond the memory."""
        memory_m = float(self.memory * self.cell_m)
        wanted = f"a length in metres, from 0 to the memory, {memory_m:.4g}"
        number("lag_m", lag_m, wanted, least=0, most=memory_m)
        return self._replace(lag=np.array(round(float(lag_m / self.cell_m))))


def _of_each(name: str, values: Any, elements: int, may_be_zero: bool = False) -> np.ndarray:
    """One number for each element, of one for all or one for each."""
    each = np.ravel(np.asarray(values, float))
    is_valid = np.isfinite(each) & (each >= 0 if may_be_zero else each > 0)
    least = "at least 0" if may_be_zero else "above 0"
    refuse(
        each.size not in (1, elements) or not is_valid.all(),
        f"{name} is {echo(values)}: give one number {least}, or one for each of {elements} "
        "elements.",
    )
    return np.broadcast_to(each, elements).copy()


def _linear_gain(amplifier: Amplifier) -> Float[np.ndarray, "2"]:
    """g_0 and g_1 of an amplifier's gain g_0 + g_1 u."""
    speeds = np.array([0.0, 1.0, -1.0, 0.1])
    gain = np.broadcast_to(np.asarray(in_numpy(amplifier).gain(speeds), float), speeds.shape)
    line = np.array([gain[0], gain[1] - gain[0]])
    left = np.abs(gain - line[0] - line[1] * speeds)
    refuse(
        not bool(np.all(left <= 1e-9 * np.abs(gain).max())),
        f"The gain of {type(amplifier).__name__} is not linear in the speed, which a live "
        "inversion needs: give another amplifier, such as CurrentAmplifier().",
    )
    return line
