"""Wiener, Tikhonov and a feature fit compared: on a scene whose truth is known, or on a recording.

On a scene: errors of p and of q, coverage of the 90 % band and time, over noise levels and draws of
the noise. On a recording, without a truth: each method's prediction of held-out samples, its
repeatability, and the agreement between methods.
"""

from .. import config, parts
from ..inverse.features.method import FeatureFit
from ..modules import with_fields
from ..report.result import Result
from ..targets import make
from . import _facts
from ._compare_recording import on_recording
from ._compare_scene import SceneComparison, levels_and_seeds, on_scene
from ._recorded import check_invertible, on_cells, traction_unit_named
from .monte_carlo import inversions

SCENE_SKIN = {"poisson_ratio": 0.5}  # of a half space, where the configuration leaves it open


def run(cfg: config.Config) -> Result:
    """The job: on the configured recording, or without one on the scene.

    Raises `BadInput` for fewer than two methods, for a recording that cannot be inverted, and for
    invalid levels or draws.
    """
    with config.precision(cfg):
        features, solver = config.features(cfg), config.solver(cfg)
        methods = inversions(config.methods(cfg) if cfg.get("method") else {}, features, solver)
        facts = {**_facts.of_friction(cfg["friction"]), "features": " + ".join(features)}
        if cfg["recording"]["path"] is not None:
            unit = traction_unit_named(cfg.get("traction_unit", "Pa"))
            recording = config.recording(cfg)
            check_invertible(recording, unit)
            problem = config.recorded_problem(cfg, recording)
            if problem.rig is not None:
                # Both halves have the same rig: tolerances of it say nothing of how they repeat.
                problem = with_fields(problem, rig=problem.rig.of_calibration)
            gridded = on_cells(problem, "comparison")
            times = config.part(cfg, "recording").get("times")
            facts |= {
                **_facts.of_recording(recording, problem, times),
                **_facts.of_cells(recording, problem, gridded),
                **_facts.of_effects(config.part(cfg, "effects")),
            }
            units = recording.signal_unit, unit
            return on_recording(recording.name, gridded, methods, units, facts)
        given = cfg["compare"]
        levels, seeds = levels_and_seeds(given, config.seed(cfg))
        cfg = config.with_facts(cfg, given["scene_sensor"], SCENE_SKIN)
        # The levels' own noise comes with each draw.
        sim, screening = config.screened({**cfg, "noise": {}})
        on = [name for name in config.part(cfg, "effects") if not screening or name in screening.on]
        noises = parts.coloured_noises(config.part(cfg, "noise"))
        white = f"white at {', '.join(f'{level:g}' for level in levels)} dB"
        facts |= {
            **_facts.of_simulation(sim, [white, *noises], on),
            "precision_and_seed": f"{cfg['precision']}, {cfg['seed']}",
        }
        scene = SceneComparison(sim, levels, seeds, noises, config.friction(cfg))
        absent = None
        if given["wrong_feature"] is not None:
            feature = make(given["wrong_feature"], "compare.wrong_feature", "feature")
            name = type(feature).__name__.removesuffix("Feature").lower()
            absent = FeatureFit({name: feature}, solver)
        return on_scene(scene, methods, absent, facts)
