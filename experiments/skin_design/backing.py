"""A skin on a backing, driven at a height that errs: change of load and signal.

A contact of width b under a uniform pressure p goes down by c p in the mean, with

    c = 1/pi integral over k > 0 of C(k) b sinc^2(kb/2) dk,  sinc(a) = sin(a)/a,

C(k) the skin's compliance. A drive that holds the height with an error h changes p by h/c. The
integral has a limit where the backing ends on a rigid core.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray

from srsinv.errors import mapping, number, number_range, refuse
from srsinv.forward.layered import Layered
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import Skin
from srsinv.forward.vibration import gain_at_rest
from srsinv.grid import Line, sinc
from srsinv.report.data import dataset

LONGEST, SHORTEST, POINTS = 1e-4, 1e3, 20_000  # k b: beyond, nothing is left to add
FREQUENCIES = 41


def height_errors(
    line: Line, scene: SurfaceScene, sensor: Sensor, scan: ConstantSpeed, given: Mapping[str, Any]
) -> xarray.Dataset:
    """Load and signal over the error of the height, and the signal of a drive that vibrates, for a
    skin on each backing. Raises `BadInput` for settings out of range."""
    key, wanted = "skin_design", "a positive length in metres"
    contact, error, vibration = (
        number(f"{key}.{name}", given[name], wanted, above=0)
        for name in ("contact_m", "height_error_m", "vibration_m")
    )
    wanted = "positive frequencies in Hz"
    low, high = number_range(f"{key}.frequency_range_hz", given["frequency_range_hz"], wanted,
                             above=0)  # fmt: skip
    backings = mapping(f"{key}.backings", given["backings"])
    refuse(not backings, f"{key}.backings is empty: give layers by the name of each backing.")
    nominal, frequency = float(scene.nominal_pressure_Pa), np.geomspace(low, high, FREQUENCIES)
    compliance, per_Pa, signals = [], [], []
    for layers in backings.values():
        backed = dataclasses.replace(sensor, skin=Layered(layers))
        compliance.append(patch_compliance(backed.skin, contact))
        of_patch = backed.charge().cell_response(jnp.zeros(1), jnp.asarray(contact))
        per_Pa.append(abs(of_patch[0, 0].item()))
        change = error / compliance[-1] / nominal
        loads = nominal * np.array([1.0, 1 - change, 1 + change])
        signals.append(
            [_peak(line, scene, backed, scan, load) if load > 0 else 0 for load in loads]
        )
    soft, heights = np.array(compliance), np.geomspace(error / 30, 3 * error, 41)
    signal, of_backing = np.array(signals), "backing"
    rate = gain_at_rest(sensor.amplifier) * 2 * np.pi * frequency
    shaken = rate * (np.array(per_Pa) * vibration / soft)[:, None]
    at_last = shaken[:, -1] / vibration
    return dataset(
        {
            "compliance": (of_backing, soft, "m/Pa"),
            "load_change": (of_backing, error / soft / nominal, "1", "load_change_{backing}"),
            "signal_change": (of_backing, np.ptp(signal, axis=1) / 2 / signal[:, 0], "1",
                              "signal_change_{backing}"),
            "ridge": (of_backing, signal[:, 0], "V", "ridge_signal_{backing}_V"),
            "vibration_as_ridge": (of_backing, signal[:, 0] / at_last, "m",
                                   "vibration_as_ridge_{backing}_m"),
            "load_error": ((of_backing, "height_error"), heights / soft[:, None] / nominal, "1"),
            "vibration_signal": ((of_backing, "frequency"), shaken, "V"),
        },
        {"backing": (list(backings), "1"), "height_error": (heights, "m"),
         "frequency": (frequency, "Hz"),
         "layers": ("backing", [Layered(each).words for each in backings.values()], "1")},
        contact_m=contact, height_error_m=error, vibration_m=vibration,
    )  # fmt: skip


def _peak(
    line: Line, scene: SurfaceScene, sensor: Sensor, scan: ConstantSpeed, load_Pa: float
) -> float:
    """Greatest size of the signal [V] on the scene's surface under a nominal pressure."""
    loaded = eqx.tree_at(lambda s: s.nominal_pressure_Pa, scene, jnp.asarray(load_Pa))
    traction = loaded.with_skin(sensor.skin).traction(line, scan.direction)
    return float(jnp.abs(sensor.operator(line, scan)(traction)).max())


def patch_compliance(skin: Skin, contact_m: float) -> float:
    """Mean displacement [m/Pa] of a contact of this width per uniform pressure."""
    log_k = np.linspace(np.log(LONGEST), np.log(SHORTEST), POINTS)
    k = jnp.asarray(np.exp(log_k) / contact_m)
    under = skin.compliance(k) * contact_m * sinc(k * contact_m / 2) ** 2 * k
    return float(jnp.sum(under)) * (log_k[1] - log_k[0]) / np.pi
