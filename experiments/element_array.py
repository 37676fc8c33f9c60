"""Aliasing of an array of elements at rest, beside one element that scans.

An array samples the charge along x at its pitch P, and folds every wave shorter than 2 P into a
longer one. The film's depth and the width of its strips are the only filter before the samples. An
element that scans at the speed u samples every u/f_s.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from jaxtyping import Complex, Float
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import number, number_range, numbers, refuse, whole
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import apparent_frequency_hz
from srsinv.grid import Periodic
from srsinv.report.data import dataset, scalars
from srsinv.report.plot.style import TRUTH
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity

NAME = "element_array"
LENGTHS = "positive lengths in metres"
SHOWN_M = 0.012  # of the grating's charge


def run(cfg: config.Config) -> Result:
    """The aliased share of a texture's power over pitch and depth, and a grating as arrays show it.

    Raises `BadInput` for a sensor that has not one element, a line that is not periodic, and
    settings that are not positive.
    """
    given = cfg[NAME]
    pitch = np.array(numbers(f"{NAME}.pitches_m", given["pitches_m"], LENGTHS, above=0))
    grating = number(f"{NAME}.grating_m", given["grating_m"], "a positive length", above=0)
    rate = number(f"{NAME}.sample_rate_hz", given["sample_rate_hz"], "a positive rate", above=0)
    wanted = "a share above 0 and below 1"
    limit = number(f"{NAME}.share", given["share"], wanted, above=0, below=1)
    depth, wavelength = _along("depth_range_m", given), _along("wavelength_range_m", given)
    with config.precision(cfg):
        line, sensor, scan = config.line(cfg), config.sensor(cfg), config.scan(cfg)
        sensor.require_elements(1)
        refuse(not isinstance(line, Periodic), "A texture repeats: give grid.line=periodic.")
        traction, k = config.scene(cfg).traction(line), np.asarray(line.k)
        waves = np.fft.rfft(np.asarray(traction))
        own = float(sensor.elements[0].depth_m)
        power = np.abs(_charge(sensor, k, waves, np.append(depth, own))) ** 2
        friction = np.stack([np.ones(1), config.scene(cfg).friction(line)[:1]])
        size = np.abs(_charge(sensor, 2 * np.pi / wavelength, friction, [own]))[0]

    lengths = np.append(wavelength, grating)
    spacing = float(scan.speed_m_per_s) / rate
    share = np.array([[aliased_share(each, k, p) for each in power] for p in pitch])
    per_m = np.stack([apparent_frequency_hz(1 / lengths, 1 / each) for each in pitch])
    apparent = np.divide(1, per_m, out=np.full_like(per_m, np.inf), where=per_m > 1e-9 / grating)
    ends = np.append(apparent[:, -1], grating)
    within = np.interp(ends, wavelength, size, left=np.nan, right=np.nan)
    x = np.arange(0, SHOWN_M, grating / 100)
    data = dataset(
        {
            "aliased_share": (("pitch", "depth"), share[:, :-1], "1"),
            "share_at_depth": ("pitch", share[:, -1], "1", "aliased_share_at_{pitch}_m"),
            "depth_needed": ("pitch", [depth_for(limit, each, depth) for each in share[:, :-1]],
                             "m", "depth_for_share_at_{pitch}_m"),
            "charge_per_pressure": ("wavelength", size, "C/Pa"),
            "apparent_wavelength": (("pitch", "wavelength"), apparent[:, :-1], "m"),
            "apparent_grating": ("pitch", apparent[:, -1], "m", "grating_seen_at_{pitch}_m"),
            "apparent_strength": ("pitch", within[-1] / within[:-1], "1",
                                  "grating_strength_at_{pitch}_m"),
            "grating_charge": ("x", np.cos(2 * np.pi * x / grating), "1"),
            **scalars({
                "aliased_share_scan": aliased_share(power[-1] * k**2, k, spacing),
                "scan_spacing_m": spacing,
            }),
        },
        {"pitch": (pitch, "m"), "depth": (depth, "m"), "wavelength": (wavelength, "m"),
         "x": (x, "m")},
        depth_m=own, share=limit, grating_m=grating, sample_rate_hz=rate,
        speed_m_per_s=float(scan.speed_m_per_s), effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    shown = sections(__file__, texture=draw_texture, grating=draw_grating)
    return Result(_title(data), data, shown)


def _along(name: str, given: Any) -> Float[np.ndarray, " n"]:
    low, high = number_range(f"{NAME}.{name}", given[name], LENGTHS, above=0)
    wanted = "a whole number from 3 to 2000"
    points = whole(f"{NAME}.points", given["points"], wanted, least=3, most=2000)
    return np.geomspace(low, high, points)


def _charge(
    sensor: Sensor, k: np.ndarray, traction: np.ndarray, depths_m: Any
) -> Complex[np.ndarray, "depth k"]:
    """The charge of waves of traction (2, k) on a film at each depth."""
    along = jnp.asarray(k)

    def one(depth_m: float) -> np.ndarray:
        moved = sensor.with_films(lambda film: dataclasses.replace(film, depth_m=depth_m))
        return np.sum(np.asarray(moved.charge().transfer(along))[0] * traction, axis=0)

    return np.stack([one(float(each)) for each in depths_m])


def aliased_share(
    power: Float[np.ndarray, " k"], k: Float[np.ndarray, " k"], pitch_m: float
) -> float:
    """The share of the power at wavenumbers > 0 that samples `pitch_m` apart fold into longer
    waves."""
    share = float(power[k > np.pi / pitch_m].sum() / power[k > 0].sum())
    return share if share > np.finfo(float).eps else 0.0  # less is rounding of the spectrum


def depth_for(share: float, shares: np.ndarray, depth: np.ndarray) -> float:
    """The least depth from which on the share is not above `share`; NaN where there is none."""
    over = np.flatnonzero(shares > share)
    if not over.size:
        return float(depth[0])
    at = int(over[-1])
    if at + 1 == depth.size:
        return float("nan")
    ends = np.log(shares[at + 1 : at - 1 if at else None : -1]), np.log(depth[[at + 1, at]])
    return float(np.exp(np.interp(np.log(share), *ends)))


def _title(data: xarray.Dataset) -> str:
    first, last = (data.isel(pitch=at) for at in (0, -1))
    shares = [f"{100 * float(each['share_at_depth']):.2g} %" for each in (first, last)]
    at = [quantity(float(each["pitch"]), "m", digits=2) for each in (first, last)]
    return (
        f"Arrays at {at[0]} to {at[1]} alias {shares[0]} to {shares[1]} of the texture's power; "
        f"an element that scans aliases {100 * float(data['aliased_share_scan']):.2g} %"
    )


def draw_texture(ds: xarray.Dataset) -> Figure:
    """The aliased share over depth, and the wavelength that an array shows over the true one."""
    names = {quantity(each, "m", digits=2): each for each in ds["pitch"].values}
    share = {f"pitch {n}": ds["aliased_share"].sel(pitch=at) for n, at in names.items()}
    shown = {f"pitch {n}": ds["apparent_wavelength"].sel(pitch=at) for n, at in names.items()}
    own = plot.Mark(ds.attrs["depth_m"], "the film's depth")
    most = 2 * float(ds["wavelength"].max())
    return plot.panels([[
        plot.panel(share, quantity="aliased share of the power", along="film depth", log="xy",
                   limits=(1e-6, 1), marks=[own], title="Texture"),
        plot.panel(shown, quantity="wavelength in the samples", along="true wavelength", log="xy",
                   limits=(None, most), title="Sinusoids"),
    ]], height_in=2.6)  # fmt: skip


def draw_grating(ds: xarray.Dataset) -> Figure:
    """The grating's charge along x, the samples of each array, and the wave through them."""
    x, parts = ds["x"].values, []
    for pitch, shown in zip(ds["pitch"].values, ds["apparent_grating"].values, strict=True):
        at = np.arange(0, x[-1], pitch)
        curves = [
            plot.Curve(ds["grating_charge"].values, "charge at the film", look={"color": TRUTH}),
            plot.Curve(np.cos(2 * np.pi * x / shown), "wave in the samples"),
            plot.Curve(np.cos(2 * np.pi * at / ds.attrs["grating_m"]), "elements", x=at,
                       look={"linestyle": "", "marker": "o", "markersize": 4}),
        ]  # fmt: skip
        up = plot.PanelAxis("relative charge")
        title = f"Array at {quantity(float(pitch), 'm', digits=2)}"
        parts.append(plot.Panel(curves, plot.PanelAxis("x", "m"), up, x, title))
    return plot.panels(parts, height_in=1.6)
