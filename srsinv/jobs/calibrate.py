"""What a rig is, from a recording of a known feature: gains, depth, angles, offsets, polarity.

It is written as a finished sidecar, with its standard errors.
"""

from collections.abc import Mapping
from typing import Any

import xarray

from .. import config
from ..inverse.diagnostics import direction_in_words
from ..inverse.problem import Problem
from ..inverse.quality import Quality
from ..inverse.rig.calibration import Calibration, calibrate
from ..progress import stage
from ..recording import Recording
from ..report.answers import answer_of, reported_parameters
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import quantity, quantity_with_error, spoken, unit_of, without_unit
from . import _facts
from ._calibrated_sidecar import SIDECAR, sidecar_of, wiring_of
from ._fit_settings import known_feature, rig_settings
from ._written_files import check_target


def run(cfg: config.Config) -> Result:
    """The job: load, fit the rig, write its sidecar."""
    with config.precision(cfg):
        settings, target = (
            rig_settings(config.part(cfg, "fit")),
            check_target(SIDECAR, config.part(cfg, "calibration").get("write")),
        )
        known = known_feature(config.surface_features(cfg) or config.features(cfg))
        wiring = wiring_of(config.part(cfg, "recording"), config.reader(cfg))
        measured = config.recording(cfg)
        recording = wiring.in_volts(measured)
        feature = known.with_edge(recording.sidecar)
        problem = config.recorded_problem(cfg, recording, is_wired_as_stated=True)
        with stage(f"fitting the rig to {recording.name}"):
            calibration = calibrate(problem, feature, settings["hold"], settings["free"])
        total = wiring.total(calibration)
        # A calibration that failed is none to go on with.
        is_good = calibration.quality is not Quality.FAILED
        sidecar = sidecar_of(recording, problem, calibration, wiring) if is_good else None
        held = ", ".join(
            f"{without_unit(key)} {quantity(value, unit_of(key))}"
            for key, value in settings["hold"].items()
        )
        facts = {
            **_facts.of_recording(measured, problem, config.part(cfg, "recording").get("times")),
            **_facts.of_effects(config.part(cfg, "effects")),
            "is_fit": 1,
            "held": f"{spoken(known.name)}: {held}",
            "noise_rms": calibration.levels.white_rms,
            "noise_sliding_rms": calibration.levels.sliding_rms,
            "noise_sliding_correlation_m": calibration.levels.longest_m,
            **({"is_written": 1} if sidecar else {}),
        }
        data = _dataset(measured, problem, calibration, total, facts)
        title = _title(recording, calibration, total)
        result = Result(title, data, sections("calibrate", "fit_recording", "assumed"),
                        {"calibration.yaml": sidecar} if sidecar else {})  # fmt: skip
        if target is not None and sidecar:
            target.write(sidecar.encode())
        return result


def _title(
    recording: Recording, calibration: Calibration, total: Mapping[str, tuple[float, float]]
) -> str:
    if calibration.quality is Quality.FAILED:
        return f"{recording.name}: the calibration failed"
    remark = " (doubtful)" if calibration.quality is Quality.DOUBTFUL else ""
    gains = [quantity_with_error(*pair, "1") for key, pair in total.items() if "gain" in key]
    said = [f"gain {' and '.join(gains)}"] if gains else []
    if "depth_m" in total:
        said.append(f"film {quantity_with_error(*total['depth_m'], 'm')} deep")
    return f"{recording.name}: {', '.join(said) or 'the rig is held'}{remark}"


def _dataset(
    recording: Recording,
    problem: Problem,
    calibration: Calibration,
    total: Mapping[str, tuple[float, float]],
    facts: Mapping[str, Any],
) -> xarray.Dataset:
    motion, along, unit = problem.motion, ("element", "sample"), recording.signal_unit
    fit = calibration.fit
    dims = ("parameter", "parameter_2")
    variables: dict[str, tuple[Any, ...]] = {
        "time": ("sample", motion.time_s, "s"),
        "position": ("sample", motion.position_m, "m"),
        "speed": ("sample", motion.speed_m_per_s, "m/s"),
        "signal": (along, calibration.data, unit),
        "fitted_signal": (along, calibration.fitted, unit),
        "whitened_residual": (along, calibration.whitened, "1"),
        **reported_parameters(total),
        "correlation": (dims, fit.correlation, "1"),
        **answer_of(calibration),
        **scalars({
            "samples": int(problem.observed.sum()),
            f"noise_rms_{unit}": facts["noise_rms"],
            "chi2_per_freedom": fit.known_chi2,
            "at_bound": ", ".join(fit.at_bound),
            "undetermined": "; ".join(map(direction_in_words, fit.undetermined)),
            "undetected_features": "",
        }),
    }  # fmt: skip
    coordinates: dict[str, tuple[Any, ...]] = {
        "element": (problem.sensor.element_names, "1"),
        "reported": (list(total), "1"),
        **dict.fromkeys(dims, (list(fit.names), "1")),
    }
    return dataset(variables, coordinates, signal_unit=unit, **facts)
