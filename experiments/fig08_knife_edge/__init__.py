"""The paper's Fig. 8: response of the resting film to a vibrating knife edge at a sequence of x."""

from typing import Any

import jax
import numpy as np
import xarray

from srsinv import config
from srsinv.effects import Order
from srsinv.errors import number, number_range, numbers, refuse, whole
from srsinv.forward.knife_edge import KnifeEdge, VibratingEdge
from srsinv.report.data import dataset
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity

from .comparison import Comparison, with_width
from .figures import draw_rig, draw_skins, draw_slid

NAME = "fig08_knife_edge"
OF_SKIN = (Order.SKIN, Order.SLIDING)
SKINS = ("theory", "rig")


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
        strips = [with_width(narrow, width) for width in given["widths_m"]]
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
        f"{NAME}.amplitude_N_per_m is {load.amplitude_N_per_m:g}, above "
        f"preload_N_per_m ({load.preload_N_per_m:g}), so the edge would leave the "
        "skin: give a smaller amplitude.",
    )
    return given


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
    turn = f"; the phase changes by 180° at {quantity(sign, 'm')} from the film"
    fitted = f"A line load with a fitted amplitude leaves {rest} of the rig's response"
    return fitted + (turn if np.isfinite(sign) else "")
