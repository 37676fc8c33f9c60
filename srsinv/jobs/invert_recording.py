"""Invert a recorded signal: p and q by every method named, with bands, and what cannot be seen."""

from ..report.outcome import Outcome
from . import build
from .analysis import Case
from .analysis import run as analyse
from .cells import pose


def run(cfg: build.Config) -> Outcome:
    """The job: load, put on a line of cells, invert, report."""
    with build.precision(cfg):
        methods, posed = build.methods(cfg), pose(cfg)
        return analyse(
            Case(
                title=f"{posed.recording.name}: {', '.join(cfg['method'])}",
                problem=posed.problem,
                sensor=posed.sensor,
                speed_m_per_s=posed.speed_m_per_s,
                methods=methods,
                signal_unit=posed.recording.signal_unit,
                traction_unit=posed.traction_unit,
                assumed=posed.assumed,
                time_steady=False,
            )
        )
