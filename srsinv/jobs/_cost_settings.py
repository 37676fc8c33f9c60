"""What accuracy_cost measures: sizes, tolerances and counts, as the configuration has them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from ..errors import echo, is_number, mapping, number, refuse, whole

TIGHT = 1e-12  # tolerance of the open line's reference solution
EXACT = 1e-13  # tolerance of a fit's reference minimum
CONVERGED_WITHIN = 0.1  # standard errors from the minimum up to which a fit is at it
PARTS = ("forward", "contact", "effects", "inversion", "fit", "recordings")


@dataclass(frozen=True)
class FitSettings:
    """`accuracy_cost.fit` of the configuration: samples of each element, signal over noise,
    tolerances of every solver, numbers of starts, of the signals that are fitted from them, and of
    those fitted together."""

    samples: int
    snr_dB: float
    tolerances: Sequence[float]
    starts: Sequence[int]
    signals: int
    batches: Sequence[int]

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> "FitSettings":
        """Those given; raises `BadInput` for what cannot be measured."""
        for name in ("starts", "batches"):
            _check_counts(f"fit.{name}", given[name], 1)
        _check_tolerances("fit.tolerances", given["tolerances"], EXACT)
        refuse(
            not given["tolerances"],
            f"accuracy_cost.fit.tolerances is []: give numbers between {EXACT:g} and 1.",
        )
        whole("accuracy_cost.fit.signals", given["signals"], "a whole number from 1", least=1)
        return cls(**{each.name: given[each.name] for each in fields(cls)})


@dataclass(frozen=True)
class CostSettings:
    """`accuracy_cost` of the configuration.

    - `parts`: those that are measured. `budget_s` [s]: None: all trials are measured. `rows`: the
      path of a file of rows that is continued, or None. `repeats`: calls after the first two.
      `is_fresh`: whether each first call compiles its programs anew.
    - `forward_cells`, `inverse_cells`, `contact_cells`, `effects_cells`: numbers of cells;
      `recording_samples`: of each element. `tolerances`: of iterations.
    - `effects`: the nodes of further effects; `fit`: the settings of the fit.
    """

    parts: Sequence[str]
    budget_s: float | None
    rows: str | None
    repeats: int
    is_fresh: bool
    forward_cells: Sequence[int]
    inverse_cells: Sequence[int]
    contact_cells: Sequence[int]
    effects_cells: Sequence[int]
    recording_samples: Sequence[int]
    tolerances: Sequence[float]
    effects: Mapping[str, Any]
    fit: FitSettings

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> "CostSettings":
        """Those given; raises `BadInput` for what cannot be measured."""
        parts, budget, rows = given["parts"], given["budget_s"], given["rows"]
        is_part = isinstance(parts, list) and parts and all(part in PARTS for part in parts)
        refuse(
            not is_part,
            f"accuracy_cost.parts is {echo(parts)}: give some of {', '.join(PARTS)}.",
        )
        if budget is not None:
            wanted = "seconds from 0, or null for no limit"
            number("accuracy_cost.budget_s", budget, wanted, least=0)
        refuse(
            not isinstance(given["is_fresh"], bool),
            f"accuracy_cost.is_fresh is {echo(given['is_fresh'])}: give true or false.",
        )
        refuse(
            not (rows is None or (isinstance(rows, str) and rows and "\0" not in rows)),
            f"accuracy_cost.rows is {echo(rows)}: give a path, as rows.jsonl, or null.",
        )
        for name in ("forward_cells", "inverse_cells"):
            cells = given[name]
            refuse(
                not cells or any(not isinstance(n, int) or n < 8 or n % cells[0] for n in cells),
                f"accuracy_cost.{name} is {cells}: give whole numbers from 8, each a multiple of "
                "the first.",
            )
        for name in ("contact_cells", "effects_cells", "recording_samples"):
            _check_counts(name, given[name], 64)
        whole("accuracy_cost.repeats", given["repeats"], "a whole number from 1", least=1)
        _check_tolerances("tolerances", given["tolerances"], TIGHT)
        effects = given["effects"]
        checked = {
            "effects": {} if effects is None else mapping("accuracy_cost.effects", effects),
            "fit": FitSettings.checked(given["fit"]),
        }
        return cls(**{each.name: given[each.name] for each in fields(cls)} | checked)


def _check_counts(name: str, counts: Any, least: int) -> None:
    is_list = isinstance(counts, list) and bool(counts)
    refuse(
        not is_list or any(not isinstance(n, int) or n < least for n in counts),
        f"accuracy_cost.{name} is {echo(counts)}: give whole numbers from {least}.",
    )


def _check_tolerances(name: str, tolerances: Any, above: float) -> None:
    refuse(
        not isinstance(tolerances, list)
        or any(not (is_number(each) and above < each < 1) for each in tolerances),
        f"accuracy_cost.{name} is {echo(tolerances)}: give numbers between {above:g} and 1.",
    )
