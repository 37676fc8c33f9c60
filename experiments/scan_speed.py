"""Speed of a scan: lag and stiffness of rubber that relaxes, and the signal over the noise.

The signal of a rate sensor grows with the speed u. In a band that passes waves down to a fixed
wavelength, the Johnson noise grows as its square root, and sliding noise as u^n. Its exponent n
depends on the cause: 1/2 for bursts whose rate goes with u, 1 for a fraction of the signal.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import BadInput, mapping, number, number_range, numbers, refuse, whole
from srsinv.forward.contact_wake import wake_friction
from srsinv.forward.indentation import relative_modulus
from srsinv.forward.noise import BOLTZMANN_J_PER_K
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import Scene, SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import gain_at_rest
from srsinv.grid import Line
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity, spoken

NAME = "scan_speed"


def run(cfg: config.Config) -> Result:
    """The skin's lag, the pressure on the scene's surface, and signal over noise, over the speed.

    Raises `BadInput` for a scene without a surface, a sensor that has not one element, another
    amplifier than one of the rate, an elastic skin, and settings out of range.
    """
    given = cfg[NAME]
    speed, wavelength, shortest = _checked(given)
    growth = mapping(f"{NAME}.noise_growth", given["noise_growth"])
    with config.precision(cfg):
        line, scene, sensor = config.line(cfg), config.scene(cfg), config.sensor(cfg)
        scan = config.scan(cfg)
        scan.require_onwards()
        own = float(scan.speed_m_per_s)
        pressed = [pressed_at(line, scene, sensor, each) for each in (*speed, own)]
        pressure, signal, friction, height = (
            np.stack([one[at] for one in pressed]) for at in range(4)
        )
        hertz = speed[:, None] / wavelength
        modulus = relative_modulus(sensor.skin, hertz.ravel(), float(sensor.depth_m))
        resistance = gain_at_rest(sensor.amplifier)

    lag_rad = np.angle(modulus).reshape(hertz.shape)
    rms = np.sqrt(np.mean(signal**2, axis=-1))
    johnson = np.sqrt(
        4 * BOLTZMANN_J_PER_K * given["temperature_K"] * resistance * speed / shortest
    )
    sliding = np.stack([
        given["sliding_fraction"] * rms[-1] * (speed / own) ** float(n) for n in growth.values()
    ])  # fmt: skip
    ratio = 20 * np.log10(rms[:-1] / np.hypot(johnson, sliding))
    peak, uneven = pressure.max(axis=-1), asymmetry(pressure, height[0])
    data = dataset(
        {
            "lag": (("speed", "wavelength"), lag_rad / (2 * np.pi) * wavelength, "m"),
            "lag_angle": (("speed", "wavelength"), np.rad2deg(lag_rad), "deg"),
            "pressure": (("speed", "x"), pressure[:-1], "Pa"),
            "height": ("x", height[0], "m"),
            "peak_pressure": ("speed", peak[:-1], "Pa"),
            "asymmetry": ("speed", uneven[:-1], "1"),
            "lag_friction": ("speed", friction[:-1], "1"),
            "signal_rms": ("speed", rms[:-1], "V"),
            "johnson_rms": ("speed", johnson, "V"),
            "sliding_rms": (("noise", "speed"), sliding, "V"),
            "snr": (("noise", "speed"), ratio, "dB"),
            "best_speed": ("noise", speed[ratio.argmax(axis=-1)], "m/s",
                           "best_speed_{noise}_m_per_s"),
            "gained": ("noise", ratio.max(axis=-1) - ratio[:, 0], "dB", "snr_gained_{noise}_dB"),
            "exponent": ("noise", [float(n) for n in growth.values()], "1"),
            **scalars(_numbers(speed, rms, peak, uneven, friction)),
            **_ends(speed, wavelength, lag_rad),
        },
        {"speed": (speed, "m/s"), "wavelength": (wavelength, "m"), "x": (np.asarray(line.x), "m"),
         "noise": (list(growth), "1"), "end": (["slowest", "fastest"], "1")},
        skin=sensor.skin.words, speed_m_per_s=own, shortest_m=shortest, resistance_ohm=resistance,
        temperature_K=given["temperature_K"], sliding_fraction=given["sliding_fraction"],
        effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    plots = {"lags": draw_lags, "pressure": draw_pressure, "ratio": draw_ratio}
    return Result(_title(data), data, sections(__file__, **plots))


def _checked(given: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, float]:
    """Speeds, wavelengths and the shortest wavelength of the band."""
    wanted = "positive speeds in m/s"
    name = f"{NAME}.speed_range_m_per_s"
    low, high = number_range(name, given["speed_range_m_per_s"], wanted, above=0)
    wanted = "a whole number from 3 to 200"
    points = whole(f"{NAME}.points", given["points"], wanted, least=3, most=200)
    lengths = numbers(f"{NAME}.wavelengths_m", given["wavelengths_m"], "lengths in m", above=0)
    wanted = "a positive length in metres"
    shortest = number(f"{NAME}.shortest_m", given["shortest_m"], wanted, above=0)
    wanted = "a temperature above 0 K"
    number(f"{NAME}.temperature_K", given["temperature_K"], wanted, above=0)
    wanted = "a fraction that is at least 0"
    number(f"{NAME}.sliding_fraction", given["sliding_fraction"], wanted, least=0)
    growth = mapping(f"{NAME}.noise_growth", given["noise_growth"])
    refuse(not growth, f"{NAME}.noise_growth is empty: give exponents by name.")
    for cause, each in growth.items():
        number(f"{NAME}.noise_growth.{cause}", each, "a number, the exponent of the speed")
    return np.geomspace(low, high, points), np.array(lengths), shortest


def pressed_at(
    line: Line, scene: Scene, sensor: Sensor, speed: float
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Pressure, signal and the friction of the lag at a speed, and the surface's height."""
    sensor.require_elements(1)
    surface, skin = scene.contact_scene, sensor.skin.sliding_at(speed)
    if not isinstance(surface, SurfaceScene):
        raise BadInput("The scene has no surface: use scene=ridge, for example.")
    refuse(not skin.relaxes, "The skin is elastic: name viscoelastic_skin in effects.")
    refuse(sensor.amplifier.order != 1, "The amplifier gives no rate: use amplifier=current.")
    pressed = surface.with_skin(skin)
    p = pressed.pressure(line)
    signal = sensor.operator(line, ConstantSpeed(speed))(pressed.traction(line, 1.0, p))
    friction = float(wake_friction(line, skin, p).in_window)
    return np.asarray(p), np.asarray(signal)[0], friction, np.asarray(surface.height(line))


def asymmetry(
    pressure: Float[np.ndarray, "speed n"], height: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " speed"]:
    """Rms of the odd over that of the even part of the pressure less its mean, on a periodic line,
    about a crest of the strongest wave of the surface."""
    surface = np.fft.rfft(height)
    strongest = 1 + np.abs(surface[1:]).argmax()
    order = np.arange(surface.size) / strongest
    waves = np.fft.rfft(pressure) * np.exp(-1j * order * np.angle(surface[strongest]))
    return np.linalg.norm(waves[:, 1:].imag, axis=-1) / np.linalg.norm(waves[:, 1:].real, axis=-1)


def _numbers(
    speed: np.ndarray, rms: np.ndarray, peak: np.ndarray, uneven: np.ndarray, friction: np.ndarray
) -> dict[str, float]:
    """How signal and pressure change from the least to the greatest speed."""
    return {
        "signal_exponent": float(np.log(rms[-2] / rms[0]) / np.log(speed[-1] / speed[0])),
        "peak_pressure_ratio": float(peak[-2] / peak[0]),
        "asymmetry_slowest": float(uneven[0]),
        "asymmetry_fastest": float(uneven[-2]),
        "lag_friction_slowest": float(friction[0]),
        "lag_friction_fastest": float(friction[-2]),
    }


def _ends(
    speed: np.ndarray, wavelength: np.ndarray, lag_rad: np.ndarray
) -> dict[str, tuple[Any, ...]]:
    """The lag at the least and the greatest speed."""
    ends = lag_rad[[0, -1]]
    along = ("end", "wavelength")
    at = "{end}_at_{wavelength}_m"
    return {
        "end_lag": (along, ends / (2 * np.pi) * wavelength, "m", f"lag_m_{at}"),
        "end_lag_angle": (along, np.rad2deg(ends), "deg", f"lag_deg_{at}"),
        "end_speed": ("end", speed[[0, -1]], "m/s"),
    }


def _title(data: xarray.Dataset) -> str:
    most = float(data["gained"].max())
    which = data["noise"][int(np.argmax(data["gained"].values))].item()
    ends = [quantity(float(each), "m/s", digits=2) for each in data["end_speed"]]
    return (
        f"From {ends[0]} to {ends[1]} the peak pressure grows by a factor of "
        f"{float(data['peak_pressure_ratio']):.3g}, and the signal-to-noise ratio by up to "
        f"{most:.3g} dB ({spoken(which)})"
    )


def draw_lags(ds: xarray.Dataset) -> Figure:
    """Angle and distance of the displacement behind the pressure, over the speed."""
    at = {quantity(each, "m", digits=2): each for each in ds["wavelength"].values}
    panel = partial(plot.panel, along="speed", log="x")
    return plot.panels([[
        panel({n: ds["lag_angle"].sel(wavelength=w) for n, w in at.items()}, quantity="lag"),
        panel({n: ds["lag"].sel(wavelength=w) for n, w in at.items()}, quantity="lag distance"),
    ]])  # fmt: skip


def draw_pressure(ds: xarray.Dataset) -> Figure:
    """Pressure at the least, a middle and the greatest speed; friction and asymmetry."""
    chosen = ds["speed"].values[[0, ds.sizes["speed"] // 2, -1]]
    lines = {quantity(u, "m/s", digits=2): ds["pressure"].sel(speed=u) for u in chosen}
    panel = partial(plot.panel, along="speed", log="x")
    raised = ds["x"].values[ds["height"].values > ds["height"].values.max() / 2]
    middle, reach = raised.mean(), 3 * max(np.ptp(raised), 2e-4)
    return plot.panels([
        [plot.panel(lines, along="x", within=(middle - reach, middle + reach)),
         panel({"": ds["peak_pressure"]}, quantity="peak pressure")],
        [panel({"": ds["lag_friction"]}, quantity="friction of the lag"),
         panel({"": ds["asymmetry"]}, quantity="odd over even part")],
    ])  # fmt: skip


def draw_ratio(ds: xarray.Dataset) -> Figure:
    """Signal and noises over the speed, and their ratio."""
    names = {spoken(each): each for each in ds["noise"].values}
    noises = {n: ds["sliding_rms"].sel(noise=each) for n, each in names.items()}
    sizes = {"signal": ds["signal_rms"], "Johnson noise": ds["johnson_rms"]}
    return plot.panels([
        plot.panel(sizes | noises, along="speed", log="xy", quantity="rms"),
        plot.panel({n: ds["snr"].sel(noise=each) for n, each in names.items()}, along="speed",
                   log="x", quantity="signal-to-noise ratio"),
    ], legend="beside")  # fmt: skip
