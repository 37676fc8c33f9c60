"""Wiener, Tikhonov and a feature fit compared: on a scene whose truth is known, or on a recording.

On a scene: errors of p and of q, coverage of the 90 % band and time, over noise levels and draws of
the noise. On a recording, without a truth: each method's prediction of held-out samples, its
repeatability, and the agreement between methods.
"""

from .. import config, parts
from ..report.outcome import Outcome
from ..targets import make
from . import contest
from .cells import StatedSettings, check_invertible, recording_problem, traction_unit_named
from .compare_recording import on_recording
from .compare_scene import SceneComparison, SceneDraws, on_scene

SCENE_SKIN = {"poisson_ratio": 0.5}  # of a half space, where the configuration leaves it open


def run(cfg: config.Config) -> Outcome:
    """The job: on the configured recording, or without one on the scene.

    Raises `BadInput` for fewer than two methods, for a recording that cannot be inverted, and for
    invalid levels or draws.
    """
    with config.precision(cfg):
        features, solver = config.features(cfg), config.solver(cfg)
        named = config.methods(cfg) if cfg.get("method") else {}
        methods = contest.compared_methods(named, features, solver)
        if cfg["recording"]["path"] is not None:
            unit = traction_unit_named(cfg.get("traction_unit", "Pa"))
            recording = config.recording(cfg)
            check_invertible(recording, unit)
            times = config.part(cfg, "recording").get("times")
            stated = StatedSettings(config.part(cfg, "effects"), cfg["friction"], times)
            problem = config.recorded_problem(cfg, recording)
            loaded = recording_problem(recording, problem, unit, stated, "comparison")
            return on_recording(loaded, methods, features)
        given = cfg["compare"]
        draws = SceneDraws.checked(given, config.seed(cfg))
        cfg = config.with_facts(cfg, given["scene_sensor"], SCENE_SKIN)
        # The levels' own noise comes with each draw.
        sim, screening = config.screened({**cfg, "noise": {}})
        effects, wrong = config.part(cfg, "effects"), given["wrong_feature"]
        if wrong is not None:
            wrong = make(wrong, "compare.wrong_feature", "feature")
        scene = SceneComparison(
            sim,
            draws,
            noises=parts.coloured_noises(config.part(cfg, "noise")),
            friction=config.friction(cfg),
            features=tuple(features),
            wrong_feature=wrong,
            effects=[name for name in effects if screening is None or name in screening.on],
            stated=(cfg["friction"], f"{cfg['precision']}, {cfg['seed']}"),
        )
        return on_scene(scene, methods, solver)
