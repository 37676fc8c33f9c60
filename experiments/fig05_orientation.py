"""The paper's Fig. 5: response of a film flat in the skin and of one on edge to a line load."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy
import xarray
from jaxtyping import Float
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import number
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.traction import UniformStrip
from srsinv.inverse.estimate import full_width_at_half_maximum
from srsinv.report.data import dataset, scalars
from srsinv.report.plot.style import TRUTH, colours
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity
from srsinv.targets import make

P, Q = colours("pq").values()
LOADS = {  # with their looks
    "p alone": {"color": P},
    "q alone": {"color": Q},
    "p with friction": {"color": TRUTH, "linestyle": "--"},
}
KZ = np.geomspace(1e-2, 10, 301)  # wavenumbers times depth
SHOWN_M = 6e-3  # on each side of the load: what follows is its far field


def run(cfg: config.Config) -> Result:
    """Charge and voltage of every element under the line load, and the pair's condition number.

    Raises `BadInput` for a load of no width, and refusals of the configuration's parts.
    """
    settings = cfg["fig05_orientation"]
    load, width, mu = (settings[k] for k in ("load_N_per_m", "load_width_m", "friction"))
    number("fig05_orientation.load_width_m", width, "a positive length in metres", above=0)
    with config.precision(cfg):
        line, sensor, scan = config.line(cfg), config.sensor(cfg), config.scan(cfg)
        sensor.require_elements(2)
        x = np.asarray(line.x)
        p = UniformStrip(load / width, width).cell_average(line)
        tractions = [jnp.outer(jnp.asarray(each), p) for each in ((1, 0), (0, 1), (1, mu))]
        stages = sensor.charge(), sensor.output(scan), sensor.stress()
        charge, voltage, stress = (
            np.stack([line.operator(each)(traction) for traction in tractions]) for each in stages
        )
        separation = _separation(sensor, make(cfg["skin"], "skin", "half_space"))

    angles = [f"{round(np.rad2deg(float(film.angle_rad)))}" for film in sensor.elements]
    peak, along = np.abs(charge).max(axis=-1), ("load", "element", "x")
    depth = float(sensor.elements[0].depth_m)
    width_of_stress = full_width_at_half_maximum(x / depth, -stress[0, 1])
    data = dataset(
        {
            "charge": (along, charge, "C"),
            "signal": (along, voltage, sensor.amplifier.unit),
            "peak_charge": (along[:2], peak, "C", "peak_charge_{load}_at_{element}_deg_C"),
            "sigma_z_from_p": ("x", stress[0, 1], "Pa"),
            **scalars({"fwhm_sigma_z_over_depth": width_of_stress}),
            "similarity_of_charge": (along[:1], similarity(charge), "1",
                                     "similarity_of_charge_{load}"),
            "similarity": (along[:1], similarity(voltage), "1", "similarity_of_signal_{load}"),
            **separation,
        },
        {"load": (list(LOADS), "1"), "element": (angles, "deg"), "x": (x, "m"),
         "stresses": (["difference", "sum"], "1"), "kz": (KZ, "1")},
        load_N_per_m=load, friction=mu, effects_on=listed(cfg["effects"]),
        speed_m_per_s=float(scan.speed_m_per_s),
    )  # fmt: skip
    each = [f"{quantity(c, 'C')} at {angle}°" for c, angle in zip(peak[0], angles, strict=True)]
    title = f"A line pressure of {load:g} N/m gives peak charges of {each[0]} and {each[1]}"
    return Result(title, data, sections(__file__, responses=draw_responses))


def _separation(sensor: Sensor, skin: HalfSpace) -> dict[str, tuple[Any, ...]]:
    """How well the pair separates the stresses, and p from q over wavenumber times depth."""
    gains = stress_gains(sensor, float(skin.poisson_ratio))
    number = condition(sensor, KZ / float(sensor.elements[0].depth_m))
    return {
        "gain": ("stresses", gains, "C/N", "gain_{stresses}_C_per_N"),
        "condition": ("kz", number, "1"),
        **scalars({
            "condition_least": number.min(),
            "condition_least_at_kz": KZ[number.argmin()],
            "condition_long_waves": number[0],
        }),
    }  # fmt: skip


def draw_responses(ds: xarray.Dataset) -> Figure:
    """Charge and signal of each element under each load."""
    return plot.panels([
        [
            plot.panel(
                {load: ds[name].sel(element=angle, load=load) for load in LOADS}, looks=LOADS,
                along="position of the film from the load", within=(-SHOWN_M, SHOWN_M),
                title=f"Film at {angle}°: {name}",
            )
            for name in ("charge", "signal")
        ]
        for angle in ds["element"].values
    ])  # fmt: skip


def stress_gains(sensor: Sensor, poisson_ratio: float) -> Float[np.ndarray, "2"]:
    """Charge per area and stress [C/N] of the combinations of sigma_x and sigma_z that the elements
    measure best and least, in plane strain with sigma_y = nu (sigma_x + sigma_z)."""
    films = sensor.elements
    area = films[0].width_m * films[0].length_m
    per_stress = np.stack([film.charge_per_stress() for film in films]) / float(area)
    in_plane = per_stress[:, :2] + poisson_ratio * per_stress[:, 3:]
    return np.linalg.svd(in_plane, compute_uv=False)


def similarity(responses: Float[np.ndarray, "load 2 x"]) -> Float[np.ndarray, " load"]:
    """Normalised cross-correlation of the pair's responses at the shift where it is largest in
    size: 1 or -1 where one is a multiple of the other, shifted along x."""
    sizes = np.linalg.norm(responses, axis=-1).prod(axis=-1)
    shifted = np.stack([scipy.signal.correlate(*pair) for pair in responses])
    at = np.abs(shifted).argmax(axis=-1)[:, None]
    return np.take_along_axis(shifted, at, -1)[:, 0] / sizes


def condition(sensor: Sensor, k: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Condition number of the elements' charge per p and q at wavenumbers above 0 [rad/m]. What all
    entries have in common, as the decay over the depth, is not in it."""
    pair = np.moveaxis(np.asarray(sensor.charge().transfer(jnp.asarray(k))), -1, 0)
    return np.linalg.cond(pair)
