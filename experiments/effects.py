"""Each effect on and off: change of a scene's signal, and cost."""

import importlib
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import xarray

from srsinv import config
from srsinv.effects import reference
from srsinv.errors import refuse
from srsinv.forward.simulation import Simulation
from srsinv.forward.trace import Cost, Trace, cost, difference, pair
from srsinv.progress import stage, steps
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import significant, spoken


class EffectRow(NamedTuple):
    """One effect: the signal with it and without, the bound on the change, and the cost."""

    with_effect: Trace
    ideal: Trace
    bound: float
    cost: Cost


def run(cfg: config.Config) -> Result:
    """Every named effect alone against none.

    Raises `BadInput` where no effect is named, and refusals of the configuration's parts.
    """
    nodes = config.part(cfg, "effects")
    refuse(not nodes, "effects names none: give effects=[strip_width,...].")
    with config.precision(cfg):
        key = config.random_key(cfg)
        none, ideal_cost = cost(partial(config.simulation, config.select_effects(cfg, ())), key)
        spectra = reference(none.scenario, none.line)
        rows = {}
        with steps("effects", config.effects(cfg).items()) as each:
            for name, effect in each:
                with stage(f"effect: {name}"):
                    alone = partial(config.simulation, config.select_effects(cfg, (name,)))
                    sim, taken = cost(alone, key)
                    bound = effect.relative_change_bound(spectra)
                    rows[name] = EffectRow(*pair(sim, none, key), bound, taken)
    settings = {
        f"{name}.{key}": str(value)
        for name, node in nodes.items()
        for key, value in node.items()
        if not key.startswith("_")
    }
    data = _dataset(rows, none, ideal_cost, settings)
    return Result(_title(data), data, sections(__file__))


def _dataset(
    rows: Mapping[str, EffectRow], none: Simulation, ideal_cost: Cost, settings: Mapping[str, str]
) -> xarray.Dataset:
    numbers = {
        "change": ([difference(row.with_effect, row.ideal) for row in rows.values()], "1"),
        "bound": ([row.bound for row in rows.values()], "1"),
        "first_call_s": ([row.cost.first_s for row in rows.values()], "s"),
        "steady_call_s": ([row.cost.steady_s for row in rows.values()], "s"),
    }
    without = {"first_call_s_none": ideal_cost.first_s, "steady_call_s_none": ideal_cost.steady_s}
    # Effects have sample times of their own, which differ in number.
    signals = {
        f"signal_{which}_{name}": (("element", f"time_{name}"), signal, none.sensor.amplifier.unit)
        for name, row in rows.items()
        for which, signal in (("with", row.with_effect.signal), ("without", row.ideal.signal))
    }
    return dataset(
        {
            **{name: ("effect", *each, f"{name}_{{effect}}") for name, each in numbers.items()},
            **scalars(without),
            "description": ("effect", [_first_line(name) for name in rows], "1"),
            "setting_value": ("setting", list(settings.values()), "1"),
            **signals,
        },
        {
            "effect": (list(rows), "1"),
            "setting": (list(settings), "1"),
            "element": (none.sensor.element_names, "1"),
            **{f"time_{name}": (row.with_effect.time_s, "s") for name, row in rows.items()},
        },
        line=none.line.kind,
        cells=none.line.n,
        refinement=none.refinement,
        speed_m_per_s=float(none.scan.speed_m_per_s),
    )


def _title(data: xarray.Dataset) -> str:
    change = data["change"]
    most, greatest = spoken(change.idxmax().item()), significant(100 * float(change.max()))
    exceeding = ", ".join(map(spoken, data["effect"].values[change > data["bound"]]))
    bounds = f"above its bound: {exceeding}" if exceeding else "all are within their bounds"
    return f"Of {change.size} effects, {most} changes the signal most, by {greatest} %; {bounds}"


def _first_line(name: str) -> str:
    """What an effect is: the first line of its module's docstring."""
    module = importlib.import_module(f"srsinv.effects.{name}")
    return (module.__doc__ or "").strip().split("\n")[0]
