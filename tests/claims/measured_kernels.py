"""What a measured kernel is worth beside theory (hours).

A sensor of films at 0 and 90 degrees that theory does not match passes a known input both ways; its
kernel is measured, by the data alone and about the theory that is fitted with it, and signals of
another scene are inverted by each kernel. All noise is drawn anew for every draw, that of the
passes included; it is white, at 40 dB of each signal.

- `errors`: rms over draws of the relative error of p on the command's scene, for each mismatch,
  input and number of passes.
- `coverage`: of the 90 % bands of p, of traction drawn from the prior of Wiener's filter, with the
  kernel's uncertainty in them and with the kernel taken as exact.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.forward.film import Film, StripAverage
from srsinv.forward.layered import Layered
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import Skin
from srsinv.forward.traction import PressedStrip
from srsinv.grid import Periodic
from srsinv.inverse.estimate import coverage_90, relative_error
from srsinv.inverse.kernel.measure import measure_kernel
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.rule import Evidence
from srsinv.inverse.method import Method
from srsinv.inverse.rig.error import SensorError
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from srsinv.jobs.trials import Row
from tests.claims.study import Study

LINE, SCAN, FRICTION = Periodic(1024, 0.04 / 1024, -0.02), ConstantSpeed(0.05), 0.5
SNR_DB, DEPTH_M = 40.0, 7.5e-4
RMS_PA, CORRELATION_M = 1500.0, 2e-3  # of the traction whose coverage is counted
LAYERS = (
    {"thickness_m": 1.5e-3, "youngs_modulus_Pa": 7e5, "poisson_ratio": 0.5},
    {"thickness_m": 5e-3, "youngs_modulus_Pa": 5e4, "poisson_ratio": 0.3},
)
Rng = np.random.Generator
Signal = Float[np.ndarray, "e n"]
DRAWS = {  # of errors, by sensor, input and passes
    "paper": {
        "line": {1: 200, 10: 200, 100: 200},
        "step": {10: 20, 100: 200, 1: 20},
        "ridge": {1: 20, 10: 20, 100: 20},
    },
    "depth and tilt": {"line": {1: 200, 10: 200, 100: 200}, "step": {10: 20, 100: 200}},
    "blur": {"line": {1: 200, 10: 200, 100: 200}, "step": {10: 20, 100: 20}},
    "layer": {"line": {1: 200, 10: 200, 100: 200}, "step": {10: 20, 100: 20}},
}
DRAWS_OF_COVERAGE = {"paper": {"line": {10: 1000, 1: 1000}, "step": {100: 1000}}}
KERNELS = ("theoretical", "measured", "fitted", "true")


@dataclass(frozen=True)
class Mismatch:
    """How the true sensor departs from the stated one."""

    depth_m: float = DEPTH_M
    tilt_deg: float = 0.0
    blur_m: float = 0.0
    skin: Skin | None = None

    @property
    def sensor(self) -> Sensor:
        """The true sensor."""
        films = [self._film(angle) for angle in (0.0, np.pi / 2)]
        return Sensor(films, self.skin)

    def _film(self, angle_rad: float) -> Film:
        film = Film(self.depth_m, angle_rad + np.deg2rad(self.tilt_deg)).with_strip_average()
        if not self.blur_m:
            return film
        return film.with_effect(StripAverage.at_depth(self.blur_m, self.depth_m))


STATED = Mismatch().sensor
MISMATCHES = {
    "paper": Mismatch(9e-4, 4.0, 3e-4),
    "depth and tilt": Mismatch(9e-4, 4.0),
    "blur": Mismatch(blur_m=6e-4),
    "layer": Mismatch(skin=Layered(LAYERS)),
}
X = np.asarray(LINE.x)
INPUTS = {
    "line": np.where(np.arange(LINE.n) == LINE.n // 2, 5.0 / float(LINE.cell_m), 0.0),
    "step": np.where(np.abs(X) < 0.0085, 1e4, 0.0),  # half the line long it would have no even wave
    "ridge": np.where(np.abs(X) <= 1e-3, 1e4, 0.0),
}


def signals(sensor: Sensor, traction: Float[np.ndarray, "2 n"]) -> Signal:
    """The signals without noise."""
    return np.asarray(sensor.operator(LINE, SCAN)(traction))


def noisy(clean: Signal, passes: int, rng: Rng) -> tuple[Signal, float]:
    """The mean of so many passes with noise, and the noise's level in it."""
    level = float(np.sqrt(np.mean(clean**2) / passes) * 10 ** (-SNR_DB / 20))
    return clean + level * rng.normal(size=clean.shape), level


def problem(
    sensor: Sensor, data: Signal, level: float, mean_Pa: float, rig: SensorError | None = None
) -> LineProblem:
    """Signals with white noise, their offsets not known."""
    noise = np.concatenate([[np.inf], np.full(LINE.k.size - 1, level**2)])
    return LineProblem.of_sensor(
        LINE, sensor, SCAN, data, noise, known_mean_Pa=(mean_Pa, None), rig=rig
    )


def found_kernels(
    mismatch: Mismatch, known: str, passes: int, rng: Rng, fitted: bool = True
) -> dict[str, Any]:
    """Kernels from passes with noise of their own."""
    p = INPUTS[known]
    clean = signals(mismatch.sensor.in_both_directions(), np.stack([p, FRICTION * p]))
    data, level = noisy(clean, passes, rng)
    given = problem(STATED.in_both_directions(), data, level, float(p.mean())), STATED, p, FRICTION
    own = {"measured": measure_kernel(*given)}
    return own | ({"fitted": measure_kernel(*given, parameters=None)} if fitted else {})


def scene() -> Float[np.ndarray, "2 n"]:
    """The command's scene: a pressed strip, and friction that steps up and back."""
    p = 1e4 + np.asarray(PressedStrip(5e3, 3e-3, 0.0, 2e-4).cell_average(LINE))
    step = np.tanh((X + 6e-3) / 3e-4) - np.tanh((X - 1e-2) / 3e-4)
    return np.stack([p, (0.3 + 0.15 * step) * p])


def errors(mismatch: Mismatch, known: str, passes: int, draws: int) -> Row:
    """Rms errors of p by each kernel, the excess over the true kernel's, and the mean over draws of
    the fitted kernel's error over the better of the theoretical and the measured one's."""
    truth, method = scene(), Tikhonov(rule=Evidence())
    clean = signals(mismatch.sensor, truth)
    rows = []
    for draw in range(draws):
        rng = np.random.default_rng([draw, passes])
        found = found_kernels(mismatch, known, passes, rng)
        sensors = {"theoretical": STATED, "true": mismatch.sensor}
        sensors |= {name: each.sensor(STATED) for name, each in found.items()}
        data, level = noisy(clean, 1, rng)
        rows.append([
            _error(method, problem(sensors[name], data, level, float(truth[0].mean())), truth)
            for name in KERNELS
        ])  # fmt: skip
    of = dict(zip(KERNELS, np.array(rows).T, strict=True))
    rms = {name: float(np.sqrt(np.mean(each**2))) for name, each in of.items()}
    excess = {name: float(np.sqrt(max(e**2 - rms["true"] ** 2, 0.0))) for name, e in rms.items()}
    better = min(("theoretical", "measured"), key=lambda name: of[name].mean())
    return {
        **{f"error_{name}": each for name, each in rms.items()},
        "excess_ratio_measured": excess["measured"] / excess["theoretical"],
        "excess_ratio_fitted": excess["fitted"] / excess["theoretical"],
        "error_ratio_measured": rms["measured"] / rms["theoretical"],
        "error_ratio_floor": rms["true"] / rms["theoretical"],
        "fitted_over_better": float(of["fitted"].mean() / of[better].mean()),
    }


def _error(method: Method, given: LineProblem, truth: Float[np.ndarray, "2 n"]) -> float:
    return float(relative_error(np.asarray(method(given).value), truth)[0])


def drawn(rng: Rng) -> Float[np.ndarray, "2 n"]:
    """p and q of the prior of Wiener's filter, around the line."""
    lag = np.minimum(np.arange(LINE.n), LINE.n - np.arange(LINE.n)) * float(LINE.cell_m)
    power = np.fft.rfft(np.exp(-lag / CORRELATION_M)).real
    return RMS_PA * np.fft.irfft(np.sqrt(power) * np.fft.rfft(rng.normal(size=(2, LINE.n))), LINE.n)


def coverage(mismatch: Mismatch, known: str, passes: int, draws: int) -> Row:
    """Coverage of p's 90 % bands by the measured and by the fitted kernel, with their uncertainty
    and as if they were exact, and by the theoretical and the true one."""
    prior = Exponential(RMS_PA, CORRELATION_M)
    method, inside = Wiener(prior, prior), {}
    cells = np.ones(LINE.n, bool)
    for draw in range(draws):
        rng = np.random.default_rng([draw, passes, 1])
        truth = drawn(rng)
        data, level = noisy(signals(mismatch.sensor, truth), 1, rng)
        given: dict[str, tuple[Sensor, SensorError | None]] = {
            "theoretical": (STATED, None), "true": (mismatch.sensor, None)
        }  # fmt: skip
        for name, each in found_kernels(mismatch, known, passes, rng).items():
            given[name] = each.sensor(STATED), each.error
            given[f"{name}_as_exact"] = each.sensor(STATED), None
        for name, (sensor, rig) in given.items():
            estimate = method(problem(sensor, data, level, float(truth[0].mean()), rig))
            value, stderr = np.asarray(estimate.value), np.asarray(estimate.stderr)
            inside.setdefault(name, []).append(coverage_90(value, stderr, truth, cells)[0])
    return {name: float(np.mean(rows)) for name, rows in inside.items()}


MEASURES = {"errors": (errors, DRAWS), "coverage": (coverage, DRAWS_OF_COVERAGE)}


def measured(what: str, sensor: str, known: str, passes: int, draws: int) -> Row:
    """Errors or coverage by the kernels of a sensor."""
    return MEASURES[what][0](MISMATCHES[sensor], known, passes, draws)


def cases() -> list[Row]:
    """Every sensor, input and number of passes."""
    return [
        {"what": what, "sensor": sensor, "known": known, "passes": passes, "draws": draws}
        for what, (_, table) in MEASURES.items()
        for sensor, inputs in table.items()
        for known, counts in inputs.items()
        for passes, draws in counts.items()
    ]


STUDY = Study("measured_kernels", measured, cases)
