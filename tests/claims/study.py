"""Studies: cases that are measured one by one, the rows that they become, and what is said of them.

A study's rows stand in `results/NAME.jsonl`, a line each, which is written as soon as it is
measured: an interrupted run goes on where it ended. `results/NAME.json` has their summary.
"""

import itertools
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from srsinv.command.programs import release_programs
from srsinv.jobs.trials import Row, Trial, TrialRows

RESULTS = Path(__file__).parent / "results"
MOST_MAPS = 30_000  # of memory: Linux ends a process that asks for 65530
DIGITS = 4
Labels = Mapping[str, Any]


@dataclass(frozen=True)
class Study:
    """What is measured, and what is said of it.

    - `measure`: gives the row of a case, whose labels are its arguments.
    - `cases`: gives the labels of all cases, in the order of the rows.
    - `summary`: of all rows, what pages say of them; None: pages are written from the rows.
    - `rests_on`: what else decides on a row, of the same arguments: a row is missing where it has
      changed.
    - `digits`: that are significant in rows and summary; None: all.
    """

    name: str
    measure: Callable[..., Row]
    cases: Callable[[], Iterable[Labels]]
    summary: Callable[[list[Row]], Row] | None = None
    rests_on: Callable[..., Row] = lambda **_: {}
    digits: int | None = DIGITS

    def trials(self) -> list[Trial]:
        """All cases."""
        score = partial(rounded, digits=self.digits)
        return [
            Trial(labels, lambda own=labels: partial(self.measure, **own), score,
                  rests_on=self.rests_on(**labels))
            for labels in self.cases()
        ]  # fmt: skip

    def missing(self) -> list[Trial]:
        """The cases without a row."""
        rows = self._rows()
        return [trial for trial in self.trials() if rows.known(trial) is None]

    def summarised(self) -> str:
        """The summary of the rows that there are, as it is written."""
        assert self.summary is not None
        found = rounded(self.summary(read(self.name)), self.digits)
        return json.dumps(found, indent=1, ensure_ascii=False) + "\n"

    def run(self, names: Sequence[str] = ()) -> None:
        """Measure the cases that are missing, or anew those that have one of `names` as a label or
        all of their labels in one; drop the rows of cases that are no more; write the summary."""
        asked = _named(self.trials(), names) if names else self.missing()
        rows = self._rows()
        for number, trial in enumerate(asked, 1):
            row = json.dumps(rows.anew(trial), ensure_ascii=False)
            print(f"{self.name} {number} of {len(asked)}: {row}", flush=True)
            release_programs(MOST_MAPS)
        rows.keep(self.trials())
        if self.summary is not None:
            (RESULTS / f"{self.name}.json").write_text(self.summarised(), encoding="utf-8")

    def _rows(self) -> TrialRows:
        return TrialRows(path=str(RESULTS / f"{self.name}.jsonl"))


def combinations(**values: Iterable[Any]) -> list[Row]:
    """The labels of all combinations of these values."""
    return [dict(zip(values, each, strict=True)) for each in itertools.product(*values.values())]


def read(name: str) -> list[Row]:
    """The rows of a study, their labels first."""
    path = RESULTS / f"{name}.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [each["labels"] | each["row"] for each in map(json.loads, lines)]


def rounded(given: Any, digits: int | None = DIGITS) -> Any:
    """Numbers of so many significant digits, None where one is not finite."""
    if isinstance(given, Mapping):
        return {key: rounded(each, digits) for key, each in given.items()}
    if isinstance(given, list | tuple):
        return [rounded(each, digits) for each in given]
    if not isinstance(given, float):
        return given
    if not math.isfinite(given):
        return None
    return float(given) if digits is None else float(f"{given:.{digits}g}")


def _named(trials: list[Trial], names: Sequence[str]) -> list[Trial]:
    named = {str(each): {str(each), *map(str, each.labels.values())} for each in trials}
    unknown = set(names).difference(*named.values())
    if unknown:
        raise SystemExit(f"No case is called {' or '.join(sorted(unknown))}: {'; '.join(named)}.")
    return [each for each in trials if named[str(each)] & set(names)]
