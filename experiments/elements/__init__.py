"""Elements along the line of travel, the paper's Section V-B: all see the same surface, and what
they do not share with it tells of the skin, which catches and snaps back."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from srsinv import config
from srsinv.errors import BadInput, number, refuse
from srsinv.forward.simulation import Simulation
from srsinv.inverse.bursts.estimate import QUANTITIES, BurstEstimate
from srsinv.inverse.bursts.method import BurstInversion
from srsinv.inverse.estimate import relative_error
from srsinv.inverse.simulated import noisy_problem
from srsinv.modules import with_fields
from srsinv.progress import stage
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, significant

from .figures import draw_bursts, draw_counts, draw_errors
from .passes import BurstStatistics, TrueBursts, burst_signals, drawn_bursts, in_a_row

CASES = ("bursts found", "bursts ignored", "no bursts")
LESS = 0.01  # of the noise, at which the floor is
NEAR = 2  # samples, within which a burst that is found is a true one


class ElementsPass(NamedTuple):
    """A pass: errors of p of each case, the estimate, the bursts, and which true burst each of the
    found ones is, -1 for none."""

    errors: list[float]
    estimate: BurstEstimate
    truth: TrueBursts
    matches: list[int]


def run(cfg: config.Config) -> Result:
    """Errors of p and bursts found over numbers of elements, the noise of each element held fixed.

    Raises `BadInput` for methods without `bursts`, a sensor that has not one element, a `shown`
    that is none of the counts, and a spacing or statistics of bursts that cannot be.
    """
    settings = cfg["elements"]
    counts, shown, passes = (settings[name] for name in ("counts", "shown", "passes"))
    wanted = "give one of elements.counts"
    refuse(shown not in counts, f"elements.shown is {shown}: {wanted}, {counts}.")
    refuse(passes < 1, f"elements.passes is {passes}: give at least 1.")
    wanted = "a positive length in metres"
    spacing = float(number("elements.spacing_m", settings["spacing_m"], wanted, above=0))
    statistics = _statistics(settings["bursts"])
    with config.precision(cfg):
        methods = config.methods(cfg).values()
        method = next((each for each in methods if isinstance(each, BurstInversion)), None)
        if method is None:
            raise BadInput(
                "method lacks bursts, which this experiment needs: give method=[bursts]."
            )
        sim, seed, friction = config.simulation(cfg), config.seed(cfg), config.friction(cfg)
        sim.sensor.require_elements(1)
        every: dict[int, list[ElementsPass]] = {}
        for count in counts:
            with stage(f"{passes} passes of {count} elements"):
                own = _with_elements(sim, count, spacing)
                rows = range(seed, seed + passes)
                every[count] = [_pass(own, method, statistics, friction, each) for each in rows]
        floor = _quieter(_with_elements(sim, counts[-1], spacing), method, friction)
    return _result(cfg, every, floor)


def _statistics(given: Any) -> BurstStatistics:
    """The statistics of bursts."""

    def checked(name: str) -> float:
        return float(number(f"elements.bursts.{name}", given[name], "a positive number", above=0))

    lengths = checked("patch_m"), checked("contact_m")
    decay = checked("decay_s")
    return BurstStatistics(checked("rate_hz"), checked("shear_Pa"), *lengths, (decay, decay))


def _with_elements(sim: Simulation, count: int, spacing_m: float) -> Simulation:
    """The simulation with so many elements in a row in place of its one."""
    films = in_a_row(sim.sensor.elements[0], count, spacing_m)
    sensor = dataclasses.replace(sim.sensor, elements=films)
    return dataclasses.replace(sim, scenario=sim.scenario.replace(sensor=sensor))


def _pass(
    sim: Simulation,
    method: BurstInversion,
    statistics: BurstStatistics,
    friction: float | None,
    seed: int,
) -> ElementsPass:
    """One pass with the bursts of this seed, whatever the number of elements."""
    problem, interval = noisy_problem(sim, jax.random.key(seed), friction), interval_s(sim)
    truth = drawn_bursts(np.random.default_rng(seed), statistics, sim.line.n * interval)
    bursts = burst_signals(truth, statistics.patch_m, sim.sensor, sim.line, sim.scan)
    snapping = with_fields(problem, data=problem.data + jnp.asarray(bursts))
    estimates = method(snapping), method.method(snapping), method.method(problem)
    found, p = estimates[0], np.asarray(sim.traction(sim.line))[0]
    assert isinstance(found, BurstEstimate)
    errors = [float(relative_error(np.asarray(each.value)[0], p)) for each in estimates]
    seconds = sim.line.n * interval
    away = found.bursts.time.value[:, None] - truth.time_s + seconds / 2
    away = np.abs(away % seconds - seconds / 2) / interval
    nearest = [int(np.argmin(row)) if row.size and row.min() <= NEAR else -1 for row in away]
    return ElementsPass(errors, found, truth, nearest)


def interval_s(sim: Simulation) -> float:
    """The time between samples."""
    return float(sim.line.cell_m) / abs(float(sim.scan.speed_m_per_s))


def _quieter(sim: Simulation, method: BurstInversion, friction: float | None) -> float:
    """The error of p where the noise is `LESS` of what it is: what averaging cannot mend."""
    problem = noisy_problem(sim, jax.random.key(0), friction)
    own = jnp.asarray(sim.signal()) - problem.mean_signal
    data = own + LESS * (problem.data - own)
    estimate = method.method(with_fields(problem, data=data, noise=LESS**2 * problem.noise))
    return float(
        relative_error(np.asarray(estimate.value)[0], np.asarray(sim.traction(sim.line))[0])
    )


def _result(
    cfg: config.Config,
    every: dict[int, list[ElementsPass]],
    floor: float,
) -> Result:
    settings, counts = cfg["elements"], list(every)
    errors = np.array([[one.errors for one in passes] for passes in every.values()])
    totals = np.array([_totals(passes) for passes in every.values()])
    true, claimed, located, false = totals.T
    shown = every[settings["shown"]]
    numbers = {
        "floor_error_p": floor,
        "false_claims": int(false.sum()),
        "located_fraction": float(located[counts.index(settings["shown"])] / max(claimed.max(), 1)),
    }
    data = dataset(
        {
            "error": (("elements", "pass_number", "case"), errors, "1"),
            "error_mean": (("elements", "case"), errors.mean(axis=1), "1"),
            "true_bursts": ("elements", true, "1"),
            "claimed": ("elements", claimed, "1"),
            "located": ("elements", located, "1"),
            "false": ("elements", false, "1"),
            **_shown(shown),
            **scalars(numbers),
        },
        {"elements": (counts, "1"), "case": (list(CASES), "1"),
         "pass_number": (np.arange(settings["passes"]), "1")},
        shown=settings["shown"], spacing_m=settings["spacing_m"], effects_on=listed(cfg["effects"]),
        noise_rms_V=float(cfg["noise"]["white"]["rms"]), friction=cfg["friction"],
        **{f"burst_{name}": settings["bursts"][name] for name in BurstStatistics._fields},
    )  # fmt: skip
    first, last = (data["error_mean"].sel(case="bursts found").values[at] for at in (0, -1))
    most, least = (f"{significant(100 * each, 2)} %" for each in (last, first))
    of_all = f"{int(located[-1])} of {int(claimed[-1])} bursts"
    title = f"{counts[-1]} elements recover p within {most}, {counts[0]} within {least}"
    own = sections(__file__, errors=draw_errors, counts=draw_counts, bursts=draw_bursts)
    return Result(f"{title}, and {of_all} are located", data, own)


def _totals(passes: list[ElementsPass]) -> tuple[int, int, int, int]:
    """Of all passes the true bursts, those claimed, those located, and false claims."""
    return (
        sum(len(one.truth.time_s) for one in passes),
        sum(len(one.matches) for one in passes),
        sum(int(one.estimate.bursts.is_located.sum()) for one in passes),
        sum(one.matches.count(-1) for one in passes),
    )


def _shown(passes: list[ElementsPass]) -> dict[str, tuple[Any, ...]]:
    """Quantities of the bursts found in these passes beside their truth."""
    matched = [(one, j, i) for one in passes for j, i in enumerate(one.matches) if i >= 0]
    made: dict[str, tuple[Any, ...]] = {}
    for name in ("time", "place", "size"):
        unit = QUANTITIES[name]
        found = [getattr(one.estimate.bursts, name) for one, _, _ in matched]
        index = [j for _, j, _ in matched]
        truth = [getattr(one.truth, f"{name}_{unit}")[i] for one, _, i in matched]
        made[f"true_{name}"] = "burst", np.array(truth, float), unit
        for part in ("value", "low", "high"):
            values = [getattr(of, part)[j] for of, j in zip(found, index, strict=True)]
            made[f"{name}_{part}"] = "burst", np.array(values, float), unit
    located = [bool(one.estimate.bursts.is_located[j]) for one, j, _ in matched]
    return made | {"is_located": ("burst", np.array(located, np.int8), "1")}
