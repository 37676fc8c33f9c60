"""An edge that is driven by a sine, and how far its charge is from proportional to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import scipy

from srsinv.forward.indentation import Indentation, has_indentation
from srsinv.forward.knife_edge import KnifeEdge
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import harmonics

SAMPLES = 4096  # of a period: where the edge leaves the skin the charge has a kink
SINE = np.sin(2 * np.pi * np.arange(SAMPLES) / SAMPLES)
PAPER_DB = 3.0
Curve = Callable[[np.ndarray], np.ndarray]
Response = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Drive:
    """An edge over the resting film, its load or its displacement driven by a sine."""

    sensor: Sensor
    edge: KnifeEdge
    given: Mapping[str, Any]

    def allows(self, control: str) -> bool:
        """Whether the control is defined: a displacement needs a rigid core and a radius."""
        depth = float(self.sensor.depth_m)
        return control == "load" or has_indentation(self.edge, self.sensor.skin, depth)

    def response(self, control: str) -> Response:
        """From amplitudes over the preload to the first harmonic over what proportionality to small
        amplitudes gives, and the root of the squares of the others over the first."""
        most = 1 + self.given["amplitude"][-1]
        load_of, small = self._by_load() if control == "load" else self._by_displacement(most)
        largest = float(np.max(load_of(np.array([most]))))
        charge = self.edge.charge_of_load(self.sensor, self.given["place_m"], largest)

        def response(amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            load = load_of(np.maximum(1 + amplitude[:, None] * SINE[None], 0.0))
            each = np.abs(harmonics(charge(load)[0, 0]))
            first = each[:, 1]
            return first / (amplitude * abs(small)), np.linalg.norm(each[:, 2:], axis=1) / first

        return response

    def _by_load(self) -> tuple[Curve, float]:
        """The load [N/m] of a drive over its mean, and the amplitude of the charge over a small one
        of the drive."""
        preload = self.given["preload_N_per_m"]
        small = self.edge.charge_per_load(self.sensor, self.given["place_m"], preload).item()
        return lambda drive: preload * drive, preload * small

    def _by_displacement(self, most: float) -> tuple[Curve, float]:
        """The same for a displacement, of drives up to `most` times the preload's indentation."""
        relation = Indentation(self.edge, self.sensor.skin, float(self.sensor.depth_m))
        preload = np.array([self.given["preload_N_per_m"]], float)
        depth, softness = (f(preload).item() for f in (relation.indentation_m, relation.per_load))
        largest, (_, small) = float(preload[0]) * most, self._by_load()
        per_drive = small / preload[0] * depth / softness
        return lambda drive: relation.load_N_per_m(depth * drive, largest), float(per_drive)

    def swept(self, control: str) -> tuple[np.ndarray, np.ndarray, float]:
        """Deviation from proportionality [dB] and distortion (amplitude,), and the least amplitude
        at which the deviation is that of the paper, NaN if nowhere."""
        response, amplitude = self.response(control), self.given["amplitude"]

        def excess(at: float) -> float:
            return abs(20 * float(np.log10(response(np.array([at]))[0][0]))) - PAPER_DB

        gain, distortion = response(amplitude)
        level = 20 * np.log10(gain)
        outside = np.flatnonzero(np.abs(level) >= PAPER_DB)
        if not outside.size:
            return level, distortion, float("nan")
        after = outside[0]
        if after == 0:
            return level, distortion, float(amplitude[0])
        crossing = scipy.optimize.brentq(
            excess, float(amplitude[after - 1]), float(amplitude[after])
        )
        return level, distortion, cast(float, crossing)
