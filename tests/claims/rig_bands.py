"""What the bands of inversions of a calibrated rig are worth (minutes).

Traction is drawn from the prior of Wiener's filter, on cells a tenth as wide as those of the
inversion, and a rig from the covariance of its calibration; the signals are inverted as if the rig
were the calibrated one, once with the covariance and once as if it were known exactly. Of p
and q the cells that the scan passed are counted, less their mean, whose error would mask theirs.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from srsinv.forward.film import Film, Offset
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, as_real
from srsinv.inverse.estimate import TractionEstimate, averages, deviation, relative_error
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.problem import Problem
from srsinv.inverse.quality import Quality
from srsinv.inverse.rig.error import RigError
from srsinv.inverse.wiener import TractionSpectrum, Wiener
from srsinv.jobs.trials import Row
from srsinv.numerics import BAND_90
from tests.claims.study import Study, combinations

DRAWS, DEPTH_M, FRICTION, FINER = 60, 7.5e-4, 0.4, 10
RMS_PA, SMOOTH_M = 4e3, 1.5e-3  # correlated as exp(-dx^2 / 2 l^2)
SCAN = Motion.from_speed(np.arange(240) / 1000, np.full(240, 0.05), -6e-3)
LINE = Open(1200, 2e-5, -1.2e-2 + 1e-5)  # of the scan's window
Rng = np.random.Generator


class Smooth(TractionSpectrum):
    """Traction of `RMS_PA`, correlated as a Gaussian over `SMOOTH_M`, and a little white."""

    def power(self, problem: LineProblem) -> Float[Array, " k"]:
        line = problem.line
        own = np.sqrt(2 * np.pi) * SMOOTH_M / line.cell_m * jnp.exp(-((line.k * SMOOTH_M) ** 2) / 2)
        return RMS_PA**2 * (own + 1e-6)


METHODS = {"wiener": Wiener(Smooth(), Smooth())}


@dataclasses.dataclass(frozen=True)
class Setting:
    """A rig of so many elements with relative errors of gains, `common` to all and of each `gain`,
    and of the depth, and errors of the second element's angle and offset; p and q apart where there
    are two."""

    elements: int
    snr_dB: float
    common: float
    gain: float
    depth: float
    angle_deg: float = 0.0
    offset_m: float = 0.0

    @property
    def stderr(self) -> dict[str, float]:
        """Standard errors of the calibration, the common one of the gains aside."""
        both = {"gain_1": self.gain, "depth_m": self.depth * DEPTH_M}
        second = {
            "gain_2": self.gain, "angle_2_deg": self.angle_deg, "offset_2_m": self.offset_m
        }  # fmt: skip
        return both if self.elements == 1 else both | second

    @property
    def friction(self) -> float | None:
        """mu, of one element."""
        return FRICTION if self.elements == 1 else None

    @property
    def rig(self) -> RigError:
        """The calibration's covariance."""
        stated = {"depth_m": DEPTH_M, "angle_2_deg": 90.0, "offset_2_m": 0.0}
        values = np.array([stated.get(name, 1.0) for name in self.stderr])
        is_gain = np.array([name.startswith("gain") for name in self.stderr], float)
        own = np.diag(np.square([*self.stderr.values()]))
        covariance = own + self.common**2 * np.outer(is_gain, is_gain)
        return RigError(tuple(self.stderr), values, covariance)

    def sensor(self, off: dict[str, float]) -> Sensor:
        """The sensor that is so far from the calibrated one."""
        depth = DEPTH_M + off.get("depth_m", 0.0)
        angle = np.deg2rad(90.0 + off.get("angle_2_deg", 0.0))
        second = Film(depth, angle).with_effect(Offset(off.get("offset_2_m", 0.0)))
        return Sensor([Film(depth), second][: self.elements])

    def problems(self, rng: Rng) -> tuple[dict[str, Problem], Float[np.ndarray, "2 fine"]]:
        """A drawn scan as a problem `with` the covariance and `without`, one of a rig that is
        `exact`, and the traction."""
        traction = np.stack([_drawn(rng), _drawn(rng)])
        traction[0] -= traction[0].mean()  # as it is known from outside
        if self.friction is not None:
            traction[1] = self.friction * traction[0]
        drawn = rng.multivariate_normal(np.zeros(len(self.stderr)), self.rig.covariance)
        off = dict(zip(self.stderr, map(float, drawn), strict=True))
        clean, exact = self._signal(traction, off), self._signal(traction, {})
        level = float(np.std(exact) * 10 ** (-self.snr_dB / 20))
        noise = level * rng.normal(size=exact.shape)
        own = {"friction": self.friction, "cell_m": FINER * float(LINE.cell_m)}
        given = {"with": (clean, self.rig), "without": (clean, None), "exact": (exact, None)}
        return {
            name: Problem(self.sensor({}), SCAN, signal + noise, level, rig=rig, **own)
            for name, (signal, rig) in given.items()
        }, traction

    def _signal(self, traction: Float[np.ndarray, "2 fine"], off: dict[str, float]) -> np.ndarray:
        gains = [[1 + off.get(f"gain_{n}", 0.0)] for n in range(1, self.elements + 1)]
        operator = self.sensor(off).operator_along(LINE, SCAN)
        return np.array(gains) * np.asarray(operator(as_real(traction)))


SETTINGS = {
    "two elements, 60 dB": Setting(2, 60.0, 0.1, 0.001, 0.001, 0.05, 1e-6),
    "two elements, 40 dB": Setting(2, 40.0, 0.1, 0.005, 0.005, 0.3, 5e-6),
    "two elements, 30 dB": Setting(2, 30.0, 0.05, 0.02, 0.015, 1.0, 2e-5),
    "one element, 60 dB": Setting(1, 60.0, 0.05, 0.01, 0.01),
}


def _drawn(rng: Rng) -> Float[np.ndarray, " fine"]:
    """Traction of the prior, on a longer line than that of the scan."""
    n, cell = 2 * LINE.n, float(LINE.cell_m)
    k = 2 * np.pi * np.fft.rfftfreq(n, cell)
    root = np.sqrt(np.sqrt(2 * np.pi) * SMOOTH_M / cell) * np.exp(-((k * SMOOTH_M) ** 2) / 4)
    return RMS_PA * np.fft.irfft(root * np.fft.rfft(rng.normal(size=n)), n)[: LINE.n]


def drawn(setting: str, method: str, draws: int) -> Row:
    """Coverage of the 90 % bands of p and q, rms of the relative error of p, and qualities."""
    rng, own = np.random.default_rng(7), {"with": [], "without": [], "exact": []}
    errors: list[float] = []
    failed = 0
    for _ in range(draws):
        problems, traction = SETTINGS[setting].problems(rng)
        for name, problem in problems.items():
            estimate = METHODS[method](problem)
            cells = problem.to_grid().observed_cells
            truth = np.asarray(averages(as_real(traction), LINE, estimate.line))
            own[name].append(_covered(estimate, truth, cells))
            if name == "with":
                errors.append(float(relative_error(np.asarray(estimate.value), truth, cells)[0]))
                failed += estimate.quality is Quality.FAILED
    return {
        **{f"coverage_{c}_{name}": float(np.mean(rows, axis=0)[i])
           for i, c in enumerate("pq") for name, rows in own.items()},
        "error_p": float(np.sqrt(np.mean(np.square(errors)))),
        "failed": int(failed),
    }  # fmt: skip


def _covered(
    estimate: TractionEstimate, truth: Float[np.ndarray, "2 n"], cells: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "2"]:
    """The fraction of `cells` whose band holds p and q, less their mean over these."""
    weights = np.broadcast_to(cells / cells.sum(), (2, cells.size))
    less_mean = dataclasses.replace(estimate, mean_weights=weights).on(estimate.line)
    wrong = deviation(np.asarray(estimate.value) - truth, cells)
    return np.mean(np.abs(wrong) <= BAND_90 * np.asarray(less_mean.stderr)[:, cells], axis=1)


STUDY = Study(
    "rig_bands",
    drawn,
    lambda: combinations(setting=SETTINGS, method=METHODS, draws=[DRAWS]),
    rests_on=lambda setting, **_: dataclasses.asdict(SETTINGS[setting]),
)
