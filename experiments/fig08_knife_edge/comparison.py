"""Fig. 8's curves: theory, the rig, theory for other strips and a scan."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from jaxtyping import Array

from srsinv.forward.knife_edge import KnifeEdge, VibratingEdge
from srsinv.forward.line_scan import integrated_scan
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scenario import Scenario
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import PERIOD_SAMPLES, gain_at_rest, measured


def with_width(sensor: Sensor, width_m: float) -> Sensor:
    """The sensor with strips of another width, which average over it."""
    return sensor.with_films(
        lambda film: dataclasses.replace(film, width_m=width_m).with_strip_average()
    )


@dataclass(frozen=True)
class Comparison:
    """What is held side by side: theory, the rig, theory for other strips, and a scan."""

    given: dict[str, Any]
    theory: Sensor
    rig: Scenario
    strips: list[Sensor]
    scan: ConstantSpeed

    @property
    def facts(self) -> dict[str, Any]:
        """What the page says of the setup, in SI units."""
        sensor, edge = self.rig.sensor, KnifeEdge(self.given["radius_m"])
        half = edge.half_width_m(sensor.skin, self.given["preload_N_per_m"])
        return {
            "theory_skin": self.theory.skin.words,
            "rig_skin": sensor.skin.words,
            "strip_width_m": float(sensor.elements[0].width_m),
            "depth_m": float(sensor.depth_m),
            "half_width_m": float(half),
            "speed_m_per_s": float(self.scan.speed_m_per_s),
            **{key: value for key, value in self.given.items() if np.isscalar(value)},
        }

    def curves(self, direction_deg: float, key: Array) -> dict[str, Any]:
        """Curves over the edge's place for one direction of the load, and the fit of theory."""
        given, angle, sensor = self.given, np.deg2rad(direction_deg), self.rig.sensor
        loads = given["preload_N_per_m"], given["amplitude_N_per_m"]
        line, edge = (
            VibratingEdge(KnifeEdge(radius, angle), *loads) for radius in (0.0, given["radius_m"])
        )
        theory, real = self._quasi_static(line, self.theory), self._quasi_static(edge, sensor)
        reading, slid = self._read(edge, key), self._slid(angle)
        amplitude, residual = _fit(theory, np.real(reading))
        mirror = theory - theory[-1] - slid
        changes = [_sign_change(given["place_m"], each) for each in (theory, real)]
        return {
            "response": np.stack([theory, real]),
            "response_of_width": np.stack([self._quasi_static(line, s) for s in self.strips]),
            "measured": reading,
            "fitted": amplitude * theory,
            "sliding": slid + theory[-1],
            "fitted_amplitude": amplitude,
            "fit_residual": residual,
            "fit_residual_without_noise": _fit(theory, real)[1],
            "mirror_error": np.max(np.abs(mirror)) / np.max(np.abs(theory)),
            "sign_change": changes,
        }

    def _quasi_static(self, load: VibratingEdge, sensor: Sensor) -> np.ndarray:
        """The signal integrated over time, in phase with the load."""
        return gain_at_rest(sensor.amplifier) * load.small_charge(sensor, self.given["place_m"])[0]

    def _read(self, load: VibratingEdge, key: Array) -> np.ndarray:
        """The rig's integrated signal as a lock-in reads it, complex."""
        given, sensor = self.given, self.rig.sensor
        charge = load.charge_over_period(sensor, given["place_m"], PERIOD_SAMPLES)[0]
        signal = measured(self.rig, charge, given["frequency_hz"], given["periods"], key)
        return signal / (2j * np.pi * given["frequency_hz"]) ** sensor.amplifier.order

    def _slid(self, angle_rad: float) -> np.ndarray:
        """The integrated signal of a scan over a line load of this direction, q = p tan(angle),
        with the film at minus the edge's place, less its first value."""
        along = np.array([np.cos(angle_rad), np.sin(angle_rad)])
        ideal = dataclasses.replace(self.theory, filters=())
        loads = self.given["amplitude_N_per_m"] * along
        film = -self.given["place_m"][::-1]
        return integrated_scan(ideal, self.scan, tuple(loads), film)[0, ::-1]


def _fit(theory: np.ndarray, curve: np.ndarray) -> tuple[float, float]:
    """The amplitude of theory by least squares, and the rms that it leaves over the curve's."""
    amplitude = float(theory @ curve / (theory @ theory))
    return amplitude, float(np.linalg.norm(curve - amplitude * theory) / np.linalg.norm(curve))


def _sign_change(place: np.ndarray, curve: np.ndarray) -> float:
    """Where the curve changes its sign nearest to the film [m], of two alike the one at x > 0; NaN
    if nowhere."""
    roots = scipy.interpolate.CubicSpline(place, curve).roots(extrapolate=False)
    return min(map(float, roots), key=lambda x: (round(abs(x), 9), -x), default=float("nan"))
