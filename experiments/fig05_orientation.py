"""The paper's Fig. 5: response of a film flat in the skin and one on edge to a line load."""

import jax.numpy as jnp
import numpy as np
import xarray

from srsinv import config
from srsinv.errors import refuse
from srsinv.forward.traction import UniformStrip
from srsinv.report import figures
from srsinv.report.figures import curves
from srsinv.report.figures.estimates import full_width_at_half_maximum
from srsinv.report.outcome import Outcome, Section, Table
from srsinv.report.text import listed
from srsinv.targets import make

LOADS = ("p alone", "q alone", "p with friction")


def run(cfg: config.Config) -> Outcome:
    """Charge and voltage of every element under the line load, and the pair's condition number.

    Raises `BadInput` for a load of no width, and refusals of the configuration's parts.
    """
    settings = cfg["fig05_orientation"]
    load, width, mu = (settings[k] for k in ("load_N_per_m", "load_width_m", "friction"))
    with config.precision(cfg):
        line, sensor, scan = config.line(cfg), config.sensor(cfg), config.scan(cfg)
        x, films = np.asarray(line.x), sensor.elements
        refuse(
            len(films) != 2,
            f"sensor has {len(films)} elements: give 2, use sensor=two_element.",
        )
        p = UniformStrip(load / width, width).cell_average(line)
        tractions = {"p alone": (1, 0), "q alone": (0, 1), "p with friction": (1, mu)}

        def responses(stage):
            respond = line.operator(stage)
            return np.stack([respond(jnp.outer(jnp.asarray(t), p)) for t in tractions.values()])

        charge, voltage = responses(sensor.charge()), responses(sensor.output(scan))
        sigma_z = responses(sensor.stress())[0, 1]

        depth, area = films[0].depth_m, films[0].width_m * films[0].length_m
        per_stress = np.stack([film.charge_per_stress() for film in films]) / float(area)
        # Plane strain: sigma_y = nu (sigma_x + sigma_z).
        skin = make(cfg["skin"], "skin", "half_space")
        per_pair = per_stress[:, :2] + float(skin.poisson_ratio) * per_stress[:, 3:]
        gains = np.linalg.svd(per_pair, compute_uv=False)
        kz = jnp.geomspace(1e-2, 10, 301)
        pair = np.moveaxis(np.asarray(sensor.charge().transfer(kz / depth)), -1, 0)
        condition = np.linalg.cond(pair)

    angles = [f"{round(np.rad2deg(float(film.angle_rad)))}" for film in films]
    peak_charge = np.abs(charge).max(axis=-1)
    metrics = {
        "fwhm_sigma_z_over_depth": full_width_at_half_maximum(x, -sigma_z) / float(depth),
        "gain_difference_C_per_N": gains[0],
        "gain_sum_C_per_N": gains[1],
        "condition_least": condition.min(),
        "condition_least_at_kz": float(kz[condition.argmin()]),
        "condition_long_waves": condition[0],
    } | {
        f"peak_charge_{name.replace(' ', '_')}_at_{angle}_deg_C": peak_charge[i, e]
        for i, name in enumerate(LOADS)
        for e, angle in enumerate(angles)
    }
    assumed = (
        "Half space in plane strain; open line, nothing beyond its ends; constant speed "
        f"{float(scan.speed_m_per_s):g} m/s; no noise.",
        f"Effects on: {listed(cfg['effects'])}. The width of sigma_z is that of the stress at the "
        "film, before the strip averages it over its own width.",
    )
    along = ("load", "element", "x")
    dataset = xarray.Dataset(
        {
            "charge": (along, charge, {"units": "C"}),
            "signal": (along, voltage, {"units": sensor.amplifier.unit}),
            "sigma_z_from_p": (("x",), sigma_z, {"units": "Pa"}),
            "condition": (("kz",), condition, {"units": "1"}),
        },
        {
            "load": ("load", list(LOADS), {"units": "1"}),
            "element": ("element", angles, {"units": "deg"}),
            "x": ("x", x, {"units": "m"}),
            "kz": ("kz", np.asarray(kz), {"units": "1"}),
        },
    )
    return Outcome(
        f"What the two orientations feel of a line load of {load:g} N/m",
        {key: float(value) for key, value in metrics.items()},
        dataset,
        _sections(dataset, metrics, mu, assumed),
        Table(
            ("load", *(f"peak charge at {angle} deg [pC]" for angle in angles)),
            tuple(
                (name, *(1e12 * c for c in row))
                for name, row in zip(LOADS, peak_charge.tolist(), strict=True)
            ),
        ),
    )


def _sections(
    ds: xarray.Dataset, metrics, mu: float, assumed: tuple[str, ...]
) -> tuple[Section, ...]:
    near = ds.sel(x=slice(-6e-3, 6e-3))

    def responses():
        parts = [
            figures.Panel(
                title=f"{what} of the element at {near['element'].values[e]}°",
                ylabel=f"{what.lower()} [{prefix}{unit}]",
                lines={name: scale * near[key].values[i, e] for i, name in enumerate(LOADS)},
            )
            for e in range(near.sizes["element"])
            for what, key, prefix, unit, scale in (
                ("Charge", "charge", "p", "C", 1e12),
                ("Signal", "signal", "µ", ds["signal"].attrs["units"], 1e6),
            )
        ]
        return figures.panels(near["x"].values, parts, "position of the film from the load")

    def conditioning():
        lines = {"two elements": ds["condition"].values}
        label = "wavenumber times depth, kz [1]"
        return curves.figure(
            ds["kz"].values, lines, label, "condition number [1]", logarithmic="xy"
        )

    difference, total = (1e12 * metrics[f"gain_{key}_C_per_N"] for key in ("difference", "sum"))
    named = ("least", "least_at_kz", "long_waves")
    least, at, long_waves = (metrics[f"condition_{key}"] for key in named)
    return (
        Section(
            "Response to a line load",
            (f"0° is the film flat in the skin (axis 1 along x, 3 along z), 90° the film on edge. "
             f"The load presses in by p, pulls along +x by q, or does both with q = {mu:g} p.",),
            {"responses": responses},
            {"responses": "Pressure gives an even charge, of opposite sign in the two films; shear "
             "an odd one, with long tails from sigma_x. Friction tilts the trace towards one "
             "side. The signal is the rate of the charge, largest on the trace's flanks."},
        ),
        Section(
            "How well the pair tells p from q",
            (f"The pair sees sigma_z - sigma_x with {difference:.3g} pC/N (the difference of its "
             f"charges) and sigma_z + sigma_x with only {total:.3g} pC/N (their sum).",),
            {"condition": conditioning},
            {"condition": f"Never better than {least:.3g}, at kz = {at:.2g}; {long_waves:.3g} at "
             "long waves. The decay e^-kz is the same for all entries and is not in this number."},
        ),
        Section("What was assumed", assumed),
    )  # fmt: skip
