"""Strips in several directions in one fingertip, beside the paper's pair of parallel strips."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from srsinv import config
from srsinv.compiled import compiled
from srsinv.errors import number, refuse, whole
from srsinv.forward.planar import Circle, PathScan, StraightPass
from srsinv.forward.sensor import Sensor, two_orientations
from srsinv.inverse.planar.signal import (
    GratingShape,
    PlanarSignal,
    RidgeShape,
    StraightFeature,
    information,
    standard_errors,
    weights,
)
from srsinv.progress import stage
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed

from .scenes import noise_rms

OWN, PAIR = "own", "pair"  # the configured sensor, and the paper's two strips
LOAD = "a number above 0"


def run(cfg: config.Config) -> Result:
    """Detection by straight passes and bounds of directions by a circle, over all directions.

    Raises `BadInput` for sizes that are not positive, and refusals of the configuration's parts.
    """
    settings = cfg["directions"]
    count = whole("directions.count", settings["count"], "a whole number from 2", least=2)
    degrees = 180.0 * np.arange(count) / count
    with config.precision(cfg):
        own = config.sensor(cfg)
        refuse(
            bool(own.filters),
            f"The sensor has {len(own.filters)} filters, which cannot be simulated on a circle: "
            "leave them out of effects.",
        )
        sensors = {OWN: own, PAIR: Sensor(two_orientations(), own.skin, own.amplifier)}
        circle, features = Circle(**settings["circle"]), _features(settings)
        with stage("weighing every direction"):
            passes = _passes(sensors[OWN], sensors[PAIR], settings["pass"], features, degrees)
            bounds, shares = _bounds(sensors, circle, features, degrees)
    worst = {
        f"information_worst_over_best_{feature}_{name}": float((rows.min() / rows.max()) ** 2)
        for feature, of in passes.items() for name, rows in zip(sensors, of, strict=True)
    } | {
        f"angle_information_worst_over_best_{feature}_{name}":
            float((rows.min() / rows.max()) ** 2)
        for feature, of in bounds.items() for name, rows in zip(sensors, of, strict=True)
    }  # fmt: skip
    along = ("arrangement", "direction")
    data = dataset(
        {f"detection_{feature}": (along, rows, "1") for feature, rows in passes.items()}
        | {f"angle_bound_{feature}": (along, np.where(np.isfinite(rows), rows, np.nan), "deg")
           for feature, rows in bounds.items()}
        | {"weight": (("element", "direction"), shares, "1")}
        | scalars(worst),
        {"arrangement": (["this sensor", "pair of parallel strips"], "1"),
         "element": (list(cfg["sensor"]["elements"]), "1"), "direction": (degrees, "deg")},
        effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    share = worst[f"information_worst_over_best_ridge_{OWN}"]
    title = f"The worst direction of a pass has {100 * share:.0f} % of the best one's information"
    return Result(title, data, sections(__file__))


def _features(settings: Mapping[str, Any]) -> dict[str, tuple[StraightFeature, np.ndarray]]:
    """Ridge and grating with their parameters, the angle still 0."""

    def row(name: str, size: str) -> np.ndarray:
        given = settings[name]
        for key in (size, "load_N_per_m"):
            number(f"directions.{name}.{key}", given[key], LOAD, above=0)
        place = number(f"directions.{name}.distance_m", given["distance_m"], "a distance in metres")
        mu = number(f"directions.{name}.friction", given["friction"], "a number, of either sign")
        load = given["load_N_per_m"]
        return np.array([0.0, place, given[size], load, load * mu])

    return {
        "ridge": (RidgeShape(), row("ridge", "width_m")),
        "grating": (GratingShape(), row("grating", "pitch_m")),
    }


def _passes(own: Sensor, pair: Sensor, given: Mapping[str, Any], features, degrees):
    """The norm of the signal over the noise of a straight pass along the normal, (arrangement,
    direction) of each feature."""
    rms = noise_rms(StraightPass(0.0, **given))

    def one(sensor: Sensor, feature: StraightFeature, row: np.ndarray) -> np.ndarray:
        return np.asarray(_norms(sensor, feature, jnp.asarray(row), jnp.deg2rad(degrees), **given))

    return {
        name: np.stack([one(sensor, *feature) / rms for sensor in (own, pair)])
        for name, feature in features.items()
    }


@compiled
def _norms(
    sensor: Sensor, feature: StraightFeature, row: Float[Array, " m"], angles: Float[Array, " a"],
    *, speed_m_per_s: float, duration_s: float, samples: int,
) -> Float[Array, " a"]:  # fmt: skip
    def norm(angle: Float[Array, ""]) -> Float[Array, ""]:
        path = StraightPass(angle, speed_m_per_s, duration_s, samples)
        params = dict(zip(feature.names, row.at[0].set(jnp.rad2deg(angle)), strict=True))
        return jnp.linalg.norm(PlanarSignal(feature, (PathScan(sensor, path),))(params))

    return jax.lax.map(norm, angles)


def _bounds(sensors: Mapping[str, Sensor], circle: Circle, features, degrees):
    """The Cramer-Rao bound of the angle by one circle [deg], (arrangement, direction) of each
    feature; and the share of each own element in the information on a ridge's angle."""
    rms, bounds, shares = noise_rms(circle), {}, np.empty(0)
    for name, (feature, row) in features.items():
        rows = []
        for key, sensor in sensors.items():
            signal, per = PlanarSignal(feature, (PathScan(sensor, circle),)), []
            levels = jnp.full(len(sensor.elements), rms)
            for angle in degrees:
                own = jnp.asarray(np.append(angle, row[1:]))
                per.append(np.asarray(information(signal, own, levels)))
            rows.append([standard_errors(each.sum(axis=0))[0] for each in per])
            if (key, name) == (OWN, "ridge"):
                shares = np.stack([weights(each) for each in per], axis=1)
        bounds[name] = np.array(rows)
    return bounds, shares
