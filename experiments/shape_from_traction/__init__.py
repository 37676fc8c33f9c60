"""Profile under the finger, from the estimated pressure: the inverse of contact."""

from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from srsinv import config
from srsinv.errors import mapping, refuse
from srsinv.inverse.estimate import Estimate, coverage_90
from srsinv.inverse.solved_contact import SolvedContact
from srsinv.progress import stage
from srsinv.report.answers import answer_variables
from srsinv.report.data import dataset
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import spoken, unit_of

from .figures import pressures, shapes
from .shape import RecoveredShape

Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result:
    """For each scene the recovered profile with its band, against the true one in contact.

    Raises `BadInput` for invalid scenes, or scenes without surfaces, and more than one method.
    """
    scenes = mapping("shape_from_traction.scenes", cfg["shape_from_traction"]["scenes"])
    refuse(not scenes, "shape_from_traction.scenes is empty: give one or more scenes by name.")
    contacts, estimates, recovered = [], {}, []
    with config.precision(cfg):
        methods = config.methods(cfg)
        refuse(len(methods) != 1, f"method names {len(methods)}: give one, method=[wiener].")
        (method,) = methods.values()
        for name, node in scenes.items():
            with stage(f"recovering the profile: {name}"):
                solved = SolvedContact(config.simulation({**cfg, "scene": node}))
                estimate = method(solved.problem(config.random_key(cfg)))
                recovered.append(RecoveredShape.under(solved, estimate))
                contacts.append(str(solved.contact.status))
                estimates[name] = estimate.with_warnings(solved.contact.warnings)
        line, depth_m = config.line(cfg), float(config.sensor(cfg).depth_m)

    answers = answer_variables(estimates, "scene")
    status = {"contact": contacts, "recovery": answers.pop("status")[1]}
    data = dataset(
        _profiles(recovered, estimates.values())
        | _errors(recovered)
        | {name: ("scene", words, "1", f"{name}_{{scene}}") for name, words in status.items()}
        | answers,
        {"scene": (list(scenes), "1"), "x": (np.asarray(line.x), "m")},
        depth_m=depth_m,
        line=line.kind,
        noise=", ".join(cfg["noise"]),
        method=", ".join(cfg["method"]),
        refinement=int(cfg["grid"]["refinement"]),
    )
    rms = zip(scenes, data["rms_error"].values, strict=True)
    parts = [f"{1e6 * error:.2g} µm rms ({spoken(name)})" for name, error in rms]
    title = f"Profiles from the pressure have errors of {', '.join(parts)} within the contact"
    return Result(title, data, sections(__file__, shapes=shapes, pressures=pressures))


def _profiles(recovered: Collection[RecoveredShape], estimates: Collection[Estimate]) -> Variables:
    """Heights and pressures along x, and where the skin touches."""
    by, units = ("scene", "x"), {"pressure": "Pa", "pressure_resolved": "Pa"}
    every = zip(RecoveredShape._fields, zip(*recovered, strict=True), strict=True)
    return {
        **{name: (by, np.stack(each), units.get(name, "m")) for name, each in every},
        "pressure_estimate": (by, [each.value[0] for each in estimates], "Pa"),
        "pressure_estimate_stderr": (by, [each.stderr[0] for each in estimates], "Pa"),
        "touching": (by, [each.touching.astype(np.int8) for each in recovered], "1"),
    }


def _errors(recovered: Collection[RecoveredShape]) -> Variables:
    """Errors of the recovered profiles within the contact."""
    inside = [RecoveredShape._make(row[each.touching] for row in each) for each in recovered]

    def rms(of: Callable[[RecoveredShape], np.ndarray]) -> list[float]:
        return [np.sqrt(np.mean(of(each) ** 2)) for each in inside]

    numbers = {
        "height_range_m": [np.ptp(each.height) for each in inside],
        "rms_error_m": rms(lambda r: r.shape - r.height),
        "rms_unresolved_m": rms(lambda r: r.shape_resolved - r.height),
        "rms_exact_pressure_m": rms(lambda r: r.shape_exact_pressure - r.height),
        "rms_predicted_m": rms(lambda r: r.shape_stderr),
        "coverage": [coverage_90(r.shape, r.shape_stderr, r.height, r.touching) for r in inside],
        "contact_fraction": [each.touching.mean() for each in recovered],
    }
    return {
        name.removesuffix("_m"): ("scene", values, unit_of(name), f"{name}_{{scene}}")
        for name, values in numbers.items()
    }
