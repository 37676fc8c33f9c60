"""Wiener, Tikhonov and a feature fit compared: on a scene whose truth is known, or on a recording.

On a scene: errors of p and of q, coverage of the 90 % band and time, over noise levels and draws of
the noise. On a recording, without a truth: each method's prediction of held-out samples, its
repeatability, and the agreement between methods.
"""

from ..report.outcome import Outcome
from . import build
from .compare_recording import on_recording
from .compare_scene import on_scene


def run(cfg: build.Config) -> Outcome:
    """The job: on the configured recording, or without one on the scene."""
    with build.precision(cfg):
        return on_scene(cfg) if cfg["recording"]["path"] is None else on_recording(cfg)
