"""The figure of textures: densities of height from the signal, over the true ones."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot

FULL, WEAK = "full contact, one recording, 90 %", "the same, less signal than noise"
LIGHT = "light pressure, mean of the draws"
DOTS = {"linestyle": "none", "markersize": 4}
LOOKS = {
    "true": {"color": "#000000"},
    FULL: {**DOTS, "color": "#0072b2", "marker": "o"},
    WEAK: {**DOTS, "color": "#b5bcc2", "marker": "o"},
    LIGHT: {**DOTS, "color": "#d55e00", "marker": "D"},
}


def height_densities(ds: xarray.Dataset) -> Figure:
    """Density of heights: true, from one recording with its band, and under light pressure."""
    band, usable = ds["band"].values, ds["usable"] == 1
    full, true = ds.sel(contact="full"), ds["height_density_true"].isel(wavenumber=slice(1, None))
    density, low, high = (full[f"height_density{end}"] for end in ("", "_low", "_high"))
    light = ds["height_density_mean"].sel(contact="light").where(usable)
    drawn = np.concatenate([each.where(usable).values.ravel() for each in (low, high, light)])
    drawn = drawn[drawn > 0]
    parts = []
    for name in ds["texture"].values:
        own = {"texture": name}
        chosen = {FULL: usable & (density > 0), WEAK: ~usable & (density > 0)}
        dots = {label: density.where(mask).sel(own) for label, mask in chosen.items()}
        bars = {
            label: (low.where(mask).sel(own), high.where(mask).sel(own))
            for label, mask in chosen.items()
        }
        parts.append(plot.panel(
            {"true": true.where(true > 0).sel(own), **dots, LIGHT: light.sel(own)}, looks=LOOKS,
            bars=bars, along="wavenumber k", quantity="density of height", log="xy",
            limits=(drawn.min() / 5, 5 * drawn.max()), within=(band[0] / 1.5, 1.3 * band[-1]),
            title=str(name).capitalize(),
        ))  # fmt: skip
    return plot.panels([parts], height_in=3.4)
