"""Each effect on and off: change of a scene's signal, and cost."""

import importlib
from functools import partial
from typing import Any, NamedTuple

import xarray
from srsinv.report.outcome import Outcome, Section, Table

from srsinv import config
from srsinv.effects import reference
from srsinv.errors import refuse
from srsinv.forward.simulation import Simulation
from srsinv.forward.trace import Cost, Trace, cost, difference, pair
from srsinv.progress import stage
from srsinv.report import figures


class EffectRow(NamedTuple):
    """One effect: the signal with it and without, the change, and the bound on it."""

    name: str
    with_effect: Trace
    ideal: Trace
    change: float
    bound: float
    cost: Cost


def run(cfg: config.Config) -> Outcome:
    """Every named effect alone against none.

    Raises `BadInput` where no effect is named, and refusals of the configuration's parts.
    """
    nodes = config.part(cfg, "effects")
    refuse(not nodes, "effects names none: give effects=[strip_width,...].")
    with config.precision(cfg):
        key = config.random_key(cfg)
        none, ideal_cost = cost(partial(config.simulation, config.select_effects(cfg, ())), key)
        spectra = reference(none.scenario, none.line)
        rows = []
        for name, effect in config.effects(cfg).items():
            with stage(f"effect: {name}"):
                alone = partial(config.simulation, config.select_effects(cfg, (name,)))
                sim, taken = cost(alone, key)
                with_effect, ideal = pair(sim, none, key)
                change = difference(with_effect, ideal)
                bound = effect.relative_change_bound(spectra)
                rows.append(EffectRow(name, with_effect, ideal, change, bound, taken))
    settings = {
        f"{name}.{key}": str(value)
        for name, node in nodes.items()
        for key, value in node.items()
        if not key.startswith("_")
    }
    return Outcome(
        f"{len(rows)} effects, each with it and without, on one scene",
        _metrics(rows, ideal_cost),
        _dataset(rows, none.sensor.amplifier.unit),
        _sections(rows, ideal_cost, none, settings),
        _table(rows, ideal_cost),
    )


def _metrics(rows: list[EffectRow], ideal_cost: Cost) -> dict[str, Any]:
    metrics = {"first_call_s_none": ideal_cost.first_s, "steady_call_s_none": ideal_cost.steady_s}
    for row in rows:
        metrics |= {
            f"change_{row.name}": row.change,
            f"bound_{row.name}": row.bound,
            f"first_call_s_{row.name}": row.cost.first_s,
            f"steady_call_s_{row.name}": row.cost.steady_s,
        }
    return metrics


def _dataset(rows: list[EffectRow], unit: str) -> xarray.Dataset:
    """Signals by effect, over each one's own sample times, which differ in number."""
    variables = {}
    for row in rows:
        along = (f"time_{row.name}",)
        for which, record in (("with", row.with_effect), ("without", row.ideal)):
            variables[f"signal_{which}_{row.name}"] = (
                ("element", *along), record.signal, {"units": unit},
            )  # fmt: skip
    coordinates = {
        f"time_{row.name}": ((f"time_{row.name}",), row.with_effect.time_s, {"units": "s"})
        for row in rows
    }
    return xarray.Dataset(variables, coordinates)


def _table(rows: list[EffectRow], ideal_cost: Cost) -> Table:
    return Table(
        ("effect", "changes", "bound", "first call [s]", "steady [ms]"),
        (
            ("none", "-", "-", ideal_cost.first_s, 1e3 * ideal_cost.steady_s),
            *(
                (r.name, f"{r.change:.2%}", f"{r.bound:.2%}", r.cost.first_s, 1e3 * r.cost.steady_s)
                for r in rows
            ),
        ),
        "Rms of the change over the rms of the signal without it, and the bound that effects=auto "
        "takes; the first call includes compilation, and both the set-up.",
    )


def _sections(
    rows: list[EffectRow], ideal_cost: Cost, none: Simulation, settings: dict[str, str]
) -> tuple[Section, ...]:
    """The page; `none` is without effects, `settings` are those of the effects, by name."""
    unit, line = none.sensor.amplifier.unit, none.line

    def drawn(row: EffectRow):
        with_effect, ideal = row.with_effect, row.ideal
        return figures.with_and_without(with_effect.time_s, with_effect.signal, ideal.signal, unit)

    each = [
        Section(
            row.name.replace("_", " ").capitalize(),
            (f"Changes {row.change:.2%} of the signal; bound {row.bound:.2%}.",),
            {f"effect_{row.name}": lambda row=row: drawn(row)},
            {f"effect_{row.name}": f"{_words(row.name)} Left the signal of each element with the "
             "effect and without it, right their difference."},
        )
        for row in rows
    ]  # fmt: skip
    return (
        Section("What each effect changes and costs", (), tables=(_table(rows, ideal_cost),)),
        *each,
        Section(
            "What was assumed",
            (f"{line.kind} line of {line.n} cells, computed on cells {none.refinement} times "
             f"finer; {float(none.scan.speed_m_per_s):g} m/s; no noise but the bursts of "
             "snap_back. At the same instants with it and without.",),
            tables=(Table(("setting", "value"), tuple(settings.items())),),
        ),
    )  # fmt: skip


def _words(name: str) -> str:
    """Description of an effect: the first line of its module's docstring."""
    module = importlib.import_module(f"srsinv.effects.{name}")
    return (module.__doc__ or "").strip().split("\n")[0]
