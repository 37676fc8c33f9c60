"""Invert a recorded signal: p and q by every method named, with bands and resolution."""

from ..report.outcome import Outcome
from . import build
from .analysis import InversionCase
from .analysis import run as analyse
from .cells import recording_problem


def run(cfg: build.Config) -> Outcome:
    """The job: load, put on a line of cells, invert, report."""
    with build.precision(cfg):
        methods, loaded = build.methods(cfg), recording_problem(cfg)
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
