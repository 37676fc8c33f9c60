"""Invert a recorded signal: p and q by every method named, with bands and resolution."""

from .. import config
from ..report.outcome import Outcome
from .analysis import InversionCase
from .analysis import run as analyse
from .cells import StatedSettings, check_invertible, recording_problem, traction_unit_named


def run(cfg: config.Config) -> Outcome:
    """The job: load, put on a line of cells, invert, report."""
    with config.precision(cfg):
        methods, unit = config.methods(cfg), traction_unit_named(cfg.get("traction_unit", "Pa"))
        recording = config.recording(cfg)
        check_invertible(recording, unit)
        times = config.part(cfg, "recording").get("times")
        stated = StatedSettings(config.part(cfg, "effects"), cfg["friction"], times)
        problem = config.recorded_problem(cfg, recording)
        loaded = recording_problem(recording, problem, unit, stated)
        return analyse(
            InversionCase(
                title=f"{loaded.recording.name}: {', '.join(cfg['method'])}",
                problem=loaded.problem,
                sensor=loaded.sensor,
                speed_m_per_s=loaded.speed_m_per_s,
                methods=methods,
                signal_unit=loaded.recording.signal_unit,
                traction_unit=loaded.traction_unit,
                assumed=loaded.assumed,
                time_steady=False,
            )
        )
