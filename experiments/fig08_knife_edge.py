"""The paper's Fig. 8: response of the resting film to a vibrating knife edge at a sequence of x."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray
from jaxtyping import Array
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline

from srsinv import config, plot
from srsinv.effects import Order
from srsinv.errors import number, number_range, numbers, refuse, whole
from srsinv.forward.knife_edge import KnifeEdge, VibratingEdge
from srsinv.forward.line_scan import integrated_scan
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scenario import Scenario
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import PERIOD_SAMPLES, gain_at_rest, measured
from srsinv.report.plot.style import TRUTH
from srsinv.report.result import Result, dataset
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity

NAME = "fig08_knife_edge"
OF_SKIN = (Order.SKIN, Order.SLIDING)
SKINS = ("theory", "rig")
MEASURED, FITTED = "rig, as measured", "theory, fitted in amplitude"
LOOKS = {MEASURED: {"linestyle": "none", "marker": ".", "color": TRUTH}}
ALONG = "position of the edge from the film"


def run(cfg: config.Config) -> Result:
    """The integrated signal over the edge's place, measured and of theory, in size and phase.

    Theory is a line load on the skin without effects, the rig an edge on the skin with them.
    Raises `BadInput` for a sensor that has not one element, an amplitude above the preload, and
    refusals of the configuration's parts.
    """
    given = _checked(cfg[NAME])
    with config.precision(cfg):
        orders = {name: each.order for name, each in config.effects(cfg).items()}
        on_film = {name for name, order in orders.items() if order not in OF_SKIN}
        theory, narrow = (
            config.at_rest(config.select_effects(cfg, names)).sensor
            for names in (on_film, on_film - {"strip_width"})
        )
        rig, scan = config.at_rest(cfg), config.scan(cfg)
        rig.sensor.require_elements(1)
        scan.require_onwards()
        strips = [_with_width(narrow, width) for width in given["widths_m"]]
        setup = Comparison(given, theory, rig, strips, scan)
        keys = jax.random.split(config.random_key(cfg), len(given["directions_deg"]))
        pairs = zip(given["directions_deg"], keys, strict=True)
        each = [setup.curves(direction, key) for direction, key in pairs]

    curves = {name: np.stack([one[name] for one in each]) for name in each[0]}
    data = dataset(
        _variables(curves, "V s" if rig.sensor.amplifier.order else rig.sensor.amplifier.unit),
        {"direction": (given["directions_deg"], "deg"), "place": (given["place_m"], "m"),
         "width": (given["widths_m"], "m"), "skin": (list(SKINS), "1")},
        effects_on=listed(cfg["effects"]), noise=listed(config.part(cfg, "noise")), **setup.facts,
    )  # fmt: skip
    return Result(
        _title(data), data, sections(__file__, rig=draw_rig, skins=draw_skins, slid=draw_slid)
    )


def _checked(settings: Any) -> dict[str, Any]:
    """The settings within their bounds, and the edge's places."""
    given, many = dict(settings), "a whole number from 3 to 10000"
    given["directions_deg"] = numbers(
        f"{NAME}.directions_deg", given["directions_deg"], "angles from -90 to 90 degrees",
        least=-90, most=90,
    )  # fmt: skip
    wanted = "positive widths in metres"
    given["widths_m"] = numbers(f"{NAME}.widths_m", given["widths_m"], wanted, above=0)
    ends = number_range(f"{NAME}.place_range_m", given["place_range_m"], "positions in metres")
    count = whole(f"{NAME}.places", given["places"], many, least=3, most=10000)
    given["place_m"] = np.linspace(*ends, count)
    number(f"{NAME}.frequency_hz", given["frequency_hz"], "a positive frequency in Hz", above=0)
    whole(
        f"{NAME}.periods", given["periods"], "a whole number from 1 to 10000", least=1, most=10000
    )
    loads = given["preload_N_per_m"], given["amplitude_N_per_m"]
    load = VibratingEdge(KnifeEdge(given["radius_m"]), *loads)
    refuse(
        load.amplitude_N_per_m > load.preload_N_per_m,
        f"{NAME}.amplitude_N_per_m is {load.amplitude_N_per_m:g}, above preload_N_per_m "
        f"({load.preload_N_per_m:g}), and the edge would leave the skin: give a smaller amplitude.",
    )
    return given


def _with_width(sensor: Sensor, width_m: float) -> Sensor:
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
    roots = CubicSpline(place, curve).roots(extrapolate=False)
    return min(map(float, roots), key=lambda x: (round(abs(x), 9), -x), default=float("nan"))


def _variables(curves: dict[str, np.ndarray], unit: str) -> dict[str, tuple[Any, ...]]:
    along, reading, fitted = ("direction", "place"), curves["measured"], curves["fitted"]
    phase = (np.rad2deg(np.angle(reading)) + 90) % 360 - 90
    peak = np.abs(curves["response"]).max(-1)
    whole_curves = {
        name: (("direction", dim, "place"), curves[name], unit)
        for name, dim in {"response": "skin", "response_of_width": "width"}.items()
    }
    ratios = {
        name: ("direction", curves[name], "1", f"{name}_{{direction}}_deg")
        for name in (
            "fitted_amplitude",
            "fit_residual",
            "fit_residual_without_noise",
            "mirror_error",
        )
    }
    return {
        **whole_curves,
        "measured": (along, np.real(reading), unit),
        "measured_magnitude": (along, np.abs(reading), unit),
        "measured_phase": (along, phase, "deg"),
        "fitted": (along, fitted, unit),
        "fitted_phase": (along, np.where(fitted < 0, 180.0, 0.0), "deg"),
        "sliding": (along, curves["sliding"], unit),
        **ratios,
        "peak": (("direction", "skin"), peak, unit, "peak_{skin}_{direction}_deg"),
        "sign_change": (("direction", "skin"), curves["sign_change"], "m",
                        "sign_change_{skin}_{direction}_deg_m"),
    }  # fmt: skip


def _title(data: xarray.Dataset) -> str:
    each = zip(data["direction"].values, data["fit_residual"].values, strict=True)
    rest = " and ".join(f"{100 * float(r):.2g} % at {float(angle):g}°" for angle, r in each)
    sign = abs(float(data["sign_change"].values[0, 1]))
    turn = f"; the phase turns by 180° {quantity(sign, 'm')} from the film"
    leaves = (
        f"A line load on theory's skin, fitted in amplitude, leaves {rest} of the rig's response"
    )
    return leaves + (turn if np.isfinite(sign) else "")


def draw_rig(ds: xarray.Dataset) -> Figure:
    """Integrated signal and its phase over the edge's place, a column for each direction."""

    def one(direction: float, end: str, word: str) -> plot.Panel:
        own = ds.sel(direction=direction)
        return plot.panel(
            {FITTED: own[f"fitted{end}"], MEASURED: own[f"measured{end}"]}, looks=LOOKS,
            quantity=word, along=ALONG, title=f"{word.capitalize()}, load at {direction:g}°",
        )  # fmt: skip

    kinds = ("", "integrated signal"), ("_phase", "phase")
    return plot.panels([[one(float(a), *kind) for a in ds["direction"].values] for kind in kinds])


def draw_skins(ds: xarray.Dataset) -> Figure:
    """The two skins, and strips of other widths, a column for each direction."""

    def one(direction: float, name: str, of: str, title: str) -> plot.Panel:
        own = ds[name].sel(direction=direction)
        words = {w: quantity(w, "m") if of == "width" else f"skin of {w}" for w in ds[of].values}
        lines = {word: own.sel({of: each}) for each, word in words.items()}
        return plot.panel(
            lines, quantity="integrated signal", along=ALONG, title=f"{title}, {direction:g}°"
        )

    kinds = ("response", "skin", "Skins"), ("response_of_width", "width", "Strip widths")
    return plot.panels([[one(float(a), *kind) for a in ds["direction"].values] for kind in kinds])


def draw_slid(ds: xarray.Dataset) -> Figure:
    """The rig's quasi-static curve and that of a scan, mirrored, a column for each direction."""

    def one(direction: float) -> plot.Panel:
        own = ds.sel(direction=direction)
        lines = {
            "rig at rest": own["response"].sel(skin="theory"),
            "scan, mirrored": own["sliding"],
        }
        return plot.panel(
            lines, looks={"scan, mirrored": {"linestyle": "--", "color": TRUTH}}, along=ALONG,
            quantity="integrated signal", title=f"Load at {direction:g}°",
        )  # fmt: skip

    return plot.panels([[one(float(a)) for a in ds["direction"].values]])
