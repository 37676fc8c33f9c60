"""The kernel of a sensor from a recording of a known feature, as a file that inversions take."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float

from .. import config
from ..errors import BadInput, echo, refuse
from ..inverse.estimate import COMPONENTS
from ..inverse.kernel.measured import MeasuredKernel, as_netcdf, is_as_written, kernels
from ..inverse.kernel.over_feature import FeatureKernel, measure_over_feature
from ..inverse.quality import Quality
from ..progress import stage
from ..recording import Recording
from ..recording.even import check_volts
from ..report.answers import answer_of, reported_parameters
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import quantity, quantity_with_error, significant, unit_of
from . import _facts
from ._fit_settings import known_feature, names_of, rig_settings
from ._kernel_plots import draw_kernels, draw_signals
from ._passes import repeating_share
from ._written_files import Target, check_target

FILE = "kernel.nc"
MODELS = ("theory", "kernel")
KEYS = ("parameters", "write")


def _is_kernel(path: Path) -> bool:
    try:
        return is_as_written(path)
    except BadInput:
        return False


KERNEL = Target("kernel.write", "a kernel's file", "measurement of a kernel", (".nc",), _is_kernel)


def run(cfg: config.Config) -> Result:
    """The job: load, fit place and friction, measure the kernel, write it."""
    with config.precision(cfg):
        given, settings = config.part(cfg, "kernel"), rig_settings(config.part(cfg, "fit"))
        names, target = _parameters(given), check_target(KERNEL, given.get("write"))
        known = known_feature(config.surface_features(cfg) or config.features(cfg))
        recording = config.recording(cfg)
        check_volts(recording)
        feature = known.with_edge(recording.sidecar)
        problem = config.recorded_problem(cfg, recording, is_wired_as_stated=True)
        with stage(f"measuring the kernel from {recording.name}"):
            found = measure_over_feature(
                problem, feature, settings["hold"], settings["free"], names
            )
        # A kernel that failed is none to go on with.
        is_good = found.quality is not Quality.FAILED
        content = as_netcdf(found.kernel) if is_good else None
        held = ", ".join(f"{key} {value:g}" for key, value in settings["hold"].items())
        facts = {
            **_facts.of_recording(recording, problem, config.part(cfg, "recording").get("times")),
            **_facts.of_cells(recording, problem, found.line_problem),
            **_facts.of_effects(config.part(cfg, "effects")),
            "held": f"{known.name}: {held}",
            "place": _known(found.place_m, "m"),
            "friction_of_feature": _known(found.friction, "1"),
            "friction_is_fitted": int(found.friction[1] > 0),
            "place_is_fitted": int(found.place_m[1] > 0),
            "has_both_ways": int(found.kernel.has_both_ways),
            "stated_depth_m": float(found.stated.depth_m),
            "reach_m": float(found.kernel.lags.x_m[-1]),
            "of_gains": found.note,
            "is_written": int(is_good),
        }
        data = _dataset(recording, found, facts)
        own = sections("measure_kernel", "assumed", kernels=draw_kernels, signals=draw_signals)
        files = {FILE: content} if content else {}
        if target is not None and content:
            target.write(content)
        return Result(_title(recording, found, data), data, own, files)


def _parameters(given: Mapping[str, Any]) -> tuple[str, ...] | None:
    unknown = sorted(set(given) - set(KEYS))
    refuse(
        bool(unknown),
        f"kernel has no key {unknown and unknown[0]!r}: choose from {', '.join(KEYS)}.",
    )
    named = given.get("parameters")
    refuse(
        isinstance(named, bool | int | float | dict),
        f"kernel.parameters is {echo(named)}: give null, or a list of names, [] for none.",
    )
    return None if named is None else names_of("kernel.parameters", named)


def _title(recording: Recording, found: FeatureKernel, data: xarray.Dataset) -> str:
    if found.quality is Quality.FAILED:
        return f"{recording.name}: the measurement of the kernel failed"
    remark = " (doubtful)" if found.quality is Quality.DOUBTFUL else ""
    errors = zip(data["shown"].values, data["relative_error"].values.max(axis=0), strict=True)
    said = " and ".join(f"{name} within {significant(100 * e, 2)} %" for name, e in errors)
    return f"{recording.name}: the kernel of {said} of its largest value{remark}"


def _known(pair: tuple[float, float], unit: str) -> str:
    value, error = pair
    return quantity_with_error(value, error, unit) if error else f"{quantity(value, unit)}, held"


def _measured_kernels(
    kernel: MeasuredKernel, theory: Float[np.ndarray, "e 2 m"]
) -> tuple[list[str], Float[np.ndarray, "2 e c m"], Float[np.ndarray, "e c m"]]:
    """What is measured: the kernels of p and of q, or, one way, their sum at the friction; the
    labels, theory and kernel, and the standard error of the latter."""
    both = np.stack([theory, kernel.value])
    if kernel.has_both_ways:
        return list(COMPONENTS), both, kernel.stderr
    weights = np.array([1.0, kernel.friction])
    error = np.sqrt(np.sum(np.einsum("jecm,c->jem", kernel.factors, weights) ** 2, axis=0))
    sign = "-" if kernel.friction < 0 else "+"
    label = f"p {sign} {abs(kernel.friction):.3g} q"
    return [label], np.einsum("aecm,c->aem", both, weights)[:, :, None], error[:, None]


def _dataset(
    recording: Recording, found: FeatureKernel, facts: Mapping[str, Any]
) -> xarray.Dataset:
    kernel, unit, problem = found.kernel, recording.signal_unit, found.line_problem
    theory = kernels(found.stated, found.stated.elements, kernel.lags.x_m)
    labels, response, error = _measured_kernels(kernel, theory)
    relative = np.sqrt(np.mean(error**2, axis=-1)) / np.abs(response[1]).max(axis=-1)
    residuals = found.residual_of_theory, found.residual
    observed, along = problem.is_observed, ("row", "x")
    signal = np.asarray(problem.data + problem.mean_signal)
    chi2 = np.array([each.chi2_per_freedom for each in residuals])
    fitted = np.stack([each.parts.fitted for each in residuals])
    variables: dict[str, tuple[Any, ...]] = {
        "response": (("model", "sensor", "shown", "lag"), response, "C m/N"),
        "response_stderr": (("sensor", "shown", "lag"), error, "C m/N"),
        "relative_error": (("sensor", "shown"), relative, "1", "kernel_error_{part}_{number}"),
        "gain_spread": ("sensor", found.gain_spread, "1", "gain_spread_{number}"),
        "known_pressure": ("x", found.pressure_Pa, "Pa"),
        "signal": (along, np.where(observed, signal, np.nan), unit),
        "fitted_signal": (("model", *along), fitted, unit),
        "whitened_residual": (along, np.asarray(found.residual.parts.whitened), "1"),
        "chi2": ("model", chi2, "1", "chi2_per_freedom_{model}"),
        **reported_parameters(kernel.parameters, _unit),
        **repeating_share(problem, chi2, "model"),
        **answer_of(found),
        **scalars(_numbers(found)),
    }  # fmt: skip
    coordinates: dict[str, tuple[Any, ...]] = {
        "model": (list(MODELS), "1"),
        "sensor": (found.stated.element_names, "1"),
        "row": (problem.sensor.element_names if problem.sensor else [], "1"),
        "shown": (labels, "1"),
        "part": ("shown", list(COMPONENTS) if kernel.has_both_ways else ["sum"], "1"),
        "number": ("sensor", np.arange(1, len(theory) + 1), "1"),
        "lag": (kernel.lags.x_m, "m"),
        "x": (np.asarray(problem.line.x), "m"),
        "reported": (list(kernel.parameters), "1"),
    }
    return dataset(variables, coordinates, signal_unit=unit, **facts)


def _unit(name: str) -> str:
    return "1" if name.endswith("_modulus") else unit_of(name)


def _numbers(found: FeatureKernel) -> dict[str, Any]:
    stats = found.kernel.stats
    numbers: dict[str, Any] = {
        "position_m": found.place_m[0],
        "position_m_stderr": found.place_m[1],
        "base_friction": found.friction[0],
        "base_friction_stderr": found.friction[1],
        "chi2_per_freedom": found.residual.chi2_per_freedom,
        "kernel_resolved_dof": stats["resolved_dof"],
        "has_both_ways": found.kernel.has_both_ways,
    }
    if "rest_over_theory" in stats:
        numbers["rest_over_theory"] = stats["rest_over_theory"]
    return numbers
