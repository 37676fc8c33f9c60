"""The paper's Figs. 10 and 11: inversion by the theoretical kernel and by a measured one."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray
from jaxtyping import Float

from srsinv import config
from srsinv.errors import choice, number, refuse, whole
from srsinv.forward.sensor import Sensor
from srsinv.forward.simulation import Simulation
from srsinv.inverse.estimate import COMPONENTS, Estimate, relative_error
from srsinv.inverse.kernel.measure import measure_kernel
from srsinv.inverse.kernel.measured import MeasuredKernel, as_netcdf, kernels
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.method import Method
from srsinv.inverse.rig.error import SensorError
from srsinv.inverse.simulated import noisy_problem
from srsinv.progress import stage
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, significant

from .figures import draw_kernels, draw_recovered
from .passes import KnownPasses, MeanPasses

KERNELS = ("theoretical", "measured", "fitted", "true")
DEPARTURE = "experiments.fig10_11.departure.Departure"
OF_SENSOR = "tilt_deg", "blur_m", "gain"


def run(cfg: config.Config) -> Result:
    """p and q by four kernels from the same signals, of as many draws of all noise.

    Raises `BadInput` for more than one method, no pass or draw, effects that sample in time, and
    refusals of the configuration's parts.
    """
    passes, draws = (whole(key, cfg[key], "a whole number from 1", least=1)
                     for key in ("passes", "draws"))  # fmt: skip
    with config.precision(cfg):
        methods = config.methods(cfg)
        refuse(
            len(methods) > 1,
            f"method names {', '.join(methods)}: give one, by which the kernels are compared.",
        )
        method = next(iter(methods.values()))
        stated, true_cfg = config.simulation(cfg).sensor, of_truth(cfg)
        test, known = config.simulation(true_cfg), known_passes(true_cfg, cfg)
        recorder = test.scenario.recorder
        refuse(
            recorder.samples_in_time or bool(recorder.conversions),
            "effects names one of the recording (sampling, speed, clipping, "
            "quantisation), but this experiment takes one sample per cell: leave it out.",
        )
        friction = float(known_input(cfg)["base_friction"])
        truth, each = np.asarray(test.traction(test.line)), []
        for i, key in enumerate(jax.random.split(config.random_key(cfg), draws)):
            with stage(f"measuring the kernel and inverting by it, draw {i + 1} of {draws}"):
                for_passes, for_test = jax.random.split(key)
                means = known.means(passes, for_passes)
                found = measured(known, means, stated, friction)
                problem = noisy_problem(test, for_test)
                each.append((means, found, inverted(problem, method, stated, test, found)))
    return _result(cfg, test, stated, known, truth, each)


def of_truth(cfg: config.Config) -> config.Config:
    """The configuration with the sensor that is simulated in place of the stated one."""
    truth = config.part(cfg, "truth")
    wanted = "a positive depth in metres"
    depth = float(number("truth.depth_m", truth["depth_m"], wanted, above=0))
    departure = {"_target_": DEPARTURE, **{name: truth[name] for name in OF_SENSOR}}
    return {
        **cfg,
        "sensor": {**cfg["sensor"], "depth_m": depth},
        "skin": truth["skin"],
        "effects": {**config.part(cfg, "effects"), "departure": departure},
    }


def known_input(cfg: config.Config) -> Mapping[str, Any]:
    """The scene of the known input."""
    inputs = config.part(cfg, "known_inputs")
    return inputs[choice("calibration", cfg["calibration"], inputs)]


def known_passes(true_cfg: config.Config, cfg: config.Config) -> KnownPasses:
    """The passes of the true sensor over the known input."""
    own = {**true_cfg, "scene": known_input(cfg)}
    speed = float(cfg["scan"]["speed_m_per_s"])
    back = {**own, "scan": {**cfg["scan"], "speed_m_per_s": -speed}}
    return KnownPasses(config.simulation(own), config.simulation(back))


def measured(
    known: KnownPasses, means: MeanPasses, stated: Sensor, friction: float
) -> dict[str, MeasuredKernel]:
    """The kernel that the means alone give, and that about the fitted theory."""
    problem = means.problem(known.onwards, stated)
    given = problem, stated, known.pressure_Pa, friction
    return {"measured": measure_kernel(*given), "fitted": measure_kernel(*given, parameters=None)}


def inverted(
    problem: LineProblem,
    method: Method,
    stated: Sensor,
    test: Simulation,
    found: Mapping[str, MeasuredKernel],
) -> dict[str, Estimate]:
    """The estimates from the same signals by each kernel."""
    given: dict[str, tuple[Sensor, SensorError | None]] = {
        "theoretical": (stated, None),
        **{name: (each.sensor(stated), each.error) for name, each in found.items()},
        "true": (test.sensor, None),
    }
    return {name: method(with_sensor(problem, *given[name])) for name in KERNELS}


def with_sensor(
    problem: LineProblem, sensor: Sensor, rig: SensorError | None = None
) -> LineProblem:
    """The same signals, with another sensor's operator."""
    assert problem.scan is not None
    return LineProblem.of_sensor(
        problem.line, sensor, problem.scan, problem.data + problem.mean_signal, problem.noise,
        known_mean_Pa=problem.known_mean_Pa, rig=rig, shared_noise=problem.shared_noise,
    )  # fmt: skip


Draw = tuple[MeanPasses, dict[str, MeasuredKernel], dict[str, Estimate]]


def _result(
    cfg: config.Config,
    test: Simulation,
    stated: Sensor,
    known: KnownPasses,
    truth: Float[np.ndarray, "2 n"],
    draws: list[Draw],
) -> Result:
    means, found, estimates = draws[0]
    errors = np.array([
        [relative_error(np.asarray(own[name].value), truth) for name in KERNELS]
        for *_, own in draws
    ])  # fmt: skip
    rms = np.sqrt(np.mean(errors**2, axis=0))
    shares = [_shares(known, test, stated, *draw[:2]) for draw in draws]
    lags = found["measured"].lags.x_m
    table = {name: each.value for name, each in found.items()} | {
        "theoretical": kernels(stated, stated.elements, lags),
        "true": kernels(test.sensor, test.sensor.elements, lags),
    }
    by, along = ("kernel", "component"), ("kernel", "element", "component", "lag")
    data = dataset(
        {
            "error": (by, rms, "1", "error_{component}_{kernel}"),
            **_excess(rms),
            "repeating_share": ("model", np.mean(shares, axis=0), "1",
                                "residual_repeating_share_{model}"),
            "response": (along, np.stack([table[name] for name in KERNELS]), "C m/N"),
            "response_stderr": (along[1:], found["measured"].stderr, "C m/N"),
            "traction": (("component", "x"), truth, "Pa"),
            "estimate": ((*by, "x"),
                         np.stack([np.asarray(estimates[name].value) for name in KERNELS]), "Pa"),
            "estimate_stderr": ((*by, "x"),
                                np.stack([np.asarray(estimates[name].stderr) for name in KERNELS]),
                                "Pa"),
            "known_pressure": ("x", known.pressure_Pa, "Pa"),
            "known_signal": (("element", "x"), means.signal[: len(stated.elements)],
                             stated.amplifier.unit),
            **scalars(_numbers(found["fitted"], len(means.difference), len(draws))),
        },
        {"kernel": (list(KERNELS), "1"), "component": (list(COMPONENTS), "1"),
         "model": (list(KERNELS[:3]), "1"), "element": (stated.element_names, "1"),
         "lag": (lags, "m"), "x": (np.asarray(test.line.x), "m")},
        method=next(iter(config.methods(cfg))), noise=", ".join(cfg["noise"]),
        effects_on=listed(cfg["effects"]), passes=len(means.difference), draws=len(draws),
        stated_depth_m=float(stated.depth_m),
        friction=float(known_input(cfg)["base_friction"]), known_input=cfg["calibration"],
        skin=test.sensor.skin.words, remarks=_remarks(draws),
        **{f"truth_{name}": float(cfg["truth"][name]) for name in ("depth_m", *OF_SENSOR)},
    )  # fmt: skip
    files = {
        "kernel.nc": as_netcdf(found["measured"]),
        "fitted_kernel.nc": as_netcdf(found["fitted"]),
    }
    own = sections(__file__, kernels=draw_kernels, recovered=draw_recovered)
    return Result(_title(data), data, own, files)


def _excess(rms: Float[np.ndarray, "kernel 2"]) -> dict[str, tuple[Any, ...]]:
    """Errors of p beyond the true kernel's, sqrt(e^2 - e_true^2), and their ratios; and those of
    the errors themselves, with the least that any kernel could have."""
    e = dict(zip(KERNELS, rms[:, 0], strict=True))
    excess = {name: np.sqrt(max(e[name] ** 2 - e["true"] ** 2, 0.0)) for name in KERNELS[:3]}
    theory = excess["theoretical"] or np.nan
    return scalars({
        **{f"excess_error_p_{name}": float(each) for name, each in excess.items()},
        "excess_ratio_p_measured": float(excess["measured"] / theory),
        "excess_ratio_p_fitted": float(excess["fitted"] / theory),
        "error_ratio_p_measured": float(e["measured"] / e["theoretical"]),
        "error_ratio_p_fitted": float(e["fitted"] / e["theoretical"]),
        "error_ratio_p_floor": float(e["true"] / e["theoretical"]),
    })  # fmt: skip


def _shares(
    known: KnownPasses,
    test: Simulation,
    stated: Sensor,
    means: MeanPasses,
    found: Mapping[str, MeasuredKernel],
) -> list[float]:
    """How much of what each model leaves of the passes over the known input repeats."""
    sim = known.onwards
    traction = sim.traction(sim.line)
    sensors = [stated, *(found[name].sensor(stated) for name in KERNELS[1:3])]
    left = [
        means.signal - np.asarray(each.in_both_directions().operator(sim.line, sim.scan)(traction))
        for each in sensors
    ]
    return [means.repeating_share(each) for each in left]


def _remarks(draws: list[Draw]) -> str:
    """What speaks against the measured kernels, in any draw."""
    said = {
        f"Of the {name} kernel in some draw: {sentence}"
        for _, found, _ in draws
        for name, kernel in found.items()
        for sentence in kernel.warnings
    }
    return " ".join(sorted(said))


def _numbers(fitted: MeasuredKernel, passes: int, draws: int) -> dict[str, float]:
    own = {}
    for name, (value, error) in fitted.parameters.items():
        own |= {f"fitted_{name}": value, f"fitted_{name}_stderr": error}
    return {**own, "rest_over_theory": fitted.stats["rest_over_theory"], "passes": passes,
            "draws": draws}  # fmt: skip


def _title(data: xarray.Dataset) -> str:
    theory, own, best = (
        f"{significant(100 * float(data['error'].sel(kernel=name, component='p')), 2)} %"
        for name in ("theoretical", "measured", "true")
    )
    doubtful = " (doubtful)" if data.attrs["remarks"] else ""
    return (
        f"p has an error of {theory} with the theoretical kernel, {own} with the measured one and "
        f"{best} with the true one{doubtful}"
    )
