"""Wiener, Tikhonov and a feature fit compared: on a scene whose truth is known, or on a recording.

On a scene: errors of p and of q, coverage of the 90 % band and time, over noise levels and draws of
the noise. On a recording, without a truth: each method's prediction of held-out samples, its
repeatability, and the agreement between methods.
"""

from .. import config, parts
from ..inverse.features.method import FeatureFit
from ..report.result import Result
from ..targets import make
from . import _facts
from ._compare_recording import on_recording
from ._compare_scene import SceneComparison, SceneDraws, on_scene
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
            on_line = on_cells(problem, "comparison")
            times = config.part(cfg, "recording").get("times")
            facts |= {
                **_facts.of_recording(recording, problem, times),
                **_facts.of_cells(recording, problem, on_line),
                **_facts.of_effects(config.part(cfg, "effects")),
            }
            units = recording.signal_unit, unit
            return on_recording(recording.name, on_line, methods, units, facts)
        given = cfg["compare"]
        draws = SceneDraws.checked(given, config.seed(cfg))
        cfg = config.with_facts(cfg, given["scene_sensor"], SCENE_SKIN)
        # The levels' own noise comes with each draw.
        sim, screening = config.screened({**cfg, "noise": {}})
        effects, wrong = config.part(cfg, "effects"), given["wrong_feature"]
        if wrong is not None:
            wrong = make(wrong, "compare.wrong_feature", "feature")
            facts["wrong_feature"] = type(wrong).__name__.removesuffix("Feature").lower()
        on = [name for name in effects if screening is None or name in screening.on]
        noises = parts.coloured_noises(config.part(cfg, "noise"))
        levels = ", ".join(f"{level:g}" for level in draws.snr_dB)
        facts |= {
            **_facts.of_simulation(sim, [f"white at {levels} dB", *noises], on),
            "precision_and_seed": f"{cfg['precision']}, {cfg['seed']}",
        }
        scene = SceneComparison(sim, draws, noises, config.friction(cfg))
        return on_scene(
            scene, methods, None if wrong is None else FeatureFit({"wrong": wrong}, solver), facts
        )
