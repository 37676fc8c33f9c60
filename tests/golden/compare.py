"""Entries old and new held against each other, within the tolerances of tolerances.yaml."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from tests.golden.entries import place

FOLDER = Path(__file__).parent
LEAST = 1e-4  # of an array's rms: a smaller sample is measured against so much
MISSING = "missing"
NUMBER = re.compile(r"\d[\d.]*(e[-+]?\d+)?")


@dataclass(frozen=True)
class Tolerance:
    """How far a quantity may move: by the largest of these.

    - `relative`: of the old value; of a small sample, of a part of its array's rms.
    - `of_stderr`: of the quantity's own standard error, QUANTITY_stderr, where it has one.
    - `absolute`: in its own unit.
    - `any_digits`: numbers within its words may be others.
    - `ignore`: it is not compared at all.
    """

    relative: float = 1e-9
    of_stderr: float = 0.0
    absolute: float = 0.0
    any_digits: bool = False
    ignore: bool = False
    reason: str = ""

    def allowed(self, size: float, stderr: Any) -> float:
        """How far what is so large may move."""
        own = self.of_stderr * stderr if is_number(stderr) else 0.0
        return max(self.relative * size, own, self.absolute)


@dataclass(frozen=True)
class Movement:
    """A quantity old and new, and how many tolerances lie between them: `ratio`, infinite for what
    is no number."""

    name: str
    where: str
    old: Any
    new: Any
    tolerance: float
    ratio: float

    def __str__(self) -> str:
        at = f" at {self.where}" if self.where else ""
        return (
            f"{self.name}{at} was {self.old} and is {self.new}: {self.ratio:.3g} times its "
            f"tolerance, {self.tolerance:.3g}"
        )


@cache
def rules() -> list[tuple[list[str], Tolerance]]:
    """Patterns of names, and the tolerance of what they name."""
    read = yaml.safe_load((FOLDER / "tolerances.yaml").read_text(encoding="utf-8"))
    return [(rule.pop("of").split(), Tolerance(**rule)) for rule in read]


def tolerance_of(name: str) -> Tolerance:
    """The tolerance of a quantity, FAMILY/NAME/QUANTITY: that of the first rule that names it."""
    for patterns, tolerance in rules():
        if any(fnmatchcase(name, pattern) for pattern in patterns):
            return tolerance
    return Tolerance()


def differences(case: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[Movement]:
    """What has moved beyond its tolerance, in a case FAMILY/NAME; of an array the sample that has
    moved furthest."""
    moves = []
    for key in sorted({*old, *new}):
        own = tolerance_of(f"{case}/{key}")
        if not own.ignore:
            pair = old.get(key, MISSING), new.get(key, MISSING)
            moves.append(_moved(f"{case}/{key}", *pair, own, old.get(f"{key}_stderr")))
    return [each for each in moves if each.ratio > 1]


def _moved(name: str, old: Any, new: Any, own: Tolerance, stderr: Any) -> Movement:
    if not (isinstance(old, Mapping) and isinstance(new, Mapping)):
        return _movement(name, "", old, new, own, abs(old) if is_number(old) else 0.0, stderr)
    for key in ("shape", "units"):
        if old[key] != new[key]:
            return Movement(name, key, old[key], new[key], 0.0, math.inf)
    is_alike = isinstance(stderr, Mapping) and stderr["shape"] == old["shape"]
    errors = stderr if is_alike else {}
    norm = old.get("norm", 0.0)
    least = LEAST * norm / max(math.prod(old["shape"]), 1) ** 0.5
    moves = [_movement(name, "norm", norm, new.get("norm", 0.0), own, norm, errors.get("norm"))]
    each_error: Sequence[Any] = errors.get("samples", [None] * len(old["samples"]))
    for i, (*pair, error) in enumerate(
        zip(old["samples"], new["samples"], each_error, strict=True)
    ):
        size = max(abs(pair[0]), least) if is_number(pair[0]) else 0.0
        moves.append(_movement(name, place(old["shape"], i), *pair, own, size, error))
    return max(moves, key=lambda each: each.ratio)


def _movement(
    name: str, where: str, old: Any, new: Any, own: Tolerance, size: float, stderr: Any
) -> Movement:
    allowed = own.allowed(size, stderr)
    if own.any_digits and isinstance(old, str) and isinstance(new, str):
        old, new = (NUMBER.sub("#", each) for each in (old, new))
    if type(old) is type(new) and old == new:
        ratio = 0.0
    elif is_number(old) and is_number(new):
        ratio = abs(new - old) / allowed if allowed else math.inf
    else:
        ratio = math.inf
    return Movement(name, where, old, new, allowed, ratio)


def is_number(value: Any) -> bool:
    """Whether an entry is a number, no word and no truth."""
    return isinstance(value, int | float) and not isinstance(value, bool)
