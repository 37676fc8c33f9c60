"""Figures of skin_design: height errors, hard outer layers, and stiff films."""

from functools import partial

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.style import names_of
from srsinv.report.text import spoken


def draw_height(ds: xarray.Dataset) -> Figure:
    """Change of the load over the error of the height, and signal of a vibrating drive."""
    backings = names_of(ds["backing"])
    load = {spoken(each): ds["load_error"].sel(backing=each) for each in backings}
    shaken = {spoken(each): ds["vibration_signal"].sel(backing=each) for each in backings}
    lost = plot.Mark(1.0, "the whole load", axis="y")
    ridge = plot.Mark(float(ds["ridge"].max()), "signal of the surface", axis="y")
    return plot.panels([[
        plot.panel(load, quantity="change over nominal load", along="height error", log="xy",
                   marks=[lost]),
        plot.panel(shaken, quantity="signal of vibration", along="frequency", log="xy",
                   marks=[ridge]),
    ]], height_in=2.6)  # fmt: skip


def draw_hardness(ds: xarray.Dataset) -> Figure:
    """Peaks over those of one material, over the ratio of the moduli."""
    loaded = {f"{each.replace('sigma_', 'σ')} at the film": ds["given_stress"].sel(stress=each)
              for each in names_of(ds["stress"])}  # fmt: skip
    pressed = {
        "pressure": ds["contact_pressure"],
        "σz at the film": ds["contact_stress"],
        "signal": ds["contact_signal"],
    }
    panel = partial(plot.panel, along="modulus of outer layer / of skin", log="x",
                    quantity="peak over that of one material", limits=(0, None))  # fmt: skip
    return plot.panels([[
        panel(loaded, title="Given line load"), panel(pressed, title="Contact with the surface")
    ]], height_in=2.6)  # fmt: skip


def draw_film(ds: xarray.Dataset) -> Figure:
    """Charge under a line load, and transfer from pressure, of each model of the film."""
    films = names_of(ds["film"])
    reach = 8 * ds.attrs["depth_m"]
    line = {each: ds["line_charge"].sel(film=each) for each in films}
    waves = {each: ds["transfer"].sel(film=each) for each in films}
    most = 10 / ds.attrs["depth_m"]
    return plot.panels([[
        plot.panel(line, quantity="charge", along="distance from the load",
                   within=(-reach, reach)),
        plot.panel(waves, quantity="charge per pressure", along="wavenumber", log="xy",
                   within=(None, most), limits=(float(ds["transfer"].max()) * 1e-4, None)),
    ]], height_in=2.6)  # fmt: skip
