"""The tables of accuracy_cost: every row, what was left out, and the fastest way to each goal."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray

from ..report.data import dataset
from ..report.text import quantity, sized
from ._cost_settings import CONVERGED_WITHIN
from ._cost_turns import sizes_of
from .trials import Row, Trial

# By their names: the unit, and whether each is a metric of every row.
MEASURES = {
    "error": ("1", True),
    "error_p": ("1", True),
    "error_q": ("1", True),
    "algebraic_error": ("1", True),
    "error_cramer_rao": ("1", True),
    "converged": ("1", True),
    "applications": ("1", True),
    "memory_bytes": ("B", True),
    "first_call_s": ("s", True),
    "steady_call_s": ("s", True),
    "lower_call_s": ("s", False),
    "upper_call_s": ("s", False),
    "cost_s": ("s", True),
    "lower_cost_s": ("s", False),
    "upper_cost_s": ("s", False),
}


class Goal(NamedTuple):
    """How near is near enough: by this measure, to each of these distances, from what."""

    measure: str
    within: tuple[float, ...]
    of: str
    is_at_one_size: bool = False


TRUTH, EXACT = "the truth", "the exact solution"
GOALS = {
    "forward": Goal("error", (1e-2, 1e-6), TRUTH),
    "contact": Goal("error", (1e-2, 1e-3), TRUTH),
    "fit": Goal("error", (CONVERGED_WITHIN, 1e-3), "the minimum, in standard errors"),
    "inversion": Goal("algebraic_error", (1e-2, 1e-6), EXACT, is_at_one_size=True),
}


def tables(rows: Sequence[Row], left_out: Sequence[Trial], **facts: Any) -> xarray.Dataset:
    """Every row along `case`, what was left out along `left`, the fastest along `goal`."""
    left, best = list(sizes_of(left_out)), list(fastest(rows))
    names = ("part", "line", "family", "peer", "key", "failure")
    return dataset(
        {
            **{name: ("case", *each) for name, each in _measures(rows).items()},
            "size": ("case", [row["size"] for row in rows], "1"),
            **{
                f"goal_{name}": ("goal", [row[name] for row in best], unit)
                for name, unit in (("within", "1"), ("steady_call_s", "s"),
                                   ("peer_steady_call_s", "s"))
            },
        },
        {
            **_words(rows, "case", "", names),
            **_words(left, "left", "left_", ("part", "line", "family", "sizes")),
            **_words(best, "goal", "goal_", ("part", "line", "of", "family", "size", "peer")),
        },
        **facts,
    )  # fmt: skip


def _measures(rows: Sequence[Row]) -> dict[str, tuple[Any, ...]]:
    """(values, unit[, metric]) of each measure, NaN where a row has none; and the time over that of
    the peer at the same size."""
    times = {_place(row, row["family"]): _number(row, "steady_call_s") for row in rows}
    ratios = [
        _number(row, "steady_call_s") / times.get(_place(row, row["peer"]), np.nan) for row in rows
    ]
    measures: dict[str, tuple[Any, ...]] = {
        name: ([_number(row, name) for row in rows], unit, *[f"{{key}}_{name}"] * is_metric)
        for name, (unit, is_metric) in MEASURES.items()
    }
    return measures | {"steady_call_s_over_peer": (ratios, "1")}


def _number(row: Row, name: str) -> float:
    """A measure of a row; NaN where it has none, or a file has something else in its place."""
    value = row.get(name)
    return float(value) if isinstance(value, int | float) else np.nan


def _place(row: Row, family: str) -> tuple[Any, ...]:
    return row["part"], row["line"], family, row["size"]


def _words(
    rows: Sequence[Row], dim: str, prefix: str, names: Iterable[str]
) -> dict[str, tuple[Any, ...]]:
    """Words of rows as labels along `dim`."""
    return {
        f"{prefix}{name}": (dim, np.array([row.get(name, "") for row in rows], dtype=str), "1")
        for name in names
    }


def fastest(rows: Sequence[Row]) -> Iterator[Row]:
    """For each part and line the fastest way of ours and of the peers to come so near; of what
    differs with the data's size, at the size that most ways were measured at."""
    for part, line in dict.fromkeys((row["part"], row["line"]) for row in rows):
        own = [row for row in rows if (row["part"], row["line"]) == (part, line)]
        goal = GOALS.get(own[0]["group"])
        if goal is None or (part == "fit" and line != "tolerance"):
            continue
        own = _at_common_size(own) if goal.is_at_one_size else own
        for within in goal.within:
            answers = (row for row in own if not row.get("failure"))
            near = [row for row in answers if _number(row, goal.measure) <= within]
            ours, peer = (_quickest(near, is_peer) for is_peer in (False, True))
            if not near:
                continue
            yield {
                "part": part, "line": line, "of": goal.of, "within": within,
                "family": ours["family"], "size": sized(ours["size"]) if ours["size"] else "none",
                "steady_call_s": ours.get("steady_call_s", np.nan), "peer": peer["family"],
                "peer_steady_call_s": peer.get("steady_call_s", np.nan),
            }  # fmt: skip


def _at_common_size(rows: Sequence[Row]) -> list[Row]:
    """Those of the size that most of them have, the largest of these."""
    sizes = [row["size"] for row in rows]
    common = max(sizes, key=lambda size: (sizes.count(size), size))
    return [row for row in rows if row["size"] == common]


def _quickest(rows: Iterable[Row], is_peer: bool) -> Row:
    nothing = {"family": "none", "size": 0, "steady_call_s": np.nan}
    own = (row for row in rows if row["is_peer"] == is_peer)
    return min(own, key=lambda row: row.get("steady_call_s", np.inf), default=nothing)


def title(data: xarray.Dataset) -> str:
    """The fastest methods of the last part, to the smallest error that one of them meets."""
    if _titular(data) == "none":
        return f"{data.sizes['case']} trials measured, {data.sizes['left']} families cut short"
    own = (data["goal_part"] == _titular(data)) & (data["goal_family"] != "none")
    goals = data.isel(goal=np.flatnonzero(own))
    tightest = goals.isel(goal=np.flatnonzero(goals["goal_within"] == goals["goal_within"].min()))
    columns = (tightest[f"goal_{name}"].values for name in ("family", "size", "line"))
    seconds = tightest["goal_steady_call_s"].values.tolist()
    part = _titular(data)
    sized_as = "at a tolerance of {}" if part == "fit" else "on {} cells"
    methods = [
        f"{family} {sized_as.format(size)} ({line if part != 'fit' else 'one start'}, "
        f"{quantity(time_s, 's')})"
        for family, size, line, time_s in zip(*columns, seconds, strict=True)
    ]
    within, of = tightest["goal_within"].values[0], tightest["goal_of"].values[0]
    return f"Fastest {part} within {within:g} of {of}: {'; '.join(methods)}"


def _titular(data: xarray.Dataset) -> str:
    """The last method, else the last part, that has met a goal."""
    answered = data["goal_part"].values[data["goal_family"].values != "none"].tolist()
    parts = list(dict.fromkeys(answered))
    return ([part for part in parts if part not in (*GOALS, "gradient")] or parts or ["none"])[-1]
