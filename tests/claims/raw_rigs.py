"""Rigs' own files through the four commands of README (ten minutes).

Each of `RIGS` writes two files as its logger does, of a known ridge and of another. Inspection
offers settings, which are taken, and a sidecar, whose blanks are filled in with what a laboratory
knows; the rig is calibrated on the known ridge, and the other one fitted and inverted with that.

A rig's row has the settings `offered` and, of the calibration and the fit, quality, warnings and
for every parameter truth, value, standard error and `pull`, the error over it; of the inversions
the error of p over its rms where the stage has been, and how much of it is within the 90 % bands.
"""

import dataclasses
import json
import shlex
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray
import yaml

from srsinv.__main__ import main as command
from srsinv.grid import Open
from srsinv.jobs.trials import Row
from tests.claims.raw_files import RIDGES, Rig, model_of, pressure, write
from tests.claims.raw_rig_list import RIGS
from tests.claims.study import Study, combinations

HELD = "fit.hold={height_m: 20e-6, width_m: 2e-3}"
BAND = 1.645  # standard errors
INSIDE = 0.95  # of the scan, where p is looked at
BY_NAME = {rig.name: rig for rig in RIGS}


def row(rig: Rig, folder: Path) -> Row:
    """What becomes of one rig, its files and runs in `folder`."""
    model = model_of(rig)
    files = write(rig, folder, model)
    known, unknown = (f"recording.path={files[name]}" for name in RIDGES)
    run(folder / "inspected", "experiment=inspect_recording", known, *rig.also)
    facts = xarray.open_dataset(folder / "inspected" / "result.nc").attrs
    # What the command line has had already is offered again.
    taken = [word for word in shlex.split(facts["next_command"])[2:] if "path=" not in word]
    _fill_in(
        folder / "inspected" / "known.yaml", rig, [p.with_suffix(".yaml") for p in files.values()]
    )
    settings = [word for word in taken if not word.startswith("friction=")]
    also, rig_file = [*dict.fromkeys((*rig.also, *settings))], folder / "rig.yaml"
    run(folder / "calibrated", "experiment=calibrate", known, "feature=ridge", HELD,
        f"calibration.write={rig_file}", *also)  # fmt: skip
    run(folder / "fitted", "experiment=fit_recording", unknown, "feature=ridge",
        f"recording.calibration={rig_file}", *also)  # fmt: skip
    inverted = run(folder / "inverted", "experiment=invert_recording", unknown,
                   f"recording.calibration={rig_file}", *also, *rig.to_invert)  # fmt: skip
    truth = {name: RIDGES["unknown"][name] for name in ("height_m", "width_m")}
    truth["base_friction"] = rig.friction
    return {
        "verdict": facts["verdict"], "offered": taken,
        "calibrated": _compared(folder / "calibrated", rig.truth),
        "fitted": _compared(folder / "fitted", truth),
        "inverted": {} if inverted else _of_inversions(folder / "inverted", rig, model),
    }  # fmt: skip


def run(folder: Path, *words: str) -> int:
    """The exit code of a command, its results in `folder`."""
    code = command([*words, f"hydra.run.dir={folder}"])
    print(f"srsinv {shlex.join(words)}: {code}", flush=True)
    return code


def _fill_in(template: Path, rig: Rig, beside: Sequence[Path]) -> None:
    """Write the sidecars: what the template has, and what the laboratory states."""
    facts, stated = yaml.safe_load(template.read_text()), dict(rig.stated)
    elements = zip(facts["sensor"]["elements"], stated.pop("elements"), strict=True)
    facts["sensor"]["elements"] = [blank | filled for blank, filled in elements]
    for key in ("depth_m", "feedback_resistance_ohm", "strips"):
        facts["sensor"][key] = stated.pop(key)
    facts["feature"] = stated.pop("feature")
    for path in beside:
        path.write_text(yaml.safe_dump(facts | stated))


def _metrics(folder: Path) -> Mapping[str, Any]:
    path = folder / "metrics.json"
    return json.loads(path.read_text()) if path.exists() else {}


def _compared(folder: Path, truth: Mapping[str, float]) -> Row:
    """Truth, value, standard error and pull of every parameter."""
    found = _metrics(folder)
    said: Row = {"quality": found.get("quality"), "warnings": found.get("warnings")}
    for name, true in truth.items():
        value, error = found.get(name), found.get(f"{name}_stderr")
        pull = (value - true) / error if value is not None and error else None
        said[name] = [true, value, error, pull]
    return said


def _of_inversions(folder: Path, rig: Rig, model: Any) -> Row:
    """Of each method, what p is worth where the stage has been."""
    found, data = _metrics(folder), xarray.open_dataset(folder / "result.nc")
    x = data["x"].values
    line = Open(x.size, float(x[1] - x[0]), float(x[0]) - rig.origin_m)
    true = pressure(model, rig, line)
    here = np.abs(x - rig.origin_m) < INSIDE * rig.half_m
    said = {}
    for at, method in enumerate(map(str, data["estimator"].values)):
        off = data["estimate"].values[at, 0] - true
        off, stderr = off[here] - off[here].mean(), data["estimate_stderr"].values[at, 0][here]
        said[method] = {
            "quality": found[f"quality_{method.lower()}"],
            "warnings": found[f"warnings_{method.lower()}"],
            "error": float(np.std(off) / np.std(true[here])),
            "coverage": float(np.mean(np.abs(off) < BAND * stderr)),
        }
    return said


def summary(rows: Sequence[Row]) -> Row:
    """How many pulls there are, the largest one and their mean square, and the qualities."""
    pulls = [
        each[stage][name][3] for each in rows for stage in ("calibrated", "fitted")
        for name in each[stage] if isinstance(each[stage][name], list)
    ]  # fmt: skip
    known = np.array([pull for pull in pulls if pull is not None])
    return {
        "rigs": len(rows), "parameters": len(pulls), "without_a_value": len(pulls) - known.size,
        "largest_pull": float(np.abs(known).max(initial=0.0)),
        "mean_square_pull": float(np.mean(known**2)) if known.size else None,
        "good_calibrations": sum(each["calibrated"]["quality"] == "good" for each in rows),
        "good_fits": sum(each["fitted"]["quality"] == "good" for each in rows),
    }  # fmt: skip


def measured(rig: str) -> Row:
    """The row of the rig of this name."""
    with tempfile.TemporaryDirectory() as folder:
        return row(BY_NAME[rig], Path(folder))


STUDY = Study(
    "raw_rigs",
    measured,
    lambda: combinations(rig=BY_NAME),
    summary,
    rests_on=lambda rig: dataclasses.asdict(BY_NAME[rig]),
)
