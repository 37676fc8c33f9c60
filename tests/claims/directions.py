"""Directions by four strips turned in the plane: from one circle, and by passes that are proposed.

- `circle`: 200 ridges and 200 gratings of random direction in one fingertip, each found from one
  circle in Johnson noise: the error of the angle over its Cramer-Rao bound, and how often the
  intervals of its standard errors cover it.
- `share`: 100 gratings whose ridges are another share of a pitch wide than the fits take.
- `passes`: ten features that one pass detected, and three more passes: proposed ones, or headings
  of 0, 90 and 45 degrees at 0.05 m/s and at the greatest speed allowed. Each twice.
"""

import dataclasses
from typing import Any

import jax
import numpy as np

from experiments.directions.scenes import (
    RANGES,
    SHAPES,
    SPEED,
    WIDTH_SHARE,
    PassesOver,
    draw_feature,
    errors,
    noise_rms,
)
from srsinv import config
from srsinv.forward.filter import FirstOrder
from srsinv.forward.planar import Circle, PathScan
from srsinv.inverse.planar.finder import DirectionFinder
from srsinv.inverse.planar.next_pass import PassLimits
from srsinv.inverse.planar.signal import (
    GratingShape,
    PlanarSignal,
    information,
    standard_errors,
)
from srsinv.inverse.quality import Quality
from srsinv.jobs.trials import Row
from tests.claims.study import Study
from tests.jobs.run import composed

DRAWS, CIRCLE = 200, {"radius_m": 8e-3, "speed_m_per_s": 0.05}
SAMPLES, SCENES, TWICE = 192, 5, 2
TIME_CONSTANT_S, LIMITS = 0.01, PassLimits(greatest_speed_m_per_s=0.15)
MISSED = 5.0  # standard errors, beyond which a direction is missed
SHARES, HARMONICS = (0.2, 0.25, WIDTH_SHARE, 0.35, 0.4), 24


def sensor():
    """Four strips in four directions, each with the mean over its width."""
    return config.sensor(composed("experiment=circular_scan", "sensor=four_directions"))


@jax.enable_x64(True)
def circle(kind: str) -> Row:
    """Directions from one circle."""
    rng, device = np.random.default_rng(3), sensor()
    path = Circle(samples=SAMPLES, **CIRCLE)
    scan, fine = PathScan(device, path), PathScan(device, Circle(samples=2 * SAMPLES, **CIRCLE))
    ranges = {name: each for name, each in RANGES[kind].items() if name != "distance_m"}
    finder, rms = DirectionFinder(scan, SHAPES[kind], ranges), noise_rms(path)
    bounds, pulls, over = [], [], []
    for _ in range(DRAWS):
        drawn = draw_feature(kind, rng, 4e-3)
        clean = np.asarray(fine(drawn.feature))[:, ::2]
        found = finder(clean + rms * rng.standard_normal(clean.shape), rms)
        per_element = information(
            PlanarSignal(SHAPES[kind], (scan,)), jax.numpy.asarray(drawn.truth),
            jax.numpy.full(len(clean), rms),
        )  # fmt: skip
        bounds.append(standard_errors(np.asarray(per_element).sum(axis=0))[0])
        error = errors(drawn, found)[0]
        over.append(error / bounds[-1])
        pulls.append(error / found.parameters["angle_deg"][1])
    pull, missed = np.abs(pulls), np.abs(over) > MISSED
    return {
        "bound_deg_greatest": float(np.max(bounds)),
        "bound_deg_least": float(np.min(bounds)),
        "missed": int(missed.sum()),
        "error_over_bound": float(np.sqrt(np.mean(np.square(over)[~missed]))),
        "coverage_68": float(np.mean(pull < 1.0)),
        "coverage_90": float(np.mean(pull < 1.645)),
    }


@jax.enable_x64(True)
def wrong_share(share: float) -> Row:
    """Directions of gratings by fits that take another width over the pitch; the signals have three
    times the harmonics of the fits and twice the samples."""
    rng, path = np.random.default_rng(5), Circle(samples=SAMPLES, **CIRCLE)
    device, twice = sensor(), Circle(samples=2 * SAMPLES, **CIRCLE)
    signal = PlanarSignal(GratingShape(share, HARMONICS), (PathScan(device, twice),))
    ranges = {"pitch_m": RANGES["grating"]["pitch_m"]}
    finder = DirectionFinder(PathScan(device, path), SHAPES["grating"], ranges)
    rms = noise_rms(path)
    found_errors, stderrs, doubtful = [], [], 0
    for _ in range(DRAWS // 2):
        drawn = draw_feature("grating", rng, 4e-3)
        params = zip(GratingShape.names, jax.numpy.asarray(drawn.truth), strict=True)
        clean = np.asarray(signal(dict(params)))[:, ::2]
        found = finder(clean + rms * rng.standard_normal(clean.shape), rms)
        found_errors.append(errors(drawn, found)[0])
        stderrs.append(found.parameters["angle_deg"][1])
        doubtful += found.fit.quality is not Quality.GOOD
    pull = np.abs(np.divide(found_errors, stderrs))
    return {
        "median_error_deg": float(np.median(np.abs(found_errors))),
        "median_stderr_deg": float(np.median(stderrs)),
        "beyond_5_stderr": int(np.sum(pull > MISSED)),
        "coverage_68": float(np.mean(pull < 1.0)),
        "coverage_90": float(np.mean(pull < 1.645)),
        "doubtful": doubtful,
    }


@jax.enable_x64(True)
def passes(kind: str, scene: int, draw: int) -> Row:
    """Three more passes over one feature."""
    device = dataclasses.replace(sensor(), filters=(FirstOrder(TIME_CONSTANT_S),))
    drawn = draw_feature(kind, np.random.default_rng(100 + scene))

    def ends(found) -> dict[str, Any]:
        _, covariance = found.posterior(SHAPES[kind].names)
        size = np.sqrt(np.diag(covariance))
        volume = np.log(size).sum() + np.linalg.slogdet(covariance / np.outer(size, size))[1] / 2
        error = np.abs(errors(drawn, found))
        return {"log_volume": float(volume), "error_deg": float(error[0]),
                "log_error": float(np.mean(np.log(error)))}  # fmt: skip

    over = PassesOver(device, drawn, LIMITS, seed=1000 * scene + draw)
    found, paths = over.proposed()
    steps = list(enumerate(paths, 1))
    rows = {"proposed": ends(found), "fixed": ends(over.fixed(SPEED)),
            "fixed_fast": ends(over.fixed(LIMITS.greatest_speed_m_per_s))}  # fmt: skip
    return {
        "truth_deg": float(drawn.truth[0]),
        **{f"heading_deg_{n}": float(np.rad2deg(path.heading_rad)) for n, path in steps},
        **{f"speed_m_per_s_{n}": float(path.speed_m_per_s) for n, path in steps},
        **{f"{name}_{arm}": value for arm, row in rows.items() for name, value in row.items()},
    }


def measure(what: str, **labels: Any) -> Row:
    """One case."""
    return {"circle": circle, "share": wrong_share, "passes": passes}[what](**labels)


def cases() -> list[dict[str, Any]]:
    """Both circles, ten scenes twice, and gratings of several widths."""
    kinds = ("ridge", "grating")
    return [{"what": "circle", "kind": kind} for kind in kinds] + [
        {"what": "passes", "kind": kind, "scene": scene, "draw": draw}
        for kind in kinds for scene in range(SCENES) for draw in range(TWICE)
    ] + [{"what": "share", "share": share} for share in SHARES]  # fmt: skip


def summary(rows: list[Row]) -> Row:
    """In how many scenes proposed passes are better, and by what ratio: geometric means, of the
    posterior's volume per parameter, of the errors of all parameters, and of the angle's."""
    made, parameters = [row for row in rows if row["what"] == "passes"], 5
    scenes = sorted({(row["kind"], row["scene"]) for row in made})

    def against(arm: str) -> Row:
        def ratios(key: str, scale: float = 1.0) -> np.ndarray:
            return np.exp([
                np.mean([scale * (row[f"{key}_{arm}"] - row[f"{key}_proposed"]) for row in made
                         if (row["kind"], row["scene"]) == scene])
                for scene in scenes
            ])  # fmt: skip

        volume, error = ratios("log_volume", 1 / parameters), ratios("log_error")
        angle = [np.sqrt(np.mean([row[f"error_deg_{which}"] ** 2 for row in made]))
                 for which in (arm, "proposed")]  # fmt: skip
        return {
            "scenes": len(scenes),
            "smaller_volume": int(np.sum(volume > 1)),
            "volume_ratio_per_parameter": float(np.exp(np.mean(np.log(volume)))),
            "smaller_error": int(np.sum(error > 1)),
            "error_ratio": float(np.exp(np.mean(np.log(error)))),
            "rms_angle_error_deg": float(angle[0]),
            "rms_angle_error_deg_proposed": float(angle[1]),
        }

    own = [row for row in rows if row["what"] == "circle"]
    circles = {row["kind"]: {k: v for k, v in row.items() if k not in ("what", "kind")}
               for row in own}  # fmt: skip
    shares = {str(row["share"]): {k: v for k, v in row.items() if k not in ("what", "share")}
              for row in rows if row["what"] == "share"}  # fmt: skip
    return {"circle": circles, "share": shares, "fixed": against("fixed"),
            "fixed_fast": against("fixed_fast")}  # fmt: skip


STUDY = Study("directions", measure, cases, summary)
