"""Scans of unknown surfaces: traction of many spectra, simulated on cells a fourth as wide as those
of the inversion, on a surface that goes on beyond the scan."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from srsinv.forward.film import Film
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.rig.error import SensorError

DEPTH_M, CELL_M, FINER, FRICTION = 0.75e-3, 5e-5, 4, 0.3
SURFACE = Periodic(2**14, CELL_M / FINER)
MARGIN = 8 * round(DEPTH_M / CELL_M)  # cells beyond the scan's ends
P_PA, Q_PA = 2000.0, 800.0  # rms; q where it is independent of p
SCAN = ConstantSpeed(0.05)
Rng = np.random.Generator


def hurst(exponent: float):
    """The spectrum of the pressure in full contact with a self-affine surface: k^2 times that of
    heights, which rolls off at 10 mm and is smooth below 0.1 mm."""

    def power(k):
        rolls_off = k**2 + (2 * np.pi / 1e-2) ** 2
        return k**2 * rolls_off ** (-0.5 - exponent) * np.exp(-((k * 5e-5) ** 2))

    return power


SPECTRA = {
    "exponential": lambda k: 1 / (1 + (k * 2e-3) ** 2),
    "Hurst 0.5": hurst(0.5),
    "Hurst 0.8": hurst(0.8),
    "Hurst 1": hurst(1.0),
    "Gaussian": lambda k: np.exp(-((k * 1.5e-3) ** 2) / 2),
    "white": np.ones_like,
}


def _waves(rng: Rng, x: np.ndarray) -> np.ndarray:
    length = SURFACE.n * float(SURFACE.cell_m)
    each = [(round(length / wave), *rng.uniform(0.5, 2, 2)) for wave in (0.7e-3, 1.9e-3, 4.3e-3)]
    return sum((a * np.cos(2 * np.pi * (n * x / length + b)) for n, a, b in each), np.zeros(x.size))


def _ridges(rng: Rng, x: np.ndarray) -> np.ndarray:
    return ((x - rng.uniform(0, 4e-3)) % 4e-3 < 0.6e-3).astype(float)


def _tape(rng: Rng, x: np.ndarray) -> np.ndarray:
    middle = x[x.size // 2] + rng.uniform(-5e-3, 5e-3)
    return (np.abs(x - middle) < 4e-3).astype(float)


def _partial(rng: Rng, x: np.ndarray) -> np.ndarray:
    height = _rough(rng, SPECTRA["Hurst 0.8"])
    return np.maximum(height / height.std() - 0.8, 0.0)


SHAPES = {"waves": _waves, "ridges": _ridges, "tape": _tape, "partial contact": _partial}


def _rough(rng: Rng, power) -> np.ndarray:
    root = np.sqrt(power(np.asarray(SURFACE.k)))
    root[0] = 0.0
    return np.fft.irfft(root * np.fft.rfft(rng.normal(size=SURFACE.n)), SURFACE.n)


def traction(surface: str, rng: Rng, independent: bool) -> Float[np.ndarray, "2 n"]:
    """p and q [Pa] on the whole surface."""
    x = np.asarray(SURFACE.x)

    def drawn(rms: float) -> np.ndarray:
        own = SHAPES[surface](rng, x) if surface in SHAPES else _rough(rng, SPECTRA[surface])
        own = own - own.mean()
        return own * rms / own.std()

    p = drawn(P_PA)
    return np.stack([p, drawn(Q_PA) if independent else FRICTION * p])


def sensor(depth_m=DEPTH_M, elements=2, gain=1.0, angle_deg=90.0) -> Sensor:
    """One element or two, the second beside the first, each averaging over its width."""
    films = Film(depth_m), Film(depth_m, np.deg2rad(angle_deg), length_m=8e-3 * gain, offset_m=3e-4)
    return Sensor([film.with_strip_average() for film in films[:elements]])


@dataclasses.dataclass(frozen=True)
class RoughScan:
    """A scan with so much noise: the `problem` as stated, and the true traction on its line."""

    problem: LineProblem
    truth: Float[np.ndarray, "2 n"]


def rough_scan(
    surface: str,
    seed: int,
    stated: Sensor,
    true: Sensor | None = None,
    *,
    length_m: float = 0.04,
    snr_dB: float = 40.0,
    independent: bool = False,
    rig: SensorError | None = None,
    friction: float | None = FRICTION,
) -> RoughScan:
    """A scan of a surface by the `true` sensor, inverted by what is `stated` of it, and by this
    friction unless p and q are independent."""
    rng = np.random.default_rng(seed)
    whole = traction(surface, rng, independent)
    elements = len(stated.elements)
    true = sensor(elements=elements) if true is None else true
    signal = np.asarray(_signals(true, jnp.asarray(whole)))
    n = round(length_m / CELL_M)
    first = SURFACE.n // 2 - FINER * n // 2
    signal = signal[:, first + FINER * np.arange(n)]
    level = signal.std() * 10 ** (-snr_dB / 20)
    signal = signal + level * rng.normal(size=signal.shape)
    start_m = float(SURFACE.x[first]) - MARGIN * CELL_M
    line = Open(n + 2 * MARGIN, CELL_M, start_m)
    cells = slice(MARGIN, MARGIN + n)
    data, observed = np.zeros((elements, line.n)), np.zeros((elements, line.n), bool)
    data[:, cells], observed[:, cells] = signal, True
    # A cell's average has its middle between two of the finer cells.
    before = first - FINER * MARGIN - FINER // 2
    own = whole[:, before : before + FINER * line.n]
    truth = own.reshape(2, line.n, FINER).mean(axis=-1)
    problem = LineProblem.of_sensor(
        line,
        stated,
        SCAN,
        data,
        np.full((1, line.k.size), level**2),
        observed=observed,
        known_mean_Pa=(0.0, None),
        friction=None if independent else friction,
        rig=rig,
    )
    return RoughScan(problem, truth)


@eqx.filter_jit
def _signals(sensor: Sensor, whole):
    return SURFACE.operator(sensor.output(SCAN))(whole)
