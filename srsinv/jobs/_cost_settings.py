"""What accuracy_cost measures: sizes, tolerances and counts, as the configuration has them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from ..errors import refuse

TIGHT = 1e-12  # tolerance of the open line's reference solution
EXACT = 1e-13  # tolerance of a fit's reference minimum


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
            counts = given[name]
            refuse(
                not counts or any(not isinstance(n, int) or n < 1 for n in counts),
                f"accuracy_cost.fit.{name} is {counts}: give whole numbers from 1.",
            )
        refuse(
            not given["tolerances"] or any(not EXACT < t < 1 for t in given["tolerances"]),
            f"accuracy_cost.fit.tolerances is {given['tolerances']}: give numbers between "
            f"{EXACT:g} and 1.",
        )
        refuse(
            not (isinstance(given["signals"], int) and given["signals"] >= 1),
            f"accuracy_cost.fit.signals is {given['signals']!r}: give a whole number from 1.",
        )
        return cls(**{each.name: given[each.name] for each in fields(cls)})


@dataclass(frozen=True)
class CostSettings:
    """`accuracy_cost` of the configuration: numbers of cells, calls after the first of which the
    least time counts, tolerances of the iterative solvers, and the settings of the fit."""

    forward_cells: Sequence[int]
    inverse_cells: Sequence[int]
    repeats: int
    tolerances: Sequence[float]
    fit: FitSettings

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> "CostSettings":
        """Those given; raises `BadInput` for what cannot be measured."""
        for name in ("forward_cells", "inverse_cells"):
            cells = given[name]
            refuse(
                not cells or any(not isinstance(n, int) or n < 8 or n % cells[0] for n in cells),
                f"accuracy_cost.{name} is {cells}: give whole numbers from 8, each a multiple of "
                "the first.",
            )
        refuse(
            not (isinstance(given["repeats"], int) and given["repeats"] >= 1),
            f"accuracy_cost.repeats is {given['repeats']}: give a whole number from 1.",
        )
        refuse(
            any(not TIGHT < tolerance < 1 for tolerance in given["tolerances"]),
            f"accuracy_cost.tolerances is {given['tolerances']}: give numbers between {TIGHT:g} "
            "and 1.",
        )
        return cls(
            forward_cells=given["forward_cells"],
            inverse_cells=given["inverse_cells"],
            repeats=given["repeats"],
            tolerances=given["tolerances"],
            fit=FitSettings.checked(given["fit"]),
        )
