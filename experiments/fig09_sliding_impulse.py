"""The paper's Fig. 9: effects of tilt and snap-back on an impulse that slides over the film."""

from typing import Any

import jax
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import refuse
from srsinv.forward.trace import trace
from srsinv.inverse.detection import finest_wavelength_m
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections

IDEAL, TILTED, SNAPPING = "ideal", "tilted", "tilted, snap-back"
BURST = ("rate_hz", "contact_m", "patch_m", "shear_Pa", "decay_s")
SHOWN_M = 5e-3  # on each side of the impulse


def run(cfg: config.Config) -> Result:
    """The signal of the impulse, ideal, from a tilted film, and with bursts of snap-back.

    Raises `BadInput` for a sensor that has not one element, without film_angle and snap_back among
    the effects, for fewer than 2 passes, and refusals of the configuration's parts.
    """
    passes, named = cfg["fig09_sliding_impulse"]["passes"], set(config.part(cfg, "effects"))
    refuse(passes < 2, f"fig09_sliding_impulse.passes is {passes}: give at least 2.")
    missing = sorted({"film_angle", "snap_back"} - named)
    refuse(
        bool(missing),
        f"effects lacks {missing and missing[0]}, which this experiment needs: add it "
        "to effects=[...].",
    )
    with config.precision(cfg):
        others = named - {"film_angle", "snap_back"}
        ideal = config.simulation(config.select_effects(cfg, others))
        ideal.sensor.require_elements(1)
        tilted = config.simulation(config.select_effects(cfg, others | {"film_angle"}))
        snapping, key = config.simulation(cfg), config.random_key(cfg)
        clean = np.stack([trace(sim, key).signal[0] for sim in (ideal, tilted)])
        each = np.stack([trace(snapping, one).signal[0] for one in jax.random.split(key, passes)])
        effects: dict[str, Any] = config.effects(cfg)
        bursts = effects["snap_back"]
        tilt_deg = float(np.rad2deg(effects["film_angle"].tilt_rad))

    unit, bursts_alone = ideal.sensor.amplifier.unit, each - clean[1]
    finest = finest_wavelength_m(np.asarray(ideal.line.k), clean[1], bursts_alone)
    numbers = {"bursts_rms_V": float(np.std(bursts_alone)), "finest_wavelength_m": finest}
    data = dataset(
        {
            "signal": (("case", "x"), clean, unit),
            "passes": (("pass_number", "x"), each, unit),
            **_lobes(clean, each, unit),
            **scalars(numbers),
        },
        {"case": ([IDEAL, TILTED], "1"), "x": (np.asarray(ideal.line.x), "m"),
         "pass_number": (np.arange(passes), "1"), "lobe": (["leading", "trailing"], "1"),
         "trace": ([IDEAL, TILTED, SNAPPING], "1")},
        tilt_deg=tilt_deg, speed_m_per_s=float(ideal.scan.speed_m_per_s),
        friction=config.part(cfg, "scene")["base_friction"], effects_on=", ".join(cfg["effects"]),
        **{f"burst_{name}": float(getattr(bursts, name)) for name in BURST},
    )  # fmt: skip
    leading, trailing = (f"{100 * each:.0f} %" for each in data["lobe_ratio"].values)
    lobes = f"the leading lobe to {leading} and the trailing lobe to {trailing}"
    title = f"A tilt of {tilt_deg:.3g}° changes {lobes}"
    return Result(title, data, sections(__file__, traces=draw_traces))


def _lobes(clean: np.ndarray, each: np.ndarray, unit: str) -> dict[str, tuple[Any, ...]]:
    """The largest size of the signal before and after the impulse, `lobe_peak` (trace, lobe): of
    the passes their mean, and as `lobe_scatter` their standard deviation."""
    half = clean.shape[-1] // 2

    def sizes(signal: np.ndarray) -> np.ndarray:
        return np.stack([np.abs(part).max(-1) for part in (signal[..., :half], signal[..., half:])])

    ideal, tilted = sizes(clean).T
    snapping = sizes(each)
    mean, scatter = snapping.mean(axis=1), snapping.std(axis=1)
    nothing = np.full(2, np.nan)
    by = ("trace", "lobe")
    return {
        "lobe_peak": (by, np.stack([ideal, tilted, mean]), unit),
        "lobe_scatter": (by, np.stack([nothing, nothing, scatter]), unit),
        "lobe_ratio": ("lobe", tilted / ideal, "1", "{lobe}_lobe_ratio"),
        **scalars({"leading_lobe_scatter": float(scatter[0] / ideal[0])}),
    }


def draw_traces(ds: xarray.Dataset) -> Figure:
    """The signals without bursts, one pass with bursts, and the mean of all passes."""
    passes, known = ds["passes"], {TILTED: ds["signal"].sel(case=TILTED)}
    mean = passes.mean("pass_number", keep_attrs=True)
    parts = {
        "Without bursts": {IDEAL: ds["signal"].sel(case=IDEAL)},
        "One pass with bursts": {"with bursts": passes[0]},
        f"Mean of {len(passes)} passes with bursts": {"with bursts": mean},
    }
    return plot.panels([
        plot.panel(
            own | known, looks={TILTED: {"linestyle": "--"}}, quantity="signal", title=title,
            along="position of the film from the impulse", within=(-SHOWN_M, SHOWN_M),
        )
        for title, own in parts.items()
    ], height_in=1.7)  # fmt: skip
