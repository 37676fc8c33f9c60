"""The long studies, one after the other, each in a process of its own: `python -m tests.claims`.

`python -m tests.claims NAME` runs one, each a module of this folder with a `STUDY` (study.py): the
cases that it has no rows of yet. `python -m tests.claims NAME LABEL ...` measures the cases with
these labels anew. The pages that quote the results are written at the end (readme.py).
"""

import subprocess
import sys
from importlib import import_module

from tests.claims import readme
from tests.claims.study import Study

STUDIES = (
    "admissible", "bursts", "calibration_of_bands", "clean_draws", "commands", "contact_events",
    "cylinder", "directions", "disturbances", "faults", "lab_cases", "layered_line", "live",
    "measured_kernels", "mgh", "passes", "plans", "raw_rigs", "regularisation_tools", "rig_bands",
    "rigs", "robustness", "rules", "screening", "screening_zones", "semi_blind",
    "skin_acceleration", "tolerances",
)  # fmt: skip


def study(name: str) -> Study:
    """The study of this name."""
    if name not in STUDIES:
        raise SystemExit(f"There is no study {name}; there are {', '.join(STUDIES)}.")
    return import_module(f"tests.claims.{name}").STUDY


def main(words: list[str]) -> None:
    """Run one study, or all."""
    if words:
        study(words[0]).run(words[1:])
        readme.write()
        return
    for name in STUDIES:
        subprocess.run([sys.executable, "-m", "tests.claims", name], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
