"""Invert a recorded signal: p and q by every method named, with bands and resolution."""

import dataclasses

import xarray

from .. import config
from ..inverse.gridding.directions import pressure_by_direction
from ..report.result import Result
from . import _facts
from ._conformal import with_conformal
from ._inversion import InversionCase
from ._inversion import run as invert
from ._recorded import check_invertible, on_cells, traction_unit_named


def run(cfg: config.Config) -> Result:
    """The job: load, put on a line of cells, invert."""
    with config.precision(cfg):
        methods, unit = config.methods(cfg), traction_unit_named(cfg.get("traction_unit", "Pa"))
        recording = config.recording(cfg)
        check_invertible(recording, unit, methods.values())
        problem = config.recorded_problem(cfg, recording)
        every, calibrated = with_conformal(cfg, methods, problem, unit)
        gridded = on_cells(problem)
        facts = {
            **_facts.of_recording(recording, problem, config.part(cfg, "recording").get("times")),
            **_facts.of_cells(recording, problem, gridded),
            **_facts.of_effects(config.part(cfg, "effects")),
            **_facts.of_friction(cfg["friction"]),
        }
        assert gridded.sensor is not None
        result = invert(
            InversionCase(
                problem=gridded,
                sensor=gridded.sensor,
                methods=every,
                facts=facts,
                name=recording.name,
                signal_unit=recording.signal_unit,
                traction_unit=unit,
                check=lambda method, joint: pressure_by_direction(method, problem, joint),
            )
        )
        if calibrated is None:
            return result
        both = result.dataset, calibrated
        data = xarray.merge(both, join="exact", combine_attrs="no_conflicts")
        return dataclasses.replace(result, dataset=data)
