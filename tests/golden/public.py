"""What the public functions give from Python: README's examples, fits of each kind, recordings."""

import math
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax.numpy as jnp
import numpy as np

import srsinv
from srsinv.forward.film import Film
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Periodic
from srsinv.inverse import nonlinear
from srsinv.recording import load, save
from tests.golden.entries import Entries, entry

EXAMPLE = Path(srsinv.__file__).parent / "examples" / "strip_two_element.csv"
X = jnp.linspace(0.0, 1.0, 50)
Y = 3.0 * jnp.exp(-2.0 * X) + 1.0 + 0.01 * jnp.sin(40.0 * X)
START = {"a": 1.0, "k": 1.0, "c": 0.0}


def decay(params):
    """README's model."""
    return params["a"] * jnp.exp(-params["k"] * X) + params["c"]


def of_fit(fit: srsinv.Fit) -> dict[str, Any]:
    """The numbers of a fit."""
    named = {f"value.{key}": value for key, value in fit.value.items()}
    named |= {f"value.{key}_stderr": value for key, value in fit.stderr.items()}
    return named | {
        "covariance": fit.covariance,
        "residual": fit.residual,
        "noise_rms": fit.noise_rms,
        "status": fit.status,
        "at_bound": " ".join(fit.at_bound),
        "log_evidence": fit.log_evidence,
        "cost": fit.stats["cost"],
        "quality": str(fit.quality),
    }


def fit_readme():
    bounds = {"k": (0.0, 10.0)}
    return of_fit(srsinv.fit(decay, START, Y, bounds=bounds, linear=("a", "c")))


def fit_priors():
    priors = {"a": (2.5, 0.3), "k": (2.0, 1.0), "c": (1.0, 1.0)}
    return of_fit(srsinv.fit(decay, START, Y, noise=0.01, priors=priors))


def fit_sliding():
    noise = nonlinear.WhitePlusOU(X, np.full((1, X.size), 0.005), 0.01, 0.05)
    return of_fit(srsinv.fit(lambda params: decay(params)[None], START, Y[None], noise=noise))


def fit_robust():
    y = Y.at[7].add(2.0)
    return of_fit(srsinv.fit(decay, START, y, noise=0.01, loss="huber"))


def fit_gradients():
    solver = nonlinear.OptaxLBFGS()
    return of_fit(srsinv.fit(decay, START, Y, noise=0.01, solver=solver))


def fit_starts():
    bounds = {"k": (0.0, 40.0), "w": (5.0, 80.0)}

    def wave(params):
        return decay(params | {"c": 1.0}) + params["b"] * jnp.sin(params["w"] * X)

    start = {"a": 1.0, "k": 1.0, "b": 0.1, "w": 20.0}
    return of_fit(srsinv.fit(wave, start, Y, noise=0.01, bounds=bounds, starts=6,
                             linear=("a", "b")))  # fmt: skip


def fit_many():
    fits = srsinv.fit_many(decay, START, jnp.stack([Y, 2 * Y, Y + 0.1 * X]), noise=0.01)
    return {f"{i}.{key}": each for i, one in enumerate(fits) for key, each in of_fit(one).items()}


def operator():
    line = Periodic(1024, cell_m=4e-5)
    sensor = Sensor([Film(), Film(angle_rad=math.pi / 2)])
    voltage = sensor.operator(line, ConstantSpeed(0.05))
    traction = np.random.default_rng(zlib.crc32(b"operator")).normal(size=(2, 1024))
    signal = voltage(jnp.asarray(traction))
    return {"signal": signal, "back": voltage.adjoint(signal)}


def recording():
    """Loaded, saved and loaded again."""
    with TemporaryDirectory() as folder:
        first = load(EXAMPLE)
        save(first, Path(folder) / "again.csv")
        again = load(Path(folder) / "again.csv")
    arrays = {"signal": again.signal, "time_s": again.time_s, "speed_m_per_s": again.speed_m_per_s,
              "position_m": again.position_m}  # fmt: skip
    unchanged = all(
        np.array_equal(getattr(first, key), each, equal_nan=True) for key, each in arrays.items()
    )
    words = {"channels": " ".join(again.channels), "signal_unit": again.signal_unit}
    return arrays | words | {"unchanged": unchanged, "sidecar": str(again.sidecar)}


SCRIPTS: dict[str, Callable[[], Mapping[str, Any]]] = {
    each.__name__: each
    for each in (fit_readme, fit_priors, fit_sliding, fit_robust, fit_gradients, fit_starts,
                 fit_many, operator, recording)
}  # fmt: skip


def entries(name: str) -> Entries:
    """What one of the scripts gives."""
    return {key: entry(value) for key, value in SCRIPTS[name]().items()}
