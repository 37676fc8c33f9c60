"""Each effect on and off: change of a scene's signal, and cost."""

import importlib
from functools import partial
from typing import Any, NamedTuple

import xarray

from srsinv import config
from srsinv.effects import reference
from srsinv.errors import refuse
from srsinv.forward.sensor import Sensor
from srsinv.forward.trace import Cost, Trace, cost, difference, pair
from srsinv.progress import stage
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections
from srsinv.report.text import significant


class EffectRow(NamedTuple):
    """One effect: the signal with it and without, the change, and the bound on it."""

    with_effect: Trace
    ideal: Trace
    change: float
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
        for name, effect in config.effects(cfg).items():
            with stage(f"effect: {name}"):
                alone = partial(config.simulation, config.select_effects(cfg, (name,)))
                sim, taken = cost(alone, key)
                with_effect, ideal = pair(sim, none, key)
                bound = effect.relative_change_bound(spectra)
                rows[name] = EffectRow(
                    with_effect, ideal, difference(with_effect, ideal), bound, taken
                )
    settings = {
        f"{name}.{key}": str(value)
        for name, node in nodes.items()
        for key, value in node.items()
        if not key.startswith("_")
    }
    data = _dataset(rows, ideal_cost, none.sensor, settings).assign_attrs(
        line=none.line.kind,
        cells=none.line.n,
        refinement=none.refinement,
        speed_m_per_s=float(none.scan.speed_m_per_s),
    )
    return Result(_title(rows), data, sections(__file__))


def _dataset(
    rows: dict[str, EffectRow], ideal_cost: Cost, sensor: Sensor, settings: dict[str, str]
) -> xarray.Dataset:
    every = list(rows.values())
    signals, times = _signals(rows, sensor.amplifier.unit)
    return dataset(
        {
            "change": ("effect", [row.change for row in every], "1", "change_{effect}"),
            "bound": ("effect", [row.bound for row in every], "1", "bound_{effect}"),
            "first_call_s": ("effect", [row.cost.first_s for row in every], "s",
                             "first_call_s_{effect}"),
            "steady_call_s": ("effect", [row.cost.steady_s for row in every], "s",
                              "steady_call_s_{effect}"),
            **scalars({"first_call_s_none": ideal_cost.first_s,
                       "steady_call_s_none": ideal_cost.steady_s}),
            "description": ("effect", [_first_line(name) for name in rows], "1"),
            "setting_value": ("setting", list(settings.values()), "1"),
            **signals,
        },
        {
            "effect": (list(rows), "1"),
            "setting": (list(settings), "1"),
            "element": (sensor.element_names, "1"),
            **times,
        },
    )  # fmt: skip


def _signals(rows: dict[str, EffectRow], unit: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Signals with and without each effect over its own sample times, which differ in number, and
    these times."""
    signals = {
        f"signal_{which}_{name}": (("element", f"time_{name}"), record.signal, unit)
        for name, row in rows.items()
        for which, record in (("with", row.with_effect), ("without", row.ideal))
    }
    return signals, {f"time_{name}": (row.with_effect.time_s, "s") for name, row in rows.items()}


def _title(rows: dict[str, EffectRow]) -> str:
    most = max(rows, key=lambda name: rows[name].change)
    exceeding = [name for name, row in rows.items() if row.change > row.bound]
    bounds = (
        f"beyond the bound: {', '.join(exceeding)}" if exceeding else "all stay within their bounds"
    )
    change = significant(100 * rows[most].change)
    return f"Of {len(rows)} effects {most} changes the signal most, by {change} %; {bounds}"


def _first_line(name: str) -> str:
    """What an effect is: the first line of its module's docstring."""
    module = importlib.import_module(f"srsinv.effects.{name}")
    return (module.__doc__ or "").strip().split("\n")[0]
